"""Whatever a run came to, its file says no more than it proves: honest runs are verified, forged ones refuted."""

import shutil
from contextlib import suppress
from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.runs.run import resume, run, write_state
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import PlanarCut
from taichi_bearings.solvers.answer import with_forces_of
from taichi_bearings.solvers.drive import solve
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("taichi_runtime")
MIXED = {"law": "coulomb-viscous"}
HONEST = {
    "splitting cut short, weak contacts": {
        "shape": (2, 2, 3), "method": "operator-splitting", "distribution": "bimodal:1e-12,1,0.5", "iterations": 7,
    },
    "springs that still load": {"shape": (3, 9), "method": "cundall-strack", "seed": 25, "iterations": 5000},
    "a plane by splitting": {"shape": (3, 9), "method": "operator-splitting", "seed": 33, "tolerance": 1e-3},
    "nearly equal driving": {
        "shape": (3, 9), "method": "operator-splitting", "spin_bottom": 1 - 1e-14, "iterations": 1000,
    },
    "snapshots": {
        "shape": (2, 3), "method": "implicit-cundall-strack", "replicas": 3, "duration": 0.5, "snapshots": "0.1,0.3",
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


SCENES = st.sampled_from(
    [
        {}, {"spin_bottom": 0.1}, {"spin_top": 1e15}, {"spin_top": 1e-12}, {"spin_bottom": 1 - 1e-10},
        {"spin_top": 1e8, "spin_bottom": 1e8 - 1}, {"spin_top": 0.5, "spin_bottom": 0.5}, {"spin_top": 0.0,
        "spin_bottom": 0.5}, {"spin_top": -1.0, "spin_bottom": 0.7}, {"normal_force": 1e-12}, {"normal_force": 1e12},
        {"radius": 1e-12}, {"radius": 1e12}, {"distribution": "lognormal:1,5"}, {"distribution": "constant:1"},
        {"distribution": "bimodal:0.1,1,0.5"}, {"distribution": "bimodal:1e-12,1,0.5"}, {"direction": (1, 0, 0)},
        {"direction": (1, 1e-9, 0)}, {"direction": (1, 1, 1)}, {"direction": (0, 0, 1)}, {"slip_threshold": 1e-3},
        {"replicas": 3}, {"initial": "random"}, {"initial": "zero"}, {"initial": "minimum-cut"},
    ]
)  # fmt: skip
METHODS = (
    "auto", "interior-point", "operator-splitting", "gradient-descent", "cundall-strack", "implicit-cundall-strack",
    "rigid-limit", "planar-cut", "linear-solver",
)  # fmt: skip
VISCOSITIES = ("uniform:0.1,1.0", "constant:1e13", "constant:1e-13", "lognormal:1,8", "constant:1e3")
ENDS = ({"iterations": 1}, {"iterations": 7}, {"iterations": 60}, {"iterations": 5000}, {"tolerance": 1e-3})
COURSES = (
    {"duration": 0.01}, {"duration": 0.1, "snapshots": "0.03,0.1"}, {"duration": 0.1, "record": "linear:0.01,0.1,7"},
    {"iterations": 3}, {"iterations": 300}, {"duration": 0.02, "checkpoint_every": 1e-3},
)  # fmt: skip


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_honest_run_is_verified(data, tmp_path, precision):
    """Every method, law and dimension, scenes that hurt, and any end."""
    law = data.draw(st.sampled_from(["coulomb", "viscous", "coulomb-viscous"]))
    method, shape = (
        data.draw(st.sampled_from(METHODS)),
        data.draw(st.sampled_from([(6, 7), (2, 3), (4, 4, 4), (2, 3, 5)])),
    )
    given = {"law": law, "method": method, "shape": shape, "precision": precision, "time_limit": 0.7}
    given |= {"seed": data.draw(st.integers(0, 99)), **data.draw(SCENES), **data.draw(SCENES)}
    is_dynamics = method in METHODS[4:7]
    given |= data.draw(st.sampled_from(COURSES if is_dynamics else ENDS))
    if law == "coulomb-viscous":
        given["viscosity"] = data.draw(st.sampled_from(VISCOSITIES))
    folder = tmp_path / "run"
    shutil.rmtree(folder, ignore_errors=True)
    try:
        report = honest(given, folder)
        if "checkpoint_every" in given:
            resume(folder, {"duration": 2 * given["duration"]})
            report = verify(folder)
    except InputError:
        return  # a scene or an option that the method does not take
    assert report["contradictions"] == []


FORGED = {
    "discs": {"shape": (4, 5)},
    "spheres": {"shape": (3, 3, 4), "spin_bottom": 0.1},
    "dampers": {"shape": (3, 3, 4), "law": "viscous"},
    "both": {**MIXED, "shape": (3, 3, 4), "viscosity": "uniform:5,60"},
    "springs": {"shape": (3, 3, 4), "method": "cundall-strack", "duration": 0.2},
    "dashpots": {"shape": (4, 5), "law": "viscous", "method": "implicit-cundall-strack", "duration": 0.2},
}
UNCHECKED = {  # docs/proofs.md says so, "What is not checked"
    "seconds", "seconds_compile", "separation_decades", "threads", "schema_version", "duration", "step_error",
    "accurate_time_step", "elastic_share", "next_cut_over_minimum", "spin_rounding",
}  # fmt: skip
UNCHECKED_IN = {"both": ("slip_threshold",), "springs": ("contact/x/force", "contact/y/force", "contact/z/force")}


def forgeries(path, left_out):
    """(what, function of the open file) of each number in a file, but for those left out."""
    rng = np.random.default_rng(5)
    with h5py.File(path, "r") as file:
        sets = []
        file.visititems(lambda name, item: sets.append(name) if isinstance(item, h5py.Dataset) else None)
        sets = [name for name in sets if name not in left_out and not name.startswith(("history/", "snapshots/"))]
        values = {name: file[name][()] for name in sets}
        numbers = {name: np.asarray(value) for name, value in file.attrs.items() if name not in left_out}

    def put(name, new):
        return lambda file: file[name].__setitem__(..., new)

    def say(name, new):
        return lambda file: file.attrs.__setitem__(name, new)

    for name, old in values.items():
        some = tuple(rng.choice(np.argwhere(old != 0)).tolist()) if old.any() else None
        states, of_bound = old.dtype.kind == "u", name.endswith("/slip_bound")
        for factor in () if some is None or states else (2.0, 0.5, -1.0):
            if not (of_bound and factor > 1):  # less is claimed, and true
                yield f"{factor} {name}", put(name, factor * old)
        for factor in () if some is None else (1 + 1e-6, 1 - 1e-6, -1.0):
            one = old.copy()
            one[some] = (one[some] + 1) % 4 if states else factor * one[some]
            if not (of_bound and factor > 1):
                yield f"{factor} {name} at {some}", put(name, one)
    for name, old in numbers.items():
        if old.dtype.kind in "iuf" and old.size and np.isfinite(old).all():
            for new in (2 * old + 1, old - 1, -old):
                if (new != old).any():
                    yield f"{name} {old} as {new}", say(name, new)


@pytest.mark.parametrize("name", FORGED)
def test_each_number_that_is_forged_is_found(name, tmp_path, needs_f64, thorough):
    assert honest(FORGED[name], tmp_path / "run")["verified"]
    path, copy = tmp_path / "run" / "run.h5", tmp_path / "forged.h5"
    with h5py.File(path, "r+") as file:
        del file.attrs["sha256"]
    left_out = UNCHECKED.union(UNCHECKED_IN.get(name, ()))
    forged, missed = list(forgeries(path, left_out))[:: 1 if thorough else 4], []
    for what, forge in forged:
        shutil.copy(path, copy)
        with h5py.File(copy, "r+") as file:
            forge(file)
        with suppress(FileError):
            missed += [what] if verify(copy)["verified"] else []
    assert "\n".join(missed) == ""
    assert len(forged) > 25


def test_what_cannot_be_judged_is_not_said_to_be_proven(tmp_path, needs_f64):
    """A direction that no arithmetic of the verifier can follow is refused; scales beyond it are not certified."""
    with pytest.raises(InputError, match="1e-100 of the largest"):
        run(RunSettings(shape=(4, 4, 4), direction=(1, 1e-200, 0)), tmp_path / "run")
    scene = make_scene((4, 5), normal_force=1e-80)
    answer = solve(scene, PlanarCut().build(), initial_spin(scene, "linear"))
    assert (answer.lower_bound[0], answer.status.value, answer.resolved[0]) == (0.0, "stalled", False)


def test_an_answer_with_the_forces_of_another_proves_what_it_says(tmp_path, needs_f64):
    """As where operator splitting goes on from a stalled answer: spins of the one, friction of the other."""
    wanted = {"shape": (3, 3, 4), "threads": 1, "replicas": 2, "figures": "none"}
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
