"""Forged spins and friction of one or two free spheres among driven ones, each of which one check of theorem 9 refuses.
Without that check a state would be claimed that is false: the true minima are known in fractions."""

from fractions import Fraction

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.proof import tied_minima
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

pytestmark = pytest.mark.usefixtures("needs_f64")
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
NOT_FELT = {"x": 0, "y": 1}  # a contact along x does not feel the spin about x


class Spheres:
    """Free spheres whose contacts have friction limits and join them to driven spheres or to each other. Spins (x, y)
    have signs that differ between neighbours, so that equal ones roll.

    free : places of the free spheres.
    contacts : (free sphere, axis with its sign, friction limit, spin of a driven neighbour or number of a free one).
    spins : of the free spheres, as stored.
    forces : of every contact, the pull (x, y) on its free sphere towards the spin of the neighbour.
    """

    def __init__(self, free, contacts, spins, forces):
        self.free, self.contacts, self.spins, self.forces = free, contacts, spins, forces

    def slips(self, spins):
        """Of every contact the neighbour's spin less that of the free sphere, in the components that it feels."""
        for sphere, axis, _, other in self.contacts:
            there = spins[other] if isinstance(other, int) else other
            yield [
                Fraction(0) if NOT_FELT.get(axis[1]) == k else Fraction(there[k]) - Fraction(spins[sphere][k])
                for k in range(2)
            ]

    def is_minimum(self, spins, forces):
        """True if forces within friction balance, and are those of the slips: all in fractions."""
        left = [[Fraction(0)] * 2 for _ in self.free]
        for (sphere, _, _, other), force in zip(self.contacts, forces, strict=True):
            for k in range(2):
                left[sphere][k] += Fraction(force[k])
                if isinstance(other, int):
                    left[other][k] -= Fraction(force[k])
        obeys = True
        for (_, _, limit, _), slip, force in zip(self.contacts, self.slips(spins), forces, strict=True):
            pull = [Fraction(part) for part in force]
            obeys &= sum(part**2 for part in pull) <= Fraction(limit) ** 2
            if any(slip):  # full friction along the slip: no part across it, and the same sense
                full = sum(part**2 for part in pull) == Fraction(limit) ** 2
                along = pull[0] * slip[1] == pull[1] * slip[0]
                obeys &= full and along and pull[0] * slip[0] + pull[1] * slip[1] > 0
        return obeys and not any(map(any, left))

    def slipping(self, spins):
        return [any(slip) for slip in self.slips(spins)]

    @property
    def known(self):
        """States that the judgement proves of the stored spins and forces."""
        centers, signs = [np.array(of, dtype=float) for of in self.free], [(-1) ** sum(of) for of in self.free]
        spin = [[sign * part for part in (*of, 0)] for of, sign in zip(self.spins, signs, strict=True)]
        pairs, normals, friction, stored = [], [], [], []
        for (sphere, axis, limit, other), force in zip(self.contacts, self.forces, strict=True):
            normal = np.array(AXES[axis[1]]) * (1 if axis[0] == "+" else -1)
            sign = -signs[sphere]  # of the neighbour
            if not isinstance(other, int):
                centers.append(np.array([0.0, 0.0, 10.0 + len(centers)]))  # anywhere, as normals are given
                spin.append([sign * part for part in (*other, 0)])
            pairs.append((sphere, other if isinstance(other, int) else len(centers) - 1))
            normals.append(normal)
            friction.append(limit)
            stored.append(sign * np.cross((*force, 0), normal))
        driven = np.append(np.full(len(self.free), -1), np.arange(len(centers) - len(self.free)))
        spins = np.array(spin, dtype=float)
        packing = tb.Packing(
            centers, pairs, driven, spins, normal=np.array(normals), friction=friction, schematic=True, normal_force=1.0
        )
        return Judgement(packing, spins, np.zeros_like(spins), np.array(stored, dtype=float)).states[0].known.tolist()


def test_friction_at_its_limit_has_to_balance(monkeypatch):
    """The sphere rests on the first neighbour with all its friction, 1, but is pulled by 2 towards the second one. It
    goes there: the first contact slips at every minimum, the second one rests."""
    contacts = [(0, "-y", 1, (0, 0)), (0, "+y", 2, (9, 0)), (0, "-x", 1, (0, 0)), (0, "+x", 2, (0, 3))]
    forged = Spheres([(0, 0, 0)], contacts, [(0, 3)], [(1, 0), (2, 0), (0, -1), (0, 1)])
    assert forged.is_minimum([(9, 3)], [(-1, 0), (1, 0), (0, -1), (0, 1)])
    assert set(forged.known) == {UNDECIDED}
    monkeypatch.setattr(tied_minima, "not_balanced", lambda pulls, _: np.zeros(pulls.firm_domain.shape, dtype=bool))
    assert forged.known == [TIED, SLIPPING, SLIPPING, SLIPLESS]


