"""Benchmarks: run time against error, throughput, and other solvers to compare with."""
