"""Exact numbers, and vectors (a0, a1) of second-order cones, |a1| <= a0, as lists of arb."""

from fractions import Fraction

from flint import arb, fmpq


def exact(value: float) -> arb:
    return ball(Fraction(float(value)))


def ball(value: Fraction) -> arb:
    return arb(fmpq(value.numerator, value.denominator))


def length(vector) -> arb:
    if len(vector) == 1:
        return abs(vector[0])
    square = vector[0] * vector[0] + vector[1] * vector[1]
    return square.nonnegative_part().sqrt()


def middle(values):
    """The numbers without their error bounds, which would grow much faster than the errors."""
    return [x.mid() for x in values]


def dot(a, b):
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), a[0] * b[0])


def determinant(a):
    """a0^2 - |a1|^2."""
    return a[0] * a[0] - dot(a[1:], a[1:])


def product(a, b):
    """Jordan product of two vectors of the cone."""
    return [dot(a, b), *(a[0] * y + b[0] * x for x, y in zip(a[1:], b[1:], strict=True))]


def divided(point, r):
    """x with point o x = r."""
    det = determinant(point).mid()
    first = ((point[0] * r[0] - dot(point[1:], r[1:])) / det).mid()
    return middle([first, *((y - first * x) / point[0] for x, y in zip(point[1:], r[1:], strict=True))])


def inverse_reach(v, dv) -> arb:
    """1 over the longest step that stays in the cone."""
    a, b, c = middle([determinant(v), v[0] * dv[0] - dot(v[1:], dv[1:]), determinant(dv)])
    disc = (b * b - a * c).mid()
    return ((disc.sqrt() - b) / a).mid() if disc > 0 else arb(0)


def least(a, b) -> arb:
    return arb(a).min(b).mid()


def most(a, b) -> arb:
    return arb(a).max(b).mid()
