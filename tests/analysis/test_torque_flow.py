"""Torque flow, saturation and self-stress: graphs known by hand, laws that hold on any, and what is unique."""

from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.analysis.structure import Structure, self_stress, structure_of
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import laboratory_forces, staggered_forces
from taichi_bearings.lattice.incidence import torques
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.analysis.networks import network_of
from tests.scenes import make_scene

SLIPLESS, SLIPPING, DRIVEN = ContactState.SLIPLESS, ContactState.SLIPPING, ContactState.DRIVEN


def states(lattice, fill=SLIPPING):
    """All contacts in one state, those between driven spheres apart; and the same contacts axis by axis, to change."""
    found = np.where(lattice.between_driven, DRIVEN, fill)
    return found, lattice.by_axis(found)


def forces(lattice, axes=(2,)):
    """Forces (C, E) of 0, and the same axis by axis, to change."""
    found = np.zeros((len(axes), lattice.all_contacts))
    return found, lattice.by_axis(found)


def analysed(scene, solution):
    """Forces, states and flow of the first sample."""
    structure = structure_of(solution)
    return staggered_forces(solution.friction, scene.lattice, scene.minimum_spin_axes)[:, 0], structure.state, structure


def through_gaps(lattice, force):
    """Torque (C, gaps) through the contacts between two layers."""
    return lattice.radius * lattice.by_axis(force)[-1].reshape(len(force), -1, lattice.shape[-1] - 1).sum(axis=1)


def deviation(lattice, force, flow):
    """Largest difference of the torque of a gap from that on the top, relative to the largest of these."""
    return np.abs(through_gaps(lattice, force) - flow.total[:, None]).max() / np.abs(flow.total).max()


def answer(scene, name, tolerance):
    return solve(scene, METHODS[name]().build(), initial_spin(scene, "linear"), StopRule(tolerance))


def drawn(scene, force, state):
    """Structure of a scene with these forces (C, E) and states (E,)."""
    friction = laboratory_forces(force[:, None], scene.lattice, scene.minimum_spin_axes)[0]
    return Structure(SimpleNamespace(scene=scene), *np.zeros((2, 1)), state, friction, state, 0.0, 0.0)


def test_a_single_path_carries_all_the_torque_of_every_gap():
    scene = make_scene((2, 3), spin_top=3.0)
    lattice = scene.lattice
    force, (x, y) = forces(lattice)
    y[0, 0, 1], x[0, 0, 1], y[0, 1, 0] = 5.0, -5.0, 5.0  # down the left column, to the right, down the right column
    state, of_axis = states(lattice)
    of_axis[1][0, 1] = SLIPLESS
    x[0, 0, 0] = 9.0  # between driven discs
    flow = drawn(scene, force, state).torque_flow
    assert flow.total == pytest.approx([2.5])
    assert flow.power == pytest.approx([0.0, 7.5])
    assert flow.slipless_share == pytest.approx(0.5)


def test_forces_that_leave_a_torque_on_a_free_sphere_have_no_torque_that_passes_all_layers():
    lattice = make_scene((2, 3), spin_top=3.0).lattice
    force, (_, y) = forces(lattice)
    y[0, 0], y[0, 1, 0] = 5.0, 0.02
    flow = drawn(make_scene((2, 3), spin_top=3.0), force, states(lattice)[0]).torque_flow
    assert (flow.total, flow.slipless_share) == (None, None)
    assert flow.power == pytest.approx([0.0, 7.5])


@pytest.mark.parametrize("name", ["planar-cut", "interior-point"])
def test_equal_columns_slip_in_their_weak_gap_and_carry_its_friction_everywhere(name, needs_f64):
    x, y = np.full((1, 3, 6), 0.5), np.full((1, 4, 5), 0.8)
    y[..., 2] = 0.3
    scene = Scene((x, y), spin_top=2.0, spin_bottom=-1.0, normal_force=10.0)
    force, state, structure = analysed(scene, answer(scene, name, 1e-12))
    flow = structure.torque_flow
    assert flow.total == pytest.approx([0.5 * 4 * 0.3 * 10.0], rel=1e-12)
    assert deviation(scene.lattice, force, flow) < 1e-13
    assert flow.power.sum() == pytest.approx(18.0, rel=1e-12)
    assert flow.slipless_share == pytest.approx(4 / 5, rel=1e-12)
    assert (state == SLIPPING).sum() == 4
    assert 0 < structure.mean_saturation <= 1


