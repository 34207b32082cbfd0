"""Contacts that slip at some minima, or at none though at their limit: what is proven of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from taichi_bearings_studies.stress import truth

import taichi_bearings as tb
from taichi_bearings.proof.between_two import BetweenTwo, Link, _farthest, _outwards, _trees
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.proof.oblique_limits import ObliqueLimits, not_balanced
from taichi_bearings.proof.pulls import Pulls
from taichi_bearings.proof.tied_minima import Constraints
from taichi_bearings.quantities import numbers_of
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.solution import DRIVEN, SLIPLESS, SLIPPING, TIED, UNDECIDED
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.proof.samples import samples_of
from tests.scenes import make_scene
from tests.stress import minima
from tests.stress.minima import EITHER, least_of_all

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
BIMODAL = "bimodal:0.1,1.0,0.5"


def minimum(shape, seed, distribution=BIMODAL, coefficients=None):
    scene = make_scene(shape, seeds=(seed,), distribution=distribution)
    scene = scene if coefficients is None else replace(scene, coefficients=coefficients)
    return solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))


def kinds(solution):
    """Numbers of slipless, slipping and tied contacts and of unproven ones."""
    proven = samples_of(solution).judgement.states[0].known
    acts = solution.state[0] != ContactState.DRIVEN
    return [int((proven[acts] == what).sum()) for what in (SLIPLESS, SLIPPING, TIED, UNDECIDED)]


@pytest.mark.parametrize(("shape", "seed", "expected"), [
    ((3, 3, 4), 3, [37, 14, 0, 0]), ((3, 3, 4), 124, [30, 17, 4, 0]), ((5, 5, 5), 3, [149, 64, 7, 0]),
])  # fmt: skip
def test_what_is_proven_is_what_contacts_are_called(shape, seed, expected):
    """Of the slipless contacts 3, 0 and 4 bear all their friction (docs/certificates.md)."""
    solution = minimum(shape, seed)
    assert kinds(solution) == expected
    numbers = numbers_of(Result(RunSettings(tolerance=1e-8), solution))
    assert [numbers[name] for name in ("slipless", "slipping", "undecided", "tied")] == [*expected[:2], 0, expected[2]]
    assert numbers["contacts"] == sum(expected)
    assert solution.unproven[0] == 0
    assert solution.states_proven[0]
    assert solution.minimum_is_unique == [not expected[2]]


AT_LIMIT = 1e-18  # margin in the middle of the optimal forces below which a contact is at its limit


@pytest.mark.parametrize(("distribution", "seed"), [*((BIMODAL, n) for n in (3, 20, 92, 124)), ("constant:0.5", 3)])
def test_states_are_those_of_an_oracle(distribution, seed):
    """Slipless, slipping or tied at all minima, in 140 digits; of seed 20 ties are left unproven, and of constant
    friction. Of seed 92 a contact rests at its limit with friction along both components. What is proven is true, and
    what is not is never called what it is not, but undecided."""
    solution = minimum((3, 3, 3) if distribution != BIMODAL else (3, 3, 4), seed, distribution)
    least, state, proven = least_of_all(solution.scene), solution.state[0], solution.proven[0]
    true, margin = (solution.scene.lattice.flat(of) for of in (least.state, least.margin))
    clear = true != truth.UNCLEAR
    names = {truth.SLIPLESS: SLIPLESS, truth.SLIPPING: SLIPPING, EITHER: TIED,
             minima.DRIVEN: DRIVEN}  # fmt: skip
    right = np.array([names.get(of, -1) for of in true.tolist()])
    assert (state == right)[clear & proven].all()
    assert ((state == right) | (state == UNDECIDED))[clear].all()
    assert proven.all() == (seed != 20 and distribution == BIMODAL)
    if proven.all() and seed == 3:
        assert ((state == SLIPLESS) & clear & (margin < AT_LIMIT)).any()


@pytest.mark.parametrize("seed", [3, 124])
def test_packings_on_a_cubic_lattice_have_the_ties_of_an_oracle(seed):
    """Spheres and contacts in another order, some contacts from the upper to the lower sphere, a normal force beside
    the friction, and several radii: the states are those of the lattice in 140 digits, and all are proven."""
    scene, draw = make_scene((3, 3, 4), seeds=(seed,), distribution=BIMODAL), np.random.default_rng(seed)
    least = least_of_all(scene)
    names = {truth.SLIPLESS: SLIPLESS, truth.SLIPPING: SLIPPING, EITHER: TIED, minima.DRIVEN: DRIVEN}
    right = np.array([names.get(of, -1) for of in scene.lattice.flat(least.state).tolist()])
    given = tb.Packing.lattice("cubic", (3, 3, 4), seed=seed, distribution=BIMODAL).arrays()
    spheres, contacts = (draw.permutation(len(given[name])) for name in ("driven", "friction"))
    place, radius = np.argsort(spheres), 0.5 * 2.0 ** draw.integers(-1, 2, len(spheres))
    pairs, turned = place[given["contact"][contacts]], draw.random(len(contacts)) < 0.5
    pairs[turned] = pairs[turned, ::-1]
    packing = tb.Packing(
        center=given["center"][spheres], contact=pairs, driven=given["driven"][spheres],
        spin=given["spin"][spheres] * (0.5 / radius)[:, None], radius=radius, friction=given["friction"][contacts] / 3,
        normal_force=3.0, normal=np.where(turned, -1, 1)[:, None] * given["normal"][contacts], schematic=True,
    )  # fmt: skip
    found = tb.solve(packing)
    acts = right[contacts] != DRIVEN
    assert (found.state == right[contacts])[acts].all()
    assert found.proven[acts].all()
    assert (found.state == TIED).sum() == {3: 0, 124: 4}[seed]


def test_nothing_is_said_of_ties_where_three_components_of_the_spins_matter():
    """Two spheres in the middle are driven, too, so that contacts slip along all three components."""
    given = tb.Packing.lattice("cubic", (2, 3, 3), distribution="constant:0.5").arrays()
    driven, spin = given["driven"].copy(), given["spin"].copy()
    place = np.round(given["center"] - given["center"].min(axis=0)).astype(int)
    sign = np.where(place.sum(axis=1) % 2, -1.0, 1.0)[:, None]
    spin[driven == 0], spin[driven == 1] = (sign * (2, 0, -2))[driven == 0], (sign * (2, -2, 2))[driven == 1]
    for body, (at, of) in enumerate({(1, 2, 1): (-2, -2, 2), (1, 0, 1): (2, 1, -1)}.items(), 2):
        own = (place == at).all(axis=1)
        driven[own], spin[own] = body, of
    found = tb.solve(tb.Packing(**given | {"driven": driven, "spin": spin}))
    assert found.status == "certified"
    assert not (found.state[found.proven] == TIED).any()


def oblique_at_limit(solution):
    """(contacts,), which contacts rest and bear all their friction, along both components."""
    friction, scene = np.abs(solution.friction[0]), solution.scene
    limit = scene.lattice.flat(tuple(of[0] for of in scene.coefficients)) * scene.normal_force
    full = np.sqrt((friction**2).sum(axis=1)) > limit * (1 - 1e-9)
    return full & (solution.slip[0] == 0) & ((friction > 1e-3 * limit[:, None]).sum(axis=1) == 2)


def test_a_contact_at_its_limit_with_both_components_needs_equal_friction():
    """It bears exactly what the slip on the other side of its sphere does; one unit in the last place is too much."""
    solution = minimum((3, 3, 4), 92)
    assert solution.states_proven[0]
    (contact,) = np.flatnonzero(oblique_at_limit(solution))
    assert solution.state[0, contact] == SLIPLESS
    samples, lattice = samples_of(solution), solution.scene.lattice
    for way in (0.0, 2.0):
        flat = lattice.flat(tuple(of[0] for of in samples.coefficient)).copy()
        flat[contact] = np.nextafter(flat[contact], way)
        judgement = replace(samples, coefficient=tuple(of[None] for of in lattice.by_axis(flat))).judgement
        (states,), acts = judgement.states, judgement.acts[0]
        assert (states.known[acts] == UNDECIDED).all()


def test_friction_that_differs_in_its_last_digit_ties_nothing():
    solution = minimum((3, 3, 4), 124)
    samples, tied = samples_of(solution), solution.scene.lattice.by_axis(solution.state[0] == TIED)
    axis, where = next((axis, tuple(np.argwhere(of)[0])) for axis, of in enumerate(tied) if of.any())
    coefficient = [of.copy() for of in samples.coefficient]
    coefficient[axis][(0, *where)] = np.nextafter(coefficient[axis][(0, *where)], 1.0)
    judgement = replace(samples, coefficient=tuple(coefficient)).judgement
    (states,), acts = judgement.states, judgement.acts[0]
    assert (states.known[acts] == UNDECIDED).all()
    assert (states.known[~acts] == SLIPLESS).all()
    assert states.unique is None


def test_friction_at_its_limit_by_hand():
    """A sphere that slips on the bottom, friction 5, between two that turn with the top, is pulled by 3 along x and by
    4 along y: at friction 3 the contact that feels x is at its limit and rests, below it slips (certificates.md)."""
    for friction, state in (
        (2.75, SLIPPING),
        (3.0, UNDECIDED),  # it rests, but rounding hides that
        (3.25, SLIPLESS),
    ):
        x, y, z = np.full((1, 2, 3), 64.0), np.full((2, 1, 3), 64.0), np.full((2, 2, 2), 64.0)
        z[:, :, 0] = 0.25
        z[0, 0] = 5.0, 0.0  # nothing joins the sphere to the top
        y[0, 0, 1] = friction
        scene = replace(make_scene((2, 2, 3), direction=(3, 4, 0)), coefficients=(x[None], y[None], z[None]))
        solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))
        state_y, slip_y, force_y = (
            scene.lattice.by_axis(v[0])[1] for v in (solution.state, solution.slip, solution.force)
        )
        assert state_y[0, 0, 1] == state
        assert (force_y[0, 0, 1] == pytest.approx(50 * friction, rel=1e-9)) == (friction <= 3)
        assert solution.states_proven[0] == (friction != 3)
        top = 1.0 * 3 / 5
        slip = 0.5 * (top - 4 / 5 * friction / np.sqrt(25 - friction**2)) if friction < 3 else 0.0
        assert slip_y[0, 0, 1] == pytest.approx(slip, rel=1e-9, abs=1e-12)


def test_layers_of_the_top_that_are_driven_differently_tie_by_slips_of_their_own():
    """Two spheres, each between one that turns with the bottom and one that turns with the top, which their contacts
    pull with equal friction. Where both rest on the latter, they slip past the former by what their layer of the top
    is driven with, which differs. All four contacts are tied."""
    x, y, z = np.ones((1, 3, 3)), np.zeros((2, 2, 3)), np.zeros((2, 3, 2))
    y[:, :, 1] = 1.0
    z[:, 0], z[:, 2] = (64.0, 0.25), (0.25, 64.0)
    given = {"normal_force": 1.0, "top": (1.0, 1.0, 0.0, 0.5), "bottom": (0.0, 0.0, 0.0, 0.0)}
    scene = tb.Scene((x[None], y[None], z[None]), **given)
    solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    samples = samples_of(solution)
    spin, rounding = samples.spin.copy(), samples.spin_rounding.copy()
    for part in (spin, rounding):
        part[0, :, 1, 1, 0] = -part[0, :, 2, 1, 0]
    for judged in (samples, replace(samples, spin=spin, spin_rounding=rounding)):
        (states,) = judged.judgement.states
        assert (scene.lattice.by_axis(states.known)[1][:, :, 1] == TIED).all()
        assert states.unique is False


def test_shortest_paths_say_what_linear_programmes_do():
    """How far contacts can slip where clusters move, of numbers that no rounding can change."""
    rng, seen = np.random.default_rng(4), []
    for _ in range(60):
        nodes, contacts = rng.integers(2, 5), rng.integers(3, 9)
        ends = np.array([rng.choice(nodes, 2, replace=False) for _ in range(contacts)]).T
        sign, slip = rng.choice([-1.0, 1.0], contacts), rng.choice([0.0, 1.0, 3.25, 7.5, 11.0], contacts)
        slip[1:][slip[1:] == slip[0]] += 0.125
        constraints = Constraints(np.arange(contacts), *ends, sign, np.arange(contacts))
        rests, always, some = constraints.limits(slip * (1 - 1e-9), slip * (1 + 1e-9))
        rows = np.zeros((contacts, nodes))
        rows[np.arange(contacts), ends[1]], rows[np.arange(contacts), ends[0]] = sign, -sign
        for e in range(contacts):
            least, most = (
                linprog(way * rows[e, 1:], A_ub=-rows[:, 1:], b_ub=slip, bounds=(-100, 100)).fun * way + slip[e]
                for way in (1, -1)
            )
            assert not (rests[e] and least > 1e-6)
            assert not (always[e] and least < 1e-6)
            assert some[e] == (most > 1e-6)
            seen.append((bool(rests[e]), bool(always[e]), bool(some[e])))
    assert {(True, False, True), (False, True, True), (True, False, False)} <= set(seen)


def test_a_domain_is_not_between_two_others_once_its_slips_have_turned(monkeypatch):
    """Newton's method may move it past one of them."""
    asked, lie_between = [], BetweenTwo.lie_between
    monkeypatch.setattr(BetweenTwo, "lie_between", lambda *given: asked.append(given) or lie_between(*given))
    assert samples_of(minimum((3, 3, 4), 20)).judgement.states[0].unique is None
    between, pulls, contacts, change = asked[-1]
    assert len(between.sets) == 1
    assert lie_between(between, pulls, contacts, change)
    turned = replace(contacts, difference=tuple(-part for part in contacts.difference))
    assert not lie_between(between, pulls, turned, change)


