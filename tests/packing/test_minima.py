"""Least dissipation of packings against solvers that share nothing with the package's, and against lattices."""

from pathlib import Path

import networkx as nx
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic import descent, shared
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.solvers import nested_cuts
from tests.packing.twins import clarabel_least, random_packing
from tests.scenes import KNOWN_LAWS, some_of

CLARABEL = 1e-7  # relative to the power, or 1e-9 of what all contacts would dissipate: what Clarabel reaches


def natural(packing):
    return sum(values.sum() for values in packing.material) * max(np.abs(packing.driven_speed).max(), 0.01)


@pytest.mark.parametrize("seed", some_of(60, 5))
def test_random_networks_have_clarabels_minimum(seed):
    """Odd loops, dangling and floating parts, several bodies, radii over two decades, contrasts of a million, ties."""
    pytest.importorskip("clarabel")
    law, dimension = KNOWN_LAWS[seed % len(KNOWN_LAWS)], 2 + seed // len(KNOWN_LAWS) % 2
    packing = random_packing(np.random.default_rng([33, seed]), dimension, law, levels=7 if seed % 7 == 0 else None)
    found, (power, slip, status) = tb.solve(packing), clarabel_least(packing)
    share = 2 if law == "viscous" else 1
    error = CLARABEL * share * abs(power) + 1e-9 * natural(packing)
    assert found.lower_bound <= share * power + error
    assert found.lower_bound <= found.potential
    assert found.status == ("certified" if found.proof == "proven" else "restricted")
    if status == "Solved":
        assert found.potential == pytest.approx(share * power, abs=error)
        lost = packing.material[0][0] * slip
        assert not ((found.state == 0) & (lost > 1e-6 * natural(packing))).any()
        assert not (
            (found.state == 1) & (slip < 1e-9) & (packing.material[0][0] * found.slip > 1e-5 * natural(packing))
        ).any()


def test_forces_are_balanced_admissible_and_oppose_the_slip():
    packing = tb.Packing.lattice("bcc", (3, 3, 3), seed=5)
    found = tb.solve(packing)
    torque = np.zeros((packing.spheres, 3))
    for end, side in zip(packing.contact.T, (1, -1), strict=True):  # at R n of the first, at -R n of the second sphere
        arm = side * packing.radius[end][:, None] * packing.normal
        np.add.at(torque, end, np.cross(arm, -side * found.friction))
    free = packing.driven < 0
    limit = packing.friction * packing.normal_force
    assert np.abs(torque[free]).max() < 1e-12 * limit.max()
    assert (found.force <= limit * (1 + 1e-12)).all()
    omega = found.spin[packing.contact] * packing.radius[packing.contact][..., None]
    slip = -np.cross(omega.sum(axis=1), packing.normal)
    acts = found.state != 3
    work = -(found.friction * slip).sum(axis=1)
    assert work[acts] == pytest.approx(found.power_per_contact[acts], abs=1e-10 * found.power)
    assert found.power_per_contact[acts].sum() == pytest.approx(found.power, rel=1e-13)


def test_no_box_of_driven_values_holds_on_oblique_networks():
    """A free sphere rolls on two driven ones with a spin that lies outside of the hull of theirs."""
    normal = np.array([[1.0, 1, 1], [1, -1, 1]]) / np.sqrt(3)
    center = np.concatenate([[np.zeros(3)], normal])
    packing = tb.Packing(center, [(0, 1), (0, 2)], [-1, 0, 1], [[0, 0, 0], [0, 0, 0], [0, -2, 0]], friction=[1, 1])
    found = tb.solve(packing)
    assert found.power < 1e-12
    assert found.status == "certified"
    assert found.lower_bound <= found.power
    assert np.abs(found.spin[0]) == pytest.approx([1, 1, 1], abs=1e-12)
    assert (found.state != 1).all()


