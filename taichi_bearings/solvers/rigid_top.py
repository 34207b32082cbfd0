"""Cundall–Strack dynamics of a torque on the top, which turns as one body: a(t) times its bearing state of strength 1.

I_a da/dt = T(t) - what the contacts hold, with I_a the sum over the spheres of the top of I |state|^2, integrated by
Gear's method as all spins are, or by implicit steps, to which the strength a is one more unknown of a stage: the last
one, S a with S^2 = sum of |state|^2 over the spheres of the top, so that its inertia is that of a sphere. The bottom
and all spheres are at rest at first.

When does it start to turn? Once it has turned farther than springs and friction let it under SAFE of the safe load,
since it was last no faster than a ramp that needs all its way up to that load for this angle (docs/scenes.md).
"""

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from taichi_bearings.conic.contact_system import free_spins, lattice_system, place_free_spins
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.fields import FieldSpec
from taichi_bearings.kernels.cundall_strack import BODY_NUMBERS, RigidTopSteps
from taichi_bearings.numerics.cholesky import dissect
from taichi_bearings.scene import Energy, Progress, Scene, Solution
from taichi_bearings.scene.driving import Ramp
from taichi_bearings.solvers.cundall_strack import CundallStrackMethod
from taichi_bearings.solvers.dynamics import SpringDynamics
from taichi_bearings.solvers.implicit_cundall_strack import GAMMA, ImplicitCundallStrackMethod

SAFE = 0.99  # of the safe load, at which a top is told from one that does not turn


def safe_angle(friction: Solution, stiffness: float) -> np.ndarray:
    """(R,) by which the top cannot turn below SAFE of the torque that the friction of a solution is proven to hold:
    E (4 s + s^2 / (1 - s)) over that torque, with E the energy of springs that bear the friction."""
    springs = (friction.friction.reshape(friction.scene.replicas, -1) ** 2).sum(axis=1) / (2 * stiffness)
    return over(springs * (4 * SAFE + SAFE**2 / (1 - SAFE)), friction.lower_bound)


