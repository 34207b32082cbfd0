"""Implicit Cundall-Strack steps: their order, their stability, what they conserve, and where they end."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import minimize

from taichi_bearings.conic.contact_system import free_spins
from taichi_bearings.conic.friction_stage import Friction
from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin, random_spin
from taichi_bearings.solvers import CundallStrack, ImplicitCundallStrack
from taichi_bearings.solvers.cundall_strack import stability_bound
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.kernels.twins import incidence
from tests.scenes import make_scene, minima, name_of, scene_of

pytestmark = pytest.mark.usefixtures("needs_f64")


def begun(scene, spin, **options):
    method = ImplicitCundallStrack(**options).build()
    method.begin(scene, spin)
    return method


def advanced(scene, spin, steps, **options):
    method = begun(scene, spin, **options)
    method.advance(steps)
    return method


def random_start(scene, seed=3):
    return np.random.default_rng(seed).uniform(-1, 1, initial_spin(scene, "zero").shape)


def slope(steps, errors):
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("shape", [(3, 5), (2, 3, 4)])
def test_viscous_decay_converges_with_order_two(shape):
    scene, inertia, duration = make_scene(shape, "viscous"), 0.05, 0.1
    spin = random_start(scene)
    component = scene.minimum_spin_axes[0]
    matrix, where = incidence(shape)
    weight = np.array([scene.coefficients[a][0][s] * (a != component) for a, s in where])
    rate = -(scene.lattice.radius**2) / inertia * (matrix.T.multiply(weight) @ matrix).toarray()
    free = ~scene.lattice.is_driven.ravel()
    omega = scene.staggered_spin(spin, (component,))[0, 0].ravel()
    rest = np.linalg.solve(rate[free][:, free], -rate[free][:, ~free] @ omega[~free])
    exact = rest + expm(duration * rate[free][:, free]) @ (omega[free] - rest)
    steps, errors = 2 ** np.arange(3, 7), []
    for number in steps:
        method = advanced(scene, spin, int(number), inertia=inertia, time_step=duration / number)
        slot = method.spin_axes.index(component)
        errors.append(np.abs(method.progress().staggered[slot, 0].ravel()[free] - exact).max())
        assert method.stage.factorisations == 1  # the matrix of a linear law depends on the step alone
    assert slope(steps, errors) == pytest.approx(2, abs=0.1), errors


@pytest.mark.parametrize("damping", [0.0, 100.0])
def test_sticking_contacts_swing_with_order_two(damping):
    """Friction that nothing overcomes: springs and dashpots, compared with the matrix exponential."""
    shape, stiffness, inertia, duration = (4, 5), 1e3, 0.2, 0.02
    scene = make_scene(shape, distribution="constant:1e9")
    spin = random_start(scene)
    matrix, _ = incidence(shape)
    free, radius = ~scene.lattice.is_driven.ravel(), scene.lattice.radius
    omega = scene.staggered_spin(spin, (2,))[0, 0].ravel()
    difference = matrix.toarray()
    spins, contacts = free.sum(), len(difference)
    system = np.zeros((spins + contacts + 1, spins + contacts + 1))  # the last state is the constant 1
    inward = -radius / inertia * difference[:, free].T
    slip = radius * np.column_stack([difference[:, free], difference[:, ~free] @ omega[~free]])
    system[spins:-1, :spins], system[spins:-1, -1] = slip[:, :-1], slip[:, -1]
    system[:spins, spins:-1] = stiffness * inward
    system[:spins, :spins], system[:spins, -1] = damping * inward @ slip[:, :-1], damping * inward @ slip[:, -1]
    exact = (expm(duration * system) @ np.concatenate([omega[free], np.zeros(contacts), [1.0]]))[:spins]
    steps, errors = 2 ** np.arange(3, 7), []
    for number in steps:
        method = advanced(
            scene, spin, int(number), stiffness=stiffness, damping=damping, inertia=inertia, time_step=duration / number
        )
        errors.append(np.abs(method.progress().staggered[0, 0].ravel()[free] - exact).max())
    assert slope(steps, errors) == pytest.approx(2, abs=0.1), errors


@pytest.mark.parametrize(("damping", "order"), [(0.0, 2), (1e3, 1)])
def test_the_order_where_every_contact_keeps_slipping(damping, order):
    """Undamped springs turn with the slip at a finite rate: order 2. With damping the law itself turns a force by so
    much a step, whatever the length of the step, and so lags behind the slip by one order
    (docs/how-methods-work.md)."""
    scene = make_scene((2, 2, 3), spin_top=3.0, seeds=(11,))
    spin, duration = 4 * random_start(scene), 0.1
    options = {"inertia": 20.0, "stiffness": 300.0, "damping": damping}
    before = advanced(scene, spin, 50, time_step=4e-3, **options).state()

    def spins_after(number):
        method = begun(scene, spin, time_step=duration / number, **options)
        method.restore(before)
        method.time_step = duration / number
        for _ in range(5):
            method.advance(number // 5)
            assert method.progress().slipping[0] == scene.lattice.contacts
        return method.progress().staggered

    fine = spins_after(640)
    steps = np.array([5, 10, 20, 40])
    errors = [np.abs(spins_after(int(number)) - fine).max() for number in steps]
    assert slope(steps, errors) == pytest.approx(order, abs=0.1), errors


@pytest.mark.parametrize(("shape", "falls", "within"), [((4, 5), 4.0, 1e-4), ((3, 3, 4), 1.2, 1e-2)])
def test_small_steps_agree_with_gears_method(shape, falls, within):
    """Through all friction events of random starts; the two share the law and no step. The typical scene counts: the
    springs jump where a contact begins to slip, so one that barely does may go either way. Contacts with two
    components follow the slip slowly (docs/how-methods-work.md), and Gear's method converges no faster there."""
    duration, errors = 4e-3, []
    scene = make_scene(shape, seeds=(32, 33, 34))
    spin = random_spin(scene)
    reference = CundallStrack(time_step=duration / 4_000).build()
    reference.begin(scene, spin)
    reference.advance(4_000)
    wanted = reference.progress().staggered
    for number in (8, 32, 128):
        found = advanced(scene, spin, number, time_step=duration / number).progress().staggered
        squares = np.moveaxis((found - wanted) ** 2, 1, 0).reshape(scene.replicas, -1)
        errors.append(np.sqrt(squares.mean(axis=1)))
    typical = np.median(errors, axis=1)
    assert (typical[:-1] > falls * typical[1:]).all(), errors
    assert typical[-1] < within, errors


