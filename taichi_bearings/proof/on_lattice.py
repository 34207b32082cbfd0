"""Spins and friction of samples of a lattice, as they are to be judged: measured from the bottom, layer by layer.

Everything that is given is in the laboratory frame. With n the direction of a contact, s = +1 or -1 the sublattice of a
sphere, and w_i, w_j the spins at its lower and upper end, the upper surface slips past the lower one with
v = -R (w_i + w_j) x n (paper, Eq. 2); friction F on the upper sphere turns both spheres alike, with the torque
-R n x F. Call s w the signed spin: across a contact the sum w_i + w_j is, up to its sign, the difference of the signed
spins, and where all signed spins are equal nothing slips, nor does it where they are A + C x, which differs along the
contacts alone. Such a bearing state can be added to all spins, so these are measured from that of the bottom.
Component k of the jump, the state of the top measured so, depends on x_k alone, and no contact that feels component k
leads from a layer x_k to another: what is said of a component is said layer by layer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import cached_property

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.enclosure import Enclosure
from taichi_bearings.scene import Bearing, Scene
from taichi_bearings.scene.exact_driving import DIGITS, power_of_two
from taichi_bearings.scene.scene import of_lattice

LEAST_SCALE, MOST_SCALE = 1e-60, 1e60  # between these the scales of a sample must lie, for products not to overflow
LEAST_JUMP = 1e-140  # smallest component of the jump over the whole, that is not 0


def samples_of_lattice(
    scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: np.ndarray
) -> OnLattice | None:
    """The samples of a lattice to be judged; None where contacts are in lists. Arguments as of :class:`OnLattice`."""
    return None if scene.network.lattice is None else OnLattice(of_lattice(scene), spin, spin_rounding, friction)


@dataclass(frozen=True, eq=False)
class OnLattice:
    """R samples of a scene, N spheres and E contacts each, beside each other.

    spin, spin_rounding : (R, *N, 3), in 2D (R, *N); the spin is the sum of the two.
    friction : (R, E, 3) on the upper spheres; in 2D (R, E), the component along z x n.
    """

    scene: Scene
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: np.ndarray

    def some(self, pick: slice) -> OnLattice:
        """The samples in the slice `pick` alone."""
        scene = self.scene.some(pick)
        if scene.replicas == 1:
            scene = self.scene.sample(pick.indices(self.count)[0])
        return OnLattice(scene, self.spin[pick], self.spin_rounding[pick], self.friction[pick])

    @property
    def count(self) -> int:
        """The number R of samples."""
        return self.scene.replicas

    @property
    def lattice(self) -> Lattice:
        return self.scene.lattice

    @property
    def components(self) -> tuple[int, ...]:
        """The components of the spins: about z in 2D; about x, y and z in 3D."""
        return self.lattice.all_spin_axes

    @property
    def can_be_judged(self) -> bool:
        """False for a law whose proofs are not known here, and for numbers that are not finite, or too large or small
        for products."""
        scene, driving = self.scene, self.scene.exact_driving
        if not scene.law.is_sum:
            return False
        scales = [scene.normal_force, scene.lattice.radius, driving.jump_size or 1.0]
        strengths = [scene.normal_force * scene.coefficient]
        viscosity = scene.named_coefficients.get("viscosity")
        strengths += [] if viscosity is None else [scene.lattice.radius * driving.unit * viscosity]
        given = zip(strengths, scene.named_coefficients.values(), strict=True)
        arrays = (self.spin, self.spin_rounding, self.friction, *strengths)
        sizes = [float(np.abs(values).max(initial=0.0)) for values in arrays]
        return (
            all(LEAST_SCALE < scale < MOST_SCALE for scale in scales)
            and all(size < MOST_SCALE for size in sizes)  # False for what is no number
            and all(bool(((values > LEAST_SCALE) | (c == 0)).all()) for values, c in given)  # lost products are not 0
            and all(value == 0 or abs(value) > LEAST_JUMP for jump in driving.jump.values() for value in jump)
        )

    @property
    def spin_unit(self) -> float:
        """A power of two near the jump; 1 without one."""
        return self.scene.exact_driving.unit

    @cached_property
    def force_unit(self) -> float:
        """A power of two near the largest friction, or without friction near the force of damping at `spin_unit`."""
        scene = self.scene
        strength = scene.normal_force if scene.law.holds else power_of_two(scene.lattice.radius * self.spin_unit)
        return power_of_two(float(scene.coefficient.max()) * strength)

    @cached_property
    def jump(self) -> dict[int, Enclosure]:
        """By component, what is imposed on the top measured from the bottom, over `spin_unit`, (layers,) or (1,)."""
        return {k: Enclosure.of_decimals(values) for k, values in self.scene.exact_driving.jump.items()}

    @cached_property
    def sublattice(self) -> np.ndarray:
        """The sign s = +1 or -1 of each sphere, (*N,)."""
        return self.lattice.parity.astype(float)

    def jump_at(self, component: int) -> Enclosure:
        """(R * N,), the jump of a component in the layer of each sphere; a read-only view where it is the same in all
        layers."""
        jump, count = self.jump[component], self.count * self.sublattice.size
        if len(jump.high) == 1:
            return jump.spread((count,))
        return jump.at(np.tile(self.layer(component), self.count))

    def layer(self, component: int) -> np.ndarray:
        """(N,), for each sphere the place of its layer in `jump`: its coordinate along the component, or 0 where the
        whole top has one jump."""
        if len(self.jump[component].high) == 1:
            return np.zeros(self.lattice.sites, dtype=np.int64)
        return np.indices(self.lattice.shape)[component].ravel()

    def leader(self, component: int) -> np.ndarray:
        """(2, R * N), for each sphere the first spheres of the bottom and of the top in its layer: all driven spheres
        there have the same component of the spin."""
        first = self.layer(component) * math.prod(self.lattice.shape[component + 1 :])
        low = (np.arange(self.count)[:, None] * first.size + first).ravel()
        return np.stack([low, low + self.lattice.shape[-1] - 1])

    def as_led(self, values: np.ndarray, component: int) -> np.ndarray:
        """The array `values` (R * N,), changed in place such that driven spheres have what the first of their plane and
        layer has."""
        spheres = values.reshape(self.count, *self.lattice.shape)
        first = [slice(None), *[slice(0, 1)] * self.lattice.height_axis]
        if len(self.jump[component].high) > 1:
            first[1 + component] = slice(None)
        for plane in (spheres[..., 0], spheres[..., -1]):
            plane[...] = plane[tuple(first)].copy()
        return values

    def anchor(self, component: int) -> np.ndarray:
        """(R * N,), the sphere whose component of the spin each shares: the first of its plane and layer for driven
        ones, else itself."""
        return self.as_led(np.arange(self.count * self.sublattice.size), component)

    @cached_property
    def signed_spin(self) -> dict[int, Enclosure]:
        """By component, (R * N,), spins times the sign of their sublattice in units of `spin_unit`, without any error;
        driven spheres have those of their leaders."""
        sign, found, shape = self.sublattice / self.spin_unit, {}, (self.count, *self.lattice.shape, -1)
        for at, k in enumerate(self.components):
            pair = (part.reshape(shape)[..., at] * sign for part in (self.spin, self.spin_rounding))
            high, low, error = Enclosure.exact(*(part.reshape(-1) for part in pair)).parts
            found[k] = Enclosure(self.as_led(high, k), self.as_led(low, k), error)
        return found

    @cached_property
    def shift(self) -> dict[int, Enclosure]:
        """By component, (R * N,), what stored signed spins of the top lack of the imposed ones, measured from the
        bottom; 0 for all other spheres."""
        return {k: self._shift(k, stored) for k, stored in self.signed_spin.items()}

    def _shift(self, component: int, stored: Enclosure) -> Enclosure:
        """`shift` (R * N,) of one component. stored : its signed spins, (R * N,)."""
        jump, size = self.scene.exact_driving.jump[component], self.sublattice.size
        # Only leaders of the bottom and the top are needed, one pair for each sample and layer.
        first = np.arange(self.count)[:, None] * size
        if len(jump) > 1:
            first = first + np.arange(len(jump)) * math.prod(self.lattice.shape[component + 1 :])
        ends = (first, first + self.lattice.shape[-1] - 1)
        bottom, top = (stored.at(end.ravel()).parts[:2] for end in ends)
        # Jump less (top less bottom), in decimals with all digits.
        with localcontext() as context:
            context.prec = DIGITS
            given = zip(*(np.transpose(pair).tolist() for pair in (bottom, top)), strict=True)
            missing = [
                jump[number % len(jump)] + sum(Decimal(v) for v in (*low, *(-v for v in high)))
                for number, (low, high) in enumerate(given)
            ]
            exact = Enclosure.of_decimals(missing)
        found = Enclosure.exact(np.zeros(self.count * size))
        along = [1] * self.lattice.height_axis
        along[component if len(jump) > 1 else 0] = len(jump)
        for whole, values in zip(found.parts, exact.parts, strict=True):
            whole.reshape(self.count, *self.lattice.shape)[..., -1] = values.reshape(self.count, *along)
        return found
