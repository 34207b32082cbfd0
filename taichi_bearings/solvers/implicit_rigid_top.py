"""A torque on the top by implicit Cundall–Strack steps: the strength a of its motion is one more unknown of a stage.

The unknown is S a with S^2 = sum of |state|^2 over the spheres of the top, so that its inertia is that of a sphere. The
matrix of a stage is that of the free spheres with one more row, which a second solve with its factor takes out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem, free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Arrays
from taichi_bearings.conic.newton_matrix import NewtonMatrix, resisted
from taichi_bearings.fields import Fields
from taichi_bearings.numerics.cholesky import NotPositiveDefinite, dissect
from taichi_bearings.scene import Scene
from taichi_bearings.solvers.implicit_cundall_strack import GAMMA, ImplicitCundallStrackMethod
from taichi_bearings.solvers.rigid_top import UnderTorque, over


@dataclass(frozen=True)
class WithTop:
    """The contacts of a system and one unknown more, the last. column : (d, n) a group, differences that it makes."""

    system: ContactSystem
    column: Arrays

    def __getattr__(self, name: str) -> Any:
        """What the one more does not change: where values are in arrays."""
        return getattr(self.system, name)

    @property
    def offset(self) -> Arrays:
        """Nothing is imposed but the bottom at rest."""
        return 0.0 * self.column

    def change(self, step: np.ndarray) -> Arrays:
        return self.system.change(step[:-1]) + float(step[-1]) * self.column

    differences = change

    def torques(self, forces: Arrays) -> np.ndarray:
        return np.append(self.system.torques(forces), (self.column * forces).sum())


class WithTopMatrix:
    """Matrix of a stage: (M, c; c^T, d) with the factor of M; way : M^-1 c. left : d - c . way."""

    def __init__(self, system: WithTop, matrix: NewtonMatrix) -> None:
        self.system, self.matrix = system, matrix

    def factorise(self, stiffness: Arrays, inertia: float) -> None:
        self.matrix.factorise(stiffness, inertia)
        *border, corner = self.system.torques(resisted(stiffness, self.system.column))
        self.border = np.array(border)
        self.way = self.matrix.solve(self.border)
        self.left = corner + inertia - float(self.border @ self.way)
        if not self.left > 0:
            raise NotPositiveDefinite

    def solve(self, right: np.ndarray) -> np.ndarray:
        found = self.matrix.solve(right[:-1])
        last = (right[-1] - self.border @ found) / self.left
        return np.append(found - last * self.way, last)


class ImplicitRigidTopMethod(UnderTorque, ImplicitCundallStrackMethod):
    """amplitude, angle : (R,), a and what the top has turned by in the way of the torque. start : (R,), when it began
    to turn, as the explicit steps have it."""

    kept = (*ImplicitCundallStrackMethod.kept, "amplitude", "angle", "start")

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        axes, nothing = self.spin_axes, np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        self.take_state(scene)
        self.share = np.sqrt(self.inertia / self.body_inertia)  # 1 / S
        own = lattice_system(scene.lattice, axes, scene.top_spin(axes))
        self.system = WithTop(own, self.share * own.offset)
        self.amplitude, self.angle, self.start = np.zeros((3, scene.replicas))
        if scene.law.holds:  # the spin at which inertia stretches a spring to what friction holds
            strongest = scene.strength * float(scene.coefficient.max())
            fastest = strongest / float(np.sqrt(self.options.stiffness * self.inertia))
        else:  # that of the steady motion
            fastest = float(over(np.full(scene.replicas, abs(self.ramp.stop)), self.known.power).max())
        self._begin(nothing, fastest)

    def driven(self, staggered: np.ndarray) -> np.ndarray:
        return staggered

    def _matrix(self) -> Any:
        own = NewtonMatrix(self.system.system, dissect(self.scene.lattice, self.spin_axes))
        return WithTopMatrix(self.system, own)

    def free_spins(self, staggered: np.ndarray) -> np.ndarray:
        return np.column_stack([free_spins(staggered), self.amplitude / self.share])

    def place_free_spins(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        place_free_spins(staggered, replica, spins[:-1])
        self.amplitude[replica] = self.share * spins[-1]
        staggered[:, replica, ..., -1] = self.amplitude[replica] * self.state_of_top[:, 0]

    def _tried(self, replica: int, spins: np.ndarray, span: float) -> Any:
        self.torques = [self.torque(self.time + part * span) for part in (1.0, GAMMA)]  # at the ends of stages
        return super()._tried(replica, spins, span)

    def _stage(self, friction: Any, base: np.ndarray, elongation: Arrays, guess: np.ndarray) -> Any:
        pushed = base.copy()
        pushed[-1] += self.share * self.torques.pop() / friction.inertia
        return super()._stage(friction, pushed, elongation, guess)

    def _take(self, found: list[Any], span: float) -> None:
        before, self.amplitude, way = self.amplitude, self.amplitude.copy(), np.copysign(1.0, self.ramp.stop)
        super()._take(found, span)
        turned = span * (before + self.amplitude) / 2
        ends = [self.torque(self.time + part * span) for part in (GAMMA, 1.0)]
        self.injected = self.injected + ((1 - GAMMA) * ends[0] + GAMMA * ends[1]) * turned
        rests = (self.angle <= self.limit) & (way * self.amplitude <= self.softness * abs(self.rate))
        self.start = np.where(rests, self.time + span, self.start)
        self.angle = self.angle + way * turned

    def kinetic_energy(self, staggered: np.ndarray) -> np.ndarray:
        return super().kinetic_energy(staggered) + self.body_inertia / 2 * self.amplitude**2

    def turning(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.amplitude, self.angle > self.limit, self.start
