"""A torque on the top instead of its spin: yield torques from one solve, and the speed that viscosity allows."""

from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import InputError
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Scene
from tests.agreement.laboratory import imposed_spin
from tests.kernels.twins import neighbours
from tests.scenes import KNOWN_LAWS, VISCOUS_LAWS

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
solve = partial(tb.solve, threads=1)
DRIVINGS = [{}, {"direction": (1.0, 0.0, 0.0)}, {"top": (1.0, 0.3, 0.0, 0.5)}]


def torque_on_top(best):
    """Work of the friction on the top for a unit of its state: sum of (arm x force) . spin, sphere by sphere."""
    scene, total = best.scene, 0.0
    shape, radius = scene.lattice.shape, scene.lattice.radius
    for lower, upper, axis in neighbours(shape):
        if axis == 2 and upper[2] == shape[2] - 1:
            spin = np.array([imposed_spin(scene, upper, k) for k in range(3)])
            total += np.dot(np.cross(radius * np.eye(3)[axis], best.friction[axis][lower]), spin)
    return abs(total)


@pytest.mark.parametrize(("shape", "driving"), [((5, 6), {}), *(((3, 4, 4), d) for d in DRIVINGS)], ids=str)
def test_the_yield_torque_is_the_slope_of_the_least_power(shape, driving):
    scene = Scene.random(shape, seed=4, **driving)
    low, high = (solve(scaled(scene, strength)).power for strength in (0.5, 1.5))
    found = solve(scene, torque=1.0).findings
    assert found["yield_torque"] == pytest.approx(high - low, rel=1e-10)
    assert found["yield_torque_lower_bound"] == pytest.approx(high - low, rel=1e-10)
    assert found["yield_torque_lower_bound"] <= found["yield_torque"]


@pytest.mark.parametrize("driving", DRIVINGS, ids=str)
def test_the_safe_load_is_what_friction_passes_on_to_the_top(driving):
    best = solve(Scene.random((3, 4, 4), seed=5, **driving), torque=1.0)
    assert torque_on_top(best) == pytest.approx(best.findings["yield_torque_lower_bound"], rel=1e-10)


def test_friction_holds_below_and_not_above():
    scene = Scene.random((3, 3, 4), seed=2)
    limit = solve(scene).power
    below, above = (solve(scene, torque=share * limit).findings for share in (0.999999, 1.000001))
    assert (below["yields"], below["amplitude"]) == (False, 0.0)
    assert above["yields"]
    assert np.isnan(above["amplitude"])  # nothing limits the motion
    rough = solve(scene, "gradient-descent", tolerance=1e-2, torque=limit)  # between its bounds nothing is proven
    assert not rough.findings["yields"]
    assert np.isnan(rough.findings["amplitude"])


@pytest.mark.parametrize("law", VISCOUS_LAWS)
@pytest.mark.parametrize("driving", [{}, {"top": (1.0, 0.3, 0.0, 0.5)}], ids=str)
def test_the_motion_of_that_strength_takes_that_torque(law, driving):
    """Power balance, torque x strength = power; and the torque is the slope of the potential."""
    viscosity = {"viscosity": "uniform:10,100"} if law == "coulomb-viscous" else {}
    scene = Scene.random((3, 3, 4), seed=3, law=law, **viscosity, **driving)
    torque = -1.3 * solve(scene).power
    strength = solve(scene, torque=torque).findings["amplitude"]
    assert strength < 0
    assert solve(scaled(scene, strength)).power == pytest.approx(torque * strength, rel=1e-9)
    low, high = (solve(scaled(scene, strength * (1 + part))).potential for part in (-1e-4, 1e-4))
    least = 1.0 if law == "coulomb-viscous" else 0.5  # of a viscous motion the power is twice the potential
    assert least * (high - low) / (2e-4 * strength) == pytest.approx(torque, rel=1e-6)


def test_a_strength_that_is_not_known_is_none():
    """Without frustration nothing limits the motion, and a solve that ends early does not tell how fast it is."""
    alike = Scene.random((3, 3, 4), law="coulomb-viscous", direction=(0.0, 0.0, 1.0))
    early = Scene.random((3, 3, 4), law="coulomb-viscous")
    for scene, options in ((alike, {}), (early, {"iterations": 1})):
        found = solve(scene, torque=1e3, **options).findings
        assert found["yields"]
        assert np.isnan(found["amplitude"])


def test_several_samples_and_a_forged_word(tmp_path):
    scene = Scene.random((3, 3, 4), seed=3, replicas=3)
    limits = np.sort(solve(scene).power)
    best = solve(scene, torque=float(limits[:2].mean()))
    assert best.findings["yields"].sum() == 1
    path = best.save(tmp_path / "run")
    assert verify(path)["contradictions"] == []
    with h5py.File(path / "run.h5" if path.is_dir() else path, "r+") as file:
        file.attrs["yields"] = ~np.array(file.attrs["yields"], dtype=bool)
        del file.attrs["sha256"]
    assert any("yields" in sentence for sentence in verify(path)["contradictions"])