SCENES = [
    ((5, 6), {}),
    ((8, 5), {"periodic": ("x",)}),
    ((2, 5), {"periodic": ("x",)}),
    ((4, 5, 6), {}),
    ((4, 2, 5), {"periodic": ("x", "y")}),
    ((5, 4, 5), {"direction": (1.0, 0.0, 0.0), "spin_bottom": -0.5}),
    ((4, 5, 5), {"direction": (0.0, 1.0, 0.0), "periodic": ("x",), "distribution": "constant:0.5"}),
    ((4, 4, 5), {"distribution": "constant:0.5"}),
    ((4, 5, 4), {"law": "viscous"}),
    ((4, 5, 4), {"law": "coulomb-viscous"}),
    ((4, 5), {"law": "coulomb-viscous"}),
    ((10, 10, 10), {}),
    *(((4, 5, 4), {"law": law, "top": (1.0, 0.4, -0.3, 0.2), "bottom": (0.1, 0.0, 0.3, -0.1)}) for law in KNOWN_LAWS),
]


@pytest.mark.parametrize(("shape", "options"), SCENES, ids=str)
def test_a_lattice_given_as_packing_has_the_same_minimum(shape, options):
    """Powers, slips and states; contacts are in the same order, so that seeds draw the same sample."""
    scene = tb.Scene.random(shape, seed=3, **options)
    lattice = tb.solve(scene, tolerance=1e-10, threads=1)
    options = dict(options)
    periodic = options.pop("periodic", ())
    packing = tb.Packing.lattice("square" if len(shape) == 2 else "cubic", shape, periodic, seed=3, **options)
    assert np.array_equal(np.concatenate([part.ravel() for part in scene.coefficients]), packing.friction)
    found = tb.solve(packing)
    state = np.concatenate([part.ravel() for part in lattice.state])
    slip = np.concatenate([part.ravel() for part in lattice.slip])
    assert found.power == pytest.approx(lattice.power, rel=1e-10)
    assert found.status == "certified"
    assert found.method == lattice.method
    assert found.gap < 1e-11
    assert found.driven_power == pytest.approx(0, abs=1e-12)
    known = (state != 2) & (found.state != 2)
    assert (state == 2).sum() >= (found.state == 2).sum()
    assert np.array_equal(found.state[known], state[known])
    if not np.isin(state, (2, 4)).any():
        assert np.abs(found.slip - slip).max() < 1e-7  # with viscosity the square root of the gap


def scattered(seed):
    """A cubic block in which four bodies of a few spheres each turn otherwise, with friction over four decades."""
    packing, draw = tb.Packing.lattice("cubic", (5, 6, 5), seed=seed), np.random.default_rng(seed)
    driven, spin = np.full(packing.spheres, -1), np.zeros((packing.spheres, 3))
    some = draw.choice(packing.spheres, 12, replace=False)
    driven[some] = np.arange(12) % 4
    spin[some] = draw.normal(size=(4, 3))[driven[some]]
    friction = 10 ** draw.uniform(-4, 0, packing.contacts)
    return tb.Packing(**packing.arrays() | {"driven": driven, "spin": spin, "friction": friction})


