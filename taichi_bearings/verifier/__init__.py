"""What is rigorously true of a run, from its numbers alone, by code that shares nothing with solvers and certificate."""