def test_friction_below_its_limit_has_to_balance(monkeypatch):
    """The sphere rests on the first neighbour with half of its friction, 1, but is pulled by 2 towards the second one.
    It goes there: the first contact slips at every minimum, the second one rests. Along y it is tied."""
    contacts = [(0, "-y", 1, (0, 0)), (0, "+y", 2, (9, 0)), (0, "-x", 1, (0, 0)), (0, "+x", 1, (0, 3))]
    forged = Spheres([(0, 0, 0)], contacts, [(0, 1)], [(-0.5, 0), (2, 0), (0, -1), (0, 1)])
    assert forged.is_minimum([(9, 1)], [(-1, 0), (1, 0), (0, -1), (0, 1)])
    assert set(forged.known) == {UNDECIDED}
    monkeypatch.setattr(tied_minima, "bearable", lambda *_: True)
    assert forged.known == [SLIPLESS, SLIPPING, TIED, TIED]


def test_contacts_that_share_a_domain_with_one_that_moves_along_a_line_stay_undecided(monkeypatch):
    """The first sphere can move on the line from (0, 0) to (8, 6), the second one along x behind it. The last contact
    slips in the stored spins by more than the second sphere can move there, but it rests at another minimum."""
    contacts = [
        (0, "-z", 5, (0, 0)), (0, "+z", 5, (8, 6)), (0, "-y", 1, (-2, 0)), (0, "+y", 1, 1),
        (1, "+x", 9, (0, 0)), (1, "+z", 2, (20, 0)), (1, "-z", 1, (1, 0)),
    ]  # fmt: skip
    forces = [(-4, -3), (4, 3), (-1, 0), (1, 0), (0, 0), (2, 0), (-1, 0)]
    forged = Spheres([(0, 0, 0), (0, 1, 0)], contacts, [(4, 3), (6, 0)], forces)
    assert forged.is_minimum([(4, 3), (6, 0)], forces)
    assert forged.is_minimum([(0, 0), (1, 0)], forces)
    assert forged.slipping([(4, 3), (6, 0)])[-1]
    assert not forged.slipping([(0, 0), (1, 0)])[-1]
    assert forged.known[-1] == UNDECIDED
    monkeypatch.setattr(tied_minima.Constraints, "sharing_a_domain", lambda _, mask: mask)
    assert forged.known[-1] == SLIPPING


def test_with_oblique_contacts_the_power_has_to_rise_along_all_other_motions(monkeypatch):
    """Both spheres are at the end of a line, where they rest on a second neighbour, and on each other: with friction
    along y alone, so that they move together along x, but not along y. They can go back along both lines."""
    contacts = [
        (0, "-z", 5, (-8, -6)), (0, "+z", 5, (0, 0)), (0, "+z", 1, 1), (0, "+x", 1, (0, 20)),
        (1, "-z", 5, (-6, -8)), (1, "+z", 5, (0, 0)), (1, "-x", 1, (0, -30)),
    ]  # fmt: skip
    forces = [(-4, -3), (4, 3), (0, -1), (0, 1), (-3, -4), (3, 4), (0, -1)]
    forged = Spheres([(0, 0, 0), (0, 0, 1)], contacts, [(0, 0), (0, 0)], forces)
    assert forged.is_minimum([(0, 0), (0, 0)], forces)
    assert forged.is_minimum([(-3, -2.25), (-3, -4)], forces)
    assert all(forged.slipping([(-3, -2.25), (-3, -4)]))
    assert set(forged.known) == {UNDECIDED}
    monkeypatch.setattr(tied_minima, "rises", lambda *_: True)
    assert [forged.known[number] for number in (1, 2, 5)] == [SLIPLESS] * 3


@pytest.mark.parametrize("seed", [3, 7, 19])
@pytest.mark.usefixtures("taichi_runtime")
def test_without_oblique_contacts_balance_implies_that_the_power_rises(monkeypatch, seed):
    """Step 4 of the proof: there `rises` need not be asked. It is True at minima with contacts at their limit."""
    seen, minimum_with_held = [], tied_minima._minimum_with_held
    monkeypatch.setattr(tied_minima, "_minimum_with_held",
                        lambda *given: seen.append((given, minimum_with_held(*given))) or seen[-1][1])  # fmt: skip
    scene = make_scene((5, 5, 5), seeds=(seed,), distribution="bimodal:0.1,1.0,0.5")
    solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "linear"), StopRule(1e-8))
    (_, pulls, between, _, saturated, limits), near = seen[-1]
    assert near is not None
    assert not pulls.in_s.all()
    assert not pulls.oblique.any()
    held = tied_minima._spheres_to_hold(pulls, pulls.locked_domain, pulls.welded_locked, between)
    assert tied_minima.rises(*tied_minima._with_oblique(saturated.motion, pulls, limits, held, near))