def over(value: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Their ratio; 0 without a torque."""
    return np.divide(value, torque, out=np.zeros_like(value), where=torque > 0)


class UnderTorque(SpringDynamics):
    """What the explicit and the implicit steps of such a top share.

    rate : of the torque, force length/time. known : the motion of strength 1, which the run answers with. friction :
    the same with friction alone. softness : (R,), the angle that tells a top that turns, over the safe load.
    """

    def __init__(self, options: Any, rate: float, ramp: Ramp, known: Solution, friction: Solution) -> None:
        super().__init__(options)
        self.ramp, self.rate, self.friction = ramp, rate, friction
        self.known = known
        self.limit = safe_angle(friction, options.stiffness)
        self.softness = over(self.limit, friction.lower_bound)

    @cached_property
    def state_of_top(self) -> np.ndarray:
        """(C, 1, *plane), of strength 1."""
        return self.scene.top_spin(self.spin_axes)[:, None]

    @cached_property
    def body_inertia(self) -> float:
        """I_a."""
        return float(self.inertia * (self.scene.top_spin(self.scene.lattice.all_spin_axes) ** 2).sum())

    def torque(self, time: Any) -> Any:
        return self.ramp.start + self.rate * time

    def turning(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(R,) each: amplitude; whether the top has turned too far to rest; time since which it turns."""
        raise NotImplementedError

    def _delay(self) -> np.ndarray:
        """(R,) about how late the moment of yield comes, time."""
        scene, motion, replicas = self.scene, self.friction, self.scene.replicas
        inertia = self.inertia * (motion.spin.reshape(replicas, -1) ** 2).sum(axis=1)
        viscous = scene.law.power(scene.contact, motion.slip).sum(axis=1) - motion.power
        return np.sqrt(2 * inertia * self.softness) + viscous * self.softness

    def answered(self, course: Any) -> Solution:
        """The motion of strength 1, to which the course adds its history and when the top turned."""
        last, left = course.last, course.last.largest_balance_residual
        ended = {"status": course.status, "iterations": last.iteration, "largest_balance_residual": left}
        findings = {**self.known.findings, **self.findings(last)}
        return replace(self.known, method=self.options.name, findings=findings, **ended)

    def findings(self, last: Progress) -> dict[str, np.ndarray]:
        _, turns, start = self.turning()
        when = {"torque_at_yield": self.torque(start), "time_at_yield": start}
        when["torque_at_yield_error"] = abs(self.rate) * self._delay()
        return super().findings(last) | {name: np.where(turns, value, np.nan) for name, value in when.items()}

    def progress(self) -> Progress:
        """As ever, but that no bound is claimed for a motion of any strength."""
        found = super().progress()
        torque = np.full(self.scene.replicas, self.torque(self.time))
        columns = {"torque": torque, "amplitude": self.turning()[0]}
        return replace(found, columns=columns, lower_bound=0 * torque, proof=0 * found.force)


class RigidTopMethod(UnderTorque, CundallStrackMethod):
    """By explicit steps."""

    stepping = RigidTopSteps

    def needed(self) -> FieldSpec:
        body = self.options.gear_order + 1 + len(BODY_NUMBERS)
        return (*super().needed(), ("state", len(self.spin_axes)), ("first", 1), ("body", body))

    @property
    def held(self) -> np.ndarray:
        return super().held & (np.arange(self.scene.lattice.shape[-1]) == 0)

    def begin(self, scene: Scene, spin: np.ndarray) -> None:
        self.body_at_start = [np.zeros(scene.replicas)]
        super().begin(scene, np.zeros_like(spin))
        at_start = {"limit": self.limit / self.time_step, "creep": self.softness * abs(self.rate)}
        body = [*self.body_at_start, *(at_start.get(name, np.zeros(scene.replicas)) for name in BODY_NUMBERS)]
        for name, numbers in (("first", np.ones((1, scene.replicas))), ("body", np.stack(body))):
            values = np.zeros((*numbers.shape, scene.lattice.sites))
            values[..., 0] = numbers
            self.fields.load(name, values.reshape(*numbers.shape, *scene.lattice.shape))
        state = np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        state[..., -1] = self.state_of_top
        self.fields.load("state", state)

    def _load_gear(self, staggered: np.ndarray) -> None:
        super()._load_gear(np.zeros_like(staggered))

    def _drive(self, rate: np.ndarray, order: int) -> None:
        pull = self.inertia * (rate[..., -1] * self.state_of_top).sum(axis=(0, *range(2, rate.ndim - 1)))
        torque = {1: self.ramp.start, 2: self.rate * self.time_step / 2}.get(order, 0.0)
        body = (pull + torque) / self.body_inertia
        super()._drive(rate, order)
        rate[..., -1] = self.state_of_top * body.reshape(-1, *(1,) * (rate.ndim - 3))
        self.body_at_start.append(self.time_step * body)

    def numbers(self) -> tuple[float, ...]:
        scene, step = self.scene, self.time_step
        height, radius = scene.lattice.shape[-1], scene.lattice.radius
        response = step * radius / self.body_inertia
        torque = (self.ramp.start / radius, self.rate * step / radius, np.copysign(1.0, self.ramp.stop))
        return (*super().numbers(), height, scene.lattice.sites // height, response, *torque)

    def spins(self) -> np.ndarray:
        return self.fields.read("gear_0")

    def _of_body(self, name: str) -> np.ndarray:
        """(R,) of its numbers one; `amplitude` is the first of them."""
        number = 0 if name == "amplitude" else self.options.gear_order + 1 + BODY_NUMBERS.index(name)
        return self.fields.read("body")[number].reshape(self.scene.replicas, -1)[:, 0]

    def books(self, staggered: np.ndarray, force: np.ndarray, spring: np.ndarray) -> Energy | None:
        found = super().books(staggered, force, spring)
        if found is None:
            return None
        kinetic = found.kinetic + self.body_inertia / 2 * self._of_body("amplitude") ** 2
        work = self.scene.lattice.radius * self.time_step * self._of_body("work")
        return replace(found, kinetic=kinetic, injected=work)

    def turning(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        turns = self._of_body("angle") > self._of_body("limit")
        return self._of_body("amplitude"), turns, self.time_step * self._of_body("start")


class ImplicitRigidTopMethod(UnderTorque, ImplicitCundallStrackMethod):
    """By implicit steps, with nothing imposed but the bottom at rest.

    amplitude, angle : (R,), a and what the top has turned by in the way of the torque. start : (R,), when it began
    to turn, as the explicit steps have it.
    """

    kept = (*ImplicitCundallStrackMethod.kept, "amplitude", "angle", "start")

    def begin(self, scene: Scene, spin: np.ndarray) -> None:
        SpringDynamics.begin(self, scene, spin)
        axes, nothing = self.spin_axes, np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        self.share = np.sqrt(self.inertia / self.body_inertia)  # 1 / S
        own = lattice_system(scene.lattice, axes, scene.top_spin(axes))
        self.system = own.with_one_more(self.share * own.offset)
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

    def _stage(self, friction: Any, base: np.ndarray, elongation: np.ndarray, guess: np.ndarray) -> Any:
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
