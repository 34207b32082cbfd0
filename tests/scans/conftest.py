"""What tests of scans share."""

import pytest

from taichi_bearings.scans.plan import read_plan


@pytest.fixture
def plan_of(tmp_path):
    """A function that reads the plan of a scan file with this text."""

    def read(text, *overrides):
        (tmp_path / "scan.toml").write_text(text)
        return read_plan(tmp_path / "scan.toml", overrides)

    return read
