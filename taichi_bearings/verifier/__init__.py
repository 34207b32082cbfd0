"""What is rigorously true of a run, from its numbers alone; borrows an order of elimination, and nothing else."""
