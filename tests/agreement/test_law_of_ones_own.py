"""A law of one's own is certified by the methods that docs/extending.md names, given what the law says of itself."""

import importlib.util
import re
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from taichi_bearings.compiler import ti
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.kernels.contact import FORCES, length
from taichi_bearings.runs import run as runs
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import estimate, scan
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS, Law, Quantity
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, CundallStrack, fastest
from tests.handbook.pages import ROOT, steps
from tests.own_laws import FAST, Bounded


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The code of the page as a module on disk; the tables have what it adds meanwhile."""
    path = tmp_path_factory.mktemp("page") / "page_extending.py"
    code = "\n\n".join(step.code for step in steps(ROOT / "docs/extending.md") if step.code)
    path.write_text(code[: code.index("scene = tb.Scene.random")], encoding="utf-8")
    spec = importlib.util.spec_from_file_location("page_extending", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["page_extending"] = module
    spec.loader.exec_module(module)
    yield module
    del LAWS["thickening"], METHODS["minimise"], FORCES["thickening"], sys.modules["page_extending"]


def least_potential(scene):
    """The least potential of discs in the laboratory frame, found by BFGS from the formula of the law alone."""
    along_x, along_y = (values.reshape(values.shape[-2:]) for values in scene.coefficients)
    spin = np.zeros(scene.lattice.shape)
    spin[:, -1] = scene.spin_top * (1 - 2 * ((np.arange(len(spin)) + spin.shape[1] - 1) % 2))

    def potential(free):
        spin[:, 1:-1] = free.reshape(spin[:, 1:-1].shape)
        parts = [(along_x[:, 1:-1], spin[:-1, 1:-1] + spin[1:, 1:-1]), (along_y, spin[:, :-1] + spin[:, 1:])]
        slips = [(eta, np.abs(scene.lattice.radius * total)) for eta, total in parts]
        return sum(float((eta * (v**2 / 2 + v**4 / 4)).sum()) for eta, v in slips)

    return minimize(potential, np.zeros(spin[:, 1:-1].size), options={"gtol": 1e-9}).fun


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("method", ["minimise", "gradient-descent"])
@pytest.mark.parametrize("shape", [(4, 5), (3, 4, 5)], ids=str)
def test_the_methods_that_the_page_names_certify_it(page, method, shape):
    scene = Scene.random(shape, seed=1, law="thickening", spin_top=3.0)
    found = solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-6))
    assert found.status is Status.CERTIFIED
    assert found.lower_bound[0] <= found.objective[0] <= found.lower_bound[0] / (1 - 1.01e-6)
    assert not found.states_proven.any()
    if len(shape) == 2:
        assert found.objective[0] == pytest.approx(least_potential(scene), rel=2e-6)
        assert found.lower_bound[0] <= least_potential(scene) * (1 + 1e-9)


def laboratory_motion(scene, spin, duration):
    """The spins of spheres after some time, from Newton's law in the laboratory frame and the formula of the law."""
    shape, radius = scene.lattice.shape, scene.lattice.radius
    inertia = (0.5 if len(shape) == 2 else 0.4) * radius**2
    spins = np.zeros((*shape, 3))
    spins[..., 2 if len(shape) == 2 else slice(None)] = spin
    free = np.zeros(shape, bool)
    free[..., 1:-1] = True
    links = []
    for axis, eta in enumerate(scene.coefficients):
        lower, upper = [slice(None)] * len(shape), [slice(None)] * len(shape)
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        links.append((tuple(lower), tuple(upper), np.eye(3)[axis], eta.reshape(*eta.shape[-len(shape) :], 1)))

    def acceleration(time, flat):
        now, torque = flat.reshape(spins.shape), np.zeros_like(spins)
        for lower, upper, normal, eta in links:
            slip = radius * np.cross(now[lower] + now[upper], normal)
            force = -eta * slip * (1 + (slip**2).sum(axis=-1, keepdims=True))
            turning = radius * np.cross(normal, force)
            torque[lower] += turning
            torque[upper] += turning
        return (torque * free[..., None] / inertia).ravel()

    found = solve_ivp(acceleration, (0, duration), spins.ravel(), rtol=1e-11, atol=1e-12)
    return found.y[:, -1].reshape(spins.shape)


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(4, 5), (3, 3, 4)], ids=str)
def test_cundall_strack_moves_it_as_newton_does(page, shape):
    """Where no contact has springs the error of Gear's method falls with the third power of the step."""
    scene = Scene.random(shape, seed=1, law="thickening", spin_top=3.0)
    spin = initial_spin(scene, "linear")
    expected = laboratory_motion(scene, spin[0], 0.2)
    error = []
    for step in (2e-3, 1e-3):
        found = solve(scene, CundallStrack(mass=1.0, time_step=step).build(), spin, StopRule(1e-15, duration=0.2))
        got = found.spin if len(shape) == 3 else np.stack([0 * found.spin, 0 * found.spin, found.spin], axis=-1)
        error.append(np.abs(got.reshape(expected.shape) - expected).max())
    assert error[1] < 1e-5
    assert 7 < error[0] / error[1] < 9
    rested = solve(scene, CundallStrack(mass=1.0).build(), spin, StopRule(1e-6))
    assert rested.status is Status.CERTIFIED
    least = solve(scene, METHODS["gradient-descent"]().build(), spin, StopRule(1e-8))
    assert rested.objective[0] == pytest.approx(least.objective[0], rel=2e-6)


