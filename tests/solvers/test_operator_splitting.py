"""Operator splitting against stored exact minima; its forces and its bits; which of its forces and bounds are kept."""

import math
from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings import runtime
from taichi_bearings.lattice.incidence import torques
from taichi_bearings.proof.certificate import dual_value, work_and_bound
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers import OperatorSplitting, operator_splitting
from taichi_bearings.solvers.drive import _Best, solve
from taichi_bearings.solvers.splitting_look import Look
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene, minima, scene_of


def split(scene, tolerance, start="linear", iterations=30_000):
    return solve(scene, OperatorSplitting().build(), initial_spin(scene, start), StopRule(tolerance, iterations))


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("number", range(7))
def test_exact_minima_are_enclosed_to_1e_5(number):
    """From one start or another; a sample of 5x5x5 and one of 10x10x10 from random spins."""
    entry, start = minima((3, 3, 3), (5, 5, 5), (10, 10, 10))[number], [*STARTS][number % len(STARTS)]
    solution, exact = split(scene_of(entry), 1e-5, start), entry["power_minimum"]
    assert solution.status is Status.CERTIFIED
    assert solution.lower_bound[0] <= exact * (1 + 1e-12)
    assert exact * (1 - 1e-12) <= solution.power[0] <= exact * (1 + 1e-5)
    assert (solution.history["lower_bound"] <= exact * (1 + 1e-12)).all()


@pytest.mark.usefixtures("needs_f64")
def test_spring_forces_are_balanced_and_friction_is_admissible():
    scene = make_scene((4, 6, 5), direction=(1, 2, 3), seeds=(8, 9))
    method = OperatorSplitting().build()
    spin = initial_spin(scene, "random")
    method.begin(scene, spin)
    for _ in range(3):  # the stiffness changes in between
        method.advance(40)
        progress = method.progress()
        force = progress.proof
        work = dual_value(scene, force, method.spin_axes)  # subtracts any torque that is left over
        assert np.abs(torques(force, scene.lattice, method.spin_axes)[..., 1:-1]).max() < 1e-10
        friction = np.sqrt((progress.force**2).sum(axis=0))
        assert (friction <= scene.normal_force * scene.coefficient * (1 + 1e-14)).all()
        assert (progress.lower_bound <= np.minimum(work, progress.objective)).all()


@pytest.fixture
def begins_single(monkeypatch):
    """Has all lattices begin in single precision, as large ones do, and go on in double after 60 iterations."""
    if runtime.current().is_gpu:
        pytest.skip("a GPU works in the precision of the runtime alone")
    monkeypatch.setattr(operator_splitting, "LARGE_LATTICE", 1)
    monkeypatch.setattr(operator_splitting, "SINGLE_ITERATIONS", 60)


@pytest.mark.usefixtures("needs_f64", "begins_single")
@pytest.mark.parametrize("number", [1, 4])
def test_minima_are_enclosed_where_iterations_begin_in_single_precision(number):
    entry = minima((3, 3, 3), (5, 5, 5), (10, 10, 10))[number]
    solution, exact = split(scene_of(entry), 1e-6), entry["power_minimum"]
    assert solution.status is Status.CERTIFIED
    assert solution.lower_bound[0] <= exact * (1 + 1e-12)
    assert exact * (1 - 1e-12) <= solution.power[0] <= exact * (1 + 1e-6)


@pytest.mark.usefixtures("needs_f64", "begins_single")
@pytest.mark.parametrize("stops_at", [25, 80])
def test_single_precision_has_the_same_bits_alone_beside_others_and_resumed(stops_at):
    """A checkpoint knows by the type of its arrays whether iterations are in single precision still."""
    scene = make_scene((5, 4, 7), direction=(1, 2, 0), seeds=(3, 4))
    spin, ways = initial_spin(scene, "random"), []
    for sample in (scene, scene.sample(1)):
        for resumes in (False, True):
            method = OperatorSplitting().build()
            method.begin(sample, spin[-sample.replicas :])
            method.advance(stops_at)
            if resumes:
                state, method = method.state(), OperatorSplitting().build()
                assert (state["trial"].dtype == np.float32) == (stops_at < 60)
                method.begin(sample, spin[-sample.replicas :])
                method.restore(state)
            method.advance(100 - stops_at)
            ways.append(method.progress())
    for other in ways[1:]:
        np.testing.assert_array_equal(ways[0].staggered[:, -1], other.staggered[:, -1])
        np.testing.assert_array_equal(ways[0].force[:, -1], other.force[:, -1])


