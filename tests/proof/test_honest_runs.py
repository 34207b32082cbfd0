"""Whatever a run came to, its file says no more than it proves: honest runs are verified, forged ones are not."""

import tempfile
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.runs.writing import write_state
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, PlanarCut
from taichi_bearings.solvers.answer import with_forces_of
from taichi_bearings.solvers.drive import solve
from tests.proof.forgeries import RUNS, fields_of, forged, honest_file, outcome
from tests.proof.honest import contradictions, drawn
from tests.properties.scenes import cases
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("taichi_runtime")
MIXED = {"law": "coulomb-viscous"}
HONEST = {
    "splitting cut short, weak contacts": {
        "shape": (2, 2, 3), "method": "operator-splitting", "distribution": "bimodal:1e-12,1,0.5", "iterations": 7,
    },
    "springs that still load": {"shape": (3, 9), "method": "cundall-strack", "seed": 25, "iterations": 5000},
    "a contact that slips on its way to rest": {
        "shape": (2, 3), "method": "cundall-strack", "seed": 964873, "distribution": "bimodal:1,2,0.5",
        "tolerance": 1e-3, "radius": 1e-12, "iterations": 300,
    },
    "a plane by splitting": {"shape": (3, 9), "method": "operator-splitting", "seed": 33, "tolerance": 1e-3},
    "nearly equal driving": {
        "shape": (3, 9), "method": "operator-splitting", "spin_bottom": 1 - 1e-14, "iterations": 1000,
    },
    "snapshots": {
        "shape": (2, 3), "method": "cundall-strack", "replicas": 3, "duration": 0.5, "snapshots": "0.1,0.3",
    },
    "a slow plane beside a fast one": {
        **MIXED, "shape": (3, 3, 5), "method": "rigid-limit", "spin_top": 1e-12, "spin_bottom": 99999999.0,
        "viscosity": "constant:1e3", "iterations": 3,
    },
    "stiff viscosity, nearly equal driving": {
        **MIXED, "shape": (4, 4, 4), "seed": 26, "spin_bottom": 0.9999999999, "viscosity": "constant:1e13",
        "tolerance": 1e-14,
    },
    "unfinished path": {**MIXED, "shape": (6, 7), "method": "interior-point", "iterations": 3},
    "some tolerance": {**MIXED, "shape": (3, 9), "seed": 5, "viscosity": "constant:1e3", "tolerance": 1e-3},
    "spins of 1e15": {**MIXED, "shape": (4, 4, 4), "spin_top": 1e15},
    "contrast": {"shape": (4, 4, 4), "distribution": "bimodal:1e-15,1,0.5"},
    "a threshold": {"shape": (4, 4, 4), "slip_threshold": 1e-3},
    "a threshold below the slips of rest": {**MIXED, "shape": (4, 4, 4), "slip_threshold": 1e-15},
    "descent": {**MIXED, "shape": (3, 4, 4), "method": "gradient-descent", "iterations": 50},
    "viscous forces far above friction": {
        **MIXED, "shape": (10, 10), "viscosity": "constant:1e6", "replicas": 4, "tolerance": 1e-5,
    },
    "the same in 3D": {**MIXED, "shape": (6, 6, 6), "viscosity": "constant:1e6", "seed": 1, "tolerance": 1e-5},
    "friction over twelve decades": {
        **MIXED, "shape": (2, 2, 4), "distribution": "bimodal:1e-6,1e6,0.5", "seed": 2, "tolerance": 1e-5,
    },
    "slips that spins round away": {
        **MIXED, "shape": (2, 3), "distribution": "bimodal:1e-6,1e6,0.5", "seed": 1, "tolerance": 1e-5,
    },
}  # fmt: skip


def honest(given, folder, monitors=()):
    run(RunSettings(threads=1, figures="none", **given), folder, monitors=monitors)
    return verify(folder)


@pytest.mark.parametrize("name", HONEST)
def test_an_honest_run_is_verified(name, tmp_path, needs_f64):
    assert honest(HONEST[name], tmp_path / "run")["contradictions"] == []


