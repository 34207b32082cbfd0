"""What is imposed on a bearing, and how its spins are carried while it is solved.

Methods compute with *carried* spins, x = s l omega - x0 for each component of the spin omega of each sphere:

* where each driven sphere has a spin of its own (:class:`Driving`), x = u = R omega is the speed of its surface: l is
  its radius R, s = 1 and x0 = 0;
* where the two planes of a lattice are in bearing states (:class:`Planes`), x is the staggered spin measured from the
  bottom: s = +1 or -1 is the sublattice, x0 the state of the bottom, and l = 1.

A bearing state is a staggered spin A + C x, with the position x measured from the centre of sphere (0, 0, 0): no
contact slips in it, because the ends of a contact differ along the contact alone. A state can therefore be taken from
all spins, and here that of the bottom is: the bottom is then at rest, and the top carries the *jump*, the difference of
the two states. Component k of the jump depends on x_k alone, and contacts along k do not slip by it: each layer x_k =
const has a problem of its own in that component. Discs have one component, and no C.

Letters: R samples, N spheres (*N is the shape of arrays over them: that of the lattice, or (N,)), C spin components,
D dimensions. A `Pair` is a number in twice the precision: the nearest double, and what its rounding leaves out.
carried spins : the numbers x. spin_axes : as an argument, the components, 0 to 2, along the first axis of (C, ...).
driven sphere : one whose spin is imposed; a driven body is a set of them with a number, of lattices a plane.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import Index
from taichi_bearings.numerics.blas import SPARSE, one_thread
from taichi_bearings.numerics.double_double import (
    Pair,
    add,
    divide,
    exactly,
    multiply,
    square_root,
    two_product,
    two_sum,
)
from taichi_bearings.numerics.graphs import odd_pieces, pieces
from taichi_bearings.read_only import cached_read_only

if TYPE_CHECKING:
    from taichi_bearings.scene.network import Network

EVEN_RESIDUAL = 1e-12  # relative residual torque of the spins that `Driving.of_equal_viscosity` returns
SAME_DRIVING = 4  # imposed speeds that differ by no more than so many units in the last place are taken as equal


class Driving:
    """Spins that are imposed on single driven spheres, and the form in which solvers store spins. An instance never
    changes.

    In this class solvers store radius * spin, the surface speed of a sphere. The subclass for lattices stores spins
    with signs that alternate between neighbours, less those of the bottom.

    In methods `spin_axes` are numbers of spin components, 0 to 2, and a Pair is a number in twice the precision: the
    nearest double, and what its rounding leaves out.
    """

    driven_contacts_slip = True  # contacts between driven spheres may slip
    slips_are_unique = False  # True if a contact that slips at every minimum has the same slip at all of them
    samples_step_together = False  # True if methods step all samples as one, with one count of iterations

    def __init__(self, network: "Network", spin: np.ndarray, contact: np.ndarray) -> None:
        """Store what is imposed on a network.

        network : the spheres, their contacts, and which spheres are driven.
        spin : (spheres N, 3), or (N,) for discs, 1/time; imposed on driven spheres, ignored on others.
        contact : (n,) numbers of the contacts that are present and join spheres of which one at least is free (not
            driven).
        """
        self.network, self.spin, self.contact = network, spin, contact

    @property
    def sign(self) -> np.ndarray | None:
        """(spheres *N), +1 or -1, signs by which solvers multiply spins when they store them; None if all are 1, as
        here. On lattices they alternate between neighbours.
        """
        return None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape *N of arrays over the spheres: (number of spheres,), since here they are a list."""
        return self.network.shape

    @property
    def length(self) -> np.ndarray | None:
        """(spheres *N), lengths by which solvers multiply spins when they store them, here the radii; None if all are
        1, as on lattices.
        """
        return self.network.radius

    @property
    def slip_radius(self) -> float:
        """Factor that turns a difference of the numbers that solvers store into a slip speed, length/time: 1 here, as
        they store surface speeds; on lattices, where they store spins, the radius.
        """
        return 1.0

    @property
    def every(self) -> tuple[int, ...]:
        """Numbers of all spin components: (0,) for discs, (0, 1, 2) for spheres."""
        return tuple(range(self.network.components))

    @property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Numbers of the spin components that have to be solved for: in this class all. A subclass leaves out
        components along which some minimum has no slip."""
        return self.every

    @property
    def places(self) -> list[Index]:
        """Indices that pick the driven spheres out of an array (..., spheres *N): here one, with a mask of all of them;
        on lattices two, the bottom and the top plane.
        """
        return [(..., self.network.is_driven)]

    def imposed(self, spin_axes: tuple[int, ...]) -> list[Pair]:
        """Return the imposed surface speeds R omega of all driven spheres, length/time, in twice the precision: a list
        with one pair, for the one index in `places`. The pair has the doubles, (components C, n) for n driven spheres,
        and what their rounding leaves out, here 0.

        spin_axes : not used; all C components are returned here. On lattices it picks the components.
        """
        u = self.speed[self.network.is_driven].T
        return [(u, np.zeros_like(u))]

    def origin(self, spin_axes: tuple[int, ...]) -> Pair | None:
        """Return what solvers subtract from spins when they store them: None for nothing, as here. On lattices it is
        the state of the bottom plane, in twice the precision, (C components, 1, spheres *N) or with axes of length 1.

        spin_axes : numbers of the C components; not used here.
        """
        return None

    def unsolved_component(self, component: int) -> np.ndarray:
        """Return spins (spheres *N) for a component that is not solved for, as solvers store them: 0 here.

        component : number of the spin component, 0 to 2; not used here.
        """
        return np.zeros(self.shape)

    @cached_read_only
    def speed(self) -> np.ndarray:
        """(spheres N, components C) surface speeds R omega of driven spheres, 0 on free ones; length/time.

        Speeds of a component whose sizes differ by rounding alone all get the smallest of these sizes.
        """
        u = self.spin.reshape(self.network.spheres, -1) * self.network.radius[:, None]
        return as_one_driving(np.where(self.network.free[:, None], 0.0, u))

    @cached_property
    def jump(self) -> float:
        """Diagonal of the smallest box that holds all imposed surface speeds times the signs of the sublattices,
        length/time; 0 where nothing is driven.

        Neighbours have opposite signs, +1 and -1. Pieces of the network with odd loops (closed chains of an odd number
        of contacts) have no such signs; their spheres enter with both.
        """
        held = ~self.network.free
        if not held.any():
            return 0.0
        # mask (spheres,) of the pieces with odd loops, and signs (spheres,) that alternate elsewhere
        odd, sign = odd_pieces(self.network.spheres, *self.network.contact[:, self.contact])
        turned = (sign[:, None] * self.speed)[held]
        both = np.concatenate([turned, -turned[odd[held]]])
        return float(np.linalg.norm(both.max(axis=0) - both.min(axis=0)))

    @property
    def is_top(self) -> np.ndarray:
        """(spheres N,) mask of the spheres of the driven body with the largest number, the top."""
        return np.asarray(self.network.body == max(self.network.body.max(), 0))

    @property
    def top_and_bottom(self) -> tuple[float, float]:
        """Two speeds, length/time: the largest imposed surface speed R omega of the top, the driven body with the
        largest number, and the largest of all other driven spheres.
        """
        speed, top = np.linalg.norm(self.speed, axis=1), self.is_top
        return float(speed[top].max(initial=0.0)), float(speed[~top].max(initial=0.0))

    @cached_property
    def fastest(self) -> float:
        """The largest imposed surface speed R omega, length/time."""
        return float(np.linalg.norm(self.speed, axis=1).max(initial=0.0))

    @property
    def natural_spin(self) -> float | None:
        """The imposed spin that serves as unit of times and powers, 1/time; here None, as there are many."""
        return None

    @property
    def largest_spin(self) -> float:
        """The largest imposed spin in the laboratory, 1/time; 1 where all are 0."""
        spin = self.spin.reshape(self.network.spheres, -1)[~self.network.free]
        return float(np.linalg.norm(spin, axis=1).max(initial=0.0)) or 1.0

    @property
    def why_without_power(self) -> str:
        """Why no contact has to slip, in words that end a sentence; empty if some may have to."""
        return "" if len(self.network.bodies) else "no sphere is driven"

    @cached_read_only
    def heights(self) -> np.ndarray:
        """(spheres N,) height of each sphere: 0 on the driven body with the smallest number, 1 on that with the
        largest. A free sphere has the mean height of its neighbours; the height is 0 in parts that are not joined to
        either body.
        """
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import laplacian

        from taichi_bearings.numerics.minimum_cut import number_bodies

        # harmonic function on the graph of free spheres and bodies: 0 on the first body, 1 on the last one
        node = number_bodies(self.network.body)
        ends, size = node[self.network.contact[:, self.contact]], int(node.max()) + 1
        graph = csr_array((np.ones(2 * ends.shape[1]), np.append(ends, ends[::-1], axis=1)), shape=(size, size))
        label = pieces(size, *ends)
        inside = np.flatnonzero(np.isin(label, label[[0, -1]])[1:-1]) + 1
        matrix, height = laplacian(graph)[inside], np.zeros(size)
        height[-1] = 1.0
        if len(inside):
            height[inside] = SPARSE.spsolve(matrix[:, inside].tocsc(), -matrix[:, [-1]].toarray()[:, 0])
        return np.asarray(height[node])

    def shown(self, spin: np.ndarray) -> np.ndarray:
        """Return spins as pictures show them, without rotations that no contact resists: here as they are.

        spin : (..., spheres *N, 3), or (..., *N) of discs, 1/time.
        """
        return spin

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray | None:
        """Return None: no bounds on the spins at a minimum are known here, since contact normals may be oblique.

        spin_axes : numbers of the C components; not used here.

        The subclass for lattices returns bounds (2, C), lower and upper, of the spins as solvers store them.
        """
        return None

    def cut_off(self, present: np.ndarray) -> np.ndarray:
        """Return a mask (samples R,), True for samples in which contacts are known to join no spheres of different
        imposed spins, so that no contact has to slip. It is not found out here: all are False.

        present : (R, contacts E) mask of the contacts with positive coefficients; only its length R is used here.
        """
        return np.zeros(len(present), dtype=bool)

    def impose(self, carried: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Give driven spheres their imposed values in an array of spins, in place; return the same array.

        carried : spins as solvers store them, (components C, samples R, spheres *N): on lattices times the sign of the
            sublattice, less those of the bottom, 1/time; in packings times the radius, length/time.
        spin_axes : numbers of their C components.
        """
        for place, (high, _) in zip(self.places, self.imposed(spin_axes), strict=True):
            carried[place] = high[:, None]
        return carried

    def carried(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return spins in the form that solvers store, (components C, samples R, spheres *N). Driven spheres get their
        imposed values.

        * On a lattice it is the spin times a sign that alternates between neighbours, measured from the state of the
          bottom plane, 1/time.
        * In a packing it is the radius times the spin, length/time.

        spin : spins, 1/time, (R, *N) of discs or (R, *N, 3) of spheres.
        spin_axes : numbers of the C components that the result has.
        """
        of_discs = spin.ndim == 1 + len(self.shape)
        parts = spin[..., None] if of_discs else spin if len(spin_axes) == 3 else spin[..., list(spin_axes)]
        for factor in (self.sign, self.length):
            parts = parts if factor is None else parts * factor[..., None]
        found = np.array(np.moveaxis(parts, -1, 0), dtype=np.float64, order="C")
        origin = self.origin(spin_axes)
        if origin is not None:
            found -= origin[0]
        return self.impose(found, spin_axes)

    def laboratory(self, carried: np.ndarray, rest: np.ndarray | None, spin_axes: tuple[int, ...]) -> Pair:
        """Return spins in the laboratory frame, in twice the precision, from the numbers that solvers store.

        carried : spins as solvers store them, (components C, R, *N), with *N the shape of the lattice or the number of
            spheres. Lattices: spin times a sign that alternates between neighbours, minus that of the bottom, 1/time.
            Packings: spin times radius, length/time.
        rest : (C, R, *N), small corrections, so that carried + rest is more precise; None for 0. Not used on driven
            spheres, whose imposed spins are known in twice the precision.
        spin_axes : axes of the C components.

        Returns spins and corrections of their rounding, 1/time, both (R, *N) of discs or (R, *N, 3) of spheres.
        """
        # all components as they are stored: those that were solved for, others, and the imposed ones
        every = self.every
        high = np.empty((len(every), carried.shape[1], *self.shape))
        low = np.zeros_like(high)
        for slot, component in enumerate(every):
            if component not in spin_axes:
                high[slot] = self.unsolved_component(component)
                continue
            high[slot] = carried[spin_axes.index(component)]
            if rest is not None:
                low[slot] = rest[spin_axes.index(component)]
        for place, (coarse, fine) in zip(self.places, self.imposed(every), strict=True):
            low[place] = np.where(coarse[:, None] != 0, fine[:, None], low[place])
        # back to laboratory spins: plus the state of the bottom, times the sign, over the radius
        origin, pair = self.origin(every), (high, low)
        pair = pair if origin is None else add(pair, origin)
        if self.sign is not None:
            pair = pair[0] * self.sign, pair[1] * self.sign
        if self.length is not None:
            pair = divide(pair, exactly(self.length))
        spin, rounding = (
            part[0] if len(every) == 1 else np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in pair
        )
        return self.with_exact_imposed(spin, rounding)

    def of_equal_viscosity(self) -> np.ndarray:
        """Return the spins (components C, 1, spheres *N) at which the power would be least if all contacts in `contact`
        had one viscosity, as solvers store them: here times the radius, length/time.

        They solve a linear least-squares problem. It is solved by conjugate gradients, as the factors of its matrix
        would take much memory.
        """
        network = self.network
        every = np.arange(network.spheres * network.components).reshape(-1, network.components)
        moved, whole = np.repeat(network.free, network.components), network.operator(self.contact, every)
        matrix, given = whole[:, moved], np.where(moved, 0.0, self.speed.ravel())
        found = given.copy()
        with one_thread():  # sums do not depend on the number of threads
            found[moved], _ = SPARSE.cg(matrix.T @ matrix, -(matrix.T @ (whole @ given)), rtol=EVEN_RESIDUAL)
        return self.impose(found.reshape(-1, network.components).T[:, None].copy(), self.every)

    def with_exact_imposed(self, spin: np.ndarray, rounding: np.ndarray) -> Pair:
        """Replace the laboratory spins of driven spheres by exactly the spins that the user gave. Their rounding
        becomes 0.

        spin, rounding : spins, 1/time, and what their rounding leaves out, (samples R, spheres *N) of discs or (R, *N,
            3) of spheres; changed in place and returned.
        """
        held = self.network.is_driven
        spin[:, held], rounding[:, held] = self.spin[held], 0.0
        return spin, rounding

    def absolute(self, carried: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return spins measured from 0, as kinetic energies need them. On lattices solvers store them less the spins of
        the bottom plane, which are added here.

        carried : (C components, samples R, spheres *N), spins as solvers store them; the result has the same shape.
        spin_axes : numbers of the C components.
        """
        origin = self.origin(spin_axes)
        return carried if origin is None else carried + origin[0]

    def spins(self) -> Pair:
        """Return laboratory spins, (spheres *N) of discs or (*N, 3) of spheres, 1/time, and an array of what their
        rounding leaves out. Driven spheres have their imposed spins; those of free ones have no meaning.
        """
        at_rest = np.zeros((len(self.every), 1, *self.shape))
        spin, rest = self.laboratory(self.impose(at_rest, self.every), None, self.every)
        return spin[0], rest[0]


@dataclass(frozen=True)
class BearingState:
    """A bearing state: spins at which no contact of a lattice slips. The spin of a sphere at position x is A + C x,
    times -1 on every second sphere. Both fields are numbers in twice the precision.

    spin : the three components of A, 1/time.
    rate : C, an array of one number, 1/(time length).
    """

    spin: Pair
    rate: Pair

    def along(self, component: int, position: np.ndarray) -> Pair:
        """Return component k of A + C x at n positions, (n,), 1/time, in twice the precision.

        component : k.
        position : (n,), the components x_k of the positions, length.
        """
        high, low = (np.repeat(part[component], len(position)) for part in self.spin)
        return add((high, low), multiply(self.rate, exactly(position))) if self.rate[0][0] else (high, low)


class Planes(Driving):
    """Bearing states A + C x that are imposed on the top and the bottom plane of a lattice.

    In a bearing state the spin of a sphere at position x is A + C x times the sign of its sublattice, +1 or -1 in turn;
    no contact slips then. Solvers store the spin times this sign, less the state of the bottom plane. In this form the
    bottom is at rest, and the top has the difference of the two states. A Pair is a number in twice the precision: the
    nearest double, and what its rounding leaves out.
    """

    driven_contacts_slip = False
    slips_are_unique = samples_step_together = True

    def __init__(
        self,
        lattice: Lattice,
        bottom: BearingState,
        difference: BearingState,
        unit: Pair,
        in_units: BearingState | None = None,
        given: tuple[float, float] | None = None,
    ) -> None:
        """Store the states that are imposed on the two planes.

        lattice : the lattice, whose first and last planes are driven.
        bottom : state of the bottom plane: the vector A, 1/time, and the number C, 1/(time length).
        difference : state of the top plane less that of the bottom.
        unit : array of one number in twice the precision, 1/time, near the size of the difference; solvers that scale
            spins divide by it.
        in_units : the difference divided by `unit` where it is the same on the whole top, else None.
        given : the imposed spins (top, bottom), 1/time, where both planes turn about one axis, else None.
        """
        self.lattice, self.bottom, self.difference, self.unit = lattice, bottom, difference, unit
        self.in_units, self.given = in_units, given

    @classmethod
    def by_spins(cls, lattice: Lattice, top: float, bottom: float, direction: tuple[float, float, float]) -> "Planes":
        """Return the driving of planes that turn about one axis (paper, Eq. 1).

        lattice : the lattice, whose first and last planes are driven.
        top, bottom : their spins, 1/time.
        direction : the axis, of any length but 0; ignored in 2D, where spins point along z.
        """
        # all in twice the precision: difference = top - bottom, its size as unit, and its direction
        axis = _unit_vector(np.array([0.0, 0.0, 1.0] if lattice.dimension == 2 else direction))
        at_rest, sign = exactly(np.zeros(1)), np.sign(top - bottom)
        low = BearingState(multiply(exactly(np.array([bottom])), axis), at_rest)
        jump = BearingState(multiply(two_sum(np.array([top]), np.array([-bottom])), axis), at_rest)
        unit = two_sum(np.array([sign * top]), np.array([-sign * bottom]))
        in_units = BearingState((sign * axis[0], sign * axis[1]), at_rest)
        return cls(lattice, low, jump, unit, in_units, (top, bottom))

    @classmethod
    def by_states(cls, lattice: Lattice, top: tuple[float, ...], bottom: tuple[float, ...]) -> "Planes":
        """Return the driving of planes in bearing states: staggered spins A + C x at position x, at which nothing
        slips.

        lattice : the lattice, whose first and last planes are driven.
        top, bottom : the numbers (A_x, A_y, A_z, C) of the plane, or in 2D (A_z,): the vector A in 1/time, the rate C
            in 1/(time length).
        """
        padded = ((0.0, 0.0, *state, 0.0) if len(state) == 1 else state for state in (top, bottom))
        (high, rise), (low, fall) = ((np.array(state[:3]), np.array(state[3:])) for state in padded)
        states = BearingState(exactly(low), exactly(fall)), BearingState(two_sum(high, -low), two_sum(rise, -fall))
        largest = cls(lattice, *states, exactly(np.ones(1))).jump
        return cls(lattice, *states, exactly(np.exp2(np.floor(np.log2([largest or 1.0])))))

    @property
    def grows(self) -> tuple[bool, bool]:
        """Two truth values, of the top and of the bottom: True if the imposed spins grow with the position (C != 0)."""
        low, more = self.bottom.rate[0][0], self.difference.rate[0][0]
        return bool(low + more), bool(low)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape *N of arrays over the spheres: numbers of spheres along the axes of the lattice, the height last."""
        return self.lattice.shape

    @property
    def sign(self) -> np.ndarray:
        """(spheres *N) sign of the sublattice, +1 and -1 in turn, by which solvers multiply spins."""
        return self.lattice.parity

    @property
    def length(self) -> None:
        """None: on lattices solvers store spins, multiplied by no radius."""
        return None

    @property
    def slip_radius(self) -> float:
        """Radius of the spheres, length. The difference of the stored spins of two touching spheres, times it, is a
        slip speed.
        """
        return self.lattice.radius

    @property
    def every(self) -> tuple[int, ...]:
        """Numbers of all spin components: (2,) for discs, (0, 1, 2) for spheres."""
        return self.lattice.all_spin_axes

    @cached_property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Numbers of the spin components that have to be solved for; some minimum has no slip from the others.

        A component in which top and bottom agree is constant at a minimum (shown in docs/equations.md, 3). The
        component along the height of a cubic lattice is constant in each layer: contacts along the height do not slip
        by it. If no component is left, the first one is taken.
        """
        every, height = self.lattice.all_spin_axes, self.lattice.height_axis
        jumps = [bool(jump.any()) for jump in self.imposed_on_top(every)[0]]
        needed = tuple(k for k, jump in zip(every, jumps, strict=True) if jump and k != height)
        return needed or every[:1]

    @property
    def places(self) -> list[Index]:
        """Indices that pick the bottom and the top plane out of an array (..., spheres *N), whose last axis is the
        height.
        """
        return [(..., 0), (..., -1)]

    def imposed(self, spin_axes: tuple[int, ...]) -> list[Pair]:
        """Return the imposed spins of bottom and top as solvers store them, 1/time: a Pair for each plane, of arrays
        (components C, *plane). Spins are 0 on the bottom, and on the top the difference of the two imposed bearing
        states at its spheres.

        spin_axes : numbers of the C components.
        """
        top = self.imposed_on_top(spin_axes)
        return [(np.zeros_like(top[0]), np.zeros_like(top[0])), top]

    def origin(self, spin_axes: tuple[int, ...]) -> Pair:
        """Return the state of the bottom plane, from which solvers measure spins, at all spheres: (C, 1, spheres *N),
        or with axes of length 1 where it is the same everywhere; 1/time, in twice the precision.

        spin_axes : numbers of the C components.
        """
        return self.bottom_state(spin_axes)

    def unsolved_component(self, component: int) -> np.ndarray:
        """Return spins, 1/time, for a component that is not solved for, as solvers store them: they rise linearly with
        the height, from 0 at the bottom to the imposed spin of the top. The shape is that of the lattice, or broadcasts
        to it. If `minimum_spin_axes` leaves out the component, these spins make no contact slip.

        component : number of the spin component.
        """
        return np.linspace(0.0, self.imposed_on_top((component,))[0][0], self.lattice.shape[-1], axis=-1)

    @property
    def why_without_power(self) -> str:
        """Why no contact has to slip, in words that end a sentence; empty if some may have to."""
        if self.jump == 0:
            return "top and bottom are driven alike, so that all spheres turn in one bearing state"
        if self.imposed_on_top(self.minimum_spin_axes)[0].any():
            return ""
        return (
            "the imposed spins point along the height, contacts along the height do not feel such spins, and every "
            "layer turns in a bearing state of its own"
        )

    @cached_read_only
    def heights(self) -> np.ndarray:
        """(spheres N,) height of each sphere: the number of its layer over that of the top."""
        *_, layer = np.indices(self.lattice.shape)
        return np.asarray(layer.ravel() / layer.max())

    def shown(self, spin: np.ndarray) -> np.ndarray:
        """Return spins as pictures show them, without rotations that no contact resists.

        No contact of a lattice resists a rotation of a whole layer about the height (with the signs of the
        sublattices), so that a dynamics keeps whatever mean each layer began with. If both driven planes have the same
        mean, free layers are shown with it too. Otherwise, and in 2D, the spins stay as they are.

        spin : (..., spheres *N, 3), or (..., *N) of discs, 1/time.
        """
        if self.lattice.dimension == 2:
            return spin
        sign = self.lattice.parity
        mean = (sign * spin[..., 2]).mean(axis=(-3, -2), keepdims=True)
        bottom, top = mean[..., :1], mean[..., -1:]
        if not np.allclose(bottom, top, rtol=0, atol=1e-12 * self.fastest):
            return spin
        shown = np.array(spin)
        shown[..., 1:-1, 2] -= (sign * (mean - bottom))[..., 1:-1]
        return shown

    def of_equal_viscosity(self) -> np.ndarray:
        """Return the minimum of a viscous law without disorder: spins (components C, 1, spheres *N), 1/time, that rise
        linearly with the height, in the form that solvers store (times the sign of the sublattice, less the state of
        the bottom).
        """
        height = np.linspace(0.0, 1.0, self.lattice.shape[-1])
        return self.imposed_on_top(self.every)[0][:, None, ..., None] * height

    def with_exact_imposed(self, spin: np.ndarray, rounding: np.ndarray) -> Pair:
        """Return laboratory spins, and what their rounding leaves out, unchanged: the imposed spins of planes are known
        in twice the precision, so that nothing has to be replaced.

        spin, rounding : 1/time, (samples R, spheres *N) of discs or (R, *N, 3) of spheres.
        """
        return spin, rounding

    @cached_read_only
    def spin(self) -> np.ndarray:
        """Laboratory spins, (spheres *N) of discs or (*N, 3) of spheres, 1/time; those of the two planes are
        imposed.
        """
        return self.spins()[0]

    @cached_read_only
    def speed(self) -> np.ndarray:
        """(spheres N, components C) imposed u = R omega, length/time, measured from the state of the bottom, so 0
        except on the top.

        Components that are not in `minimum_spin_axes` are 0.
        """
        axes = self.minimum_spin_axes
        u = np.zeros((*self.lattice.shape, 3))
        top = self.lattice.parity[..., -1, None] * np.moveaxis(self.imposed_on_top(axes)[0], 0, -1)
        u[..., -1, list(axes)] = self.lattice.radius * top
        return as_one_driving(u.reshape(-1, 3) if self.lattice.dimension == 3 else u[..., 2].reshape(-1, 1))

    @cached_property
    def jump(self) -> float:
        """Largest size, over the top plane, of the difference of the imposed spins of top and bottom, without the signs
        by which neighbours differ, 1/time.
        """
        if self.in_units is not None:
            return float(self.unit[0][0])
        return float(np.linalg.norm(self.imposed_on_top(self.lattice.all_spin_axes)[0], axis=0).max())

    @property
    def top_and_bottom(self) -> tuple[float, float]:
        """The imposed spins of top and bottom, 1/time: as given, with their signs, if both turn about one axis;
        otherwise the largest size of the spin vector on each of the two planes.
        """
        if self.given is not None:
            return self.given
        axes = self.lattice.all_spin_axes
        whole, rest = (
            np.broadcast_to(part[:, 0], (len(axes), *self.lattice.shape)) for part in self.bottom_state(axes)
        )
        high = add((whole[..., -1], rest[..., -1]), self.imposed_on_top(axes))[0]
        top, bottom = (float(np.linalg.norm(of, axis=0).max()) for of in (high, whole[..., 0]))
        return top, bottom

    @property
    def fastest(self) -> float:
        """The larger size of the imposed spins of top and bottom, 1/time."""
        return max(map(abs, self.top_and_bottom))

    @property
    def natural_spin(self) -> float:
        """Unit of spins, 1/time, in which times and powers are reported: the size of the top's spin, of the bottom's if
        the top has none, or 1.
        """
        top, bottom = self.top_and_bottom
        return abs(top) or abs(bottom) or 1.0

    @property
    def largest_spin(self) -> float:
        """The larger size of the imposed spins of top and bottom, 1/time."""
        return self.fastest

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return bounds (2, C), lower and upper, 1/time, between which some minimum has all its spins (shown in
        docs/equations.md, 4), in the form that solvers store: times the sign of the sublattice, less the state of the
        bottom. They are the smallest and largest of the imposed values: 0 at the bottom, and those of the top.

        spin_axes : numbers of the C components.
        """
        top = self.imposed_on_top(spin_axes)[0].reshape(len(spin_axes), -1)
        return np.stack([top.min(axis=1, initial=0.0), top.max(axis=1, initial=0.0)])

    def cut_off(self, present: np.ndarray) -> np.ndarray:
        """Return a mask (samples R,), True for samples in which no chain of contacts joins bottom and top in any spin
        component that has to be solved for. A chain of a component consists of contacts that this component makes slip:
        all but those along its axis.

        present : (R, contacts E) mask of the contacts with positive coefficients.
        """
        if present.all():
            return np.zeros(len(present), dtype=bool)
        sites, joined = self.lattice.sites, np.zeros(len(present), dtype=bool)
        sphere = np.arange(sites).reshape(self.lattice.shape)
        sphere[..., 0], sphere[..., -1] = 0, sites - 1
        body = sphere.ravel()[self.lattice.ends]
        for replica, slips in product(range(len(present)), self.lattice.tangential_mask(self.minimum_spin_axes)):
            label = pieces(sites, *body[:, slips & present[replica]])
            joined[replica] |= label[0] == label[-1]
        return ~joined

    def positions(self, component: int) -> np.ndarray:
        """Return the positions (n,), length, of the n layers of spheres along an axis; the first is at 0. In 2D, where
        spins do not depend on the position, return the one position 0.

        component : number of the axis.
        """
        if self.lattice.dimension == 2:
            return np.zeros(1)
        return 2 * self.lattice.radius * np.arange(self.lattice.shape[component])

    def _of_layers(self, state: BearingState, spin_axes: tuple[int, ...], shape: tuple[int, ...]) -> Pair:
        """Return an imposed bearing state A + rate * x at spheres of the lattice, 1/time, in twice the precision: two
        arrays (components, *shape), one of doubles and one of what their rounding leaves out.

        state : the vector A and the rate.
        spin_axes : numbers of the components of the result.
        shape : number of layers along each axis, counted from the first one. If the axis of the height is left out, the
            values are those of the top plane.
        """
        found = np.empty((2, len(spin_axes), *shape))
        for slot, k in enumerate(spin_axes):
            position = self.positions(k)
            pair = state.along(k, position[: shape[k]] if k < len(shape) else position[-1:])
            for whole, part in zip(found, pair, strict=True):
                whole[slot] = part.reshape([-1 if a == k else 1 for a in range(len(shape))])
        return found[0], found[1]

    @cached_property
    def _all_on_top(self) -> Pair:
        """Imposed spins of the top less those of the bottom, 1/time, at each sphere of the top plane: a pair of arrays
        (components C, *plane), which are to be added. There are all C spin components of the lattice, also those that
        need not be solved for.
        """
        return self._of_layers(self.difference, self.lattice.all_spin_axes, self.lattice.shape[:-1])

    def imposed_on_top(self, spin_axes: tuple[int, ...]) -> Pair:
        """Return the imposed spins of the top plane as solvers store them: times the sign of the sublattice, less the
        state of the bottom; (C, nx, ny), in 2D (C, nx), 1/time, in twice the precision.

        spin_axes : numbers of the C components.
        """
        slots = [self.lattice.all_spin_axes.index(k) for k in spin_axes]
        high, low = self._all_on_top
        return high[slots], low[slots]

    def top_in_units(self, spin_axes: tuple[int, ...]) -> Pair:
        """Return the imposed spins of the top plane, as solvers store them, divided by `unit`: (C, nx, ny), in 2D (C,
        nx), in twice the precision. Solvers store spins times the sign of the sublattice, less the state of the bottom.

        spin_axes : numbers of the C components.
        """
        if self.in_units is not None:
            return self._of_layers(self.in_units, spin_axes, self.lattice.shape[:-1])
        high, low = self.imposed_on_top(spin_axes)
        return high / self.unit[0], low / self.unit[0]

    def bottom_state(self, spin_axes: tuple[int, ...]) -> Pair:
        """Return the state of the bottom plane, continued to all spheres, (C, 1, spheres *N), 1/time, in twice the
        precision. If it is the same everywhere the axes *N have length 1.

        spin_axes : numbers of the C components.
        """
        varies = bool(self.bottom.rate[0][0])
        high, low = self._of_layers(
            self.bottom, spin_axes, self.lattice.shape if varies else (1,) * self.lattice.dimension
        )
        return high[:, None], low[:, None]


def as_one_driving(u: np.ndarray) -> np.ndarray:
    """Remove differences between imposed speeds that come from rounding, in place; return the same array.

    u : (spheres N, components C), length/time. Sizes of a component that differ by no more than SAME_DRIVING units in
        the last place all become the smallest of them.
    """
    for part in u.T:
        size, place = np.unique(np.abs(part), return_inverse=True)
        for number in range(1, len(size)):
            if size[number] - size[number - 1] <= SAME_DRIVING * np.spacing(size[number]):
                size[number] = size[number - 1]
        part[:] = np.copysign(size[place.reshape(-1)], part)
    return u


def _unit_vector(vector: np.ndarray) -> Pair:
    """Return the unit vector along a vector (3,) that is not 0: two arrays (3,), the nearest doubles and what their
    rounding leaves out."""
    # scaled by a power of two, which rounds nothing, so that squares neither overflow nor vanish
    vector = np.asarray(vector, dtype=np.float64)
    vector = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
    squares = two_product(vector, vector)
    total = exactly(np.zeros(1))
    for k in range(3):
        total = add(total, (squares[0][k : k + 1], squares[1][k : k + 1]))
    return divide(exactly(vector), square_root(total))
