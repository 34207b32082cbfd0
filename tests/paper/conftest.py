"""Studies compute in the runtime that the tests have, on one thread."""

import pytest


@pytest.fixture(autouse=True)
def _runtime_of_the_tests(taichi_runtime, monkeypatch):
    monkeypatch.setattr("taichi_bearings.runtime.available_threads", lambda: 1)
