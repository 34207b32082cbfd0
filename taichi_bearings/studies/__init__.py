"""Whole jobs: from a description of a run to its files."""
