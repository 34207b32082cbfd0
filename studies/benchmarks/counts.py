"""Work of each kernel a site: numbers read and written, operations, roots; counted from what the kernels do.

A number counts once a pass, also where neighbours read it again: caches hold it until then. A line that is written
without being read counts as written alone, though most processors read it first; the measured bandwidth counts alike.
An operation is an addition, multiplication, negation, or a comparison with the choice that follows from it; a root is a
square root or a division. What each block of sites does once more (a contact below its first site) is left out.
tests/benchmarks/test_counts.py counts the same from the compiled programs, and from which rows they depend on.
"""

from dataclasses import dataclass
from math import comb

from taichi_bearings.kernels.stencil import Stencil

CLAMP = 2  # both ends of an interval
SLIDE = {1: 2 + CLAMP, 2: 7}  # Coulomb force of a spin difference, by its components
SLIDE_ROOTS = {1: 0, 2: 2}
SPRING = {1: 15, 2: 26}  # spring, damper and friction, from differences of spins
SPRING_ROOTS = {1: 1, 2: 2}
RELAX = {1: 18, 2: 37}  # operator splitting: old force, new force, spring
RELAX_ROOTS = {1: 0, 2: 4}
GEAR_ORDER = 3  # values a spin component that Gear's method keeps


@dataclass(frozen=True)
class Work:
    """What a kernel does a site: numbers read, numbers written, operations, roots, passes over the lattice."""

    read: float
    written: float
    operations: float
    roots: float
    passes: int

    def __add__(self, other: "Work") -> "Work":
        return Work(
            self.read + other.read,
            self.written + other.written,
            self.operations + other.operations,
            self.roots + other.roots,
            self.passes + other.passes,
        )

    def bytes(self, itemsize: int) -> float:
        """Bytes a site."""
        return itemsize * (self.read + self.written)


def _by_axis(stencil: Stencil, each: dict[int, int], times: int = 1) -> int:
    """Sum over the axes whose contacts slip of what a contact of so many components takes, contacts beside the height
    `times` as often."""
    return sum(
        each[stencil.kept_count[axis]] * (1 if axis == stencil.height else times) for axis in stencil.slipping_axes
    )


def descent_sweep(stencil: Stencil, momentum: bool) -> Work:
    """A sweep of descent under Coulomb friction: contacts beside the height are reckoned with from both ends."""
    components, axes, forces = stencil.components, len(stencil.slipping_axes), stencil.force_components
    differences, slides = _by_axis(stencil, {1: 1, 2: 2}, 2), _by_axis(stencil, SLIDE, 2)
    sums = 2 * forces  # the pulls of an axis, and these added up
    move = components * (3 + CLAMP + (3 if momentum else 0))
    kept = components if momentum else 0
    return Work(
        read=2 * components + axes + kept,  # points, weights, coefficients, spins
        written=components + kept,
        operations=differences + slides + sums + move,
        roots=_by_axis(stencil, SLIDE_ROOTS, 2),
        passes=1,
    )


def contact_pass(stencil: Stencil) -> Work:
    """The first half of a Cundall-Strack step: springs, dampers and friction at the contacts."""
    components, axes, forces = stencil.components, len(stencil.slipping_axes), stencil.force_components
    return Work(
        read=2 * components + axes + forces,  # spins at the end and on the way, coefficients, elongations
        written=2 * forces,
        operations=2 * forces + _by_axis(stencil, SPRING),
        roots=_by_axis(stencil, SPRING_ROOTS),
        passes=1,
    )


def sphere_pass(stencil: Stencil) -> Work:
    """The second half: torques turn the spheres, and Gear's method tells where they turn next."""
    components, forces, n = stencil.components, stencil.force_components, GEAR_ORDER
    series = [(k, low) for low in range(n) for k in range(low, n)]
    taylor = len(series) + sum(comb(k, low) > 1 for k, low in series)
    one = 3 + 2 * (n - 2) + 3 + (n - 1) + taylor + (n - 1) + 2 * (n - 1) + 2  # see CundallStrackSteps.motion
    return Work(forces + 1 + n * components, (n + 2) * components, one * components, 0, 1)


def cundall_strack_step(stencil: Stencil) -> Work:
    """A step of Cundall-Strack dynamics with friction."""
    return contact_pass(stencil) + sphere_pass(stencil)


def limit_pass(stencil: Stencil) -> Work:
    """The first half of the contact step of operator splitting: friction limits the force of each contact."""
    components, axes, forces = stencil.components, len(stencil.slipping_axes), stencil.force_components
    return Work(
        components + forces + axes, 2 * forces, _by_axis(stencil, RELAX), _by_axis(stencil, RELAX_ROOTS), passes=1
    )


def gather_pass(stencil: Stencil) -> Work:
    """The second half: what the springs pull on each sphere."""
    forces = stencil.force_components
    return Work(forces, stencil.components, 2 * forces, 0, 1)


def torque_balance(stencil: Stencil, shape: tuple[int, ...], modes: float = 1.0) -> Work:
    """A Poisson solve on a CPU: sines along the height, chains beside it to and fro, sines back; of whole rows.

    modes : size of a number there over that of a number of the fields.
    """
    components, products = stencil.components, 2 * 2 * shape[-1]
    return Work(
        read=components * (2 + 3 * modes),  # pulls and potential; modes by either half of the chains and at the end
        written=components * (1 + 3 * modes),
        operations=components * (products + 7),
        roots=0,
        passes=4,
    )


def splitting_iteration(stencil: Stencil, shape: tuple[int, ...], modes: float = 1.0) -> Work:
    """An iteration of operator splitting."""
    return limit_pass(stencil) + gather_pass(stencil) + torque_balance(stencil, shape, modes)
