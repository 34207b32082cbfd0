"""One bearing state on all that is driven dissipates nothing, and added to everything it changes nothing: by every
method, in two and three dimensions, with free and periodic sides, between planes and walls and round a shaft."""

from functools import partial

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.scene import Scene
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS

pytestmark = pytest.mark.usefixtures("taichi_runtime", "needs_f64")
LATTICES = [((4, 4), ()), ((2, 4), "x"), ((3, 3, 4), ()), ((4, 3, 4), "x"), ((3, 2, 4), "y"), ((4, 2, 4), "x,y")]
BODIES = [("square", (5, 5), "walls"), ("square", (5, 5), "shaft:0.6"), ("cubic", (4, 3, 3), "planes"),
          ("cubic", (4, 3, 3), "walls"), ("cubic", (5, 5, 3), "shaft:0.6")]  # fmt: skip
OF_PACKINGS = ("auto", "gradient-descent", "cundall-strack")
ADDED, JUMP, ABOUT_X = (4.1, -8.3, 2.7, 1.9), (1.0, 0.5, 0.0, 0.3), (1.0, 0.0, 0.0, 0.0)
ROUNDING = 1e-15  # of what all contacts dissipate that slip as fast as the fastest driven sphere


def every_other(methods, places):
    """Each method at half of the places, and at the other half with --thorough."""
    return [
        pytest.param(method, *place, marks=() if (at + number) % 2 else pytest.mark.thorough)
        for number, method in enumerate(methods)
        for at, place in enumerate(places)
    ]


def carried(spin, place, state):
    """Spins (N, 3) or (N,) with a bearing state, A + C x with the sign of the sublattice, on top."""
    sign = 1.0 - 2.0 * (place.sum(axis=1) % 2)
    return spin + (sign * state[0] if spin.ndim == 1 else sign[:, None] * (np.array(state[:3]) + state[3] * place))


def driven(make, dimension, jump=JUMP):
    """All that is driven at ADDED; the top faster by the jump, the bottom at rest; and that with ADDED on both."""
    both, jump = (state if dimension == 3 else state[:1] for state in (ADDED, jump))
    top = tuple(a + b for a, b in zip(both, jump, strict=True))
    return both, make(top=both, bottom=both), make(top=jump), make(top=top, bottom=both)


@pytest.mark.parametrize(("method", "shape", "periodic"), every_other(METHODS, LATTICES), ids=str)
def test_of_lattices(method, shape, periodic):
    law = next(law for law in LAWS.values() if METHODS[method].solves(law))
    jump = ABOUT_X if method == "planar-cut" else JUMP
    make = partial(Scene.random, shape, seed=5, law=law, periodic=periodic)
    state, alike, plain, more = driven(make, len(shape), jump)
    answer = partial(tb.solve, method=method, threads=1, iterations=30)
    unit = alike.strength * alike.coefficient.sum() * alike.lattice.radius * alike.fastest
    assert METHODS[method].refusal(alike) or answer(alike).power <= ROUNDING * unit
    place = np.indices(shape).reshape(len(shape), -1).T
    start = np.random.default_rng(1).uniform(-1, 1, (*shape, 3) if len(shape) == 3 else shape)
    flat = carried(start.reshape(len(place), -1) if len(shape) == 3 else start.ravel(), place, state)
    first, second = answer(plain, start=start), answer(more, start=flat.reshape(start.shape))
    assert second.power == pytest.approx(first.power, rel=2e-8)  # twice the gap at which a solve ends
    if first.states_proven and second.states_proven:
        assert all((one == other).all() for one, other in zip(first.state, second.state, strict=True))


@pytest.mark.parametrize(("method", "kind", "cells", "bodies"), every_other(OF_PACKINGS, BODIES), ids=str)
def test_of_other_driven_bodies(kind, cells, bodies, method):
    make = partial(tb.Packing.lattice, kind, cells, seed=5, driven=bodies)
    state, alike, plain, more = driven(make, len(cells))
    close = 1e-4 if method == "gradient-descent" else 1e-8
    options = {} if method == "auto" else {"threads": 1, "iterations": 20_000 if method == "gradient-descent" else 100}
    rest, some = np.zeros(alike.spin.shape), np.random.default_rng(1).uniform(-1, 1, alike.spin.shape)

    def answer(packing, spin, state=(0.0,) * 4):
        start = {"start": carried(spin, packing.center, state)} if options else {}
        return tb.solve(packing, method, close, **start, **options)

    best, first, second = answer(alike, rest, state), answer(plain, some), answer(more, some, state)
    unit = alike.material[0].sum() * np.abs(alike.driven_speed).max()
    assert best.power + best.driven_power <= ROUNDING * unit
    assert second.power == pytest.approx(first.power, rel=2 * close)
    assert second.driven_power == pytest.approx(first.driven_power, rel=1e-12, abs=ROUNDING * unit)
