"""Writes runs as files of other programs."""
