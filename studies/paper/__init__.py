"""The figures and claims of the paper, with a verdict for each."""