def by_contact(scene, axes):
    """For each sample, contact and spin component: the indices, and the two spheres with the sign of its force."""
    lattice = scene.lattice
    for sample, contact in np.ndindex(scene.replicas, lattice.all_contacts):
        low, high = (np.unravel_index(end, lattice.shape) for end in lattice.ends[:, contact])
        felt = [slot for slot, axis in enumerate(axes) if axis != lattice.axis[contact]]
        yield sample, contact, felt, (sample, *low), (sample, *high)


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("noise", [1.0, 1e-3])
@pytest.mark.parametrize(
    ("shape", "direction", "periodic", "strength"),
    [
        ((3, 4, 5), (1, 1, 0), "", 50.0),
        ((4, 6), (1, 1, 0), "x", 50.0),
        ((4, 2, 4), (0, 1, 0), "xy", 1e-140),
    ],
)
def test_a_look_equals_sums_over_contacts_one_by_one(shape, direction, periodic, strength, noise):
    """Friction, spring forces, power, work and the bound, whose torques `fsum` adds exactly."""
    scene = make_scene(
        shape, direction=direction, periodic=tuple(periodic), seeds=(3, 4), normal_force=strength, spin_bottom=0.25
    )
    method, rng = OperatorSplitting().build(), np.random.default_rng(6)
    method.begin(scene, initial_spin(scene, "random"))
    axes, lattice, radius = method.spin_axes, scene.lattice, scene.radius
    spin = scene.staggered_spin(initial_spin(scene, "linear"), axes)
    spin = scene.impose_driving(spin + noise * rng.standard_normal(spin.shape), axes)
    size = (len(axes), 2, lattice.all_contacts)
    trial = (
        strength
        * noise
        * rng.standard_normal(size)
        * lattice.tangential_mask(axes)[:, None]
        * (scene.acting_coefficient > 0)
    )
    stored, stiffness = method.stencil.forces_at_lower_sphere(trial, method.layout), strength * np.array([0.07, 0.19])
    weights = (1.0,) * lattice.height_axis + (0.25,)
    look = Look(scene, method.stencil, method.layout, axes, spin, stored, (stiffness, weights))
    found = look.look(map)
    power, friction, springs = np.zeros(2), np.zeros(size), np.zeros(size)
    pulls = {}
    for sample, contact, felt, low, high in by_contact(scene, axes):
        limit = strength * scene.acting_coefficient[sample, contact]
        step = [spin[slot][high] - spin[slot][low] for slot in felt]
        power[sample] += strength * scene.acting_coefficient[sample, contact] * radius * math.hypot(*step)
        given = [trial[slot, sample, contact] for slot in felt]
        kept = min(1.0, limit / (math.hypot(*given) or 1e-300))
        spring = [
            weights[lattice.axis[contact]] * stiffness[sample] * d - (v - 2 * kept * v)
            for d, v in zip(step, given, strict=True)
        ]
        share = min(1.0, limit / (math.hypot(*spring) or 1e-300))
        for slot, v, b in zip(felt, given, spring, strict=True):
            friction[slot, sample, contact], springs[slot, sample, contact] = kept * v, b
            pulls.setdefault((slot, *low), []).append(share * b)
            pulls.setdefault((slot, *high), []).append(-share * b)
    half = scene.top_spin(axes) / 2
    bound = np.zeros(2)
    for (slot, sample, *place), forces in pulls.items():
        width = np.broadcast_to(half[slot], (2, *shape[:-1]))[(sample, *place[:-1])] * math.fsum(forces)
        bound[sample] += radius * {0: width, shape[-1] - 1: -width}.get(place[-1], -abs(width))
    assert (bound > 0).all() or noise == 1.0
    near = {"rel": 1e-12, "abs": 0.0}
    assert found.power == pytest.approx(power, **near)
    assert np.abs(found.friction - friction).max() <= 1e-14 * strength
    assert np.abs(found.balanced - springs).max() <= 1e-14 * strength
    assert found.bound == pytest.approx(np.maximum(bound, 0.0), rel=1e-10, abs=1e-12 * strength)
    whole = work_and_bound(scene, found.balanced, axes)
    assert found.work == pytest.approx(whole[0], **near)


