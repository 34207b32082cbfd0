"""What a new method needs: a row and a class, in one file; everything else reads the table."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.errors import InputError
from taichi_bearings.lattice.incidence import contact_differences, torques, weights
from taichi_bearings.options import POSITIVE, how
from taichi_bearings.proof.certificate import largest_unbalanced_torque, lower_bound, relative_gap
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings, read_toml
from taichi_bearings.scans.plan import sample_key
from taichi_bearings.scene import Progress
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, MethodOptions, register
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.agreement.methods import assert_agreement
from tests.scenes import make_scene

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, kw_only=True)
class Relaxation(MethodOptions):
    name = "relaxation"
    implementation = "tests.solvers.test_toy_method:RelaxationMethod"
    needs_taichi = False
    solves = staticmethod(lambda law: not law.holds)

    eagerness: float = how(0.9, POSITIVE, "Share of the torque that is taken from each sphere in turn.")


class RelaxationMethod:
    """Jacobi's method for viscous contacts."""

    def __init__(self, options):
        self.options = options

    def plan(self, scene, spin):
        return ()

    def begin(self, scene, spin, fields):
        self.scene, self.axes, self.iteration = scene, scene.minimum_spin_axes, 0
        self.spin = scene.clip_to_box(scene.staggered_spin(spin, self.axes), self.axes)
        self.damping = scene.lattice.radius * scene.acting_coefficient
        self.share = self.options.eagerness / weights(self.damping, scene.lattice, self.axes)
        self.share[..., scene.lattice.is_driven] = 0.0

    def next_check(self, iteration):
        return iteration + 50

    def force(self):
        return self.damping * contact_differences(self.spin, self.scene.lattice, self.axes)

    def advance(self, steps):
        for _ in range(steps):
            self.spin = self.spin + self.share * torques(self.force(), self.scene.lattice, self.axes)
        self.iteration += steps

    def progress(self):
        scene, force = self.scene, self.force()
        return Progress(
            iteration=self.iteration,
            staggered=self.spin.copy(),
            spin_axes=self.axes,
            force=force,
            objective=scene.objective(self.spin, self.axes),
            lower_bound=lower_bound(scene, force, self.axes),
            resolution=0.0,
            largest_balance_residual=largest_unbalanced_torque(scene, force, self.axes),
        )


@pytest.fixture
def relaxation():
    yield register(Relaxation)
    del METHODS["relaxation"]


@pytest.mark.usefixtures("needs_f64")
def test_it_solves_is_certified_and_agrees(relaxation):
    scene = make_scene((4, 3, 4), "viscous")
    solution = solve(scene, Relaxation(eagerness=0.7).build(), initial_spin(scene, "zero"), StopRule(1e-9))
    assert solution.status.reached
    assert relative_gap(scene, solution.objective, solution.lower_bound) <= 1e-9
    assert "relaxation" in assert_agreement(scene)
    with pytest.raises(InputError, match="method 'relaxation' does not solve the law 'coulomb'; it solves viscous"):
        solve(make_scene((4, 3)), Relaxation().build(), initial_spin(make_scene((4, 3)), "zero"))


def test_a_name_is_given_once(relaxation):
    with pytest.raises(InputError, match="one of that name already"):
        register(Relaxation)
    with pytest.raises(InputError, match="eagerness is '-1'; it must be a positive number"):
        Relaxation(eagerness=-1)


@pytest.mark.usefixtures("needs_f64")
def test_files_hold_it(relaxation, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('shape = [4, 4]\nlaw = "viscous"\nmethod = "relaxation"\neagerness = 0.5\nfigures = "none"\n')
    summary = run(RunSettings.from_mapping(read_toml(scene)), tmp_path / "run").summary
    assert (summary["method"], summary["status"]) == ("relaxation", "certified")
    assert RunSettings.from_mapping(read_toml(tmp_path / "run")).values["eagerness"] == 0.5
    with pytest.raises(InputError, match=r"eagerness is 0\.5, but linear-solver with the law viscous does not use it"):
        run(RunSettings(shape=(4, 4), law="viscous", eagerness=0.5), tmp_path / "other")


def test_the_command_line_knows_it(tmp_path):
    program = (
        "from tests.solvers.test_toy_method import Relaxation; from taichi_bearings.solvers import register; "
        "register(Relaxation); from taichi_bearings_cli.main import main; main()"
    )

    def bearings(*words):
        command = [sys.executable, "-c", program, "run", *words]
        return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300)

    done = bearings(
        "--shape", "4,4", "--law", "viscous", "--method", "relaxation", "--eagerness", "0.8", "--figures", "none",
        "--out", str(tmp_path / "run"), "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["method"], summary["status"]) == ("relaxation", "certified")
    assert "Options of relaxation:\n  --eagerness NUMBER  Share of the torque" in bearings("--help").stdout


def test_it_renames_no_sample():
    """An option counts in a name only where it is given."""
    settings = [{}, {"law": "viscous"}, {"method": "cundall-strack", "stiffness": 2e5}, {"law": "coulomb-viscous"}]
    before = [sample_key(RunSettings(shape=(4, 4), **given)) for given in settings]
    register(Relaxation)
    try:
        assert [sample_key(RunSettings(shape=(4, 4), **given)) for given in settings] == before
        own = {sample_key(RunSettings(law="viscous", method="relaxation", eagerness=e)) for e in (0.5, 0.9, 1.0)}
        assert len(own) == 3
        default = sample_key(RunSettings(law="viscous", method="relaxation", eagerness=0.9))
        assert default == sample_key(RunSettings(law="viscous", method="relaxation"))
    finally:
        del METHODS["relaxation"]
    assert np.all([len(key) == 16 for key in before])
