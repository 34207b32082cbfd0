"""Makes what all samples on a network share: its rows (slips as functions of spins), an order of elimination, and the
matrix of Newton steps.

Samples of one network differ only in the friction of their contacts. So what follows from the network alone is made
once, and small samples are factorised side by side.
"""

import threading
from typing import cast

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.resolution import Surroundings
from taichi_bearings.numerics.cholesky import Engine
from taichi_bearings.numerics.cholesky.tuning import LAUNCH_UNKNOWNS
from taichi_bearings.scene.bearing import Bearing

KEPT_UNKNOWNS = 30_000  # from so many unknowns on the matrix of a network is not kept for its other samples (memory)
SMALL_SPHERES = 5_000  # over signed spins systems with fewer spheres count as small, see `is_small`


def system_of(bearing: Bearing) -> ContactSystem:
    """Return the contact system of a bearing (slips as functions of the unknown spins), with so many spins held at 0
    that the spheres have no motion left at which no contact slips.

    Such motions make the Newton matrix singular. Where normals have any direction there mostly are none, and one
    factorisation, which is needed anyhow, shows it. Only where it does not are motions looked for, by elimination.

    bearing : spheres, contacts, and what is driven.
    """
    system = ContactSystem.before_motions(bearing)
    if system.motions is not None or not system.unknowns:
        return system
    made = _made(system)
    if not made.matrix.is_regular(isotropic(system.offset, np.ones(len(system.numbers)))):
        return system.without_motions()
    found = system.with_motions(0)
    found.kept[_name()] = made
    return found


def surroundings_of(system: ContactSystem) -> Surroundings:
    """Return what all samples on the network of a contact system share: the system itself, or where possible over spins
    with signs, so that slips are differences; an order in which its unknowns are eliminated; and its Newton matrix.

    It is made once in each thread, as the numbers of a factorisation are stored in the matrix, and kept in
    `system.kept` for later calls, unless there are KEPT_UNKNOWNS or more unknowns.

    system : the contacts, over plain spins.
    """
    name = _name()
    found = cast(Surroundings | None, system.kept.get(name))
    if found is None:
        found = _made(system.signed() or system)
        system.kept.clear()
        system.kept[name] = found
    if system.unknowns >= KEPT_UNKNOWNS:
        system.kept.clear()
    return found


def is_small(system: ContactSystem) -> bool:
    """Return True for systems of which several samples are factorised in one launch. Which of their contacts slip is
    then first guessed from the last step of the central path.

    Over plain spins (`system.sign` is None) the number of unknowns decides; over signed spins, as on lattices, the
    number of spheres with an unknown spin.
    """
    if system.sign is None:
        return system.unknowns < LAUNCH_UNKNOWNS
    return len(np.unique(system.sphere)) < SMALL_SPHERES


def _name() -> tuple[str, int]:
    """Return the key in `ContactSystem.kept` under which the present thread finds its :class:`Surroundings`."""
    return "surroundings", threading.get_ident()


def _made(rows: ContactSystem) -> Surroundings:
    """Return what all samples on one network share, newly made: the contacts `rows`, an order in which their unknowns
    are eliminated, and a Newton matrix.

    rows : the contacts over the unknowns that are solved for.
    """
    order = order_by_place(rows)
    return Surroundings(rows, order, NewtonMatrix(rows, order, engine=Engine.LAUNCH if is_small(rows) else None), None)
