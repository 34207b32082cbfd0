"""The physics of one contact, for any lattice and any set of spin components.

In staggered spins (spins with signs by which neighbours differ, docs/equations.md) the slip velocity of paper Eq. (2)
has the length R |D|, where R is the radius and D the difference of the spins of the upper and the lower sphere without
its component along the contact. Slip and friction force are parallel to D rotated by 90 degrees about the contact; that
rotation drops out of every power and torque. So a contact works on D: only the components across it take part, e.g.
both for a z-contact driven along x + y, one for an x-contact, and the one component there is in 2D. Kernels hold D as a
list with an entry for each component; an entry is a number for one site, or a vector for a block of sites.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator
from typing import Any

from taichi_bearings.compiler import ti
from taichi_bearings.errors import InputError


@ti.func
def length(components: ti.template()):
    """Return the Euclidean length of a list of one or two components. Each is a number for one site, or a vector for a
    block of sites; so is the result.

    One component needs no square root. Its sign is changed by `0.0 - x`, as Taichi's abs and minus take no vectors."""
    if ti.static(len(components) == 1):
        return ti.select(components[0] < 0.0, 0.0 - components[0], components[0])
    return ti.sqrt(components[0] * components[0] + components[1] * components[1])


@ti.func
def smaller(a, b):
    """Return the smaller of two numbers, of vectors entry by entry, as one machine instruction; unlike ti.min it makes
    no promise about NaN.

    a, b : two numbers, or two vectors of one length.
    """
    return ti.select(a < b, a, b)


@ti.func
def clamp(value, low, high):
    """Return `value` where it lies within [low, high], else the nearer end.

    value, low, high : numbers, or vectors, which are compared entry by entry."""
    inside = ti.select(value < low, low, value)
    return ti.select(inside > high, high, inside)


@ti.func
def coulomb_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Return the friction force along D, the difference of the spins of the upper and the lower sphere without its
    component along the contact: a list with an entry for each component.

    Where the contact slips, |D| sharpness >= 1, the size of the force is the friction limit; below that it grows in
    proportion to D. So a steep line replaces the jump at D = 0 of paper Eq. (3), whose two cases are printed in the
    wrong order.

    spin_difference : D, a list of one or two components, 1/time: numbers, or vectors for a block of contacts.
    coefficients : a list that begins with the friction limit mu F_n, force.
    sharpness : 1 over the largest |D| that counts as no slip, time."""
    friction = coefficients[0]
    if ti.static(len(spin_difference) == 1):
        return [friction * clamp(spin_difference[0] * sharpness, -1.0, 1.0)]
    scale = friction * smaller(sharpness, 1.0 / length(spin_difference))
    return [d * scale for d in ti.static(spin_difference)]


@ti.func
def viscous_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Return the viscous force of paper Eq. (1) divided by the radius, viscosity times D: a list with an entry for each
    component of D, the difference of the spins of both spheres without its component along the contact.

    spin_difference : D, a list of one or two components, 1/time: numbers, or vectors for a block of contacts.
    coefficients : a list that ends with the viscosity.
    sharpness : not used; all force laws take the same arguments."""
    return [d * coefficients[ti.static(len(coefficients) - 1)] for d in ti.static(spin_difference)]


@ti.func
def coulomb_viscous_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Return the sum of friction and viscous force along D, the difference of the spins of both spheres without its
    component along the contact: a list with an entry for each component.

    spin_difference : D, a list of one or two components, 1/time: numbers, or vectors for a block of contacts.
    coefficients : a list: friction limit, force, and viscosity.
    sharpness : 1 over the largest |D| that counts as no slip, time."""
    held = coulomb_force(spin_difference, coefficients, sharpness)
    flowing = viscous_force(spin_difference, coefficients, sharpness)
    return [held[t] + flowing[t] for t in ti.static(range(len(held)))]


FORCES = {"coulomb": coulomb_force, "viscous": viscous_force, "coulomb-viscous": coulomb_viscous_force}
"""For each law of scene/law.py by name, its force along D; a steep linear part stands in for jumps of the force.

Arguments of these functions: D, the coefficients in one unit, and the sharpness of a law with friction, or the radius R
of one without. The slip speed is R |D|."""


def force_on_device(law: str) -> Callable[..., Any]:
    """Return the force of a contact as kernels compute it, a function of the table `FORCES`.

    law : name of the law.

    Raises InputError if the table has no force of this law, or one that uses what vectors over contacts do not know, at
    which the compiler would end the process.
    """
    if law not in FORCES:
        raise InputError(
            f"law is {law!r}, which has no compiled force; add one to the table FORCES in "
            "taichi_bearings.kernels.contact, or take another method"
        )
    for used in _unknown_to_vectors(FORCES[law]):
        raise InputError(
            f"law is {law!r}, whose compiled force uses {used}; it works on several contacts at once, so it may use "
            f"only + - * / ** between two terms, length, and {', '.join(f'ti.{name}' for name in ON_VECTORS[3:])}"
        )
    return FORCES[law]


ON_VECTORS = ("func", "template", "static", "sqrt", "select", "min", "max", "floor")
"""What a force may use of Taichi, whose other functions do not work on vectors over contacts."""


def _unknown_to_vectors(force: Callable[..., Any]) -> Iterator[str]:
    """Yield what the source of a force uses that does not work on vectors over contacts.

    force : a Taichi function.
    """
    function = inspect.unwrap(force)
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if function.__globals__.get(node.value.id) is ti and node.attr not in ON_VECTORS:
                yield f"ti.{node.attr}"
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "abs":
            yield "abs"
        elif isinstance(node, ast.UnaryOp) and not isinstance(node.operand, ast.Constant):
            yield "a minus sign before a term (write 0.0 - term)"
