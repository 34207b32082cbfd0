"""Spheres whose contacts lie along the axes and whose loops are even, as the contact systems of lattices.

A contact along an axis feels the two other components alone. Where they have no odd loop, signs by which neighbours
differ, those of each component its own, make of their sums the differences of a lattice: its central path, its settling
of contact states and its ties serve any such network.
"""

import numpy as np

from taichi_bearings.conic.central_path import flowing
from taichi_bearings.conic.contact_system import ContactGroup, ContactSystem, Places
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.descent import Descent, Sample
from taichi_bearings.conic.grouped import Arrays
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.resolution import Surroundings
from taichi_bearings.conic.rows import compile_passes
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.packing.central_path import MOST_STEPS, SLACK, Point
from taichi_bearings.packing.system import System, along_axes, odd_parts

SMALL_SPHERES = 5_000  # up to which states are settled as those of small lattices


def signed(system: System) -> tuple[ContactSystem, np.ndarray] | None:
    """Contacts over signed spins U = s u, numbered as those of the system, and s (N, C); None where there are none.

    The difference U_j - U_i of a contact is s_j (u_i + u_j).
    """
    packing, needed = system.packing, np.flatnonzero((system.moved >= 0).any(axis=0))
    if not along_axes(packing, system.contact):
        return None
    felt, contact = np.any(system.across, axis=0), packing.contact[system.contact]
    sign = np.ones(system.known.shape)
    for k in needed:
        ends = contact[felt[:, k]]
        odd, sign[:, k] = odd_parts(packing.spheres, *ends.T)
        if odd[ends].any():
            return None
    known, felt, groups, places = sign * system.known, felt[:, needed], [], []
    for count in range(1, len(needed) + 1):
        own = np.flatnonzero(felt.sum(axis=1) == count)
        if len(own):
            slot = needed[np.nonzero(felt[own])[1].reshape(-1, count).T]
            first, second = contact[own].T
            offset = known[second, slot] - known[first, slot]
            groups.append(ContactGroup(system.moved[first, slot], system.moved[second, slot], offset, system.unknowns))
            places.append(Places(own, slot))
    place = packing.center[system.sphere].T
    return ContactSystem(system.unknowns, tuple(groups), tuple(places), place), sign


def followed_along_axes(
    system: System, friction: np.ndarray
) -> tuple[Point, np.ndarray | None, np.ndarray | None, int] | None:
    """Where the central path and the settling of states lead; which contacts slip there, and which tie or bear all
    their friction at rest, (A,) each, None if that is not settled; and the number of steps. None if this is no such
    network. friction : (A,)."""
    found = signed(system)
    if found is None:
        return None
    contacts, sign = found
    order = order_by_place(*contacts.couplings(), system.packing.center[system.sphere].T)
    matrix = NewtonMatrix(contacts, order)
    compile_passes()
    matrix.compile()
    unit = float(np.exp2(np.round(np.log2(friction.mean()))))  # as of lattices
    strength = contacts.gather(friction[None] / unit, 0)
    try:
        spins = flowing(contacts, strength, matrix, np.zeros(contacts.unknowns))
    except NotPositiveDefinite:
        return None
    slips = np.concatenate([*contacts.differences(spins).length()])
    spheres = len(np.unique(system.sphere))
    descent = Descent(Surroundings(contacts, order, matrix, None), spheres, spheres < SMALL_SPHERES, settles=True)
    sample = Sample(Iterate.start(contacts, spins, strength, SLACK * float(slips.mean())), unit)
    descent.samples = [sample]
    while not sample.done and sample.steps < MOST_STEPS:
        descent.advance(MOST_STEPS - sample.steps)
    settled, steps, second = sample.resolved, sample.steps, sign[system.packing.contact[system.contact, 1]]
    answer = settled or sample.iterate

    def across(vectors: Arrays) -> np.ndarray:
        """(d, A), along the tangents."""
        whole = np.zeros((second.shape[1], 1, len(friction)))
        contacts.scatter_vectors(vectors, whole, 0)
        return np.einsum("tek,ek,ke->te", system.across, second, whole[:, 0])

    def everywhere(of: Arrays) -> np.ndarray:
        """(A,), 0 for contacts that feel no component which moves."""
        whole = np.zeros((1, len(friction)), dtype=of.parts[0].dtype)
        contacts.scatter(of, whole, 0)
        return whole[0]

    spin, bound = sign[system.moved >= 0] * answer.spins, everywhere(sample.iterate.bound)
    held = unit * across(-answer.dual)
    point = Point(spin, across(answer.difference), bound, held, friction, np.zeros(len(friction)))
    if settled is None:
        return point, None, None, steps
    return point, everywhere(settled.slipping), everywhere(settled.ties | settled.critical), steps
