"""A torque on the top by implicit Cundall–Strack steps: the strength a of its motion is one more unknown of a stage.

The unknown, the last one, is S a with S^2 = sum of |state|^2 over the spheres of the top, so that its inertia is that
of a sphere. Nothing is imposed but the bottom at rest.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.grouped import Arrays
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.fields import Fields
from taichi_bearings.numerics.cholesky import dissect
from taichi_bearings.scene import Scene
from taichi_bearings.solvers.implicit_cundall_strack import GAMMA, ImplicitCundallStrackMethod
from taichi_bearings.solvers.rigid_top import UnderTorque, over


class ImplicitRigidTopMethod(UnderTorque, ImplicitCundallStrackMethod):
    """amplitude, angle : (R,), a and what the top has turned by in the way of the torque. start : (R,), when it began
    to turn, as the explicit steps have it."""

    kept = (*ImplicitCundallStrackMethod.kept, "amplitude", "angle", "start")

    def begin(self, scene: Scene, spin: np.ndarray, fields: Fields | None) -> None:
        axes, nothing = self.spin_axes, np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        self.take_state(scene)
        self.share = np.sqrt(self.inertia / self.body_inertia)  # 1 / S
        own = lattice_system(scene.lattice, axes, scene.top_spin(axes))
        pairs = zip(own.groups, self.share * own.offset, strict=True)
        groups = tuple(group.with_one_more(column) for group, column in pairs)
        self.system = replace(own, unknowns=own.unknowns + 1, groups=groups)
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
        order = dissect(self.scene.lattice, self.spin_axes)
        return NewtonMatrix(self.system, np.append(order, len(order)))

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
