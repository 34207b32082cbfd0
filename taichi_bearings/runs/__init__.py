"""Runs: their settings, their solve, their directories and files, and the analysis of their answers."""