def test_a_force_that_vectors_do_not_know_is_refused_in_a_sentence(page, monkeypatch):
    """The compiler would end the process without a message."""
    scene = Scene.random((4, 5), law="thickening")
    refused = {
        "ti.exp": uses_exp,
        "abs": uses_abs,
        "a minus sign before a term": uses_sign,
        "if (use ti.select)": uses_if,
    }
    for used, force in refused.items():
        monkeypatch.setitem(FORCES, "thickening", force)
        with pytest.raises(InputError, match=f"law is 'thickening', whose compiled force uses {re.escape(used)}"):
            solve(scene, METHODS["gradient-descent"]().build(), initial_spin(scene, "linear"), StopRule(1e-6))


@ti.func
def uses_exp(difference: ti.template(), coefficients: ti.template(), radius):
    return [coefficients[0] * ti.exp(d) for d in ti.static(difference)]


@ti.func
def uses_abs(difference: ti.template(), coefficients: ti.template(), radius):
    return [coefficients[0] * radius * abs(d) for d in ti.static(difference)]


@ti.func
def uses_sign(difference: ti.template(), coefficients: ti.template(), radius):
    return [-(coefficients[0] * d) for d in ti.static(difference)]


@ti.func
def uses_if(difference: ti.template(), coefficients: ti.template(), radius):
    scale = radius
    if difference[0] > 1.0:
        scale = 2.0 * radius
    return [coefficients[0] * scale * d for d in ti.static(difference)]


@ti.func
def without_radius(difference: ti.template(), coefficients: ti.template(), radius):
    slip = length(difference)
    return [coefficients[0] * (1.0 + slip * slip) * d for d in ti.static(difference)]


@ti.func
def by_component(difference: ti.template(), coefficients: ti.template(), radius):
    return [coefficients[0] * radius * (1.0 + (radius * d) ** 2) * d for d in ti.static(difference)]


@pytest.mark.parametrize("method", ["gradient-descent", "cundall-strack"])
@pytest.mark.parametrize("force", [without_radius, by_component])
def test_a_compiled_force_that_is_not_that_of_the_class_is_refused(page, monkeypatch, method, force):
    scene = Scene.random((4, 5), law="thickening")
    monkeypatch.setitem(FORCES, "thickening", force)
    with pytest.raises(InputError, match=r"law is 'thickening', whose compiled force at slip .* both must be the same"):
        solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-6))


@pytest.mark.usefixtures("needs_f64")
def test_the_slip_of_the_law_is_that_of_the_laboratory(page):
    """Two radii with the same surface speeds are one problem: the kernel's force depends on R |D| alone."""
    thin, thick = (
        Scene.random((4, 5), seed=1, law="thickening", spin_top=2 / radius, radius=radius) for radius in (0.5, 2.0)
    )
    rule = StopRule(1e-7)
    power = [
        solve(s, METHODS["gradient-descent"]().build(), initial_spin(s, "linear"), rule).power[0] for s in (thin, thick)
    ]
    assert power[0] == pytest.approx(power[1], rel=1e-6)


def test_others_refuse_it_in_a_sentence_and_auto_descends(page):
    scene = Scene.random((4, 5), law="thickening")
    takes = {name for name, row in METHODS.items() if not row.refusal(scene)}
    assert takes == {"minimise", "gradient-descent", "cundall-strack"}
    assert fastest(scene, 1e-6, on_gpu=False).name in takes
    for name in set(METHODS) - takes:
        assert f"method {name!r} does not solve the law 'thickening'; it solves" in METHODS[name].refusal(scene)
    with pytest.raises(InputError, match="law is 'thickening'; packings can have coulomb, viscous, coulomb-viscous"):
        Packing.lattice("square", (3, 4), law="thickening")


@pytest.mark.usefixtures("needs_f64")
def test_a_run_says_what_its_bound_rests_on(page, tmp_path):
    settings = RunSettings(shape=(4, 4), law="thickening", method="minimise", tolerance=1e-5, figures="none")
    found = runs.run(settings, tmp_path / "run")
    assert found.summary["status"] == "certified"
    assert found.summary["warnings"][0].startswith("what is proven rests on the law 'thickening' as it was given")
    with pytest.raises(
        FileError, match="has the law 'thickening'; only coulomb, viscous, coulomb-viscous can be verified"
    ):
        verify(tmp_path / "run")
    known = LAWS.pop("thickening")
    try:
        with pytest.raises(FileError, match="once the file that defines them is imported"):
            verify(tmp_path / "run")
    finally:
        LAWS["thickening"] = known