@pytest.mark.parametrize(("damping", "factors"), [(0.0, (1e1, 1e2, 1e3, 1e4)), (1e3, (1e3, 1e4, 1e5))])
@pytest.mark.parametrize("shape", [(7, 8), (4, 3, 5)])
def test_no_step_is_too_long(shape, damping, factors):
    """Driven spheres at rest, steps many times what an explicit method bears: energy never grows.

    Steps so short that damping makes unstretched contacts slip are left out: there the law itself loads the springs.
    """
    scene = make_scene(shape, spin_top=0.0)
    spin = random_start(scene)
    axes = (2,) if scene.lattice.dimension == 2 else (0, 1, 2)
    bound = stability_bound(scene, axes, CundallStrack())
    for factor in factors:
        method = begun(scene, spin, damping=damping, time_step=factor * bound)
        energy = [method.progress().energy]
        for _ in range(6):
            method.advance(1)
            energy.append(method.progress().energy)
        total = np.array([float((e.kinetic + e.spring)[0]) for e in energy])
        assert (np.diff(total) <= 1e-14 * total[0]).all(), (factor, total)
        assert total[-1] < 0.6 * total[0]


@pytest.mark.parametrize("entry", minima((3, 3, 3), (5, 5, 5))[::2], ids=name_of)
def test_dynamics_ends_at_the_stored_minimum(entry):
    scene = scene_of(entry)
    solution = solve(scene, ImplicitCundallStrack().build(), random_spin(scene), StopRule(1e-10, 400))
    assert solution.status is Status.CERTIFIED
    assert solution.power[0] == pytest.approx(entry["power_minimum"], rel=1e-9)


def test_a_run_comes_to_rest_on_its_own():
    scene = make_scene((4, 3, 5), seeds=(8,))
    solution = solve(scene, ImplicitCundallStrack().build(), random_spin(scene), StopRule(1e-17, 400))
    assert solution.status is Status.STATIONARY
    assert solution.gap[0] < 1e-9


@pytest.mark.parametrize("law", ["coulomb", "viscous"])
@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5)])
def test_energy_balances_close(shape, law):
    scene = make_scene(shape, law, spin_top=1.3, spin_bottom=-0.4)
    method = begun(scene, random_spin(scene))
    for _ in range(60):
        method.advance(1)
        energy = method.progress().energy
        assert np.abs(energy.residual).max() < 1e-12
    assert (energy.injected > 0).all()
    assert (energy.dissipated > 0).all()


@pytest.mark.parametrize("law", ["coulomb", "viscous"])
def test_no_contact_turns_a_layer_about_the_height(law):
    scene = make_scene((3, 4, 5), law)
    method = begun(scene, random_start(scene))

    def layer_means():
        return method.progress().staggered[2, 0, ..., 1:-1].mean(axis=(0, 1))

    before = layer_means()
    method.advance(80)
    assert method.time > 1.0
    assert layer_means() == pytest.approx(before, abs=1e-14)


def test_a_time_that_is_aimed_at_is_met_exactly():
    scene = make_scene((4, 5))
    method = begun(scene, random_spin(scene))
    method.advance(10)
    planned, target = method.time_step, method.time + 0.3 * method.time_step
    method.aim_at(target)
    assert method.next_check(method.iteration) == method.iteration + 1
    method.advance(1)
    assert method.time == target
    assert method.time_step >= planned
    method.aim_at(np.inf)
    method.advance(1)
    assert method.time > target


def test_a_stage_ends_at_the_minimum_of_its_function():
    """Compared with a general minimiser of inertia |x - base|^2 / 2 + sum of huber(trial force) / resistance."""
    scene = make_scene((2, 2, 4), seeds=(9,))
    method = begun(scene, random_start(scene))
    rng = np.random.default_rng(1)
    base = free_spins(method.staggered)[0]
    start = rng.uniform(-20, 20, method.system.offset.shape)
    limit = method.strength[0]
    friction = Friction(limit, np.full_like(limit, 80.0), 7.0)
    end = method.stage.solve(friction, base, start, base)

    def function(x):
        size = np.linalg.norm(start + 80.0 * scene.lattice.radius * method.system.differences(x), axis=0)
        huber = np.where(size > limit, limit * size - limit**2 / 2, size**2 / 2)
        return 3.5 * float((x - base) @ (x - base)) + float(huber.sum()) / 80.0

    general = minimize(function, base, method="BFGS", options={"gtol": 1e-5})
    assert function(end.spins) <= general.fun + 1e-9
    assert end.spins == pytest.approx(general.x, abs=1e-4)
    assert 0 < int(end.slips.sum()) < scene.lattice.contacts
