"""Spins and friction of samples of a lattice, as they are to be judged: measured from the bottom, layer by layer.

Everything that is given is in the laboratory frame. Let n be the direction of a contact, s = +1 or -1 the sublattice of
a sphere, and w_i, w_j the spins at its lower and upper end. The upper surface slips past the lower one with v = -R (w_i
+ w_j) x n (paper, Eq. 2). Friction F on the upper sphere turns both spheres alike, with the torque -R n x F.

* The *signed spin* is s w. Across a contact the sum w_i + w_j is, up to its sign, the difference of the signed spins.
* Where all signed spins are equal nothing slips. Nor does it where they are A + C x, with a vector A and a number C,
  since this differs along the contacts alone. Such a bearing state can be added to all spins, so they are measured from
  that of the bottom.
* The *jump* is the signed spin of the top measured so. Its component k depends on the coordinate x_k alone. No contact
  that slips with component k leads from a layer x_k = const to another one, so what is said of a component is said
  layer by layer.

Shapes: R samples of N spheres and E contacts; *N are the sides of the lattice, whose last axis is the height.
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

LEAST_SCALE, MOST_SCALE = 1e-60, 1e60  # between these the scales of a sample must lie, for products not to overflow
LEAST_JUMP = 1e-140  # smallest component of the jump over the whole, that is not 0


def samples_of_lattice(
    scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: np.ndarray
) -> OnLattice | None:
    """Return the samples of a lattice to be judged; None for a bearing whose contacts are in lists.

    scene : R samples of N spheres (shape *N) and E contacts.
    spin, spin_rounding : (R, *N, 3), in 2D (R, *N), 1/time; the spin is the sum of the two.
    friction : (R, E, 3), force on the upper sphere of each contact; in 2D (R, E), the component along z x n."""
    return OnLattice(scene, spin, spin_rounding, friction) if isinstance(scene, Scene) else None


@dataclass(frozen=True, eq=False)
class OnLattice:
    """The spins and friction of R samples of a lattice with N spheres (shape *N) and E contacts each, as they are
    given.

    scene : the lattice, its coefficients and its driving.
    spin, spin_rounding : (R, *N, 3), in 2D (R, *N), 1/time; the spin is the sum of the two.
    friction : (R, E, 3), force on the upper sphere of each contact; in 2D (R, E), the component along z x n, with n the
        unit normal from the lower to the upper sphere."""

    scene: Scene
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: np.ndarray

    def some(self, pick: slice) -> OnLattice:
        """Return the samples in the slice `pick` of the R samples alone."""
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
        """The lattice of the scene."""
        return self.scene.lattice

    @property
    def components(self) -> tuple[int, ...]:
        """The axes about which spheres spin: z in 2D; x, y and z in 3D, as numbers 0 to 2."""
        return self.lattice.all_spin_axes

    @property
    def can_be_judged(self) -> bool:
        """True if the proofs can judge these samples: if proofs are known for their contact law, and all numbers are
        finite and of a size that lets no product overflow or underflow."""
        scene, driving = self.scene, self.scene.exact_driving
        if not scene.law.is_sum:
            return False
        scales = [scene.normal_force, scene.lattice.radius, driving.jump_size or 1.0]
        strengths = [scene.normal_force * scene.coefficient]
        viscosity = scene.named_coefficients.get("viscosity")
        strengths += [] if viscosity is None else [scene.lattice.radius * driving.unit * viscosity]
        given = zip(strengths, scene.named_coefficients.values(), strict=True)
        arrays = (self.spin, self.spin_rounding, self.friction, *strengths)
        largest = [float(np.abs(values).max(initial=0.0)) for values in arrays]
        return (
            all(LEAST_SCALE < scale < MOST_SCALE for scale in scales)
            and all(size < MOST_SCALE for size in largest)  # False for what is no number
            and all(bool(((values > LEAST_SCALE) | (c == 0)).all()) for values, c in given)  # lost products are not 0
            and all(value == 0 or abs(value) > LEAST_JUMP for jump in driving.jump.values() for value in jump)
        )

    @property
    def spin_unit(self) -> float:
        """The unit of spins in the proof, 1/time: a power of two near the jump, the difference between the imposed
        spins of both planes; 1 without a jump."""
        return self.scene.exact_driving.unit

    @cached_property
    def force_unit(self) -> float:
        """The unit of force in the proof: a power of two near the largest friction limit; for damping alone near the
        force of damping at a slip by `spin_unit`."""
        scene = self.scene
        strength = scene.normal_force if scene.law.has_friction else power_of_two(scene.lattice.radius * self.spin_unit)
        return power_of_two(float(scene.coefficient.max()) * strength)

    @cached_property
    def jump(self) -> dict[int, Enclosure]:
        """For each spin component k the difference of the imposed signed spins, top less bottom, in units of
        `spin_unit` (signed: times +1 or -1, alternating between neighbours). It is (1,) if all spheres of the top have
        the same difference; else (layers,), a number for each layer of spheres across axis k."""
        return {k: Enclosure.of_decimals(values) for k, values in self.scene.exact_driving.jump.items()}

    @cached_property
    def sublattice(self) -> np.ndarray:
        """Sign +1 or -1 of each sphere, an array of the shape *N of the lattice: neighbours have opposite signs."""
        return self.lattice.parity.astype(float)

    def jump_at(self, component: int) -> Enclosure:
        """Return for each of the R * N spheres the jump of a spin component in its layer: the imposed signed spin of
        the top less that of the bottom (signed: times +1 or -1, alternating between neighbours). The result is an
        enclosure (R * N,) in units of `spin_unit`; a read-only view where all layers have the same.

        component : number of the spin component.
        """
        jump, count = self.jump[component], self.count * self.sublattice.size
        if len(jump.high) == 1:
            return jump.spread((count,))
        return jump.at(np.tile(self.layer(component), self.count))

    def layer(self, component: int) -> np.ndarray:
        """Return for each of the N spheres of a sample the number (N,) of its layer, which is its index in the arrays
        of `jump`: its coordinate along the spin component, or 0 where all layers have the same jump, what is imposed on
        the top less that on the bottom.

        component : number of the spin component.
        """
        if len(self.jump[component].high) == 1:
            return np.zeros(self.lattice.sites, dtype=np.int64)
        found: np.ndarray = np.indices(self.lattice.shape)[component].ravel()
        return found

    def leader(self, component: int) -> np.ndarray:
        """Return for each of N spheres of R samples the indices of the two leaders of its layer, (2, R * N): of the
        first sphere of the bottom plane and of the first of the top plane in it.

        A layer has the spheres of a sample with the same coordinate along the axis of the spin component; where all
        layers are driven alike, they count as one. The driven spheres of one plane and layer have the same spin in this
        component, so that the first of them, the leader, stands for all.

        component : number of the spin component.
        """
        first = self.layer(component) * math.prod(self.lattice.shape[component + 1 :])
        low = (np.arange(self.count)[:, None] * first.size + first).ravel()
        return np.stack([low, low + self.lattice.shape[-1] - 1])

    def as_led(self, values: np.ndarray, component: int) -> np.ndarray:
        """Change `values` in place and return it: spheres of a driven plane that always turn alike all get the value of
        the first of them, their leader.

        They turn alike in a component if they have the same coordinate along its axis; if the whole plane is driven
        alike in it, all of the plane do.

        values : (R * N,), a number of each of N spheres of R samples, such as its label.
        component : number of the spin component.
        """
        spheres = values.reshape(self.count, *self.lattice.shape)
        first = [slice(None), *[slice(0, 1)] * self.lattice.height_axis]
        if len(self.jump[component].high) > 1:
            first[1 + component] = slice(None)
        for plane in (spheres[..., 0], spheres[..., -1]):
            plane[...] = plane[tuple(first)].copy()
        return values

    def anchor(self, component: int) -> np.ndarray:
        """Return (R * N,), for R samples of N spheres: for each sphere the index of the first sphere that has to have
        the same spin component, whatever the contacts do. For a free sphere that is the sphere itself.

        For a driven sphere it is a sphere of its driven plane: the first one with the same coordinate along the
        component, or the first one of all if the whole plane is driven alike.
        """
        return self.as_led(np.arange(self.count * self.sublattice.size), component)

    @cached_property
    def signed_spin(self) -> dict[int, Enclosure]:
        """By spin component, exact enclosures (R * N,): spins times the sign +1 or -1 of their sublattice, in units of
        `spin_unit`. All driven spheres of a plane and layer have that of the first one."""
        sign, found, shape = self.sublattice / self.spin_unit, {}, (self.count, *self.lattice.shape, -1)
        for at, k in enumerate(self.components):
            pair = (part.reshape(shape)[..., at] * sign for part in (self.spin, self.spin_rounding))
            high, low, _ = Enclosure.exact(*(part.reshape(-1) for part in pair)).parts
            none = np.broadcast_to(0.0, high.shape)  # takes no memory
            found[k] = Enclosure(self.as_led(high, k), self.as_led(low, k), none)
        return found

    @cached_property
    def shift(self) -> dict[int, Enclosure]:
        """By spin component, (R * N,) for R samples of N spheres, in units of `spin_unit`: for spheres of the top plane
        how much the imposed difference of signed spins between top and bottom exceeds the stored one; 0 for all other
        spheres. (Signed: times +1 or -1, alternating between neighbours.) It is far below the rounding of spins, but
        may exceed the smallest slips."""
        return {k: self._shift(k, stored) for k, stored in self.signed_spin.items()}

    def _shift(self, component: int, stored: Enclosure) -> Enclosure:
        """Return for each sphere of the top plane how much the imposed difference between top and bottom exceeds the
        stored one, in one spin component: (R * N,), 0 for all other spheres, in units of `spin_unit`.

        The difference is that of signed spins (spins times +1 or -1, alternating between neighbours), top less bottom,
        within one layer (same coordinate along the component). It is computed for one sphere of the top and of the
        bottom of each layer, its leaders, with all digits of the imposed decimal numbers.

        component : number of the spin component.
        stored : (R * N,), the stored signed spins in this component, in units of `spin_unit`."""
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
