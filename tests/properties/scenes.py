"""Scenes that hurt: flat and tall, tied and torn coefficients, odd axes, hardly any driving, huge and tiny units.

A strategy draws the shape of a difficulty, a seed its numbers, so that cases stay cheap and shrink to small lattices.
"""

from dataclasses import replace

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene
from taichi_bearings.scene.law import LAWS

DISCS = ((2, 3), (3, 3), (2, 4), (3, 4), (4, 5), (2, 9), (8, 3), (6, 6))
SPHERES = ((2, 2, 3), (2, 3, 3), (3, 2, 4), (2, 2, 4), (3, 3, 3), (5, 4, 3), (2, 2, 9), (2, 5, 4))
DRIVINGS = (
    (1.0, 0.0),
    (0.0, 1.0),
    (1.0, -1.0),
    (-0.37, 2.1),
    (1.0, 0.9),
    (1.0, 1 - 1e-12),
    (-1.0, -1 + 1e-7),
    (1.0, 1e-9),
)
PLANAR = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 3.0), (0.0, -2.0, 1e-6))
TILTED = ((1.0, 1.0, 0.0), (1.0, -2.0, 3.0), (1.0, 1e-3, 0.0), (-1e-8, 1.0, 1.0), (1.0, 1e-12, 1e-5), (1e-4, 1e-4, 1.0))
SPREADS = {  # of coefficients, from 1 over `contrast` to 1, about
    "constant": lambda rng, contrast, shape: np.ones(shape),
    "tied": lambda rng, contrast, shape: rng.integers(1, 4, shape).astype(float),
    "uniform": lambda rng, contrast, shape: rng.uniform(0.1, 1.0, shape),
    "bimodal": lambda rng, contrast, shape: np.where(rng.random(shape) < 0.5, 1.0, 1.0 / contrast),
    "power-law": lambda rng, contrast, shape: contrast ** rng.uniform(-1.0, 0.0, shape),
}
ABSENT = (0.0, 0.0, 0.0, 0.1, 0.5)  # shares of contacts that are not there
THOROUGH, QUICK = 1000, 0.25  # cases from which a profile is thorough; share of those of the others
seeds = st.integers(0, 2**32 - 1)


def cases(share=1.0):
    """So many of the cases of the profile: `share` is less for what takes longer."""
    most = settings.default.max_examples
    return settings(max_examples=max(3, round(share * (most if most >= THOROUGH else QUICK * most))))


def decades(most):
    """Powers of ten, 1 as the simplest and the most frequent."""
    return st.one_of(st.just(0), st.integers(-most, most)).map(lambda power: 10.0**power)


@st.composite
def coefficients(draw, lattice, replicas=1, contrast=18, unit=1.0):
    """One array (R, *contacts) an axis; the middle of their decades is `unit`."""
    rng, spread = np.random.default_rng(draw(seeds)), SPREADS[draw(st.sampled_from(tuple(SPREADS)))]
    ratio = 10.0 ** draw(st.integers(0, contrast))
    shapes = [(replicas, *lattice.contact_shape(axis)) for axis in range(lattice.dimension)]
    return tuple(unit * ratio**0.5 * spread(rng, ratio, shape) for shape in shapes)


@st.composite
def scenes(
    draw, laws=tuple(LAWS), shapes=DISCS + SPHERES, directions=PLANAR + TILTED, replicas=(1,), contrast=18, scale=12
):
    """A scene. contrast : decades of the coefficients. scale : decades up and down of every unit."""
    law, count = draw(st.sampled_from(laws)), draw(st.sampled_from(replicas))
    lattice = Lattice(draw(st.sampled_from(shapes)), draw(decades(scale)))
    force, speed = draw(decades(scale)), draw(decades(scale))
    top, bottom = (speed * spin for spin in draw(st.sampled_from(DRIVINGS)))
    given, absent = {"coefficients": draw(coefficients(lattice, count, contrast))}, draw(st.sampled_from(ABSENT))
    if law != "viscous":
        given["normal_force"] = force
    if law == "coulomb-viscous":  # friction and viscosity alike, or one of them as good as absent
        even = force / (lattice.radius * abs(top - bottom)) * draw(decades(6))
        unit = float(np.clip(even, 1e-15 * 10.0 ** (contrast / 2 + 1), 1e15 / 10.0 ** (contrast / 2 + 1)))
        given["viscosity"] = draw(coefficients(lattice, count, contrast, unit))
    if lattice.dimension == 3:
        given["direction"] = draw(st.sampled_from(directions))
    if absent:
        there = _present(lattice, count, absent, draw(seeds))
        for name in given.keys() & {"coefficients", "viscosity"}:
            given[name] = tuple(values * held for values, held in zip(given[name], there, strict=True))
    return Scene(
        law=law,
        spin_top=top,
        spin_bottom=bottom,
        radius=lattice.radius,
        seeds=tuple(range(count)),
        **given,
    )


def _present(lattice, replicas, absent, seed):
    """1 for contacts that are there, else 0, of every axis; the first one along the height is."""
    rng = np.random.default_rng(seed)
    found = [rng.random((replicas, *lattice.contact_shape(axis))) >= absent for axis in range(lattice.dimension)]
    found[-1][(slice(None), *(0,) * lattice.dimension)] = True
    return [part.astype(float) for part in found]


def arrays_of(scene):
    """What a scene takes, one array (R, *contacts) an axis; no viscosity of a law without."""
    coefficients, *beside = map(scene.lattice.by_axis, scene.named_coefficients.values())
    return {"coefficients": coefficients, "viscosity": beside[0] if beside else ()}


def changed(scene, function, **changes):
    """The scene with `function` of every array of coefficients (R, *contacts) and its axis, and other changes."""
    named = arrays_of(scene).items()
    arrays = {name: tuple(function(values, axis) for axis, values in enumerate(of)) for name, of in named}
    return replace(scene, **(arrays | changes))
