"""Makes what all samples of a network share, and keeps it for the last network: the contact system (slips as functions
of spins), an order of elimination, and the matrix of Newton steps.

Samples of one network differ only in the coefficients of their contacts. So what follows from the network alone is made
once.
"""

import threading
from collections.abc import Callable

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem, lattice_system
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.resolution import Surroundings
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Engine, dissect
from taichi_bearings.numerics.cholesky.tuning import LAUNCH_UNKNOWNS
from taichi_bearings.numerics.double_double import Pair
from taichi_bearings.scene.bearing import Bearing

KEPT_UNKNOWNS = 30_000  # from so many unknowns on the matrix of a network is not kept for its other samples (memory)
SMALL_SPHERES = 5_000  # over signed spins systems with fewer spheres count as small, see `is_small`

Made = tuple[ContactSystem, Surroundings | None]
"""The contact system of a network, and what its samples share; None for the second where it is not made yet."""


class LastNetwork(threading.local):
    """The contact system and the Newton matrix of the network that a thread solved last, for further samples on the
    same network. Each thread has its own, as a factorisation writes its numbers into the matrix.

    of : key of this network: an object that is compared by ==, and a tuple of arrays; None before the first.
    made : the contact system of this network, and what its samples share (None if it is not made yet, or too large to
        be kept); None before the first network.
    """

    of: tuple[object, tuple[np.ndarray, ...]] | None = None
    made: Made | None = None

    def find(self, of: object, arrays: tuple[np.ndarray, ...], make: Callable[[], Made]) -> Made:
        """Return the pair `made` if it belongs to this network; else call `make`, and keep and return its result.

        of, arrays : the two parts of the key of the network.
        make : function without arguments that returns the pair.
        """
        known = self.of
        same = known is not None and known[0] == of and all(map(np.array_equal, known[1], arrays))
        if not same or self.made is None:
            self.forget()
            self.made = make()
            self.of = of, arrays
        return self.made

    def forget(self) -> None:
        """Free the memory of the last network."""
        self.of = self.made = None


last = LastNetwork()


def system_of(bearing: Bearing) -> ContactSystem:
    """Return the contact system of a bearing (slips as functions of the unknown spins). Some spins are held at 0 if
    otherwise the spheres could move without slip of any contact, which would make the Newton matrix singular. If only
    coefficients differ from the bearing of the last call, as between seeds, the system of that call is returned.

    bearing : spheres, contacts, and what is driven.
    """

    def make() -> Made:
        """Return the contact system of the bearing, without the motions in which no contact slips. Return also the
        Newton matrix with its order of elimination, for further samples, if it shows that there are no such motions;
        else None."""
        system = ContactSystem.before_motions(bearing)
        if system.motions is not None or not system.unknowns:
            return system, None
        # With normals in any directions motions without slip are rare. A regular Newton matrix shows that there are
        # none; else they are found by elimination, and taken out.
        shared = _made(system)
        if not shared.matrix.is_regular(isotropic(system.offset, np.ones(len(system.numbers)))):
            return system.without_motions(), None
        return system.with_motions(0), shared

    network = bearing.network
    spheres = network.center, network.radius, network.body, bearing.driven_speed
    return last.find("contacts", (*spheres, network.contact, network.normal, bearing.acting), make)[0]


def surroundings_of(system: ContactSystem) -> Surroundings:
    """Return what all samples on the network of a contact system share: the contacts, an order in which unknowns are
    eliminated, and the Newton matrix. If possible the contacts are those over signed spins, so that each slip is a
    difference of two unknowns (`ContactSystem.signed`).

    A second call for the system that :func:`system_of` has returned last in this thread gives the same object, if the
    system has fewer than KEPT_UNKNOWNS unknowns.

    system : the contacts, over plain spins.
    """
    kept, known = last.made or (None, None)
    found = known if kept is system and known is not None else _made(system.signed() or system)
    if kept is system:
        last.made = system, found if system.unknowns < KEPT_UNKNOWNS else None
    return found


def surroundings_of_lattice(lattice: Lattice, spin_axes: tuple[int, ...], top: Pair, small: bool) -> Surroundings:
    """Return what all samples of a lattice share: contact system over staggered spins, order of elimination, and Newton
    matrix; no matrix if top and bottom have the same spins, so that nothing has to be solved. With fewer than
    KEPT_UNKNOWNS unknowns it is kept for other samples.

    lattice : the spheres and contacts.
    spin_axes : numbers of the axes of the C spin components that are computed.
    top : (C, *plane), imposed spins of the top plane less those of the bottom, in the unit of spins on the path, as
        sums of two doubles.
    small : True to factorise several samples in one launch.
    """

    def make() -> Made:
        """Return the contact system of this lattice, and what its samples share."""
        system = lattice_system(lattice, spin_axes, top[0], top[1] if top[1].any() else None)
        order = dissect(lattice, spin_axes)
        matrix = NewtonMatrix(system, order, engine=Engine.LAUNCH if small else None) if top[0].any() else None
        return system, Surroundings(system, order, matrix)

    system, found = last.find((lattice, spin_axes, small), top, make)
    assert found is not None
    if system.unknowns >= KEPT_UNKNOWNS:
        last.forget()
    return found


def is_small(system: ContactSystem) -> bool:
    """Return True for a system whose matrix is so small that several samples are factorised in one launch of a kernel.
    Over signed spins the number of spheres with an unknown spin decides, over plain spins (`system.sign` is None) the
    number of unknowns.
    """
    if system.sign is None:
        return system.unknowns < LAUNCH_UNKNOWNS
    return len(np.unique(system.sphere)) < SMALL_SPHERES


def _made(rows: ContactSystem) -> Surroundings:
    """Return what all samples on one network share, newly made: the contacts `rows`, an order in which their unknowns
    are eliminated, and a Newton matrix.

    rows : the contacts over the unknowns that are solved for.
    """
    order = order_by_place(rows)
    return Surroundings(rows, order, NewtonMatrix(rows, order, engine=Engine.LAUNCH if is_small(rows) else None))
