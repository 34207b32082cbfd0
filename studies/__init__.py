"""Studies beside the package: figures of the paper, benchmarks, stress. Installed as `taichi_bearings_studies`."""
