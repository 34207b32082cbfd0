"""Small scenes with unequal sides and odd-looking seeds, so that swapped axes and lucky numbers show up."""

import json
from pathlib import Path

import numpy as np
import pytest

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import axis_numbers
from taichi_bearings.scene import Scene
from taichi_bearings.scene.disorder import Distribution, draw_coefficients
from taichi_bearings.scene.generators.lattices import KINDS as LATTICES
from taichi_bearings.scene.law import LAWS, law_named

KNOWN_LAWS = tuple(name for name, law in LAWS.items() if law.is_sum)
"""Laws that every method and the proofs know; tests that loop over them take in a new one of friction and viscosity."""
FRICTION_LAWS = tuple(name for name in KNOWN_LAWS if LAWS[name].has_friction)
VISCOUS_LAWS = tuple(name for name in KNOWN_LAWS if LAWS[name].has_viscosity)
SIMPLE_LAWS = tuple(name for name in KNOWN_LAWS if len(LAWS[name].quantities) == 1)
"""Laws with a single coefficient."""
BIPARTITE = tuple(kind for kind, cell in LATTICES.items() if cell.parity is not None)
"""Lattices of packings whose spheres are of two sublattices."""
MINIMA = json.loads((Path(__file__).parent / "reference" / "minima.json").read_text())["scenes"]


def some_of(count, every):
    """Seeds from 0 on: every so many-th of them always, the others only with `pytest --thorough`."""
    return [pytest.param(n, marks=() if n % every == 0 else pytest.mark.thorough) for n in range(count)]


def make_scene(
    shape,
    law="coulomb",
    seeds=(4711,),
    distribution="uniform:0.1,1.0",
    radius=0.5,
    viscosity="uniform:0.1,1.0",
    periodic=(),
    **driving,
):
    lattice = Lattice(tuple(shape), radius, axis_numbers(periodic))
    given = {"coefficients": distribution, "viscosity": viscosity}
    found = {}
    for _, (name, text) in zip(law_named(law).quantities, given.items(), strict=False):
        drawn = [draw_coefficients(lattice, Distribution.parse(text), seed, name == "viscosity") for seed in seeds]
        found[name] = tuple(np.stack(parts) for parts in zip(*drawn, strict=True))
    return Scene(law=law, radius=radius, seeds=tuple(seeds), periodic=periodic, **found, **driving)


def cells_of(kind):
    """Unequal numbers of cells of a small packing of a lattice, which then has some tens of spheres."""
    cell = LATTICES[kind]
    sides, a_side = {2: (5, 6), 3: (3, 3, 4)}[len(cell.size)], len(cell.basis) ** (1 / len(cell.size))
    return tuple(max(1, round(side / a_side)) for side in sides)


def axis_of(scene):
    """Unit vector (3,) of the imposed spins."""
    axis = np.array([0.0, 0.0, 1.0] if scene.lattice.dimension == 2 else scene.direction)
    return axis / np.linalg.norm(axis)


def minima(*shapes):
    """The stored exact minima of the given shapes."""
    return [entry for entry in MINIMA if tuple(entry["shape"]) in shapes]


def scene_of(entry):
    return make_scene(
        entry["shape"], seeds=(entry["seed"],), spin_top=entry["spin_top"], spin_bottom=entry["spin_bottom"]
    )


def name_of(entry):
    return f"{'x'.join(map(str, entry['shape']))}-seed{entry['seed']}-bottom{entry['spin_bottom']}"