def test_links_that_share_domains_make_trees():
    """Links 0-1 and 0-2 of domains share the domain 0 of the first component; a loop of four is left out."""

    def link(first, second, sizes=(1.0, 2.0)):
        return Link(((0, first), (1, second)), np.arange(2), (True, True), sizes)

    star, loop = [link(0, 1), link(0, 2, (3.0, 1.0))], [link(5, 6), link(5, 7), link(8, 6), link(8, 7)]
    alone = link(9, 9)
    trees = _trees([star[0], *loop, alone, star[1]])
    assert [len(tree) for tree in trees] == [2, 1]
    # A motion of 1 in the first component moves domain 1 by 2 and domain 2 by 1/3 in the second one.
    assert _farthest(trees[0]) == (1, 1)
    assert [(of.nodes[1][1], slot) for of, slot in _outwards(trees[0], (1, 1))] == [(1, 1), (2, 0)]
    assert _farthest(trees[1]) == (1, 9)


def test_a_line_may_be_along_one_component_and_may_end_at_rest():
    """Free spheres between bottom and top, with equal friction, in four columns: one is driven along y alone, one along
    x alone, one along both and one not at all. All contacts of the first three are tied: none is proven otherwise, in
    the middle of the minima or where all spheres rest on the top."""
    x, y, z = np.zeros((1, 1, 2, 3)), np.zeros((1, 2, 1, 3)), np.ones((1, 2, 2, 2))
    scene = tb.Scene((x, y, z), normal_force=1.0, top=(1.0, 1.0, 0.0, -1.0), bottom=(0.0, 0.0, 0.0, 0.0))
    solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    samples = samples_of(solution)
    spin, rounding = samples.spin.copy(), samples.spin_rounding.copy()
    for part in (spin, rounding):
        part[:, :, :, 1] = -part[:, :, :, 2]
    for judged in (samples, replace(samples, spin=spin, spin_rounding=rounding)):
        known = scene.lattice.by_axis(judged.judgement.states[0].known)[2].reshape(4, 2)
        assert np.isin(known[:3], (TIED, UNDECIDED)).all()
        assert known[3].tolist() == [SLIPLESS, SLIPLESS]
    assert (scene.lattice.by_axis(solution.slip[0])[2].reshape(4, 2)[:3] > 0).all()


