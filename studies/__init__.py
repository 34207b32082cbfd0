"""Figures of the paper, benchmarks and stress tests, which use the package. Installed as `taichi_bearings_studies`."""
