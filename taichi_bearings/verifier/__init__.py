"""What is rigorously true of a run, from its numbers alone; shares no code with solvers and certificate."""
