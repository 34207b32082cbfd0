"""Make the network that the proofs judge from a bearing, its spins and its friction.

Speeds and forces are scaled by powers of two, by which nothing is rounded, and enclosed in sums of two doubles. Driven
spheres get exactly the spins that are imposed.
"""

from __future__ import annotations

import numpy as np

from taichi_bearings.numerics.double_double import two_product
from taichi_bearings.proof.enclosure import UNDERFLOWING_PRODUCT, Enclosure
from taichi_bearings.proof.judged_network import JudgedNetwork
from taichi_bearings.proof.listed import Listed, moments
from taichi_bearings.proof.on_lattice import LEAST_SCALE, MOST_SCALE, OnLattice, samples_of_lattice
from taichi_bearings.proof.slices import Grid
from taichi_bearings.scene import Bearing
from taichi_bearings.scene.exact_driving import power_of_two

LEAST_SPEED = 1e-100  # slowest allowed value of the fastest imposed surface speed
LOSING_DIGITS = 1e-290  # imposed spin in units of the scaled ones, below which it loses digits; only its sign is kept
# Units in the last place by which imposed surface speeds may differ and be taken for one. A spin computed as speed over
# radius is off by half a unit, so the speed by up to one; two of them differ by up to 2 units, and this is twice that.
ONE_SPEED = 4


def judged_network(
    scene: Bearing, spin: np.ndarray, spin_rounding: np.ndarray, friction: np.ndarray
) -> JudgedNetwork | None:
    """Return the network to be judged, with its numbers as enclosures (two doubles and a bound on the error); None for
    numbers that are not finite, or whose scales are so large or small that products might overflow or underflow.

    scene : R samples of a lattice or of a packing, with N spheres (on lattices *N, its shape) and E contacts each.
    spin, spin_rounding : (R, *N, 3), of discs (R, *N), 1/time; the spin is the sum of the two.
    friction : (R, E, 3), of discs (R, E), force on the second sphere of each contact."""
    samples = samples_of_lattice(scene, spin, spin_rounding, friction)
    if samples is None:
        return _in_lists(scene, spin, spin_rounding, friction)
    return _on_lattice(samples) if samples.can_be_judged else None


def _on_lattice(samples: OnLattice) -> JudgedNetwork:
    """Return the network of R samples of a lattice for the proofs, with its numbers as enclosures. Forces are in a unit
    that is a power of two, speeds in a power of two times the radius.

    samples : the samples, whose scales have been checked (`can_be_judged`)."""
    scene, grid, force = samples.scene, Grid(samples), samples.force_unit
    strength, radius, law = scene.strength, scene.lattice.radius, scene.law
    coefficient, free = scene.coefficient.ravel(), np.ones(grid.spheres, dtype=bool)
    for plane in (0, -1):
        grid.on_spheres(free)[..., plane] = False
    acts, zeros = grid.any_end(free) & (coefficient != 0), np.broadcast_to(0.0, grid.contacts)  # takes no memory
    zero = Enclosure(zeros, zeros, zeros)
    # Friction limits mu F_n; both factors are divided by powers of two. Then eta, times the unit of speed over force.
    scale, viscosity = power_of_two(strength), scene.named_coefficients.get("viscosity", coefficient).ravel()
    limit = Enclosure.exact(coefficient / (force / scale)).times(np.array([strength / scale]))
    speed_over_force = radius * (samples.spin_unit / force)
    return JudgedNetwork(
        law, samples.count, free, radius * samples.spin_unit, np.full(samples.count, force),
        list(samples.signed_spin.values()), grid.moment(acts), limit if law.has_friction else zero,
        Enclosure.exact(viscosity).times(np.array([speed_over_force])) if law.has_viscosity else zero,
        [grid.imposed(k) for k in samples.components], grid, factors=(coefficient,),
    )  # fmt: skip


