"""The physics of one contact, for any lattice and any set of spin components.

In staggered spins (equations.md) the slip velocity of paper Eq. (2) has the length R |D|, where D is the difference of
the spins of the upper and the lower sphere without its component along the contact; slip and friction force are
parallel to D turned by 90 degrees about the contact, a turn that drops out of every power and torque. So a contact
works on D: only the components across it take part, e.g. both for a z-contact driven along x + y, one for an x-contact,
and the one component there is in 2D. Kernels hold them as lists, of numbers of a site or of
vectors for a block of sites.
"""

from taichi_bearings.compiler import ti


@ti.func
def length(components: ti.template()):
    """Euclidean length of one or two components; one needs no square root. (Taichi's abs and minus take no vectors.)"""
    if ti.static(len(components) == 1):
        return ti.select(components[0] < 0.0, 0.0 - components[0], components[0])
    return ti.sqrt(components[0] * components[0] + components[1] * components[1])


@ti.func
def smaller(a, b):
    """min(a, b) as one machine instruction; unlike ti.min it makes no promise about NaN."""
    return ti.select(a < b, a, b)


@ti.func
def clamp(value, low, high):
    inside = ti.select(value < low, low, value)
    return ti.select(inside > high, high, inside)


@ti.func
def coulomb_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Friction along D: of its full size where the contact slips, |D| sharpness >= 1, and linear in D below.

    paper Eq. (3) with its cases in the right order; sharpness is 1 over the largest |D| that counts as no slip.
    """
    friction = coefficients[0]
    if ti.static(len(spin_difference) == 1):
        return [friction * clamp(spin_difference[0] * sharpness, -1.0, 1.0)]
    scale = friction * smaller(sharpness, 1.0 / length(spin_difference))
    return [d * scale for d in ti.static(spin_difference)]


@ti.func
def viscous_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """Paper Eq. (1), over the radius: damping, the last coefficient, times D."""
    return [d * coefficients[ti.static(len(coefficients) - 1)] for d in ti.static(spin_difference)]


@ti.func
def coulomb_viscous_force(spin_difference: ti.template(), coefficients: ti.template(), sharpness):
    """The sum of both."""
    held = coulomb_force(spin_difference, coefficients, sharpness)
    flowing = viscous_force(spin_difference, coefficients, sharpness)
    return [held[t] + flowing[t] for t in ti.static(range(len(held)))]


FORCES = {"coulomb": coulomb_force, "viscous": viscous_force, "coulomb-viscous": coulomb_viscous_force}
"""Law of scene/law.py -> its force along D, for coefficients in one unit, regularised where it jumps.

The last argument is the sharpness of a law with friction, and the radius R of one without: the slip is R |D|."""
