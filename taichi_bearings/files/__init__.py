"""Files of results, written and read."""
