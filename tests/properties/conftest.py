"""Properties speak of double precision."""

import pytest


@pytest.fixture(autouse=True, scope="session")
def _in_double_precision(needs_f64):
    pass