@pytest.mark.parametrize(
    ("method", "scene"),
    [("cundall-strack", {}), ("auto", {"spin_top": 2.0}), ("auto", {"bottom": (0.0, 1.0, 0.0)})],
)  # fmt: skip
def test_what_a_torque_cannot_go_with(method, scene):
    with pytest.raises(InputError, match="torque"):
        solve(Scene.random((2, 2, 3), **scene), method, torque=3.0)


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
    with pytest.raises(InputError, match="bottom"):
        solve(Scene.random((3, 3, 4), law="viscous", spin_bottom=0.3), torque=3.0)


def test_a_top_that_turns_with_the_bottom_is_held_from_turning_on_by_the_jump_alone():
    """About one axis only the difference counts: against the bottom's motion the whole least power holds the top."""
    scene = Scene.random((3, 3, 4), seed=2, spin_bottom=0.5)
    limit = solve(replace(scene, spin_bottom=0.0)).power
    against, along = (solve(scene, torque=torque, tolerance=1e-12).findings for torque in (-1.0, 1.0))
    assert (against["yields"], along["yields"]) == (False, True)
    assert against["yield_torque"] == pytest.approx(limit, rel=1e-6)
    assert along["yield_torque"] == pytest.approx(-limit, rel=1e-6)


def test_a_top_that_the_bottom_turns_against_the_torque_is_not_called_held():
    """A bottom that turns about the same axis takes the top along, against any torque below the whole least power."""
    scene = Scene.random((3, 3, 4), seed=2, spin_bottom=0.5)
    limit = solve(replace(scene, spin_bottom=0.0)).power
    torque = -limit / 2
    still, along = (solve(replace(scene, spin_top=spin), tolerance=1e-12).power for spin in (0.0, 0.25))
    assert along - 0.25 * torque < still  # power less the work of the torque falls if the top turns with the bottom
    against, with_it = (solve(scene, torque=one, tolerance=1e-12) for one in (torque, -torque))
    (sentence,) = against.warnings
    assert (
        "does not turn the top in its direction, but the bottom may turn the top the other way: it does if the "
        in sentence
    )
    assert with_it.findings["yield_torque"] < torque  # what the sentence names
    assert not with_it.warnings


def test_no_amplitude_follows_from_a_power_that_is_not_within_the_tolerance():
    scene = Scene.random((4, 4, 5), seed=1, law="viscous")
    early = solve(scene, "gradient-descent", torque=5.0, iterations=2)
    assert early.gap > early.asked.tolerance
    assert np.isnan(early.findings["amplitude"])
    assert solve(scene, torque=5.0).findings["amplitude"] == pytest.approx(5.0 / solve(scene).power)


@pytest.mark.parametrize("law", KNOWN_LAWS)
@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 4)])
def test_every_double_about_the_yield_torque_is_decided(law, shape, tmp_path):
    """Held up to the lower bound, turning beyond the upper one, and between them neither, which is said."""
    viscosity = {"viscosity": "uniform:10,100"} if law == "coulomb-viscous" else {}
    scene = Scene.random(shape, seed=3, law=law, **viscosity)
    found = solve(scene, torque=1.0).findings
    low, high = found["yield_torque_lower_bound"], found["yield_torque"]
    assert low == high == 0.0 if law == "viscous" else low < high < low * (1 + 1e-8)
    near = (low, np.nextafter(low, np.inf), high, np.nextafter(high, np.inf), high * (1 + 1e-9))
    for torque in (torque for torque in near if torque == 0 or torque >= 1e-15):  # smaller ones cannot be asked for
        for way in (1.0, -1.0):
            best = solve(scene, torque=way * float(torque))
            found = best.findings
            assert (found["yield_torque_lower_bound"], found["yield_torque"]) == (low, high)
            assert found["yields"] == (torque > high)
            if torque <= low:
                assert found["amplitude"] == 0.0
            elif law == "coulomb" or torque <= high:
                assert np.isnan(found["amplitude"])
            said = any("not known whether it moves" in sentence for sentence in best.warnings)
            assert said == (low < torque <= high)
    path = best.save(tmp_path / "run")
    assert verify(path)["contradictions"] == []
    assert b"NaN" not in (path / "summary.json").read_bytes()


def scaled(scene, strength):
    if scene.top is None:
        return replace(scene, spin_top=strength)
    return replace(scene, top=tuple(strength * part for part in scene.top))
