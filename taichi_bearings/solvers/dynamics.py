"""What the dynamics have in common: which spins move, their inertia, their energy."""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.scene import Scene
from taichi_bearings.scene.scene import vector_length

COARSEST = 1e-6  # of the imposed jump
REST_CHECKS = 3  # consecutive checks, each 1/16 of the time so far apart, that must agree


def moving_spin_axes(scene: Scene, spin: np.ndarray) -> tuple[int, ...]:
    """Components a dynamics needs: those of the minimum, and any in which these laboratory spins (R, *N, 3) start
    unlike the driven planes."""
    needed = scene.minimum_spin_axes
    if scene.lattice.dimension == 2:
        return needed
    full = scene.staggered_spin(spin, scene.lattice.all_spin_axes)
    return tuple(k for k in scene.lattice.all_spin_axes if k in needed or full[k].any())


def default_inertia(scene: Scene, mass: float) -> float:
    """m R^2 / 2 of a disc or 2 m R^2 / 5 of a sphere."""
    return mass * scene.lattice.radius**2 * (0.5 if scene.lattice.dimension == 2 else 0.4)


def replica_sum(values: np.ndarray) -> np.ndarray:
    """(R,) from (T, R, ...): the sum over everything but the replicas."""
    return values.sum(axis=(0, *range(2, values.ndim)))


def absolute(scene: Scene, staggered: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Staggered spins (C, R, *N) as they are in the laboratory, not measured from the bottom: for kinetic energies."""
    return staggered + scene.driving.bottom_state(spin_axes)[0]


def kinetic_energy(scene: Scene, staggered: np.ndarray, spin_axes: tuple[int, ...], inertia: float) -> np.ndarray:
    """(R,) of the free spheres with staggered spins (C, R, *N), energy."""
    return inertia / 2 * replica_sum(absolute(scene, staggered, spin_axes)[..., 1:-1] ** 2)


def elastic_share(scene: Scene, longest: np.ndarray, time: float) -> dict[str, np.ndarray]:
    """Share of the distance that the driven planes have slid past each other which the longest spring, (R,), takes up,
    as a finding; none before they have slid, or without springs. Rigid contacts would take up nothing."""
    slid = scene.lattice.radius * scene.jump * time
    return {"elastic_share": longest / slid} if slid > 0 and scene.law.holds else {}


@dataclass(frozen=True)
class Saturation:
    """Contacts that bear all the friction they can, to a relative `tolerance`, and so slip; none without friction.

    slipping : (R,). creep : largest slip speed of a contact that holds, length/time: by less a contact is not known to
    slip; at most COARSEST of the imposed jump, so that contacts which slip plainly are told from the first step on.
    """

    slipping: np.ndarray
    creep: float

    @classmethod
    def of(cls, scene: Scene, force: np.ndarray, slip: np.ndarray, tolerance: float) -> "Saturation":
        """force : (C, R, E). slip : (R, E)."""
        limit, coarsest = scene.law.holding_force(scene.contact), COARSEST * scene.lattice.radius * scene.jump
        if limit is None:
            return cls(np.zeros(scene.replicas, dtype=np.int64), 0.0)
        slips = vector_length(force) >= (1 - tolerance) * limit
        return cls((slips & (limit > 0)).sum(axis=1), min(float(slip[~slips].max(initial=0.0)), coarsest))


@dataclass
class RestWatch:
    """Counts the checks in a row at which a dynamics has been stationary.

    last_objective : (R,), at the last check. last_slipping : slipping contacts then, of all replicas.
    """

    last_objective: np.ndarray
    last_slipping: int = -1
    quiet_checks: int = 0

    @property
    def at_rest(self) -> bool:
        return self.quiet_checks >= REST_CHECKS

    def look(
        self,
        scene: Scene,
        objective: np.ndarray,
        slipping: int,
        force: np.ndarray,
        left_over: np.ndarray,
        tolerance: float,
        believed: bool,
    ) -> None:
        """A check: objective (R,), contact forces (C, R, E), and the largest torque (R,) they leave.

        tolerance : change of the objective, relative; a thousand times as much of the typical torque may be left.
        believed : springs that have not loaded yet look stationary too; True once that can be ruled out.
        """
        typical_torque = scene.lattice.radius * float(vector_length(force).max(initial=0.0))
        still = bool((np.abs(objective - self.last_objective) <= tolerance * np.abs(objective)).all())
        balanced = bool((left_over <= 1e3 * tolerance * typical_torque).all())
        quiet = believed and still and balanced and slipping == self.last_slipping
        self.quiet_checks = self.quiet_checks + 1 if quiet else 0
        self.last_objective, self.last_slipping = objective, slipping
