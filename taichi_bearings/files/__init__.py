"""The run file, written and read."""
