"""Dynamics and descents of several samples of a packing in one solve: the bits of each alone, one memory, own ends."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers import drive, together
from taichi_bearings.solvers.drive import Checkpoints
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule

pytestmark = pytest.mark.usefixtures("taichi_runtime")

SPRINGS = tb.CundallStrack(stiffness=1e3, damping=30.0, energy=True)
CASES = [
    (SPRINGS, "coulomb", "fcc", StopRule(2e-1)),
    (SPRINGS, "viscous", "bcc", StopRule(1e-9, duration=1.03)),
    (SPRINGS, "coulomb-viscous", "triangular", StopRule(1e-9, duration=0.0201)),
    (tb.GradientDescent(), "coulomb", "triangular", StopRule(1e-2)),
    (tb.GradientDescent(), "viscous", "fcc", StopRule(1e-8)),
    (tb.GradientDescent(momentum=False), "coulomb", "triangular", StopRule(5e-2)),
    (tb.RigidLimit(), "coulomb", "triangular", StopRule(1e-9, iterations=8)),
]


def samples(law, kind, count):
    cells = (4, 4) if kind == "triangular" else (2, 2, 2)
    return [Packing.lattice(kind, cells, seed=seed, law=law, spin_bottom=0.3) for seed in range(3, 3 + count)]


def solved(packing, options, stop, start="random", **more):
    spin = initial_spin(packing, start)
    return drive.solve(packing, options.build(), spin, stop, recording=Recording(**more.pop("times", {})), **more)


def assert_same(one, other):
    assert (one.status, one.iterations) == (other.status, other.iterations)
    for name in ("spin", "slip", "force", "friction", "state", "proven", "power", "lower_bound", "gap"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert one.history.keys() == other.history.keys()
    for name in one.history.keys() - {"seconds"}:
        np.testing.assert_array_equal(one.history[name], other.history[name], err_msg=name)
    assert one.findings.keys() == other.findings.keys()
    for name in one.findings:
        np.testing.assert_array_equal(one.findings[name], other.findings[name], err_msg=name)


@pytest.mark.parametrize(("options", "law", "kind", "stop"), CASES, ids=lambda part: getattr(part, "name", None))
def test_samples_that_are_stepped_together_have_the_bits_of_each_alone(options, law, kind, stop, monkeypatch):
    """Though they end at different times and have steps, widths and restarts of their own."""
    joins = []
    join = together.Together._join
    monkeypatch.setattr(together.Together, "_join", lambda self: (joins.append(len(self.joined)), join(self)))
    ones = samples(law, kind, 3)
    whole = solved(Packing.together(ones), options, stop)
    assert joins[:1] == ([] if options.name == "rigid-limit" else [3])
    for number, one in enumerate(ones):
        assert_same(whole.sample(number), solved(one, options, stop))
    if law == "coulomb" and options.name != "rigid-limit":
        assert len(set(whole.own["iterations"].tolist())) > 1  # of their own


def test_samples_go_by_so_many_as_fit_and_snapshots_are_those_of_each(monkeypatch):
    ones, stop = samples("coulomb", "triangular", 3), StopRule(1e-9, duration=0.003)
    monkeypatch.setattr(together, "MOST_ON_CPU", 2 * ones[0].spheres)
    times = {"history": np.array([0.001, 0.002]), "snapshots": np.array([0.0, 0.002])}
    whole = solved(Packing.together(ones), tb.CundallStrack(), stop, times=times)
    for number, one in enumerate(ones):
        alone = solved(one, tb.CundallStrack(), stop, times=times)
        assert_same(whole.sample(number), alone)
        np.testing.assert_array_equal(whole.sample(number).snapshots.spin, alone.snapshots.spin)


def test_samples_with_other_contacts_are_stepped_each_for_itself():
    ones = samples("coulomb", "triangular", 3)
    friction = ones[1].friction.copy()
    friction[7] = 0.0
    ones[1] = Packing(**{**ones[1].arrays(), "friction": friction}, seed=ones[1].seed)
    stop = StopRule(1e-9, iterations=300)
    whole = solved(Packing.together([Packing(**one.arrays(), seed=one.seed) for one in ones]), SPRINGS, stop)
    for number, one in enumerate(ones):
        assert_same(whole.sample(number), solved(one, SPRINGS, stop))


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("options", [SPRINGS, tb.GradientDescent()], ids=lambda row: row.name)
def test_samples_that_are_stopped_go_on_to_the_same_bits(options):
    packing, stop, kept, heard = Packing.together(samples("coulomb", "triangular", 3)), StopRule(1e-3), [], []
    whole = solved(packing, options, stop)

    def unwanted(report):
        heard.append(report.progress.iteration)
        return len(heard) > 12

    def written(resume=None):
        return Checkpoints(0.0, lambda arrays: kept.append({n: np.array(v) for n, v in arrays.items()}), resume)

    part = solved(packing, options, stop, monitors=[unwanted], checkpoints=written())
    assert Status.INTERRUPTED in part.own["status"]
    again = solved(packing, options, stop, checkpoints=written(kept[-1]))
    for number in range(3):
        assert_same(again.sample(number), whole.sample(number))