def test_one_component_of_a_cubic_lattice_does_not_flow_along_its_own_axis(needs_f64):
    scene = make_scene((3, 4, 5), direction=(0.0, 1.0, 0.0))
    force, _, structure = analysed(scene, answer(scene, "planar-cut", 1e-12))
    assert [part.any() for part in scene.lattice.by_axis(force)] == [True, False, True]
    assert deviation(scene.lattice, force, structure.torque_flow) < 1e-14
    assert structure.torque_flow.total[0] > 0


def test_the_current_of_a_component_stays_in_planes_normal_to_it(needs_f64):
    scene = make_scene((4, 3, 5), spin_bottom=0.2)
    force, _, structure = analysed(scene, answer(scene, "interior-point", 1e-10))
    flow = structure.torque_flow
    for slot, component in enumerate((0, 1)):
        torque, through = scene.lattice.by_axis(scene.lattice.radius * force[slot]), 0.0
        for index in range(scene.lattice.shape[component]):
            sideways, upright = (np.take(values, index, component) for a, values in enumerate(torque) if a != component)
            through += upright.sum(axis=0)
            assert np.ptp(upright.sum(axis=0)) < 1e-12 * flow.total[slot]
            padded = np.pad(sideways[:, 1:-1], ((1, 1), (0, 0)))
            assert np.diff(upright, axis=1) + np.diff(padded, axis=0) == pytest.approx(0.0, abs=1e-11)
        assert through == pytest.approx(flow.total[slot], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "law", "shape", "tolerance"),
    [
        ("interior-point", "coulomb", (5, 4, 6), 1e-10),
        ("operator-splitting", "coulomb", (5, 4, 6), 1e-5),
        ("linear-solver", "viscous", (5, 4, 6), 1e-10),
        ("planar-cut", "coulomb", (7, 9), 1e-10),
    ],
)
def test_torque_is_conserved_and_drives_with_the_power(name, law, shape, tolerance, needs_f64):
    scene = make_scene(shape, law, spin_top=1.7, spin_bottom=0.4)
    solution = answer(scene, name, tolerance)
    force, state, structure = analysed(scene, solution)
    flow = structure.torque_flow
    assert deviation(scene.lattice, force, flow) < 1e-12
    left_over = scene.lattice.radius * torques(force[:, None], scene.lattice, scene.minimum_spin_axes)[..., 1:-1]
    assert np.abs(left_over).max() < 1e-12 * flow.total.min()
    assert flow.power.sum() == pytest.approx(solution.power[0], rel=tolerance)
    assert not (state == ContactState.UNDECIDED).any()


def test_what_is_unique_does_not_depend_on_the_method(needs_f64):
    scene = make_scene((4, 3, 5), seeds=(77,), spin_bottom=0.1)
    exact = answer(scene, "interior-point", 1e-12)
    force, state, structure = analysed(scene, exact)
    flow = structure.torque_flow
    assert self_stress(network_of(scene.lattice, state), scene.minimum_spin_axes).sum() > 0
    for name, tolerance in (("gradient-descent", 1e-5), ("operator-splitting", 1e-7), ("rigid-limit", 1e-9)):
        other = answer(scene, name, tolerance)
        others, _, its = analysed(scene, other)
        other_flow = its.torque_flow
        if name == "rigid-limit":  # spheres still gain speed within the last step
            assert other_flow.total is None
            continue
        as_exact = drawn(scene, others, state).torque_flow
        missing = abs(1 - other_flow.power.sum() / exact.power[0])
        uncertain = 3 * np.sqrt(missing + 1e-12)  # friction discs are round: forces may turn like the root of the gap
        assert other_flow.total == pytest.approx(flow.total, rel=uncertain)
        assert as_exact.slipless_share == pytest.approx(flow.slipless_share, abs=uncertain)
        apart = np.abs(force - others)
        assert apart[:, state == SLIPLESS].max() > 10 * apart[:, state == SLIPPING].max()


def test_total_torque_is_the_derivative_of_the_least_power(needs_f64):
    def least_power(x, y):
        scene = make_scene((4, 3, 5), direction=(x, y, 0.0), spin_top=float(np.hypot(x, y)))
        return scene, answer(scene, "interior-point", 1e-12)

    flow = analysed(*least_power(1.0, 0.7))[2].torque_flow
    step = 1e-4
    for slot, (x, y) in enumerate([(step, 0.0), (0.0, step)]):
        ahead, behind = least_power(1.0 + x, 0.7 + y)[1], least_power(1.0 - x, 0.7 - y)[1]
        slope = float(ahead.power[0] - behind.power[0]) / (2 * step)
        assert flow.total[slot] == pytest.approx(slope, rel=1e-5)


