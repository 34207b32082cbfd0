"""How run.h5 stores its arrays."""

import h5py
import numpy as np
import pytest

from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")


@pytest.mark.parametrize(("spin_bottom", "components"), [(0.25, {"x": 1, "y": 1, "z": 2}), (1.0, {})])
def test_components_of_friction_that_are_0_take_no_space(spin_bottom, components, tmp_path):
    """Sides of 35 contacts are cut into chunks. Where both planes turn alike no contact bears friction."""
    settings = RunSettings(shape=(36, 3, 5), direction=(1, 2, 0), spin_top=1.0, spin_bottom=spin_bottom, threads=1)
    found = run(settings, tmp_path / "run").solution.friction
    with h5py.File(tmp_path / "run" / "run.h5") as file:
        for axis in "xyz":
            stored = file[f"contact/{axis}/friction"]
            some, part = (stored[()] != 0).any(axis=(0, 1, 2)).sum(), stored.id.get_storage_size() / stored.nbytes
            assert some == components.get(axis, 0)
            assert max(some, 1) / 3 <= part < 1.1 * max(some, 1) / 3
    np.testing.assert_array_equal(read_run(tmp_path / "run").solution.friction, found)