def test_spheres_that_share_one_component_move_along_two_lines():
    """Both are pulled by equal friction on either side; the oracle says that minima differ by one motion."""
    scene = make_scene((3, 3, 5), seeds=(133,))
    draw = np.random.default_rng([133, 3, 120])
    given = [np.asarray(draw.choice((0.1, 0.1, 1.0), size=of.shape)) for of in scene.coefficients]
    solution = minimum((3, 3, 5), 133, coefficients=tuple(given))
    least, proven = least_of_all(solution.scene), solution.proven[0]
    true = solution.scene.lattice.flat(least.state)
    assert least.freedom == 1
    assert (true[~proven & (solution.state[0] != DRIVEN)] == EITHER).all()
    names = {truth.SLIPLESS: SLIPLESS, truth.SLIPPING: SLIPPING, EITHER: TIED}
    assert all(names[of] == state for of, state in zip(true[proven], solution.state[0, proven], strict=True)
               if of != minima.DRIVEN)  # fmt: skip
    assert (solution.state[0, proven] != UNDECIDED).sum() > 60


def test_the_friction_of_a_contact_at_its_limit_follows_from_balance():
    """The example of oblique_limits.py: sphere 1 slips on sphere 0 and rests on sphere 2, both driven. Contact 2 bears
    what contact 0 does, if contacts 1 and 3 pull along x by 1 and -1; if the former pulls by 2, nothing is known."""
    domain, x, both = np.array([[0, 1, 1], [0, 1, 1]]), [True, False], [True, True]
    apart = np.array([[0, 2, 1], [0, 2, 1]])
    pulls = Pulls(
        own=np.arange(4), lower=np.array([0, 0, 1, 1]), upper=np.array([1, 1, 2, 2]),
        felt=np.array([both, x, both, x]).T, sign=np.array([[1, 1], [1, 0], [1, 1], [1, 0]]).T,
        coefficient=np.ones((4, 1)), in_s=np.array([True, True, False, False]),
        oblique=np.array([False, False, True, False]), slipless_domain=domain, firm_domain=apart, locked_domain=apart,
        driven=np.array([True, False, True]),
    )  # fmt: skip
    limits = ObliqueLimits.of(pulls)
    assert (limits.guide[2], limits.way[2]) == (0, 1)
    assert [(pair.sphere, pair.contacts.tolist(), pair.way) for pair in limits.between] == [(1, [0, 2], -1)]
    assert not not_balanced(pulls, limits.between).any()
    assert not_balanced(pulls, []).tolist() == [[False, True, False]] * 2
    for contact, friction in ((1, 2.0), (2, 2.0), (3, np.nextafter(1.0, 2.0))):
        coefficient = pulls.coefficient.copy()
        coefficient[contact] = friction
        assert ObliqueLimits.of(replace(pulls, coefficient=coefficient)) is None
