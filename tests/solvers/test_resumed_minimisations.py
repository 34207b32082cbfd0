"""Minimisations that are stopped on their way and go on from their checkpoint: the answer of an undisturbed one."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import FileError
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import packing_paths
from taichi_bearings.solvers.drive import Checkpoints, solve
from taichi_bearings.solvers.packings import least_power
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, GradientDescent, InteriorPoint, OperatorSplitting
from tests.scenes import make_scene

CASES = [
    (InteriorPoint(), "coulomb", (9, 8, 10), 1e-9, 3),
    (InteriorPoint(settle=False), "coulomb", (18, 17, 18), 1e-7, 2),
    (InteriorPoint(), "coulomb-viscous", (6, 7, 6), 1e-9, 2),
    (OperatorSplitting(), "coulomb", (8, 7, 9), 1e-4, 4),
    (GradientDescent(), "coulomb", (5, 4, 6), 1e-2, 5),
    (GradientDescent(momentum=False), "coulomb", (5, 4, 6), 3e-2, 20),
    (GradientDescent(), "viscous", (6, 7), 1e-8, 3),
]


def stopped(scene, row, stop, looks, resume=None):
    """A solve that is unwanted after so many looks, and the last checkpoint of it."""
    kept, heard = [], []

    def unwanted(report):
        heard.append(report.progress.iteration)
        return len(heard) >= looks

    checkpoints = Checkpoints(0.0, lambda arrays: kept.append({n: np.array(v) for n, v in arrays.items()}), resume)
    return solve(scene, row.build(), initial_spin(scene, "linear"), stop, [unwanted], checkpoints=checkpoints), kept[-1]


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
@pytest.mark.parametrize("replicas", [1, 2])
@pytest.mark.parametrize(("row", "law", "shape", "tolerance", "looks"), CASES, ids=lambda value: str(value)[:30])
def test_a_minimisation_that_goes_on_comes_to_the_same_bits(row, law, shape, tolerance, looks, replicas):
    goes_on_to_the_same_bits(make_scene(shape, law, seeds=tuple(range(5, 5 + replicas))), row, tolerance, looks)


PACKED = [
    (GradientDescent(), "coulomb", "fcc", 1e-3, 4),
    (GradientDescent(), "coulomb-viscous", "triangular", 1e-4, 6),
    (GradientDescent(), "viscous", "bcc", 1e-8, 3),
    (GradientDescent(momentum=False), "coulomb", "triangular", 3e-2, 20),
]


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
@pytest.mark.parametrize(("row", "law", "kind", "tolerance", "looks"), PACKED, ids=lambda value: str(value)[:30])
def test_a_descent_of_a_packing_that_goes_on_comes_to_the_same_bits(row, law, kind, tolerance, looks):
    cells = (5, 5) if kind == "triangular" else (2, 2, 3)
    goes_on_to_the_same_bits(tb.Packing.lattice(kind, cells, seed=3, law=law, spin_bottom=0.3), row, tolerance, looks)


MINIMA = [
    ("coulomb", "fcc", 3), ("coulomb", "fcc", 9), ("coulomb", "cubic", 5), ("coulomb", "cubic", 19),
    ("coulomb-viscous", "fcc", 4), ("coulomb-viscous", "cubic", 12),
]  # fmt: skip


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
@pytest.mark.parametrize("replicas", [1, 2])
@pytest.mark.parametrize(("law", "kind", "looks"), MINIMA)
def test_a_minimum_of_a_packing_that_goes_on_comes_to_the_same_bits(law, kind, looks, replicas, monkeypatch):
    """Looked at after every step, as large packings are; with oblique normals, and where states are settled exactly."""
    monkeypatch.setattr(packing_paths, "is_small", lambda system: False)
    cells = (5, 5, 6) if kind == "cubic" else (2, 3, 3)
    packings = [tb.Packing.lattice(kind, cells, seed=seed, law=law) for seed in range(replicas)]
    stop, packing = StopRule(1e-8), tb.Packing.together(packings)
    whole = least_power(packing, "interior-point", stop)
    assert whole.status is Status.CERTIFIED
    assert len(whole.history["iteration"]) > 5
    kept = []

    def written(arrays):
        kept.append({name: np.array(values) for name, values in arrays.items()})

    def unwanted(report):
        return len(kept) >= looks

    least_power(packing, "interior-point", stop, [unwanted], Checkpoints(0.0, written))
    again = least_power(packing, "interior-point", stop, [], Checkpoints(np.inf, lambda _: None, kept[-1]))
    for name in ("spin", "spin_rounding", "slip", "force", "friction", "state", "proven", "power", "lower_bound"):
        assert np.array_equal(getattr(again, name), getattr(whole, name)), name
    assert (again.status, again.iterations) == (whole.status, whole.iterations)
    for name in {*whole.history} - {"seconds"}:
        assert np.array_equal(again.history[name], whole.history[name]), name


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
def test_a_checkpoint_with_a_settled_minimum_of_another_packing_is_refused():
    kept, stop = [], StopRule(1e-8)
    large, small = (tb.Packing.lattice("cubic", (5, 5, height), seed=1) for height in (6, 5))
    least_power(large, "interior-point", stop, [], Checkpoints(0.0, kept.append))
    with pytest.raises(FileError, match="of another scene"):
        least_power(small, "interior-point", stop, [], Checkpoints(0.0, kept.append, kept[-1]))
    damaged = kept[-1] | {"0/settled/slipping": np.zeros(3, dtype=np.uint8)}
    with pytest.raises(FileError, match="has the wrong type"):
        least_power(large, "interior-point", stop, [], Checkpoints(0.0, kept.append, damaged))


def goes_on_to_the_same_bits(scene, row, tolerance, looks):
    stop = StopRule(tolerance)
    whole = solve(scene, row.build(), initial_spin(scene, "linear"), stop)
    assert whole.status is Status.CERTIFIED
    part, arrays = stopped(scene, row, stop, looks)
    if part.status is not Status.INTERRUPTED:  # done at its first looks
        assert row.name == "interior-point"
        return
    again, _ = stopped(scene, row, stop, np.inf, arrays)
    assert again.status is Status.CERTIFIED
    assert again.iterations == whole.iterations
    for name in ("spin", "friction", "state", "power", "lower_bound"):
        assert np.array_equal(getattr(again, name), getattr(whole, name)), name
    rows = again.history["iteration"]
    assert rows.tolist() == whole.history["iteration"].tolist()
    ends_again_with_the_same_bits(scene, row, stop, whole)


def ends_again_with_the_same_bits(scene, row, stop, whole):
    """A run whose process dies after its last look, before the answer is written, goes on from its last checkpoint."""
    _, last = stopped(scene, row, stop, np.inf)
    ended = Checkpoints(np.inf, lambda _: None, last)
    once_more = solve(scene, row.build(), initial_spin(scene, "linear"), stop, checkpoints=ended)
    assert (once_more.status, once_more.iterations) == (whole.status, whole.iterations)
    for name in ("spin", "friction", "state", "power", "lower_bound"):
        assert np.array_equal(getattr(once_more, name), getattr(whole, name)), name
    assert once_more.history["iteration"].tolist() == whole.history["iteration"].tolist()


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
def test_a_checkpoint_of_another_scene_is_refused():
    stop = StopRule(1e-4)
    _, arrays = stopped(make_scene((8, 7, 9), seeds=(5,)), OperatorSplitting(), stop, 2)
    with pytest.raises(FileError, match="of another scene"):
        stopped(make_scene((8, 7, 8), seeds=(5,)), OperatorSplitting(), stop, 2, arrays)
    arrays["best/objective"] = np.array([np.nan])
    with pytest.raises(FileError, match="`objective` of the best state holds a number that is infinite"):
        stopped(make_scene((8, 7, 9), seeds=(5,)), OperatorSplitting(), stop, 2, arrays)
    arrays["best/objective"] = np.ones(2)
    with pytest.raises(FileError, match=r"`objective` of the best state has the shape \(2,\); this scene has \(1,\)"):
        stopped(make_scene((8, 7, 9), seeds=(5,)), OperatorSplitting(), stop, 2, arrays)


def test_every_method_that_keeps_checkpoints_resumes_and_is_tried():
    """Two places say it: the row of options, for those who ask, and the class, for the loop."""
    for name, row in METHODS.items():
        if not row.implementation.startswith("taichi_bearings."):  # another test may have registered it
            continue
        assert row.keeps_checkpoints == type(row().build()).resumes, name
        assert not row.keeps_checkpoints or row.is_dynamics or row in {type(case[0]) for case in CASES}, name
