"""Small scenes with unequal sides and odd-looking seeds, so that swapped axes and lucky numbers show up."""

import json
from pathlib import Path

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene
from taichi_bearings.scene.disorder import Distribution, draw_coefficients

MINIMA = json.loads((Path(__file__).parent / "reference" / "minima.json").read_text())["scenes"]


def make_scene(shape, law="coulomb", seeds=(4711,), distribution="uniform:0.1,1.0", radius=0.5, **driving):
    lattice = Lattice(tuple(shape), radius)
    drawn = [draw_coefficients(lattice, Distribution.parse(distribution), seed) for seed in seeds]
    coefficient = tuple(np.stack(parts) for parts in zip(*drawn, strict=True))
    return Scene(lattice, law, coefficient, seeds=tuple(seeds), **driving)


def minima(*shapes):
    """The stored exact minima of the given shapes."""
    return [entry for entry in MINIMA if tuple(entry["shape"]) in shapes]


def scene_of(entry):
    return make_scene(
        entry["shape"], seeds=(entry["seed"],), spin_top=entry["spin_top"], spin_bottom=entry["spin_bottom"]
    )


def name_of(entry):
    return f"{'x'.join(map(str, entry['shape']))}-seed{entry['seed']}-bottom{entry['spin_bottom']}"