def test_saturations_are_those_of_slipless_contacts():
    x, y = np.ones((1, 1, 3)), np.array([[[1.0, 2.0], [1.0, 1.0]]])
    scene = Scene((x, y), normal_force=1.0)
    lattice = scene.lattice
    force, (x, y) = forces(lattice)
    x[0, 0, 1], y[0] = 0.2, [[-1.0, 1.995], [0.5, 0.0]]
    state, of_axis = states(lattice, SLIPLESS)
    of_axis[1][0, 0] = SLIPPING
    assert drawn(scene, force, state).mean_saturation == pytest.approx(np.mean([0.0, 0.2, 0.5, 0.9975]))


def test_nothing_slipless_has_no_load_and_no_self_stress():
    lattice = Lattice((2, 3, 3))
    state, _ = states(lattice)
    assert self_stress(network_of(lattice, state), (0, 1)).tolist() == [0, 0]


def test_a_plaquette_is_one_loop_for_the_components_that_all_its_contacts_carry():
    flat = Lattice((2, 4))
    state, (x, y) = states(flat)
    x[0, 1], x[0, 2], y[0, 1] = SLIPLESS, SLIPLESS, SLIPLESS
    assert self_stress(network_of(flat, state), (2,)).sum() == 0  # open
    y[1, 1] = SLIPLESS
    assert self_stress(network_of(flat, state), (2,)).sum() == 1
    cubic = Lattice((2, 2, 4))
    state, (x, _, z) = states(cubic)
    x[0, 0, 1:3], z[:, 0, 1] = SLIPLESS, SLIPLESS  # upright, normal to y
    assert self_stress(network_of(cubic, state), (0, 1)).tolist() == [0, 1]
    state, (x, y, _) = states(cubic)
    x[0, :, 1], y[:, 0, 1] = SLIPLESS, SLIPLESS  # lying
    assert self_stress(network_of(cubic, state), (0, 1)).sum() == 0
    assert self_stress(network_of(cubic, state), (0, 1, 2)).tolist() == [0, 0, 1]


def test_a_driven_plane_is_one_body():
    lattice = Lattice((2, 3))
    assert self_stress(network_of(lattice, states(lattice, SLIPLESS)[0]), (2,)) == [2]  # 5 contacts of 4 bodies


def test_where_top_and_bottom_turn_alike_torque_between_them_is_a_self_stress(needs_f64):
    """At rest in the first layer of each component: the forces of the slipless contacts there are not unique."""
    scene = Scene.random((3, 3, 4), seed=4, top=(0.0, 0.0, 0.0, 0.3))
    structure = structure_of(answer(scene, "interior-point", 1e-12))
    lattice, axes, jump = scene.lattice, scene.minimum_spin_axes, scene.top_spin(scene.minimum_spin_axes)
    rows = []
    for slot, contact in np.argwhere(lattice.tangential_mask(axes) & structure.slipless):
        force = np.zeros((len(axes), 1, lattice.all_contacts))
        force[slot, 0, contact] = 1.0
        pull = torques(force, lattice, axes)[:, 0]
        rows.append(np.append(pull[..., 1:-1].ravel(), (pull[..., -1] * jump).sum()))  # torques, and work of the top
    assert structure.states_proven
    assert structure.self_stress == len(rows) - np.linalg.matrix_rank(np.array(rows)) == 9


@pytest.mark.parametrize(("shape", "axes"), [((4, 5), (2,)), ((3, 4, 4), (0, 1)), ((3, 2, 4), (0, 1, 2))])
def test_self_stress_is_the_null_space_of_balance_with_given_totals(shape, axes):
    lattice, generator = Lattice(shape), np.random.default_rng(31)
    for share in (0.3, 0.6, 0.9):
        state, _ = states(lattice)
        state[(generator.random(state.shape) < share) & (state != DRIVEN)] = SLIPLESS
        rows = []
        for slot, contact in np.argwhere(lattice.tangential_mask(axes) & (state == SLIPLESS)):
            force = np.zeros((len(axes), 1, lattice.all_contacts))
            force[slot, 0, contact] = 1.0
            pull = torques(force, lattice, axes)[:, 0]
            rows.append(np.concatenate([pull[..., 1:-1].ravel(), pull[..., -1].reshape(len(axes), -1).sum(axis=1)]))
        matrix = np.array(rows)
        assert self_stress(network_of(lattice, state), axes).sum() == len(matrix) - np.linalg.matrix_rank(matrix)
