"""Power, lower bound and contact states of a packing: what is rigorously true of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.verifier.network import Network, StoredPacking
from taichi_bearings.verifier.network_bounds import Bounds
from taichi_bearings.verifier.network_states import network_states
from taichi_bearings.verifier.samples import OfLaw
from taichi_bearings.verifier.states import States

NORMAL_ROUNDING = 1e-12  # of the friction, along a normal


@dataclass(frozen=True)
class PackingJudgement(OfLaw):
    """Of the spins and the friction of a packing, one sample: arrays (1,) and (1, E), as of a `Judgement`."""

    packing: StoredPacking
    network: Network

    @classmethod
    def of(
        cls, law: str, arrays: dict[str, np.ndarray], spin: np.ndarray, friction: np.ndarray
    ) -> PackingJudgement | None:
        """As of `StoredPacking`; None for numbers that no arithmetic can judge."""
        packing = StoredPacking(law, arrays, spin, friction)
        network = Network.of(packing)
        return None if network is None else cls(packing, network)

    @property
    def law(self) -> str:  # type: ignore[override]
        return self.packing.law

    @cached_property
    def bounds(self) -> Bounds:
        return Bounds.of(self.network)

    @cached_property
    def states(self) -> list[States]:
        return [network_states(self.bounds)]

    @property
    def acts(self) -> np.ndarray:
        return self.network.acts[None]

    @property
    def limit(self) -> np.ndarray:
        """Friction that a contact bears, or without friction its damping."""
        return (self.packing.arrays["friction"] * (self.packing.arrays["normal_force"] if self.holds else 1.0))[None]

    @property
    def damping(self) -> np.ndarray | None:
        """Beside friction."""
        return self.packing.arrays["viscosity"][None] if "viscosity" in self.packing.arrays else None

    @property
    def force_unit(self) -> float:
        return self.network.force_unit

    @property
    def _friction(self) -> np.ndarray:
        """(E, C), as stored, in units of force."""
        return self.packing.friction.reshape(len(self.network.contact), -1) / self.force_unit

    @property
    def friction_size(self) -> np.ndarray:
        return np.linalg.norm(self._friction, axis=1)[None] * self.force_unit

    @property
    def friction_along(self) -> np.ndarray:
        """Mask of the contacts along which friction acts, by more than rounding."""
        if self._friction.shape[1] == 1:
            return np.zeros((1, len(self.network.contact)), dtype=bool)
        along = np.abs((self._friction * self.network.normal).sum(axis=1))
        return (along > NORMAL_ROUNDING * np.linalg.norm(self._friction, axis=1))[None]

    @property
    def slip(self) -> np.ndarray:
        """Speeds, to the nearest doubles."""
        return (self.network.slip.value * self.network.speed_unit)[None]

    @property
    def slip_bound(self) -> np.ndarray:
        """Speeds that no slip of any minimum exceeds; infinite where that is not known."""
        bound = self.states[0].slip_bound
        assert bound is not None
        return np.asarray(bound * self.network.speed_unit)[None]

    @property
    def power(self) -> np.ndarray:
        return np.array([self.bounds.power])

    @property
    def objective(self) -> np.ndarray:
        return np.array([self.bounds.objective])

    @property
    def upper_bound(self) -> np.ndarray:
        return np.array([self.bounds.upper_bound])

    @property
    def lower_bound(self) -> np.ndarray:
        return np.array([self.bounds.lower_bound])

    @property
    def gap(self) -> np.ndarray:
        return np.array([self.bounds.gap])

    @property
    def proof(self) -> str:
        return self.bounds.proof

    @property
    def saturation(self) -> np.ndarray:
        return np.array([self.bounds.worst])

    @property
    def price(self) -> np.ndarray:
        """What torques left over on free spheres cost, over the objective."""
        price, upper = self.bounds.price, self.bounds.upper
        return np.array([price / upper if upper > 0 else np.inf if price > 0 else 0.0])

    @property
    def largest_torque(self) -> np.ndarray:
        """Over the radius, left over on a free sphere, rounded up; force."""
        return np.array([self.bounds.largest_torque * self.network.force_unit])

    @property
    def driven_power(self) -> float:
        """What contacts between driven spheres dissipate."""
        between = ~self.network.free[self.network.contact].any(axis=1)
        return float(self.network.dissipated(1.0, between).value[0] * self.network.power_unit)
