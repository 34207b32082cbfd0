"""The rigid limit against motion worked out by hand, a conic solver, linear algebra, and its own claims."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.solvers import InteriorPoint, LinearSolver, PlanarCut, RigidLimit
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.clarabel_twin import least
from tests.kernels.twins import incidence
from tests.scenes import FRICTION_LAWS, KNOWN_LAWS, make_scene

pytestmark = pytest.mark.usefixtures("needs_f64")

RADIUS, NORMAL_FORCE, INERTIA = 0.5, 50.0, 0.4


def begun(scene, spin, **options):
    method = RigidLimit(**options).build()
    method.begin(scene, spin)
    return method


def two_discs(left, right):
    """Two free discs side by side: friction 0.7 on the top, 0.3 on the bottom, 0.1 between them; top at 1, bottom 0."""
    between, height = np.full((1, 1, 3), 0.1), np.empty((1, 2, 2))
    height[..., 0], height[..., 1] = 0.3, 0.7
    scene = Scene((between, height), normal_force=NORMAL_FORCE)
    staggered = np.zeros((1, 1, 2, 3))
    staggered[0, 0, :, 1] = left, right
    return scene, scene.laboratory_spin(scene.impose_driving(staggered, (2,)), (2,))


@pytest.mark.parametrize("steps", [1, 2, 15])
def test_a_disc_between_unequal_frictions_turns_at_a_constant_rate_until_it_sticks(steps):
    """dOmega/dt = R F_n (0.7 - 0.3) / I until the disc turns like the top."""
    scene, spin = two_discs(0.3, 0.3)
    arrival = 0.7 * INERTIA / (RADIUS * NORMAL_FORCE * 0.4)
    method = begun(scene, spin, inertia=INERTIA, time_step=0.8 * arrival / steps)
    method.advance(steps)
    assert method.staggered[0, 0, :, 1] == pytest.approx(0.3 + 0.8 * 0.7, abs=1e-9)
    method.advance(2 * steps)
    assert method.staggered[0, 0, :, 1] == pytest.approx(1.0, abs=1e-10)
    progress = method.progress()
    assert progress.lower_bound[0] == pytest.approx(progress.objective[0], rel=1e-9)
    assert progress.objective[0] == pytest.approx(2 * 0.3 * RADIUS * NORMAL_FORCE, rel=1e-10)
    assert progress.slipping[0] == 2


def test_two_discs_meet_and_go_on_together():
    """The slower one feels 0.1 more, the faster one 0.1 less, until they meet; their mean is 0.3 + 0.4 t."""
    scene, spin = two_discs(0.2, 0.4)
    unit = INERTIA / (RADIUS * NORMAL_FORCE)
    method = begun(scene, spin, inertia=INERTIA, time_step=0.25 * unit)
    for number in range(1, 7):
        method.advance(1)
        t = 0.25 * number
        expected = [min(0.2 + 0.5 * t, 0.3 + 0.4 * t), max(0.4 + 0.3 * t, 0.3 + 0.4 * t)]
        assert method.staggered[0, 0, :, 1] == pytest.approx(expected, abs=2e-5)  # root of the excess allowed


def test_rest_is_reached_in_finite_time_where_the_power_is_piecewise_linear():
    scene, spin = two_discs(0.2, 0.4)
    method = RigidLimit(inertia=INERTIA).build()
    solution = solve(scene, method, spin, StopRule(1e-12))
    assert solution.status is Status.CERTIFIED
    exact = 0.7 / 0.4 * INERTIA / (RADIUS * NORMAL_FORCE)
    assert solution.findings["rest_time"][0] == pytest.approx(exact, rel=0.02)


def conic_step(scene, axes, before, weight):
    """argmin sum mu |D| + weight / 2 |spins - before|^2 of the free spins (C, *N) by Clarabel."""
    shape = scene.lattice.shape
    matrix, where = incidence(shape)
    free = ~scene.lattice.is_driven.ravel()
    sites, contacts = int(free.sum()), len(where)
    flat = before.reshape(len(axes), -1)
    slips, fixed = np.zeros((contacts, len(axes), len(axes) * sites)), np.zeros((contacts, len(axes)))
    for number, (axis, _) in enumerate(where):
        for slot in tangential(axis, axes):
            slips[number, slot, slot * sites : (slot + 1) * sites] = matrix[number][:, free].toarray()
            fixed[number, slot] = (matrix[number][:, ~free] @ flat[slot, ~free])[0]
    friction = np.array([scene.coefficients[axis][0][site] for axis, site in where])
    own = flat[:, free].ravel()
    found = least(slips.reshape(-1, len(own)), fixed, friction, np.zeros(contacts), 1e-12, weight, own)
    after = flat.copy()
    after[:, free] = found.spins.reshape(len(axes), -1)
    return after.reshape(before.shape)


@pytest.mark.parametrize("relative_step", [0.01, 1.0, 100.0])
@pytest.mark.parametrize(
    ("shape", "driving"), [((4, 5), {}), ((3, 2, 4), {}), ((2, 3, 4), {"direction": (1, -2, 3), "spin_bottom": -0.4})]
)
def test_a_step_is_the_minimum_that_clarabel_finds(shape, driving, relative_step):
    scene = make_scene(shape, **driving)
    spin = initial_spin(scene, "random")
    method = begun(scene, spin, time_step=1.0)
    duration = relative_step * method.relaxation_time
    method = begun(scene, spin, time_step=duration)
    before = method.staggered[:, 0].copy()
    method.advance(1)
    weight = method.inertia / (duration * RADIUS * NORMAL_FORCE)
    expected = conic_step(scene, method.spin_axes, before, weight)
    assert method.staggered[:, 0] == pytest.approx(expected, abs=2e-5 * np.abs(expected - before).max() + 1e-7)


@pytest.mark.parametrize("law", FRICTION_LAWS)
@pytest.mark.parametrize("relative_step", [1e-6, 1e-2, 1.0, 1e3])
def test_a_step_obeys_the_law_of_friction_and_of_motion(relative_step, law):
    scene = make_scene((4, 3, 5), law, seeds=(8, 9), viscosity="uniform:5,60")
    spin = initial_spin(scene, "random")
    duration = relative_step * begun(scene, spin).relaxation_time
    method = begun(scene, spin, time_step=duration)
    before = method.staggered.copy()
    method.advance(1)
    change = (method.staggered - before)[..., 1:-1]
    pull = torques(method.force, scene.lattice, method.spin_axes)[..., 1:-1]
    assert method.inertia * change == pytest.approx(duration * RADIUS * pull, rel=1e-7, abs=1e-9 * duration)
    difference = contact_differences(method.staggered, scene.lattice, method.spin_axes)
    limit = scene.normal_force * scene.acting_coefficient
    if law == "coulomb-viscous":
        limit = (limit + scene.viscosities * RADIUS * vector_length(difference)) * (1 + 1e-14)
    assert (vector_length(method.force) <= limit).all()
    slips = vector_length(difference) > 1e-3
    along = limit * difference / np.maximum(vector_length(difference), 1e-300)
    assert method.force[:, slips] == pytest.approx(along[:, slips], abs=2e-3 * scene.normal_force)


@pytest.mark.parametrize("law", KNOWN_LAWS)
def test_energy_balance_and_layer_means_are_kept_to_round_off(law):
    """No contact turns a whole layer about the height, so a random start keeps the layers' means (equations.md, 3)."""
    scene = make_scene((4, 3, 5), law, spin_bottom=-0.3, seeds=(5, 6))
    spin = initial_spin(scene, "random")
    method = begun(scene, spin, error_tolerance=0.1)
    assert method.spin_axes == (0, 1, 2)
    means = method.staggered[2].mean(axis=(1, 2))
    while not (progress := method.progress()).at_rest:
        assert np.abs(progress.energy.residual).max() < 1e-12
        method.advance(1)
    assert method.staggered[2].mean(axis=(1, 2)) == pytest.approx(means, abs=1e-14)
    assert (np.ptp(method.staggered[2], axis=(1, 2)) < 1e-6).all()
    assert (progress.energy.dissipated > progress.energy.at_start).all()


