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

import numpy as np

from taichi_bearings.compiler import ti
from taichi_bearings.errors import InputError
from taichi_bearings.fields import on_device
from taichi_bearings.kernels.memory import VALUES


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
    coefficients : a list that ends with the viscosity; beside friction, with the viscosity times the radius.
    sharpness : not used; all force laws take the same arguments."""
    return [d * coefficients[ti.static(len(coefficients) - 1)] for d in ti.static(spin_difference)]


@ti.func
def coulomb_viscous_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Return the sum of friction and viscous force along D, the difference of the spins of both spheres without its
    component along the contact: a list with an entry for each component.

    spin_difference : D, a list of one or two components, 1/time: numbers, or vectors for a block of contacts.
    coefficients : a list: the friction limit, force, and the viscosity times the radius.
    sharpness : 1 over the largest |D| that counts as no slip, time."""
    held = coulomb_force(spin_difference, coefficients, sharpness)
    flowing = viscous_force(spin_difference, coefficients, sharpness)
    return [held[t] + flowing[t] for t in ti.static(range(len(held)))]


FORCES = {"coulomb": coulomb_force, "viscous": viscous_force, "coulomb-viscous": coulomb_viscous_force}
"""For each law of scene/law.py by name, its force along D; a steep linear part stands in for jumps of the force.

Arguments of these functions: D; the coefficients in one unit, a viscosity beside friction times R; and the sharpness of
a law with friction, or the radius R of one without. The slip speed is R |D|."""


def force_on_device(law: str) -> Callable[..., Any]:
    """Return the force of a contact as kernels compute it, a function of the table `FORCES`.

    law : name of the law.

    Raises InputError if the table has no force of this law, and if the force uses something that does not work on
    vectors over contacts, since the compiler would then end the process.
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
        elif isinstance(node, (ast.If, ast.IfExp, ast.While)) and not _is_static(node.test):
            yield f"{'while' if isinstance(node, ast.While) else 'if'} (use ti.select)"


def _is_static(test: ast.expr) -> bool:
    """Return True if a condition is one that Taichi evaluates while it compiles, ti.static(...).

    test : the condition in the source.
    """
    return isinstance(test, ast.Call) and isinstance(test.func, ast.Attribute) and test.func.attr == "static"


@ti.data_oriented
class ForceTrial:
    """A kernel that evaluates a force law at single contacts: at a spin difference d of one component, and at one with
    the components 0.6 d and 0.8 d, which is as long.

    force_law : Taichi function, such as one of `FORCES`."""

    def __init__(self, force_law: Callable[..., Any]) -> None:
        """Store the force law."""
        self.force_law = force_law

    @ti.kernel
    def write(self, differences: VALUES, coefficients: VALUES, radii: VALUES, forces: VALUES, count: int):
        """Write three numbers for each contact: its force at the spin difference d, a single component; then both
        components of its force at the spin difference (0.6 d, 0.8 d), which has the same length.

        differences : (count,), d of each contact, 1/time.
        coefficients : (count,), the coefficient of the law at each contact.
        radii : (count,), radius of the spheres at each contact.
        forces : (3 count,), the numbers that are written, contact by contact."""
        for k in range(count):
            d = differences[k]
            one = self.force_law([d], [coefficients[k]], radii[k])
            two = self.force_law([0.6 * d, 0.8 * d], [coefficients[k]], radii[k])
            forces[3 * k], forces[3 * k + 1], forces[3 * k + 2] = one[0], two[0], two[1]


def check_force(law: str, trial: ForceTrial, slip: np.ndarray, coefficient: np.ndarray, radius: float,
                force: np.ndarray) -> None:  # fmt: skip
    """Raise InputError if the compiled force of a law of one's own differs from the `force` of its class.

    law : name of the law.
    trial : the kernel that evaluates the compiled force.
    slip : (n,), slip speeds of n contacts that are tried.
    coefficient : (n,), their coefficients.
    radius : radius of the spheres.
    force : (n,), the force by the class of the law.
    """
    found = on_device(np.zeros(3 * len(slip)))
    arrays = (on_device(values) for values in (slip / radius, coefficient, np.full(len(slip), radius)))
    trial.write(*arrays, found, len(slip))
    computed = np.reshape(found if isinstance(found, np.ndarray) else found.to_numpy(), (-1, 3))
    missed = np.abs(computed - force[:, None] * (1.0, 0.6, 0.8))
    for n in np.flatnonzero(~(missed <= SAME_FORCE * force[:, None] + SAME_FORCE**2 * force.max()).all(axis=1)):
        raise InputError(
            f"law is {law!r}, whose compiled force at slip {slip[n]:g} and coefficient {coefficient[n]:g} is "
            f"{computed[n, 0]:g}, or ({computed[n, 1]:g}, {computed[n, 2]:g}) along (0.6, 0.8), but the `force` of its "
            f"class is {force[n]:g} there; both must be the same"
        )


SAME_FORCE = 1e-3  # relative difference that both forces may have, in single precision
