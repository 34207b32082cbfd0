"""Samples of one packing side by side, and what their network says of all of them."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.conic import shared
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.shared import system_of
from taichi_bearings.solvers import packing_states
from tests.packing.twins import random_packing

ARRAYS = ("spin", "spin_rounding", "slip", "force", "friction", "state", "proven", "power", "lower_bound", "iterations")


def with_absent_contacts(seed):
    """A packing in which one contact has no friction, another one for each seed."""
    packing = tb.Packing.lattice("bcc", (3, 3, 3), seed=seed)
    friction = packing.friction.copy()
    friction[40 + 7 * (seed % 2)] = 0
    return tb.Packing(**packing.arrays() | {"friction": friction})


def with_none_that_holds(seed):
    """Packings of which every second has no friction at all, so that another method solves it."""
    packing = tb.Packing.lattice("bcc", (3, 3, 3), seed=seed)
    return tb.Packing(**packing.arrays() | {"friction": packing.friction * (seed % 2)})


@pytest.mark.parametrize(
    "draw",
    [
        lambda seed: tb.Packing.lattice("bcc", (3, 3, 4), seed=seed),
        lambda seed: tb.Packing.lattice("cubic", (4, 4, 4), seed=seed),
        lambda seed: tb.Packing.lattice("triangular", (5, 5), seed=seed),
        lambda seed: tb.Packing.lattice("fcc", (2, 2, 3), seed=seed, law="coulomb-viscous"),
        lambda seed: tb.Packing.lattice("diamond", (2, 2, 2), seed=seed, law="viscous"),
        with_absent_contacts,
        with_none_that_holds,
    ],
    ids=["bcc", "cubic", "triangular", "both", "viscous", "absent", "none"],
)
def test_a_sample_has_the_same_bits_alone_and_beside_others(draw, monkeypatch):
    packings = [draw(seed) for seed in range(3)]
    block = tb.solve(tb.Packing.together(packings))
    for packing, beside in zip(packings, block, strict=True):
        shared.last.forget()  # nothing is known of the network
        alone = tb.solve(packing)
        for name in ARRAYS:
            assert np.array_equal(getattr(alone, name), getattr(beside, name)), name
        assert alone.status == beside.status
        assert alone.method == beside.method


def kernel_of(matrix):
    """Motions (unknowns, number) that a dense matrix takes to 0."""
    size, vectors = np.linalg.svd(matrix.toarray() if hasattr(matrix, "toarray") else matrix)[1:]
    return vectors[(size > 1e-10).sum() :].T


@pytest.mark.parametrize("seed", range(6))
def test_motions_are_the_kernel_of_all_slips(seed):
    """Loose spheres, chains and blocks: where one factorisation tells that nothing moves freely, and where not."""
    if seed % 2:
        packing = random_packing(np.random.default_rng(seed), 3)
    else:
        packing = tb.Packing.lattice("bcc", (2, 2, 2 + seed // 2), seed=seed)
    whole, found = ContactSystem.before_motions(packing), system_of(packing)
    kernel = kernel_of(whole.operator)
    assert found.motions == kernel.shape[1]
    assert found.unknowns == whole.unknowns - kernel.shape[1]
    assert np.linalg.matrix_rank(found.operator.toarray()) == found.unknowns


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.99])
def test_a_minimum_is_the_only_one_where_nothing_moves_along_its_slips(share):
    system = system_of(tb.Packing.lattice("bcc", (2, 3, 3), seed=4))
    draw = np.random.default_rng(3)
    d, count = system.offset.shape
    force, state = draw.normal(size=(d, count)), (draw.uniform(size=count) < share).astype(int)
    along = force / np.linalg.norm(force, axis=0)
    rows = system.operator.toarray().reshape(d, count, -1)
    across = np.stack([-along[1], along[0]])
    kept = [*rows[:, state == 0], np.einsum("te,teu->eu", across, rows)[state == 1]]
    kernel = kernel_of(np.concatenate(kept))
    slips = np.einsum("te,teu,uk->ek", along, rows, kernel)
    expected = (state == 1) & (np.abs(slips) > 1e-7).any(axis=1)
    assert np.array_equal(packing_states.tied(system, force, state), expected)
