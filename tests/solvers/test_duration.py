"""A dynamics ends at its duration to rounding, whatever its step: by a last step that is shorter, and as accurate."""

from functools import partial

import numpy as np
import pytest
from scipy.linalg import expm

import taichi_bearings as tb
from taichi_bearings.runs.run import resume, run
from taichi_bearings.runs.settings import RunSettings
from tests.kernels.twins import incidence
from tests.scenes import KNOWN_LAWS

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
SMALL = (("triangular", (3, 4)), ("bcc", (2, 2, 3)))
solve = partial(tb.solve, threads=1)


@pytest.mark.parametrize("law", KNOWN_LAWS)
@pytest.mark.parametrize("method", ["cundall-strack", "rigid-limit"])
def test_every_dynamics_ends_at_its_duration(method, law):
    things = [tb.Scene.random((4, 5), law=law, seed=1), tb.Scene.random((3, 3, 4), law=law, seed=2)]
    if method == "cundall-strack":
        things += [tb.Packing.lattice(kind, cells, law=law, seed=3) for kind, cells in SMALL]
    for thing in things:
        for duration in (0.0123456789, 1e-7, 1e-15):
            found = solve(thing, method, start="random", duration=duration, snapshots=f"0,{duration!r}")
            assert found.status in ("finished", "certified")
            assert found.time == found.history["time"][-1] == pytest.approx(duration, rel=1e-15)
            assert found.history["time"].max() == found.time
            assert len(found.snapshots.time) == 2


def viscous_spins(scene, start, duration):
    """Spins (N,) of a lattice of discs after a time, by the exponential of the matrix of the whole system."""
    matrix, where = incidence(scene.lattice.shape)
    weight = [scene.coefficients[axis][site] for axis, site in where]
    free, radius = ~scene.lattice.is_driven.ravel(), scene.lattice.radius
    sign = np.where(np.indices(scene.lattice.shape).sum(axis=0).ravel() % 2, -1.0, 1.0)
    resistance = radius**2 * (matrix.T.multiply(weight) @ matrix).toarray() * free[:, None]
    return sign * (expm(-resistance / (radius**2 / 2) * duration) @ (sign * start.ravel()))


def test_the_last_step_keeps_the_order_of_the_scheme():
    """Third order of Gear's method with two derivatives, at a time that none of the steps divides."""
    scene, duration, errors = tb.Scene.random((4, 5), seed=1, law="viscous"), 0.0976543, []
    start = np.random.default_rng(4).uniform(-1, 1, (4, 5))
    start[:, 0], start[:, -1] = 0.0, (-1.0) ** (np.arange(4) + 4)
    expected = viscous_spins(scene, start, duration)
    for step in (4e-3, 2e-3, 1e-3):
        found = solve(scene, tb.CundallStrack(time_step=step), start=start, duration=duration)
        errors.append(np.abs(found.spin.ravel() - expected).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(3.0, abs=0.2)
    assert errors[-1] < 1e-7


@pytest.mark.parametrize("share", [1e-9, 0.01, 0.4, 0.99])
@pytest.mark.parametrize("relax", ["reset", "relax"])
def test_a_last_step_that_is_shorter_is_one_of_the_same_course(share, relax):
    """Springs, slips and books after 200 steps and a share of another lie between what they are after 200 and 201,
    but for the curvature of the course in one step."""
    scene, step = tb.Scene.random((3, 3, 4), seed=7), 2e-5
    options = tb.CundallStrack(time_step=step, slipping_spring=relax, energy=True)
    before, here, after = (
        solve(scene, options, start="random", duration=duration)
        for duration in (200 * step, (200 + share) * step, 201 * step)
    )
    assert [answer.iterations for answer in (before, here, after)] == [200, 201, 201]
    for name in ("spin", "power", "kinetic_energy", "spring_energy", "injected_energy", "dissipated_energy"):
        ends = [np.asarray(a.history[name][-1] if "_" in name else getattr(a, name)) for a in (before, here, after)]
        change = np.abs(ends[2] - ends[0]).max()
        assert np.abs(ends[1] - (1 - share) * ends[0] - share * ends[2]).max() < 0.05 * change, name
    missed = [abs(answer.history["energy_residual"][-1]) for answer in (before, here, after)]
    assert missed[1] < 2 * max(missed[0], missed[2])


@pytest.mark.parametrize("energy", [False, True])
def test_a_run_that_goes_on_for_longer_has_the_bits_of_one_that_never_ended(energy, tmp_path):
    centers = tb.Packing.lattice("bcc", (2, 2, 3), spin_bottom=0.2)
    centers.save(tmp_path / "bcc.npz")
    for number, scene in enumerate(({"shape": (3, 4)}, {"packing": str(tmp_path / "bcc.npz")})):
        settings = partial(RunSettings, method="cundall-strack", initial="random", threads=1, figures="none",
                           energy=energy, checkpoint_every=1e3, record="0.01,0.02", **scene)  # fmt: skip
        whole = run(settings(duration=0.02), tmp_path / f"whole {number}").solution
        assert run(settings(duration=0.0123456), tmp_path / f"part {number}").solution.history["time"][-1] == 0.0123456
        parts = resume(tmp_path / f"part {number}", {"duration": 0.02}).solution
        assert np.array_equal(whole.spin, parts.spin)
        assert np.array_equal(whole.force, parts.force)
        for name in set(whole.history) - {"seconds"}:
            assert np.array_equal(whole.history[name], parts.history[name], equal_nan=True), name