def test_the_order_in_the_step_is_one():
    scene = make_scene((2, 2, 4))
    spin = initial_spin(scene, "random")
    duration = begun(scene, spin).relaxation_time / 2
    states = {}
    for steps in (3, 6, 12, 96):
        method = begun(scene, spin, time_step=duration / steps)
        method.advance(steps)
        states[steps] = method.staggered
    errors = [np.sqrt(np.mean((states[n] - states[96]) ** 2)) for n in (3, 6, 12)]
    slope = -np.polyfit(np.log([3, 6, 12]), np.log(errors), 1)[0]
    assert slope == pytest.approx(1, abs=0.2), errors


def test_viscous_decay_converges_to_the_matrix_exponential():
    scene = make_scene((3, 6), "viscous")
    spin = initial_spin(scene, "random")
    matrix, where = incidence((3, 6))
    weight = [scene.coefficients[axis][0][site] for axis, site in where]
    laplacian, free = (matrix.T.multiply(weight) @ matrix).toarray(), ~scene.lattice.is_driven.ravel()
    start = begun(scene, spin).staggered.ravel()
    rate = -(RADIUS**2) / begun(scene, spin).inertia * laplacian
    block = rate[free][:, free]
    rest = np.linalg.solve(block, -rate[free][:, ~free] @ start[~free])
    duration = 0.3 * begun(scene, spin).relaxation_time
    exact = rest + expm(duration * block) @ (start[free] - rest)
    errors = []
    for steps in (20, 40, 80):
        method = begun(scene, spin, time_step=duration / steps)
        method.advance(steps)
        errors.append(np.abs(method.staggered.ravel()[free] - exact).max())
    assert errors[0] / errors[1] == pytest.approx(2, abs=0.1)
    assert errors[1] / errors[2] == pytest.approx(2, abs=0.1)


