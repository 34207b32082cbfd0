"""Numbers that a pass of each kernel reads and writes a site, counted from what the kernels do.

A number counts once a pass, also where neighbours read it again: caches hold it until then. A line that is written
without being read counts as written alone, though most processors read it first; the measured bandwidth counts alike.
tests/benchmarks/test_counts.py finds the same from the rows that results depend on.
"""

from dataclasses import dataclass

from taichi_bearings.kernels.stencil import Stencil

GEAR_ORDER = 3  # values a spin component that Gear's method keeps


@dataclass(frozen=True)
class Traffic:
    """Numbers read and written a site."""

    read: float
    written: float

    def __add__(self, other: "Traffic") -> "Traffic":
        return Traffic(self.read + other.read, self.written + other.written)

    def bytes(self, itemsize: int) -> float:
        """Bytes a site."""
        return itemsize * (self.read + self.written)


def descent_sweep(stencil: Stencil, momentum: bool) -> Traffic:
    """A sweep of descent under Coulomb friction: points, weights, coefficients and spins; points, and spins with
    momentum."""
    components, kept = stencil.components, stencil.components if momentum else 0
    return Traffic(2 * components + len(stencil.slipping_axes) + kept, components + kept)


def contact_pass(stencil: Stencil) -> Traffic:
    """The first half of a Cundall-Strack step: spins at the end and on the way, coefficients, elongations; forces."""
    forces = stencil.force_components
    return Traffic(2 * stencil.components + len(stencil.slipping_axes) + forces, 2 * forces)


def sphere_pass(stencil: Stencil) -> Traffic:
    """The second half: torques turn the spheres, and Gear's method tells where they turn next."""
    components = stencil.components
    return Traffic(stencil.force_components + 1 + GEAR_ORDER * components, (GEAR_ORDER + 2) * components)


def cundall_strack_step(stencil: Stencil) -> Traffic:
    """A step of Cundall-Strack dynamics with friction."""
    return contact_pass(stencil) + sphere_pass(stencil)


def limit_pass(stencil: Stencil) -> Traffic:
    """The first half of the contact step of operator splitting: friction limits the force of each contact."""
    forces = stencil.force_components
    return Traffic(stencil.components + forces + len(stencil.slipping_axes), 2 * forces)


def gather_pass(stencil: Stencil) -> Traffic:
    """The second half: what the springs pull on each sphere."""
    return Traffic(stencil.force_components, stencil.components)


def splitting_iteration(stencil: Stencil, modes: float = 1.0) -> Traffic:
    """An iteration of operator splitting, with its Poisson solve on a CPU: sines along the height, chains beside it to
    and fro, sines back; of whole rows.

    modes : size of a number there over that of a number of the fields.
    """
    components = stencil.components
    balance = Traffic(components * (2 + 3 * modes), components * (1 + 3 * modes))
    return limit_pass(stencil) + gather_pass(stencil) + balance
