import pytest


def oracle_or_skip():
    """The oracle of extended_precision.py; skips where python-flint is not installed."""
    return pytest.importorskip("tests.truth.extended_precision", reason="python-flint is not installed")
