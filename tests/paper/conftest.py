"""Studies compute in the runtime that the tests have, on one thread, and draw each figure once."""

import pytest

from taichi_bearings.plots import style


@pytest.fixture(autouse=True)
def _runtime_of_the_tests(taichi_runtime, monkeypatch):
    monkeypatch.setattr("taichi_bearings.runtime.available_threads", lambda: 1)


@pytest.fixture(autouse=True)
def _pdf_without_a_picture(monkeypatch):
    """A PDF of a study has what the PNG beside it has; `bearings reproduce` in tests/cli draws both."""
    content = style._file_content
    monkeypatch.setattr(
        style, "_file_content", lambda figure, kind: b"%PDF" if kind == "pdf" else content(figure, kind)
    )
