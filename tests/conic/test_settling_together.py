"""Samples settled together, as parts of one system that no contact joins, and each of them alone."""

import numpy as np
import pytest

from taichi_bearings.conic.cones import isotropic, length
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.contraction import Contraction
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import dissect

LATTICE, AXES = Lattice((4, 4, 5)), (0, 1)
SHARES = (0.0, 0.3, 0.6, 1.0)  # of the contacts that are tied, sample by sample; with all of them nothing is left


@pytest.fixture(scope="module")
def system():
    return lattice_system(LATTICE, AXES, np.array([1.0, 0.0]))


@pytest.fixture(scope="module")
def tied(system):
    """Masks of the tied contacts, none at the driven planes but in the last sample."""
    rng, free = np.random.default_rng(1), ((system.ends >= 0) | ~system.felt).all(axis=(0, 1))
    return [(rng.random(len(free)) < share) & (free | (share == 1)) for share in SHARES]


@pytest.fixture(scope="module")
def order():
    return dissect(LATTICE, AXES)


@pytest.fixture(scope="module")
def contraction(system, order, tied):
    return Contraction(system.copies(len(tied)), order, np.concatenate(tied), len(tied))


def test_sets_of_tied_spins_are_those_of_each_sample_alone(system, order, tied, contraction):
    heads = np.split(contraction.heads, len(tied))
    for number, mask in enumerate(tied):
        alone, own = Contraction(system, order, mask), contraction.span(number)
        assert alone.unknowns == own.stop - own.start
        assert contraction.contradicts[number] == alone.contradicts[0] == (SHARES[number] == 1)
        assert (heads[number] == alone.heads).all()
        assert contraction.order(number).tolist() == alone.order(0).tolist()
        assert sorted(alone.order(0).tolist()) == list(range(alone.unknowns))


def test_contacts_that_loops_leave_no_slip_are_tied_too(system, tied, contraction):
    rng = np.random.default_rng(5)
    spins, _ = contraction.expanded((rng.random(contraction.unknowns), np.zeros(contraction.unknowns)))
    slip, mask = length(system.copies(len(tied)).differences(spins)), np.concatenate(tied)
    left = np.zeros(len(slip), dtype=bool)
    left[contraction.kept] = True
    consistent = np.repeat(~contraction.contradicts, len(slip) // len(tied))
    assert not (left & mask).any()
    assert (left == (slip > 0))[consistent].all()
    assert (~left & ~mask)[consistent].any()


def blocks_of(tied):
    parts = [tied.span(sample) for sample in range(tied.owners.samples)]
    return NewtonMatrix(tied.system, tied.order, parts=parts)


def test_a_singular_block_is_no_matter_to_the_others(system, order, tied, contraction):
    owners, rng = contraction.owners, np.random.default_rng(3)
    strength = np.where(owners.contacts == 1, 0.0, rng.uniform(1, 2, len(owners.contacts)))
    blocks, right = blocks_of(contraction), rng.random(contraction.unknowns)
    stiffness = isotropic(contraction.system.offset, strength)
    assert blocks.factorise_each(stiffness, np.array([True, True, False, True])).tolist() == [True, False, False, True]
    assert blocks.factorise_each(stiffness, np.ones(4, dtype=bool)).tolist() == [True, False, True, True]
    found = blocks.solve(right, np.array([True, False, True, False]))
    assert (found[contraction.span(1)] == 0).all()
    for number in (0, 2):
        own, alone = contraction.span(number), Contraction(system, order, tied[number])
        of_sample = strength[owners.contacts == number]
        block = blocks_of(alone)
        block.factorise_each(isotropic(alone.system.offset, of_sample), np.ones(1, dtype=bool))
        assert (found[own] == block.solve(right[own], np.ones(1, dtype=bool))).all()
