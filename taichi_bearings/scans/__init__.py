"""Many runs: plan, workers, tables, figures."""