@pytest.mark.usefixtures("needs_f64")
def test_gradient_descent_refuses_a_law_that_is_infinitely_steep(page, monkeypatch):
    scene = Scene.random((4, 5), law="thickening")
    monkeypatch.setattr(type(scene.law), "steepest", lambda self, of, slip: np.full_like(of[0], np.inf))
    with pytest.raises(
        InputError, match="whose force is infinitely steep at some slip; gradient-descent and cundall-strack need"
    ):
        solve(scene, METHODS["gradient-descent"]().build(), initial_spin(scene, "linear"), StopRule(1e-6))


WRONG = {
    "its force must not fall as the slip grows": {"force": lambda self, of, slip: of[0] * slip / (1 + slip**2)},
    "its power must be force times slip": {"power": lambda self, of, slip: of[0] * slip},
    "potential(v) + conjugate(force(v)) must be force(v) * v": {"conjugate": lambda self, of, force: 0 * force},
    "must be finite numbers": {"conjugate": lambda self, of, force: force * np.nan},
    "its potential and its power must be 0 without slip": {
        "potential": lambda self, of, slip: of[0] * (1 + slip**2 / 2)
    },
    "its power must be `share` times its potential": {"share": 1.0},
    "its `steepest` must be at least the slope": {"steepest": lambda self, of, slip: of[0] * (slip < 1e-5)},
}  # fmt: skip


@pytest.mark.parametrize("sentence", WRONG)
def test_a_law_that_contradicts_itself_is_refused(sentence):
    right = {
        "force": lambda self, of, slip: of[0] * slip,
        "power": lambda self, of, slip: of[0] * slip**2,
        "potential": lambda self, of, slip: of[0] * slip**2 / 2,
        "conjugate": lambda self, of, force: force**2 * np.divide(0.5, of[0], out=0 * of[0], where=of[0] > 0),
    }
    share = WRONG[sentence].get("share", 2.0)
    more = {name: function for name, function in WRONG[sentence].items() if callable(function)}
    quantity = (Quantity("damping", "force*time/length"),)
    Scene.random((3, 4), law=type("Right", (Law,), right)("right", quantity, share=2.0))
    law = type("Wrong", (Law,), right | more)("wrong", quantity, share=share)
    with pytest.raises(InputError) as told:
        Scene.random((3, 4), law=law)
    assert sentence in str(told.value)
    assert "law is 'wrong', whose functions contradict each other at a contact with coefficient" in str(told.value)


@pytest.mark.parametrize("wrong", ["a tenth", "none where it bends", "nothing"])
def test_a_slope_that_is_too_small_is_refused(wrong):
    """Of a force that grows up to a speed; beyond, only the largest slope so far may be returned."""
    too_small = {
        "a tenth": lambda self, of, slip: of[0] / FAST / 10,
        "none where it bends": lambda self, of, slip: of[0] / FAST * (slip < FAST),
        "nothing": lambda self, of, slip: 0.0 * of[0],
    }
    quantity = (Quantity("limit", "force"),)
    Scene.random((3, 4), law=Bounded("right", quantity, minimises="potential"))
    law = type("Flat", (Bounded,), {"steepest": too_small[wrong]})("flat", quantity, minimises="potential")
    with pytest.raises(InputError, match=r"law is 'flat', .* its `steepest` must be at least the slope of its force"):
        Scene.random((3, 4), law=law)


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_conjugate_that_divides_by_the_coefficient_of_an_absent_contact_is_refused():
    class Naive(Bounded):
        def conjugate(self, of, force):
            return np.where(force > of[0], np.inf, FAST * force**2 / (2 * of[0]))

    with pytest.raises(
        InputError, match=r"law is 'naive', whose conjugate is nan at contacts that take no part, .*where="
    ):
        Scene.random((3, 4), law=Naive("naive", (Quantity("limit", "force"),), minimises="potential"))


def test_a_scan_refuses_a_law_that_its_processes_would_not_know(page, tmp_path):
    (tmp_path / "scan.toml").write_text('shape = [4, 5]\nlaw = "thickening"\n[scan]\nseed = { start = 0, stop = 2 }\n')
    plan = read_plan(tmp_path / "scan.toml")
    for asked in (lambda: estimate(plan, tmp_path / "out"), lambda: scan(plan, tmp_path / "out")):
        with pytest.raises(InputError, match="law is 'thickening', a law of your own; scans allow coulomb, viscous, "):
            asked()
    assert not (tmp_path / "out").exists()
