"""Packings that are made: regular lattices, spheres put one by one, and discs that fill a strip."""