@pytest.mark.parametrize("method", ["operator-splitting", "interior-point", "gradient-descent", "cundall-strack"])
def test_an_interrupted_run_is_verified(method, tmp_path, needs_f64):
    looks = []
    report = honest({"shape": (4, 4, 4), "method": method}, tmp_path / "run", [lambda look: bool(looks.append(look))])
    assert report["contradictions"] == []
    halfway = max(len(looks) // 2, 1)

    def stop(look):
        looks.pop()
        return len(looks) < halfway

    report = honest({"shape": (4, 4, 4), "method": method}, tmp_path / "half", [stop])
    assert report["status"] in ("interrupted", "certified")
    assert report["contradictions"] == []


@cases()
@given(number=st.integers(0, 10**6))
def test_every_honest_run_is_verified(number, needs_f64):
    """Every method, law and dimension, scenes that hurt, and any end."""
    with tempfile.TemporaryDirectory() as folder:
        assert contradictions(drawn(7, number) | {"time_limit": 0.7}, Path(folder) / "run") in (None, [])


def test_a_bound_on_rounding_is_part_of_what_is_stated(tmp_path, needs_f64):
    """At tolerances near rounding the gap is that of the bounds, each rounded outwards: certified is proven."""
    ended = []
    for number, law in enumerate([{"shape": (3, 3, 4)}, {"shape": (4, 5)}, {"shape": (3, 3, 4), "law": "viscous"}]):
        for seed in range(3):
            folder = tmp_path / f"{number}-{seed}"
            assert contradictions(law | {"seed": seed, "tolerance": 1e-15, "iterations": 300}, folder) == []
            with h5py.File(folder / "run.h5") as file:
                said = {name: file.attrs[name] for name in ("power", "lower_bound", "gap", "status")}
            ended.append(said["status"])
            assert said["gap"] >= (said["power"] - said["lower_bound"]) / said["power"]
            assert (said["gap"] <= 1e-15) == (said["status"] == "certified")
    assert "certified" in ended


@pytest.mark.parametrize("seed", range(4))
def test_slips_that_are_proven_below_others_that_are_not_are_no_contradiction(seed, tmp_path, needs_f64):
    """The threshold is then the largest slip of a contact that is said to rest."""
    given = {**MIXED, "shape": (3, 9), "seed": seed, "distribution": "bimodal:1e-4,1e4,0.3", "method": "interior-point"}
    given |= {"spin_top": 1e8, "spin_bottom": 1e8 - 1, "viscosity": "power-law:1e-15,1e15,-1"}
    assert contradictions(given, tmp_path / "run") == []


def test_states_that_are_proven_are_those_that_are_said(needs_f64):
    """One component, thirty decades of friction, a method that says wrong things there."""
    corrected = 0
    for seed in range(6):
        scene = make_scene((4, 5), seeds=(seed,), distribution="power-law:1e-15,1e15,-1")
        answer = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"))
        states = Judgement(scene, answer.spin, answer.spin_rounding, answer.friction).states[0]
        said, proven = answer.state[0], states.known
        known = (proven != ContactState.UNDECIDED) & (said != ContactState.DRIVEN)
        assert (said[known] == proven[known]).all()
        corrected += known.sum()
    assert corrected > 50


PROVES = {
    "spin",
    "coefficient",
    "viscosity",
    "power",
    "potential",
    "lower_bound",
    "gap",
    "slipping",
    "slipless",
    "undecided",
    "contacts",
    "unproven",
    "states_proven",
    "minimum_is_unique",
    "status",
    "law",
    "seed",
    "shape",
}
OF_CONTACTS = ("/slip", "/power", "/state")  # which follow from spins, coefficients and counts; /proven may say less


@pytest.mark.parametrize("name", RUNS)
def test_what_proves_and_what_is_proven_is_not_forged_unseen(name, tmp_path, needs_f64, thorough):
    """A few of each run, and of one all fields. Friction that a dynamics stores proves what others prove as well."""
    path, rng = honest_file(name, tmp_path / "run"), np.random.default_rng(5)
    attributes, sets = fields_of(path)
    fields = ["scene", *attributes, *(1 + thorough) * sets] if name == "spheres" else []
    for field in [*fields, *[""] * (200 if thorough else 4)]:  # "" for any
        forgery = next(filter(None, (forged(path, rng, field) for _ in range(100))))
        what, named, _ = forgery
        proves = named.split("/")[0] in PROVES or (named.startswith("contact/") and named.endswith(OF_CONTACTS))
        if outcome(path, forgery, tmp_path / "forged.h5") == "missed":
            assert not proves or what == "as i8", forgery[:2]  # whole numbers are the same ones


def test_what_cannot_be_judged_is_not_said_to_be_proven(tmp_path, needs_f64):
    """A direction that no arithmetic of the proofs can follow is refused; scales beyond it are not certified."""
    with pytest.raises(InputError, match="1e-100 times the largest"):
        run(RunSettings(shape=(4, 4, 4), direction=(1, 1e-200, 0)), tmp_path / "run")
    scene = make_scene((4, 5), normal_force=1e-80)
    answer = solve(scene, PlanarCut().build(), initial_spin(scene, "linear"))
    assert (answer.lower_bound[0], answer.status.value, answer.states_proven[0]) == (0.0, "stalled", False)


def test_an_answer_with_the_forces_of_another_proves_what_it_says(tmp_path, needs_f64):
    """As where operator splitting goes on from a stalled answer: spins of the one, friction of the other."""
    wanted = {"shape": (3, 3, 4), "threads": 1, "figures": "none"}
    rough = RunSettings(method="gradient-descent", iterations=300, **wanted)
    near = RunSettings(method="interior-point", iterations=9, **wanted)
    spins, forces = (run(settings, tmp_path / settings.method) for settings in (rough, near))
    answer = with_forces_of(spins.solution, forces.solution)
    assert (answer.lower_bound == forces.solution.lower_bound).all()
    assert (answer.lower_bound > spins.solution.lower_bound).all()
    assert (answer.gap < spins.solution.gap).all()
    write_state(tmp_path / "both.h5", replace(spins, solution=answer), rough)
    assert verify(tmp_path / "both.h5")["contradictions"] == []
    mixed = replace(spins.solution, lower_bound=answer.lower_bound, gap=answer.gap)
    write_state(tmp_path / "mixed.h5", replace(spins, solution=mixed), rough)
    assert not verify(tmp_path / "mixed.h5")["verified"]
