"""A torque on the top in time: the top turns as one rigid body, by Cundall-Strack dynamics."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.runs.run import resume, run
from taichi_bearings.runs.run_directory import read_checkpoint
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Scene
from taichi_bearings.solvers.rigid_top import SAFE
from tests.agreement.laboratory import imposed_spin
from tests.kernels.twins import is_driven, neighbours, slip

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)
UNEVEN = {"top": (1.0, 0.3, 0.2, 0.5)}


def in_time(scene, torque, duration, method=tb.CundallStrack, **options):
    return solve(scene, method(**options), torque=torque, duration=duration)


def exact_amplitude(scene, torque, time):
    """Of the viscous law: all spins in the laboratory frame and the body, by the exponential of one matrix."""
    shape, inertia = scene.lattice.shape, 0.4 * scene.lattice.radius**2
    free = [site for site in np.ndindex(*shape) if not is_driven(site, shape)]
    unknowns = 3 * len(free) + 1
    maps, weight, of_body = np.zeros((unknowns, *shape, 3)), np.full(unknowns, inertia), 0.0
    for number, site in enumerate(free):
        maps[(range(3 * number, 3 * number + 3), *site, range(3))] = 1.0
    for site in np.ndindex(*shape):
        if site[-1] == shape[-1] - 1:
            maps[(-1, *site)] = [imposed_spin(scene, site, k) for k in range(3)]
            of_body += inertia * (maps[(-1, *site)] ** 2).sum()
    weight[-1] = of_body
    resistance = np.zeros((unknowns, unknowns))
    for lower, upper, axis in neighbours(shape):
        moves = np.array([slip(one, lower, upper, axis) for one in maps])
        resistance += scene.coefficients[axis][lower] * moves @ moves.T
    load = np.append(np.zeros(unknowns - 1), torque)
    whole = np.block([[-resistance, load[:, None]], [np.zeros((1, unknowns + 1))]])
    return expm(whole / np.append(weight, 1.0)[:, None] * time)[-2, -1]


@pytest.mark.parametrize("driving", [{}, UNEVEN], ids=["even", "uneven"])
def test_spheres_and_top_follow_the_exact_motion_with_the_order_of_the_scheme(driving):
    scene = Scene.random((2, 3, 4), seed=6, law="viscous", **driving)
    errors, books = [], []
    for step in (4e-3, 2e-3, 1e-3):
        found = in_time(scene, -3.0, 0.4, time_step=step, energy=True)
        errors.append(abs(found.history["amplitude"][-1] - exact_amplitude(scene, -3.0, 0.4)))
        books.append(abs(found.history["energy_residual"][-1]))
    assert errors[-1] < 1e-8 * abs(exact_amplitude(scene, -3.0, 0.4))
    for values, order in ((errors, 3.0), (books, 2.0)):  # of Gear's method, and of the rule that sums work
        assert np.log2(np.divide(values[:-1], values[1:])) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("driving", [{}, UNEVEN], ids=["even", "uneven"])
def test_implicit_steps_follow_the_exact_motion_with_theirs(driving):
    scene, errors = Scene.random((2, 3, 4), seed=6, law="viscous", **driving), []
    for step in (0.04, 0.02, 0.01):
        found = in_time(scene, -3.0, 0.4, tb.ImplicitCundallStrack, time_step=step)
        errors.append(abs(found.history["amplitude"][-1] - exact_amplitude(scene, -3.0, 0.4)))
        assert abs(found.history["energy_residual"][-1]) < 1e-13
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx(2.0, abs=0.1)


def test_implicit_steps_have_the_limit_of_explicit_ones():
    """Where springs relax, so that there is one; contacts that begin to slip within a step cost some of the order 2."""
    scene = Scene.random((4, 5), seed=20)
    torque = 1.3 * solve(scene).power
    expected = in_time(scene, torque, 0.05, slipping_spring="relax", time_step=2e-6).history["amplitude"][-1]
    errors = []
    for step in (2e-4, 5e-5):
        found = in_time(scene, torque, 0.05, tb.ImplicitCundallStrack, slipping_spring="relax", time_step=step)
        errors.append(abs(found.history["amplitude"][-1] / expected - 1))
    assert errors[1] < 2e-6
    assert np.log2(errors[0] / errors[1]) > 1.5 * 2


@pytest.mark.parametrize(
    ("law", "shape", "way", "method"),
    [("coulomb", (4, 5), 1, tb.CundallStrack), ("coulomb", (2, 3, 4), -1, tb.CundallStrack),
     ("coulomb-viscous", (2, 3, 4), 1, tb.CundallStrack), ("coulomb", (4, 5), -1, tb.ImplicitCundallStrack)],
)  # fmt: skip
def test_a_slow_ramp_turns_the_top_between_the_proven_bounds(shape, law, way, method):
    """Up to the error that is reported, and half as quickly half as far beyond."""
    scene, beyond = Scene.random(shape, seed=20, law=law, replicas=3 if law == "coulomb" else 2), []
    limits = solve(replace(scene, law="coulomb", viscosity=()))
    for duration in (1.0, 2.0):
        found = in_time(scene, f"0:{1.5 * way * limits.power.max()}:20", duration, method).findings
        assert found["yield_torque"] == pytest.approx(limits.power, rel=1e-8)
        turns = way * found["torque_at_yield"]
        assert (turns >= SAFE * found["yield_torque_lower_bound"]).all()
        assert (turns <= found["yield_torque"] + found["torque_at_yield_error"]).all()
        beyond.append(turns / limits.power - 1)
    assert (np.abs(beyond[1]) < 0.7 * np.abs(beyond[0])).all()


@pytest.mark.parametrize("driving", [{}, UNEVEN], ids=["even", "uneven"])
def test_above_yield_the_top_reaches_the_speed_of_the_static_solve_and_below_it_rests(driving):
    scene = Scene.random((3, 3, 4), seed=3, law="coulomb-viscous", viscosity="uniform:10,100", **driving)
    limit = solve(replace(scene, law="coulomb", viscosity=())).power
    above, below = (in_time(scene, share * limit, 1.5, energy=True) for share in (1.3, 0.9))
    assert above.findings["yields"]
    assert above.history["amplitude"][-1] == pytest.approx(above.findings["amplitude"], rel=1e-7)
    assert not below.findings["yields"]
    assert np.isnan(below.findings["torque_at_yield"])
    kinetic = below.history["kinetic_energy"]
    assert kinetic[-1] < 1e-20 * kinetic.max()
    assert np.abs(above.history["energy_residual"][-1]) < 1e-6


def test_a_ramp_is_recorded_at_its_steps_and_verified(tmp_path):
    scene = Scene.random((3, 4, 4), seed=5)
    found = in_time(scene, "10:360:10", 0.7)
    rows = found.history
    assert rows["torque"] == pytest.approx(np.arange(10.0, 361.0, 10.0), abs=500 * 1e-4)  # within a time step
    assert rows["torque"] == pytest.approx(10 + 500 * rows["time"], rel=1e-12)
    path = found.save(tmp_path / "run")
    assert verify(path)["contradictions"] == []
    assert tb.load(path).plot("history").axes[0].get_xlabel().startswith("torque")
    assert tb.load(path).findings["torque_at_yield"] == found.findings["torque_at_yield"]


@pytest.mark.parametrize(
    "method", [{"method": "cundall-strack", "energy": True}, {"method": "implicit-cundall-strack"}]
)
def test_it_goes_on_to_the_same_bits(method, tmp_path):
    settings = RunSettings(shape=(3, 4), torque="0:90:3", duration=0.2, threads=1, figures="none",
                           checkpoint_every=60.0, **method)  # fmt: skip
    whole = run(replace(settings, checkpoint_every=None), tmp_path / "whole").solution
    run(settings, tmp_path / "part", monitors=[lambda report: report.progress.time > 0.1])
    assert read_checkpoint(Path(tmp_path / "part"))[1]["time"] < 0.15
    with pytest.raises(InputError, match="duration"):
        resume(tmp_path / "part", {"duration": 1.0})
    parts = resume(tmp_path / "part").solution
    for name in set(whole.history) - {"seconds"}:
        assert np.array_equal(whole.history[name], parts.history[name]), name
    for name in whole.findings:
        assert np.array_equal(whole.findings[name], parts.findings[name], equal_nan=True), name


@pytest.mark.parametrize(
    ("torque", "method", "options", "word"),
    [("0:9:1", "auto", {}, "grows in time"), (9.0, "cundall-strack", {}, "duration"),
     (9.0, "cundall-strack", {"duration": 1.0, "start": "random"}, "starts at rest"),
     (9.0, "rigid-limit", {"duration": 1.0}, "needs --method"), ("9:0:1", "cundall-strack", {}, "rising"),
     ("0:9", "cundall-strack", {}, "rising"), ("-1:9:1", "cundall-strack", {}, "rising"),
     ("0:9:1e-9", "cundall-strack", {}, "100,000")],
)  # fmt: skip
def test_what_a_torque_in_time_cannot_be(torque, method, options, word):
    with pytest.raises(InputError, match=word):
        solve(Scene.random((3, 4)), method, torque=torque, **options)


def test_a_bottom_that_turns_loosens_the_top():
    """4x4x4 with x on top and y below: a third of the torque sets it in motion. The top turns where that lowers the
    potential less the work of the torque."""
    crossed = Scene.random((4, 4, 4), seed=3, top=(1.0, 0.0, 0.0), bottom=(0.0, 1.0, 0.0))
    held = solve(replace(crossed, bottom=(0.0,) * 4), torque=1.0).findings["yield_torque"]
    assert held == pytest.approx(167.364, abs=1e-3)
    for way in (1, -1):
        found = solve(crossed, torque=60.0 * way, tolerance=1e-12).findings
        low, high = found["yield_torque_lower_bound"], found["yield_torque"]
        assert 0.32 * held < low < high < 0.33 * held
        assert high - low < 1e-6 * high
        assert found["yields"]
        still, little, more = (
            solve(replace(crossed, top=(way * a, 0, 0)), tolerance=1e-12).power for a in (0.0, 1e-4, 1e-2)
        )
        assert little - 1e-4 * high <= still <= little - 1e-4 * low
        assert more - 1e-2 * 60.0 < still
    for case, word in (({"law": "viscous"}, "bottom"), ({"method": "cundall-strack"}, "bottom")):
        scene = Scene.random((3, 3, 4), law=case.get("law", "coulomb"), spin_bottom=0.3)
        with pytest.raises(InputError, match=word):
            solve(scene, case.get("method", "auto"), torque=3.0, **({"duration": 1.0} if "method" in case else {}))


def test_a_top_that_turns_with_the_bottom_is_held_from_turning_on_by_the_jump_alone():
    """About one axis only the difference counts: against the bottom's motion the whole least power holds the top."""
    scene = Scene.random((3, 3, 4), seed=2, spin_bottom=0.5)
    limit = solve(replace(scene, spin_bottom=0.0)).power
    against, along = (solve(scene, torque=torque, tolerance=1e-12).findings for torque in (-1.0, 1.0))
    assert (against["yields"], along["yields"]) == (False, True)
    assert against["yield_torque"] == pytest.approx(limit, rel=1e-6)
    assert along["yield_torque"] == pytest.approx(-limit, rel=1e-6)
