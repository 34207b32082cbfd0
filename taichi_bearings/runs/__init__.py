"""One run: its settings, its solve, its directory, its analysis."""