def test_a_smaller_tolerance_makes_a_smaller_error():
    scene = make_scene((2, 3, 4))
    spin = initial_spin(scene, "random")
    duration = begun(scene, spin).relaxation_time / 2
    states = []
    for tolerance in (3e-2, 3e-3, 5e-4):
        method = begun(scene, spin, error_tolerance=tolerance)
        method.aim_at(duration)
        while method.time < duration:
            method.advance(1)
        assert method.time == duration
        states.append(method.staggered)
    coarse, fine = (np.sqrt(np.mean((state - states[-1]) ** 2)) for state in states[:2])
    assert fine < coarse / 2
    assert fine < 0.02


@pytest.mark.parametrize(
    ("shape", "law", "tolerance", "other"),
    [
        ((3, 3, 3), "coulomb", 1e-2, InteriorPoint), ((10, 10, 10), "coulomb", 1.0, InteriorPoint),
        ((8, 9), "coulomb", 1e-1, PlanarCut), ((4, 5, 6), "viscous", 1e-1, LinearSolver),
        ((4, 3, 5), "coulomb-viscous", 1e-1, InteriorPoint),
    ],
)  # fmt: skip
def test_the_stationary_power_is_the_certified_minimum(shape, law, tolerance, other):
    scene = make_scene(shape, law, seeds=(3,), viscosity="uniform:5,60")
    method = RigidLimit(error_tolerance=tolerance).build()
    solution = solve(scene, method, initial_spin(scene, "random"), StopRule(1e-13))
    assert solution.status in (Status.STATIONARY, Status.CERTIFIED)
    assert solution.gap[0] < 1e-10
    minimum = solve(scene, other().build(), initial_spin(scene, "linear"), StopRule(1e-11))
    assert solution.objective == pytest.approx(minimum.objective, rel=1e-10)


def test_a_state_that_is_wanted_at_a_time_is_met_exactly_and_the_steps_go_on_as_before():
    scene = make_scene((3, 5))
    spin = initial_spin(scene, "random")
    method = begun(scene, spin, error_tolerance=0.01)
    method.advance(4)
    length = method.length
    wanted = method.time + length / 7
    method.aim_at(wanted)
    method.advance(1)
    assert method.time == wanted
    assert method.length == length


def test_neither_rest_nor_a_stall_ends_a_run_of_given_duration():
    scene = make_scene((3, 4))
    method = begun(scene, initial_spin(scene, "minimum-cut"))
    progress = replace(method.progress(), at_rest=True, exhausted=True)
    bound = np.zeros(1)
    assert StopRule(1e-12).judge(scene, progress, progress.objective, bound, 0.0, stalled=True) is Status.STATIONARY
    assert StopRule(1e-12, duration=1.0).judge(scene, progress, progress.objective, bound, 0.0, stalled=True) is None
