"""What a state means: contact states, distributions. NumPy only; accepts results of any method."""