def _in_lists(packing: Bearing, spin: np.ndarray, rounding: np.ndarray, friction: np.ndarray) -> JudgedNetwork | None:
    """Return the network of R samples of a packing for the proofs; None where speeds or forces are so large or small
    that products might overflow or underflow.

    packing : the R samples, with N spheres and E contacts each.
    spin, rounding : (R, N, 3), of discs (R, N), 1/time; the spin is the sum of the two.
    friction : (R, E, 3), of discs (R, E), force on the second sphere of each contact."""
    contacts, law, count = packing.network, packing.law, packing.replicas
    free, radius, spheres = contacts.free, contacts.radius, contacts.spheres
    imposed = packing.imposed_spins()[0].reshape(spheres, -1)
    spin, rounding = (of.reshape(count, spheres, -1) for of in (spin, rounding))
    friction = friction.reshape(count, contacts.contacts, contacts.components)
    spin = np.where(free[:, None], spin, imposed)
    rounding = np.where(free[:, None], rounding, 0.0)
    # Lengths are in the radius if it is the same for all spheres: then radii are 1, and no speed is rounded.
    length, radius = (float(radius[0]), np.ones(len(radius))) if (radius == radius[0]).all() else (1.0, radius)
    fastest = float(np.abs(imposed * radius[:, None])[~free].max(initial=0.0)) or 1.0
    coefficient, *further = packing.named_coefficients.values()
    normal_force = np.broadcast_to(packing.normal_force if law.has_friction else 1.0, coefficient.shape)
    # Friction limits mu F_n and damping eta in doubles, to choose units by them.
    limit, damping = coefficient * normal_force, np.zeros(coefficient.shape)
    if law.has_viscosity:
        damping = further[0] if law.has_friction else coefficient
    largest = damping.max(axis=1, initial=0.0) * length * fastest
    largest = np.maximum(limit.max(axis=1, initial=0.0) if law.has_friction else 0.0, largest)
    # Divide spins and forces by units, powers of two, so that nothing is rounded; each sample has its own for forces.
    if not all(LEAST_SPEED < fast < MOST_SCALE for fast in (fastest, fastest * length)):
        return None
    if not ((largest == 0) | ((largest > LEAST_SCALE) & (largest < MOST_SCALE))).all():
        return None
    spin_unit, force_unit = power_of_two(fastest), np.array([power_of_two(of) for of in largest.tolist()])
    acts = ((limit > 0) | (damping > 0)) & contacts.has_free_end
    with np.errstate(over="ignore"):
        spin, rounding, friction = spin / spin_unit, rounding / spin_unit, friction / force_unit[:, None, None]
    scaled = (spin, rounding, spin * radius[:, None], rounding * radius[:, None], friction)
    if not all((np.abs(values) < MOST_SCALE).all() for values in scaled):
        return None
    graph = Listed.of_samples(contacts, friction)
    free_of_all, radius = np.tile(free, count), np.tile(radius, count)
    speeds = [Enclosure.exact(*(of[..., k].ravel() for of in (spin, rounding))) for k in range(spin.shape[2])]
    speeds = speeds if (radius == 1).all() else [_surface_speed(part, radius, ~free_of_all) for part in speeds]
    # Imposed spins that lose digits when they are divided: only their sign is kept, and a bound on their size.
    loses_digits = (imposed != 0) & (np.abs(imposed) < LOSING_DIGITS * spin_unit)
    for part, sign in zip(speeds, np.tile(np.where(loses_digits, np.sign(imposed), 0.0).T, count), strict=True):
        _equalise_imposed_speeds(part, np.flatnonzero(~free_of_all))
        faint = np.flatnonzero((sign != 0) & ~free_of_all)
        size = LOSING_DIGITS * radius[faint]
        part.put(faint, Enclosure(sign[faint] * size, np.zeros(len(faint)), 2 * size))
    zero, normal_force = Enclosure.exact(np.zeros(acts.size)), normal_force.ravel()
    moment = moments([Enclosure.exact(np.where(acts.ravel(), part, 0.0)) for part in graph.friction.T], graph.normal)
    return JudgedNetwork(
        law, count, free_of_all, spin_unit * length, force_unit, speeds, moment,
        Enclosure.exact((coefficient / force_unit[:, None]).ravel()).times(normal_force) if law.has_friction else zero,
        zero if not law.has_viscosity else
        Enclosure.exact((damping * (spin_unit / force_unit)[:, None]).ravel()).times(np.array([length])),
        [part.where(~free_of_all) for part in speeds],
        graph, factors=(coefficient.ravel(), np.broadcast_to(packing.normal_force, coefficient.shape).ravel()),
    )  # fmt: skip


def _surface_speed(spin: Enclosure, radius: np.ndarray, driven: np.ndarray) -> Enclosure:
    """Return one component of spin times radius of N spheres, an enclosure (N,). Imposed spins are doubles, and two
    doubles hold their product with a radius exactly, unless it is tiny.

    spin : the component, an enclosure (N,).
    radius : (N,).
    driven : (N,) mask of the driven spheres."""
    found, (high, low) = spin.times(radius), two_product(spin.high, radius)
    exact = np.flatnonzero(driven & (spin.low == 0) & ((spin.high == 0) | (np.abs(high) > UNDERFLOWING_PRODUCT)))
    found.put(exact, Enclosure.exact(high[exact], low[exact]))
    return found


def _equalise_imposed_speeds(u: Enclosure, driven: np.ndarray) -> None:
    """Change one component u of spin times radius of N spheres, an enclosure (N,), in place, so that driven spheres
    with nearly the same size of u have exactly the same.

    A spin that was computed as speed over radius is rounded, so that one driving appears as several. Sizes that differ
    by no more than ONE_SPEED units in the last place are all replaced by the smallest of them, as a double; signs stay.
    Sizes that are close to no other one keep all their digits.

    driven : indices of the driven spheres.
    """
    turning = driven[u.high[driven] != 0]
    sign = np.sign(u.high[turning])
    # Distinct sizes in ascending order, in groups: a size belongs to the group before if close to its smallest size.
    (size, _), place = np.unique(np.stack([sign * u.high[turning], sign * u.low[turning]]), axis=1, return_inverse=True)
    group = np.arange(len(size))  # number of the smallest size of the group
    for number in range(1, len(size)):
        least = size[group[number - 1]]
        if size[number] - least <= ONE_SPEED * np.spacing(size[number]):
            group[number] = group[number - 1]
    # Replace the sizes in groups of several by the smallest one.
    has_several = np.bincount(group, minlength=len(size)) > 1
    group_of_sphere = group[place.reshape(-1)]
    changes = has_several[group_of_sphere]
    u.put(turning[changes], Enclosure.exact(sign[changes] * size[group_of_sphere[changes]]))
