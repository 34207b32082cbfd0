"""What the dynamics have in common: which spins move, their inertia, their energy."""

import numpy as np

from taichi_bearings.scene import Scene


def moving_spin_axes(scene: Scene, spin: np.ndarray) -> tuple[int, ...]:
    """Components a dynamics needs: those of the minimum, and any in which these laboratory spins (R, *N, 3) start
    unlike the driven planes."""
    needed = scene.minimum_spin_axes
    if scene.lattice.dimension == 2:
        return needed
    full = scene.staggered_spin(spin, scene.lattice.all_spin_axes)
    bottom, _ = scene.driven_values(scene.lattice.all_spin_axes)
    return tuple(k for k in scene.lattice.all_spin_axes if k in needed or (full[k] != bottom[k]).any())


def default_inertia(scene: Scene, mass: float) -> float:
    """m R^2 / 2 of a disc or 2 m R^2 / 5 of a sphere."""
    return mass * scene.lattice.radius**2 * (0.5 if scene.lattice.dimension == 2 else 0.4)


def replica_sum(values: np.ndarray) -> np.ndarray:
    """(R,) from (T, R, ...): the sum over everything but the replicas."""
    return values.sum(axis=(0, *range(2, values.ndim)))


def kinetic_energy(scene: Scene, staggered: np.ndarray, inertia: float) -> np.ndarray:
    """(R,) of the free spheres with staggered spins (C, R, *N), energy."""
    return inertia / 2 * replica_sum(staggered[..., 1:-1] ** 2)