@pytest.mark.parametrize("unsettled", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_networks_along_the_axes_have_the_minimum_of_any_other(seed, unsettled, monkeypatch):
    """Also where the path of lattices is followed, and does not settle the states."""
    packing = scattered(seed)
    if unsettled:
        monkeypatch.setattr(descent, "resolve", lambda iterates, *_: [None] * len(iterates))
    own = tb.solve(packing)
    monkeypatch.setattr(ContactSystem, "signed", lambda self: None)
    shared.last.forget()  # with the signed rows that it has kept
    other = tb.solve(packing)
    assert own.status == "certified"
    assert own.gap < 1e-12
    assert own.power == pytest.approx(other.power, rel=1e-12)
    known = (own.state != 2) & (other.state != 2)
    assert np.array_equal(own.state[known], other.state[known])
    assert own.proven.sum() >= other.proven.sum()
    assert own.slipless_motions == other.slipless_motions


def test_odd_rings_are_half_of_their_double_cover():
    packing = tb.Packing.lattice("cubic", (3, 4, 4), ("x",), seed=8)
    count, (first, second) = packing.spheres, packing.contact.T
    cover = tb.Packing(
        center=np.concatenate([packing.center, packing.center + 100]),
        contact=np.concatenate([np.stack([first, second + count], 1), np.stack([first + count, second], 1)]),
        driven=np.tile(packing.driven, 2), spin=np.concatenate([packing.spin, packing.spin]),
        normal=np.tile(packing.normal, (2, 1)), friction=np.tile(packing.friction, 2), schematic=True,
    )  # fmt: skip
    one, two = tb.solve(packing), tb.solve(cover)
    assert one.power == pytest.approx(two.power / 2, rel=1e-10)
    assert {one.status, two.status} == {"certified"}


@pytest.mark.parametrize("seed", range(3))
def test_odd_loops_about_one_axis_are_cut_as_those_of_discs(seed):
    """Rings of three spheres and of five; of the contacts along the axis none slips."""
    driving = {"direction": (0.0, 1.0, 0.0), "spin_bottom": -0.4, "periodic": ("x",)}
    packing = tb.Packing.lattice("cubic", (3 + 2 * (seed % 2), 3, 4), seed=seed, **driving)
    found, other = tb.solve(packing), tb.solve(packing, "interior-point")
    assert (found.method, other.method) == ("planar-cut", "interior-point")
    assert found.power == pytest.approx(other.power, rel=1e-11)
    assert max(found.gap, other.gap) < 1e-11
    known = (found.state < 2) & (other.state < 2)
    assert np.array_equal(found.state[known], other.state[known])
    assert found.slip[np.abs(packing.normal[:, 1]) == 1].max() == 0.0


def test_radii_drop_out():
    """The same velocities u = R omega at other radii."""
    packing = tb.Packing.lattice("bcc", (3, 3, 3), seed=2)
    radius = 10 ** np.random.default_rng(1).uniform(-1, 1, packing.spheres)
    spin = packing.driven_speed / radius[:, None]
    given = packing.arrays() | {"radius": radius, "spin": spin, "schematic": True}
    one, two = tb.solve(packing), tb.solve(tb.Packing(**given))
    assert one.power == pytest.approx(two.power, rel=1e-11)
    assert np.abs(one.spin * packing.radius[:, None] - two.spin * radius[:, None]).max() < 1e-8


def test_what_the_driven_dissipate_is_told_apart():
    """A triangular row that turns with one spin slips in itself."""
    packing = tb.Packing.lattice("triangular", (4, 3), seed=1)
    found = tb.solve(packing)
    between = (packing.driven[packing.contact] >= 0).all(axis=1)
    slip = np.abs(packing.driven_speed[packing.contact, 0].sum(axis=1))
    assert found.driven_power == pytest.approx((packing.material[0][0] * slip)[between].sum())
    assert found.driven_power > 0
    assert (found.state[between] == 3).all()


def test_nothing_to_solve():
    """All driven, none driven, or no contact."""
    row = {"center": [[0, 0], [1, 0]], "contact": [[0, 1]], "spin": [1.0, 2.0], "friction": [0.5]}
    for driven, power in ([0, 1], 0.5 * 50 * 1.5), ([-1, -1], 0.0):
        found = tb.solve(tb.Packing(driven=driven, **row))
        assert (found.power, found.lower_bound, found.status) == (0, 0, "certified")
        assert found.driven_power == pytest.approx(power)
    found = tb.solve(tb.Packing(driven=[0, -1], **row | {"contact": np.zeros((0, 2), int), "friction": []}))
    assert (found.power, found.status, len(found.state)) == (0, "certified", 0)


def test_solve_refuses_what_a_packing_does_not_take():
    packing = tb.Packing.lattice("square", (2, 3))
    for options in ({"method": "operator-splitting"}, {"start": "random"}, {"tolerance": 0}, {"duration": 3}):
        with pytest.raises(tb.InputError):
            tb.solve(packing, **options)


@pytest.mark.parametrize("angle", [1e-3, 1e-5, 1e-7, 1e-9, 1e-12, 1e-15])
def test_normals_that_nearly_agree_prove_nothing_false(angle):
    """A sphere between two driven ones rolls on both, with a spin of one over the angle of their normals: P = 0."""
    normal = np.array([[0, 0, 1.0], [np.sin(angle), 0, np.cos(angle)]])
    center = np.array([[0, 0, 0], [0, 0, 1.0], [0, 0, 9.0]])
    spin = [[0, 0, 0], [0, 0, 0], [1.0, 0, 0]]
    of = {"normal": normal, "friction": [1.0, 0.5], "schematic": True}
    packing = tb.Packing(center, [(0, 1), (0, 2)], [-1, 0, 1], spin, **of)
    found = tb.solve(packing)
    assert found.lower_bound <= found.power
    assert found.lower_bound == pytest.approx(0, abs=1e-8)
    if angle > 1e-6:
        assert found.power == pytest.approx(0, abs=1e-8)
        assert found.status == "certified"


@pytest.mark.parametrize(
    "packing",
    [
        tb.Packing.lattice("bcc", (6, 5, 7), seed=2),
        tb.Packing.lattice("fcc", (3, 4, 3), seed=1),
        tb.Packing.random(120, seed=4),
    ],
    ids=["bcc", "fcc", "random"],
)
def test_oblique_contacts_are_settled(packing):
    """Those that rest are still and below their friction, the others bear it along their slip: to the last digits."""
    found = tb.solve(packing)
    assert found.gap < 1e-13
    assert not (found.state == 2).any()
    limit, unit = packing.friction * packing.normal_force, np.abs(packing.driven_speed).max()
    rests, slips = found.state == 0, found.state == 1
    assert found.slip[rests].max() < 1e-13 * unit
    assert (found.force[rests] < (1 - 1e-6) * limit[rests]).all()
    u = found.spin * packing.radius[:, None]
    slip = -np.cross(u[packing.contact].sum(axis=1), packing.normal)
    along = -limit[:, None] * slip / np.maximum(found.slip, 1e-300)[:, None]
    error = np.linalg.norm(found.friction - along, axis=1)
    assert (error < 1e-14 * unit * limit / np.maximum(found.slip, 1e-300) + 1e-11 * limit.max())[slips].all()


@pytest.mark.parametrize("kind", ["bcc", "fcc"])
def test_the_matrix_of_oblique_contacts_is_that_of_their_slips(kind):
    system = ContactSystem.of(tb.Packing.lattice(kind, (2, 2, 3), seed=3))
    draw = np.random.default_rng(5)
    root = draw.normal(size=(2, 2, len(system.numbers)))
    stiffness = np.einsum("ike,jke->ije", root, root)
    matrix = NewtonMatrix(system, order_by_place(system))
    matrix.factorise(stiffness)
    spins = draw.normal(size=system.unknowns)
    slips = (system.operator @ spins).reshape(2, -1)
    torques = system.operator.T @ np.einsum("ije,je->ie", stiffness, slips).ravel()
    assert np.abs(matrix.solve(torques) - spins).max() < 1e-9


@pytest.mark.parametrize("seed", some_of(20, 3))
@pytest.mark.parametrize("levels", [1, 2, 1000])
def test_levels_of_mirror_images_are_those_of_all_cuts(seed, levels):
    """Odd loops, discs driven by spins of many values, frictions that tie: spins are the middle of the lowest and the
    highest ones, found by one cut of the double cover at each value, mirror images or not."""
    rng = np.random.default_rng([35, seed])
    packing = tb.Packing.lattice("triangular", (6, 5), seed=seed)
    driven, spin = packing.driven.copy(), packing.spin.copy()
    shafts = rng.choice(np.flatnonzero(driven < 0), 4, replace=False)
    driven[shafts], spin[shafts] = np.arange(2, 6), rng.integers(-4, 5, 4) / 4
    friction = rng.integers(1, levels + 1, packing.contacts).astype(float)
    packing = tb.Packing(center=packing.center, contact=packing.contact, driven=driven, spin=spin, friction=friction)
    system = ContactSystem.of(packing)
    cover = nx.DiGraph()
    for (i, j), capacity in zip(packing.contact.tolist(), friction, strict=True):
        for low, high in (((i, 1), (j, -1)), ((j, 1), (i, -1))):
            cover.add_edge(low, high, capacity=capacity)
            cover.add_edge(high, low, capacity=capacity)
    held = {(i, sign): sign * spin[i] for i in np.flatnonzero(driven >= 0).tolist() for sign in (1, -1)}
    values = sorted(set(held.values()))
    own = dict.fromkeys(cover, values[0])
    for value in values[1:]:
        for node, there in held.items():
            cover.add_edge(*(("source", node) if there >= value else (node, "sink")))
        smallest = nx.minimum_cut(cover, "source", "sink")[1][0] - {"source"}
        own |= dict.fromkeys(smallest, value)
        cover.remove_nodes_from(["source", "sink"])
    middle = [(own[i, 1] - own[i, -1]) / 2 for i in range(packing.spheres)]
    found, _ = nested_cuts.least_power(system, packing)[0]
    spins = packing.spins_of(exactly(system.all_spins(found)))[0]
    assert spins.tolist() == pytest.approx(middle, abs=1e-15)
    assert (nested_cuts.least_spins(system, packing) == found).all()


def test_a_tie_of_two_contacts_is_not_broken_by_the_rounding_of_normals():
    """A free sphere that touches two others by contacts of equal friction may share the slip between them in any way:
    its spin along the line across both normals does not change the power. But the normals are rounded, so that one of
    both contacts may seem to have 1e-16 of its friction left."""
    with np.load(Path(__file__).with_name("tied_by_rounding.npz")) as stored:
        packing = tb.Packing(**stored, normal_force=1.0)
    found = tb.solve(packing)
    assert found.status == "certified"
    lonely = 33
    tied = np.flatnonzero((packing.contact == lonely).any(axis=1) & (packing.friction > 0))
    along = np.cross(*packing.normal[tied])
    u = found.spin * packing.radius[:, None]
    powers = []
    for share in (-0.05, -0.02, 0.0, 0.02, 0.05):
        u[lonely] = found.spin[lonely] * packing.radius[lonely] + share * along / np.linalg.norm(along)
        slips = np.cross(u[packing.contact].sum(axis=1), packing.normal)[tied]
        powers.append(np.linalg.norm(slips, axis=1).sum())
    assert min(np.ptp(powers[:3]), np.ptp(powers[2:])) < 1e-14
    assert not found.proven[tied].any()
    assert found.proven[found.state == 0].any()


def test_a_proof_that_runs_into_infinite_loads_leaves_contacts_open():
    """Sixteen spheres of bcc whose contacts have two values of friction; loads beside what rolls are not finite."""
    center = np.array([[a + i, b + i, c + i] for a in (0, 2) for b in (0, 2) for c in (0, 2) for i in (0, 1)])
    center = center / 2 * (2 / np.sqrt(3))
    apart = np.linalg.norm(center[:, None] - center, axis=2)
    contact = np.argwhere(np.triu(np.abs(apart - 1) < 1e-9))
    spin = np.zeros((16, 3))
    spin[3::4, 0] = 1
    weak = [2, 5, 9, 11, 12, 13, 14, 16, 18, 19, 24]
    packing = tb.Packing(
        center,
        contact,
        np.tile([0, -1, -1, 1], 4),
        spin,
        friction=np.where(np.isin(np.arange(len(contact)), weak), 0.1, 1.0),
        normal_force=1.0,
    )
    found = tb.solve(packing)
    assert found.status == "certified"
    assert found.power == pytest.approx(1.3713221653370282, rel=1e-12)
    assert found.lower_bound <= found.power
