"""run.h5 gives back what was stored, and says what it lacks."""

import h5py
import numpy as np
import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.runs.run_file import read_run, write_run_file
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.solved import Run
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import LinearSolver
from taichi_bearings.solvers.drive import solve
from tests.scenes import make_scene


@pytest.mark.parametrize(("shape", "seeds"), [((4, 5), (7,)), ((3, 4, 5), (7,)), ((3, 4, 5), (7, 8))], ids=str)
def test_friction_vectors_come_back_and_must_be_there(tmp_path, shape, seeds):
    scene = make_scene(shape, "viscous", seeds=seeds)
    solution = solve(scene, LinearSolver().build(), initial_spin(scene, "linear"))
    path, settings = tmp_path / "run.h5", RunSettings(shape=shape, law="viscous")
    write_run_file(path, solution, Run(settings, solution).summary | {"scene": settings.to_toml()})
    stored = read_run(path).solution
    assert stored.friction.shape == (len(seeds), scene.lattice.all_contacts, *((3,) if len(shape) == 3 else ()))
    assert (stored.friction == solution.friction).all()
    assert np.abs(stored.friction).max() > 0
    with h5py.File(path, "r+") as file:
        assert file["contact/x/friction"].attrs["units"] == "force"
        for axis in file["contact"]:
            del file[f"contact/{axis}/friction"]
    with pytest.raises(FileError, match=r"lacks contact/x/friction"):
        read_run(path)
