"""Tests. Linear algebra has one thread in them: those of several workers of pytest would wait for each other."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded; programs that tests start have it too