@pytest.mark.usefixtures("needs_f64")
def test_another_stiffness_changes_neither_spins_nor_friction():
    """v - f and rho Omega grow by the factor; a contact that sticks keeps its trial force bit by bit."""
    scene = make_scene((4, 3, 6), direction=(1, 2, 3), seeds=(8, 9))
    method = OperatorSplitting().build()
    method.begin(scene, initial_spin(scene, "random"))
    method.advance(30)
    trial, potential, before = method.fields.read("trial"), method.fields.read("potential"), method.stiffness
    friction = method.fields.read("friction")
    change = np.array([1.7, 0.6])
    method._change_stiffness(change)
    assert (method.stiffness == change * before).all()
    factor = change[:, None, None, None]
    assert (method.fields.read("potential") == factor * potential).all()
    for axis, rows in enumerate(method.stencil.force_rows(0)):
        v, limit = trial[list(rows)], np.maximum(friction[axis], 0.0)
        length = np.sqrt((v**2).sum(axis=0))
        f = v * np.where(length > limit, limit / np.maximum(length, 1e-300), 1.0)
        new = method.fields.read("trial")[list(rows)]
        assert np.abs(new - (f + factor * (v - f))).max() <= 1e-12 * np.abs(v).max()
        sticks = length <= limit
        assert sticks.any()
        assert (new[:, sticks] == v[:, sticks]).all()


@pytest.mark.usefixtures("needs_f64")
def test_contacts_that_exceed_the_resolution_slip_in_the_exact_solution_too():
    """At the reference accuracy 585 contacts of this scene slip; a gap of 1e-7 leaves few in doubt."""
    entry = minima((10, 10, 10))[0]
    solution = split(scene_of(entry), 1e-7)
    state = solution.state[solution.scene.acting_coefficient > 0]
    assert abs((state == 1).sum() - entry["slipping"]) <= 0.03 * entry["slipping"]
    assert (state == 2).sum() <= 0.03 * entry["contacts"]


@pytest.mark.parametrize("start", ["zero", "random"])
def test_a_start_far_outside_a_small_jump(start):
    scene = make_scene((6, 6, 6), spin_bottom=0.99)
    assert split(scene, 1e-3, start, 3_000).status is Status.CERTIFIED


@pytest.mark.usefixtures("needs_f64")
def test_the_bound_that_is_kept_is_what_the_kept_forces_prove():
    """Also where forces that prove contact states are kept although they prove a little less."""
    scene = make_scene((4, 5, 6), seeds=(3, 4))
    method = OperatorSplitting().build()
    method.begin(scene, initial_spin(scene, "linear"))
    method.advance(300)
    first, best = method.progress(), _Best(method)
    weaker = first.proof * (1 - 5e-12 * np.random.default_rng(7).random(first.proof.shape))
    proven = method.proven_by(weaker)
    assert first.lower_bound[0] * (1 - 1e-11) < proven[0] < first.lower_bound[0]
    best.take(first)
    best.take(replace(first, force=weaker, proof=None, lower_bound=proven, states_believed=np.array([True, False])))
    np.testing.assert_array_equal(best.bound, [proven[0], max(proven[1], first.lower_bound[1])])
    np.testing.assert_allclose(method.proven_by(best.proof), best.bound, rtol=1e-14)


@pytest.mark.parametrize(("power", "ends"), [(-0.03, True), (-0.5, False)])
def test_a_gap_that_hardly_falls_ends_a_run_soon_after_20_000_iterations(power, ends):
    """One that falls as 1 / sqrt(iteration), as in the slowest method, never does."""
    method, iteration, has_ended = OperatorSplitting().build(), 50, False
    method.begin(scene := make_scene((3, 4)), initial_spin(scene, "linear"))
    best = _Best(method)
    while iteration < 1e6 and not has_ended:
        iteration = method.next_check(iteration)
        has_ended = best.has_stalled(iteration, iteration**power)
    assert has_ended == ends
    assert not ends or 20_000 < iteration < 25_000
