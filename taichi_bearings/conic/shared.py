"""What all samples on a network share: its rows (slips as functions of spins), an order of elimination, and the matrix
of Newton steps.

Seeds of one network differ only in their coefficients. So what follows from the network alone is made once, and small
samples are factorised side by side.
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

KEPT_UNKNOWNS = 30_000  # number of unknowns from which the matrix of a network is not kept for its other samples
SMALL_SPHERES = 5_000  # number of spheres below which states of signed rows are settled as those of small lattices


def system_of(bearing: Bearing) -> ContactSystem:
    """The contact system of a bearing, in which no motion is left that makes no contact slip.

    Oblique networks mostly have no such motion. One factorisation of their matrix, which is needed anyhow, tells
    whether that is so. Only where it does not are motions looked for by elimination.
    """
    system = ContactSystem.before_motions(bearing)
    if system.motions is not None or not system.unknowns:
        return system
    made = _made(system, system)
    if not made.matrix.is_regular(isotropic(system.offset, np.ones(len(system.numbers)))):
        return system.without_motions()
    found = system.with_motions(0)
    found.kept[_name()] = made
    return found


def surroundings_of(system: ContactSystem) -> Surroundings:
    """System, order and matrix that samples share, over signed spins where the system has them.

    They are made once in each thread, as the numbers of a factorisation are kept in the matrix. Those of large systems
    are not kept for other samples.
    """
    name = _name()
    found = cast(Surroundings | None, system.kept.get(name))
    if found is None:
        found = _made(system, system.signed() or system)
        system.kept.clear()
        system.kept[name] = found
    if system.unknowns >= KEPT_UNKNOWNS:
        system.kept.clear()
    return found


def is_small(system: ContactSystem) -> bool:
    """True where samples are factorised side by side and, if their contact states are settled, this is done as in small
    lattices."""
    if system.sign is None:
        return system.unknowns < LAUNCH_UNKNOWNS
    return len(np.unique(system.sphere)) < SMALL_SPHERES


def _name() -> tuple[str, int]:
    """The key under which a thread keeps what it shares."""
    return "surroundings", threading.get_ident()


def _made(system: ContactSystem, rows: ContactSystem) -> Surroundings:
    """System, order and matrix over the given rows. system : decides whether samples are small."""
    order = order_by_place(rows)
    return Surroundings(rows, order, NewtonMatrix(rows, order, engine=Engine.LAUNCH if is_small(rows) else None), None)
