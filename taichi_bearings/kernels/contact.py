"""The physics of one contact, for any lattice and any set of spin components.

In staggered spins (PHYSICS 3) the slip velocity of paper Eq. (2) has the length R |D|, where D is the difference of the
spins of the upper and the lower sphere without its component along the contact; slip and friction force are parallel to
D turned by 90 degrees about the contact, a turn that drops out of every power and torque. So a contact works on D:
``kept`` lists which components of the spin vector take part, e.g. both for a z-contact driven along x + y, one for an
x-contact, and the one component there is in 2D.
"""

import taichi as ti


@ti.func
def difference(lower, upper, kept: ti.template()):
    """D: components `kept` of upper - lower."""
    return ti.Vector([upper[slot] - lower[slot] for slot in ti.static(kept)])


@ti.func
def length(vector):
    """Euclidean length; one component needs no square root."""
    result = 0.0
    if ti.static(vector.n == 1):  # noqa: SIM108 (Taichi needs the statement to drop the other branch)
        result = ti.abs(vector[0])
    else:
        result = ti.sqrt(vector.dot(vector))
    return result


@ti.func
def smaller(a, b):
    """min(a, b) as one machine instruction; unlike ti.min it makes no promise about NaN."""
    return ti.select(a < b, a, b)


@ti.func
def clamp(value, low, high):
    inside = ti.select(value < low, low, value)
    return ti.select(inside > high, high, inside)


@ti.func
def coulomb_force(spin_difference, friction, sharpness):
    """Friction along D: of size `friction` where the contact slips, |D| sharpness >= 1, and linear in D below.

    paper Eq. (3) with its cases in the right order; sharpness is 1 over the largest |D| that counts as no slip.
    """
    force = spin_difference
    if ti.static(spin_difference.n == 1):
        force[0] = friction * clamp(spin_difference[0] * sharpness, -1.0, 1.0)
    else:
        force = spin_difference * (friction * smaller(sharpness, 1.0 / length(spin_difference)))
    return force


@ti.func
def viscous_force(spin_difference, damping, unused):
    """Paper Eq. (1), over the radius: damping times D."""
    return spin_difference * damping
