"""The interactive 3D page of a run: what it holds, and the file."""
