"""Rest that is proven although loops beside it cannot roll as their normals are rounded, and none that is not so."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.proof.judgement import Judgement
from tests.packing.twins import clarabel_least, random_packing
from tests.proof.smoothed import states
from tests.scenes import some_of

LAW = "coulomb-viscous"
VISCOSITIES = ("power-law:1,100,-1", "power-law:0.1,10,-1", "power-law:10,1000,-1")


def random_spheres(count, seed, law=LAW):
    """Viscosities over two decades, or none."""
    own = {"viscosity": VISCOSITIES[seed % 3]} if law == LAW else {}
    return tb.Packing.random(count, seed=seed, law=law, spin_bottom=-0.5, **own)


def cut_out(found, contact, count, rng):
    """A small packing: spheres of a solved one about a contact, what touches them being driven as it turned there."""
    arrays, pairs = found.packing.arrays(), found.packing.contact
    free, kept = found.packing.driven < 0, [int(i) for i in pairs[contact] if found.packing.driven[i] < 0]
    while len(kept) < count:
        inside = np.isin(pairs, kept) & (found.state == 0)[:, None]
        beside = pairs[inside.any(axis=1) & ~inside.all(axis=1)].ravel()
        beside = beside[free[beside] & ~np.isin(beside, kept)]
        if not len(beside):
            break
        times = np.bincount(beside)
        kept.append(int(np.argmax(times + rng.random(len(times)) * (times > 0))))
    own = np.isin(pairs, kept).any(axis=1)
    spheres = np.unique(pairs[own])
    spin = np.where(np.abs(found.spin) < 1e-11 * np.abs(found.spin).max(), 0.0, found.spin)
    if rng.random() < 0.5:  # spins that a simple driving has
        spin = np.round(8 * spin) / 8
    spin[kept] = 0.0
    of_contacts = {name: arrays[name][own] for name in ("normal", "friction", "viscosity") if name in arrays}
    of_spheres = {name: arrays[name][spheres] for name in ("center", "radius")}
    return tb.Packing(
        **of_contacts, **of_spheres, contact=np.searchsorted(spheres, pairs[own]), normal_force=1.0, schematic=True,
        driven=np.where(np.isin(spheres, kept), -1, 0), spin=spin[spheres],
    )  # fmt: skip


def proven_of(found, spin, rounding, friction):
    return Judgement(found.packing, spin, rounding, friction).states[0].known


@pytest.mark.parametrize(("count", "seed"), [(100, 1), (300, 3), pytest.param(300, 10, marks=pytest.mark.thorough)])
def test_most_contacts_of_random_spheres_are_proven(count, seed):
    found = tb.solve(random_spheres(count, seed))
    assert found.proven[found.state != 3].mean() > 0.98


def test_most_contacts_with_friction_alone_are_proven_beside_such_loops():
    found = tb.solve(tb.Packing.random(1000, seed=1))
    assert found.proven[found.state != 3].mean() > 0.99


def test_a_loop_that_only_uneven_friction_can_bear_leaves_all_others_proven():
    """Springs cannot show it: one loop of three contacts would leave all 838 resting contacts undecided."""
    pytest.importorskip("clarabel")
    packing = tb.Packing.random(400, seed=21)
    found, (power, slip, status) = tb.solve(packing), clarabel_least(packing)
    assert status == "Solved"
    assert found.power == pytest.approx(power, rel=1e-8)
    assert found.unproven <= 2
    known, fastest = found.proven & (found.state != 3), np.abs(packing.driven_speed).max()
    assert ((slip > 1e-5 * fastest) == (found.state == 1))[known].all()


@pytest.mark.parametrize("law", ["coulomb", LAW])
@pytest.mark.parametrize("seed", some_of(60, 10))
def test_what_is_proven_beside_such_loops_is_true(seed, law):
    """As solved, and of spins and friction beside the minimum."""
    rng = np.random.default_rng([41, seed])
    large = tb.solve(random_spheres(*((100, int(rng.integers(20))) if seed % 24 else (300, 3)), law))
    rests = np.flatnonzero(large.state == 0)
    open_ = rests if large.proven[rests].all() else rests[~large.proven[rests]]
    packing = cut_out(large, rng.choice(open_), int(rng.integers(3, 6)), rng)
    found, truth = tb.solve(packing), states(packing)
    answers = [(found.spin, found.spin_rounding, found.friction)]
    for size in 10.0 ** rng.uniform(-15, -2, 4):
        moved = found.spin + size * rng.standard_normal(found.spin.shape) * (packing.driven < 0)[:, None]
        pulled = found.friction * (1 + size * rng.standard_normal(len(truth)))[:, None]
        answers += [(moved, np.zeros_like(moved), found.friction), (found.spin, found.spin_rounding, pulled)]
    for answer in answers:
        proven = proven_of(found, *answer)
        assert ((proven == truth) | (proven == 2) | (truth >= 2)).all()
    assert (found.proven & (found.state == truth)).any()


@pytest.mark.parametrize("seed", some_of(60, 12))
def test_states_of_small_networks_are_those_of_the_smoothed_minimum(seed):
    rng = np.random.default_rng([43, seed])
    while True:
        packing = random_packing(rng, 2 + seed % 2, LAW, spheres=int(rng.integers(5, 12)))
        if 2 <= (packing.driven < 0).sum() <= (5 if seed % 2 else 9):
            break
    packing = tb.Packing(**packing.arrays() | {"radius": 1.0, "schematic": True})
    found, truth = tb.solve(packing), states(packing)
    assert ((found.state == truth) | ~found.proven | (truth >= 2)).all()


def chain_with_a_weak_contact(weak, order):
    """A packing, and friction of which every sphere is in balance. Six spheres in a row along x, and two more that
    close a square with the middle ones, roll on each other: contacts bear 10, but contact `weak`, at one end of the
    row, bears 1.5. Either end touches two driven spheres, with friction 1 each, that turn the row in opposite senses.
    So they pull at contact `weak` with 2, and it slips at every minimum. But the friction given here cancels at each
    end. The other two spheres touch spheres at rest, with friction 0.01, so that none can turn freely."""
    center = [*([2.0 * i, 0, 0] for i in range(6)), [4.0, 2, 0], [6.0, 2, 0]]
    contact, along = [*([i, i + 1] for i in range(5)), [2, 6], [3, 7], [6, 7]], [[1.0, 0, 0], [0, 1.0, 0]]
    normal, limit = [along[k] for k in (0, 0, 0, 0, 0, 1, 1, 0)], np.full(8, 10.0)
    limit[weak] = 1.5
    spin, friction = np.zeros((8, 3)), np.zeros((8, 3))
    for sphere, turn, bears, n in (
        (0, 1, 1, (0, 1, 1)),
        (5, 1, 1, (0, 1, 1)),
        (6, 0, 0.01, (0, 1, -1)),
        (7, 0, 0.01, (1, 0, 1)),
    ):
        n = np.sqrt(0.5) * np.array(n)
        force = np.cross((0, 0, 1), n)
        for way in (1, -1):
            contact.append([sphere, len(center)])
            center.append([*center[sphere][:2], 3.0 + way])
            normal.append(n)
            limit, spin = np.append(limit, bears), np.append(spin, [[0, 0, turn]], axis=0)
            friction = np.append(friction, [way * bears * force / np.linalg.norm(force)], axis=0)
    place = np.append(order, np.arange(8, len(center)))
    driven, back = np.where(np.arange(len(center)) < 8, -1, 0), np.argsort(place)
    packing = tb.Packing(
        np.array(center)[back], place[np.array(contact)], driven=driven[back], spin=spin[back], normal=np.array(normal),
        radius=1.0, friction=limit, normal_force=1.0, schematic=True,
    )  # fmt: skip
    return packing, friction


@pytest.mark.parametrize("weak", [0, 4])
def test_no_rest_is_proven_where_torques_are_left_over_on_spheres_that_roll_freely(weak):
    """Torques on some spheres of the row need friction all along it, though these could turn without any: which of
    them, the order of the spheres decides."""
    rng = np.random.default_rng(weak)
    found = tb.solve(chain_with_a_weak_contact(weak, np.arange(8))[0])
    assert (found.state[weak], found.proven.all()) == (1, True)
    for _ in range(16):
        packing, friction = chain_with_a_weak_contact(weak, rng.permutation(8))
        spin = packing.spin[None]
        known = Judgement(packing, spin, np.zeros_like(spin), friction[None]).states[0].known
        assert known[weak] in (1, 2)


@pytest.mark.parametrize("seed", some_of(30, 15))
def test_states_are_proven_where_some_contacts_have_no_viscosity(seed):
    """A lattice as a packing, in which each component of a slip depends on one component of the spins."""
    arrays = tb.Packing.lattice("cubic", (2, 2, 3), seed=seed, law=LAW).arrays()
    viscosity = np.random.default_rng([47, seed]).choice([0.0, 0.3, 3.0, 30.0], len(arrays["viscosity"]))
    packing = tb.Packing(**arrays | {"viscosity": viscosity, "normal_force": 50.0, "schematic": True})
    found, truth = tb.solve(packing), states(packing)
    assert ((found.state == truth) | (truth == 2)).all()
    assert found.proven.all()
