"""Samples of a lattice as plain arrays of the laboratory frame, for oracles and for the judgement."""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class Samples:
    """R samples. coefficient, viscosity, friction : one array (R, *contacts), (R, *contacts, 3) an axis."""

    shape: tuple[int, ...]
    law: str
    coefficient: tuple[np.ndarray, ...]
    spin_top: float
    spin_bottom: float
    direction: tuple[float, ...]
    normal_force: float
    radius: float
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: tuple[np.ndarray, ...]
    viscosity: tuple[np.ndarray, ...] = ()
    top: tuple[float, ...] | None = None
    bottom: tuple[float, ...] | None = None
    periodic: tuple[int, ...] = ()

    @property
    def dimension(self):
        return len(self.shape)

    @property
    def components(self):
        return (2,) if self.dimension == 2 else (0, 1, 2)

    @property
    def sublattice(self):
        return 1.0 - 2.0 * (np.indices(self.shape).sum(axis=0) % 2)

    @property
    def scene(self):
        given = {"top": self.top, "bottom": self.bottom}
        if self.top is None:
            given = {"spin_top": self.spin_top, "spin_bottom": self.spin_bottom, "direction": self.direction}
        others = {"normal_force": self.normal_force, "radius": self.radius, "viscosity": self.viscosity}
        return Scene(self.coefficient, self.law, periodic=tuple("xyz"[a] for a in self.periodic), **given, **others)

    @property
    def jump_size(self):
        """|jump| where it is largest on the top plane."""
        top = self.scene.top_spin(self.components)
        return float(np.sqrt((top**2).sum(axis=0).max()))

    @property
    def flat_friction(self):
        vector = (3,) if self.dimension == 3 else ()
        parts = [of.reshape(len(self.spin), -1, *vector) for of in self.friction]
        return np.concatenate(parts, axis=1)

    @property
    def judgement(self):
        return Judgement(self.scene, self.spin, self.spin_rounding, self.flat_friction)


def samples_of(solution):
    """What a solution of a lattice says, as plain arrays."""
    scene, by_axis = solution.scene, solution.scene.lattice.by_axis
    coefficient, *viscosity = map(by_axis, scene.named_coefficients.values())
    top, bottom = scene.imposed
    vector = solution.friction.shape[2:]
    friction = tuple(
        solution.friction[:, span].reshape(len(solution.spin), *scene.lattice.contact_shape(axis), *vector)
        for axis, span in enumerate(scene.lattice.spans)
    )
    return Samples(
        scene.lattice.shape, scene.law.name, coefficient, top, bottom, scene.direction, scene.normal_force,
        scene.lattice.radius, solution.spin, solution.spin_rounding, friction, *viscosity or [()],
        scene.top, scene.bottom, scene.lattice.periodic,
    )  # fmt: skip
