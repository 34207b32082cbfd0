"""What is imposed on a bearing, and how its spins are carried while it is solved.

A method carries x = s l omega - x0 for each component of the spin omega of each sphere:

* where each driven sphere has a spin of its own (:class:`Driving`), x = u = R omega is the speed of its surface: l is
  its radius R, s = 1 and x0 = 0;
* where the two planes of a lattice are in bearing states (:class:`Planes`), x is the staggered spin measured from the
  bottom: s = +1 or -1 is the sublattice, x0 the state of the bottom, and l = 1.

A bearing state is a staggered spin A + C x, with the position x measured from the centre of sphere (0, 0, 0): no
contact slips in it, because the ends of a contact differ along the contact alone. A state can therefore be taken from
all spins, and here that of the bottom is: the bottom is then at rest, and the top carries the *jump*, the difference of
the two states. Component k of the jump depends on x_k alone, and contacts along k do not feel it: each layer x_k =
const has a problem of its own in that component. Discs have one component, and no C.

Letters: R samples, N spheres (*N is the shape of arrays over them), C spin components.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.blas import one_thread
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

EVEN_RESIDUAL = 1e-12  # of the torques of the spins at even viscosities, relative
SAME_DRIVING = 4  # units in the last place, up to which imposed speeds are one


class Driving:
    """Spins that are imposed on driven spheres one by one. Nothing of it changes once it is made."""

    rubs = True  # contacts between driven spheres may slip

    def __init__(self, network: "Network", spin: np.ndarray, contact: np.ndarray) -> None:
        """Take a network whose spheres are driven.

        spin : (N, 3), of discs (N,), 1/time; imposed on driven spheres, ignored on others. contact : (n,), numbers of
        the contacts that act.
        """
        self.network, self.spin, self.contact = network, spin, contact

    @property
    def sign(self) -> np.ndarray | None:
        """s, (*N); None where it is 1."""
        return None

    @property
    def shape(self) -> tuple[int, ...]:
        """*N."""
        return self.network.shape

    @property
    def length(self) -> np.ndarray | None:
        """l, (*N); None where it is 1."""
        return self.network.radius

    @property
    def slip_radius(self) -> float:
        """Length by which a difference of carried spins is multiplied to be a slip."""
        return 1.0

    @property
    def every(self) -> tuple[int, ...]:
        """All spin components that there are."""
        return tuple(range(self.network.components))

    @property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Components of the spins that a minimum needs."""
        return self.every

    @property
    def places(self) -> list[Any]:
        """Indices of the driven spheres in arrays (..., *N), body by body or of all at once."""
        return [(..., self.network.is_driven)]

    def imposed(self, spin_axes: tuple[int, ...]) -> list[Pair]:
        """What these spheres carry, (C, n) or in the shape of a plane, in twice the precision; one pair for each
        place."""
        u = self.speed[self.network.is_driven].T
        return [(u, np.zeros_like(u))]

    def origin(self, spin_axes: tuple[int, ...]) -> Pair | None:
        """x0, (C, 1, *N) or with sides of 1, in twice the precision; None where it is 0."""
        return None

    def left_out(self, component: int) -> np.ndarray:
        """What spheres carry, (*N), in a component that is not carried: it slips nowhere."""
        return np.zeros(self.shape)

    @cached_read_only
    def speed(self) -> np.ndarray:
        """u = R omega of driven spheres, (N, C); 0 on free ones; length/time. Sizes of a component that differ by no
        more than 4 units in the last place are one driving, the least of them."""
        u = self.spin.reshape(self.network.spheres, -1) * self.network.radius[:, None]
        return as_one_driving(np.where(self.network.free[:, None], 0.0, u))

    @cached_property
    def jump(self) -> float:
        """Diagonal of the box of the imposed u, with the signs of a sublattice where there are two, else of both; 0
        where nothing is driven; length/time."""
        held = ~self.network.free
        if not held.any():
            return 0.0
        odd, sign = odd_pieces(self.network.spheres, *self.network.contact[:, self.contact])
        turned = (sign[:, None] * self.speed)[held]
        both = np.concatenate([turned, -turned[odd[held]]])
        return float(np.linalg.norm(both.max(axis=0) - both.min(axis=0)))

    @property
    def is_top(self) -> np.ndarray:
        """(N,) True for the spheres of the body of the largest number."""
        return np.asarray(self.network.body == max(self.network.body.max(), 0))

    @property
    def sides(self) -> tuple[float, float]:
        """The largest R omega of the last body, the top, and of all others, length/time."""
        speed, top = np.linalg.norm(self.speed, axis=1), self.is_top
        return float(speed[top].max(initial=0.0)), float(speed[~top].max(initial=0.0))

    @cached_property
    def fastest(self) -> float:
        """The largest imposed R omega, length/time."""
        return float(np.linalg.norm(self.speed, axis=1).max(initial=0.0))

    @property
    def natural_spin(self) -> float | None:
        """The imposed spin in which times and powers are counted, 1/time; None where none stands out."""
        return None

    @property
    def largest_spin(self) -> float:
        """The largest imposed spin in the laboratory, 1/time; 1 where all are 0."""
        spin = self.spin.reshape(self.network.spheres, -1)[~self.network.free]
        return float(np.linalg.norm(spin, axis=1).max(initial=0.0)) or 1.0

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray | None:
        """(2, C) lower and upper ends of the interval in which some minimum has each component; None where no box is
        known to hold one, as with oblique normals."""
        return None

    def cut_off(self, present: np.ndarray) -> np.ndarray:
        """(R,) True where it is known that contacts which are present, (R, E), do not join what is driven unlike."""
        return np.zeros(len(present), dtype=bool)

    def impose(self, carried: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """The same carried spins (C, R, *N), changed in place: driven spheres have their imposed values."""
        for place, (high, _) in zip(self.places, self.imposed(spin_axes), strict=True):
            carried[place] = high[:, None]
        return carried

    def carried(self, spin: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Spins as methods carry them, (C, R, *N), of those of the laboratory, (R, *N), of spheres (R, *N, 3); of
        driven spheres the imposed ones."""
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
        """Spins as one sees them, (R, *N), of spheres (R, *N, 3), and what their rounding leaves out; 1/time.

        carried : (C, R, *N). rest : what is to be added to them, if anything; of driven spheres it is known.
        """
        every = self.every
        high = np.empty((len(every), carried.shape[1], *self.shape))
        low = np.zeros_like(high)
        for slot, component in enumerate(every):
            if component not in spin_axes:
                high[slot] = self.left_out(component)
                continue
            high[slot] = carried[spin_axes.index(component)]
            if rest is not None:
                low[slot] = rest[spin_axes.index(component)]
        for place, (coarse, fine) in zip(self.places, self.imposed(every), strict=True):
            low[place] = np.where(coarse[:, None] != 0, fine[:, None], low[place])
        origin, pair = self.origin(every), (high, low)
        pair = pair if origin is None else add(pair, origin)
        if self.sign is not None:
            pair = pair[0] * self.sign, pair[1] * self.sign
        if self.length is not None:
            pair = divide(pair, exactly(self.length))
        spin, rounding = (
            part[0] if len(every) == 1 else np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in pair
        )
        return self.as_given(spin, rounding)

    def evenly(self) -> np.ndarray:
        """Carried spins (C, 1, *N) of all components, of least power with the same viscosity at all contacts that act:
        by conjugate gradients, which need no factor of a matrix, as that is large and a GPU has none."""
        from scipy.sparse.linalg import cg

        network = self.network
        every = np.arange(network.spheres * network.components).reshape(-1, network.components)
        moved, whole = np.repeat(network.free, network.components), network.operator(self.contact, every)
        matrix, given = whole[:, moved], np.where(moved, 0.0, self.speed.ravel())
        found = given.copy()
        with one_thread():  # sums do not depend on the number of threads
            found[moved], _ = cg(matrix.T @ matrix, -(matrix.T @ (whole @ given)), rtol=EVEN_RESIDUAL)
        return self.impose(found.reshape(-1, network.components).T[:, None].copy(), self.every)

    def as_given(self, spin: np.ndarray, rounding: np.ndarray) -> Pair:
        """The same spins and roundings, changed in place: those of driven spheres bit by bit as they were given."""
        held = self.network.is_driven
        spin[:, held], rounding[:, held] = self.spin[held], 0.0
        return spin, rounding

    def absolute(self, carried: np.ndarray, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Carried spins (C, R, *N) with the x0 that was taken from all of them: for energies."""
        origin = self.origin(spin_axes)
        return carried if origin is None else carried + origin[0]

    def spins(self) -> Pair:
        """Spins of all spheres in the laboratory, (*N), of spheres (*N, 3), of which those of driven spheres are the
        imposed ones; and what their rounding leaves out; 1/time."""
        at_rest = np.zeros((len(self.every), 1, *self.shape))
        spin, rest = self.laboratory(self.impose(at_rest, self.every), None, self.every)
        return spin[0], rest[0]


@dataclass(frozen=True)
class BearingState:
    """Staggered spin A + C x, in twice the precision. spin : A, (3,), 1/time. rate : C, (1,), 1/(time length)."""

    spin: Pair
    rate: Pair

    def along(self, component: int, position: np.ndarray) -> Pair:
        """Component k at positions x_k, (n,), length."""
        high, low = (np.repeat(part[component], len(position)) for part in self.spin)
        return add((high, low), multiply(self.rate, exactly(position))) if self.rate[0][0] else (high, low)


class Planes(Driving):
    """Bearing states that are imposed on the top and the bottom plane of a lattice."""

    rubs = False

    def __init__(
        self,
        lattice: Lattice,
        bottom: BearingState,
        difference: BearingState,
        unit: Pair,
        in_units: BearingState | None = None,
        given: tuple[float, float] | None = None,
    ) -> None:
        """Take the state of the bottom plane, and that of the top less that of the bottom.

        unit : (1,), what spins are measured in where they are to be of order one, 1/time, in twice the precision.
        in_units : the difference in this unit where it is the same on the whole top, else None. given : the spins of
        top and bottom, 1/time, where they turn about one axis.
        """
        self.lattice, self.bottom, self.difference, self.unit = lattice, bottom, difference, unit
        self.in_units, self.given = in_units, given

    @classmethod
    def by_spins(cls, lattice: Lattice, top: float, bottom: float, direction: tuple[float, float, float]) -> "Planes":
        """Planes that turn with spins about one axis (paper, Eq. 1). direction : its, not normalised; of spheres."""
        axis = _unit_vector(np.array([0.0, 0.0, 1.0] if lattice.dimension == 2 else direction))
        at_rest, sign = exactly(np.zeros(1)), np.sign(top - bottom)
        low = BearingState(multiply(exactly(np.array([bottom])), axis), at_rest)
        jump = BearingState(multiply(two_sum(np.array([top]), np.array([-bottom])), axis), at_rest)
        unit = two_sum(np.array([sign * top]), np.array([-sign * bottom]))
        in_units = BearingState((sign * axis[0], sign * axis[1]), at_rest)
        return cls(lattice, low, jump, unit, in_units, (top, bottom))

    @classmethod
    def by_states(cls, lattice: Lattice, top: tuple[float, ...], bottom: tuple[float, ...]) -> "Planes":
        """Planes in the bearing states (A_x, A_y, A_z, C); discs have (A_z,)."""
        padded = ((0.0, 0.0, *state, 0.0) if len(state) == 1 else state for state in (top, bottom))
        (high, rise), (low, fall) = ((np.array(state[:3]), np.array(state[3:])) for state in padded)
        states = BearingState(exactly(low), exactly(fall)), BearingState(two_sum(high, -low), two_sum(rise, -fall))
        largest = cls(lattice, *states, exactly(np.ones(1))).jump
        return cls(lattice, *states, exactly(np.exp2(np.floor(np.log2([largest or 1.0])))))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.lattice.shape

    @property
    def sign(self) -> np.ndarray:
        return self.lattice.parity

    @property
    def length(self) -> None:
        return None

    @property
    def slip_radius(self) -> float:
        return self.lattice.radius

    @property
    def every(self) -> tuple[int, ...]:
        return self.lattice.all_spin_axes

    @cached_property
    def minimum_spin_axes(self) -> tuple[int, ...]:
        """Components the minimum needs.

        Where top and bottom agree, the staggered spin is constant (equations.md, 3). Nor is the component along the
        height of a cubic lattice ever needed: contacts along it do not feel it, so it is constant in each layer.
        """
        every, height = self.lattice.all_spin_axes, self.lattice.height_axis
        jumps = [bool(jump.any()) for jump in self.imposed_on_top(every)[0]]
        needed = tuple(k for k, jump in zip(every, jumps, strict=True) if jump and k != height)
        return needed or every[:1]  # no frustration: one component, to have something to show

    @property
    def places(self) -> list[Any]:
        return [(..., 0), (..., -1)]

    def imposed(self, spin_axes: tuple[int, ...]) -> list[Pair]:
        top = self.imposed_on_top(spin_axes)
        return [(np.zeros_like(top[0]), np.zeros_like(top[0])), top]

    def origin(self, spin_axes: tuple[int, ...]) -> Pair:
        return self.bottom_state(spin_axes)

    def left_out(self, component: int) -> np.ndarray:
        """What spheres carry in a component that is not carried: it goes linearly from bottom to top, which is constant
        where the two agree."""
        return np.linspace(0.0, self.imposed_on_top((component,))[0][0], self.lattice.shape[-1], axis=-1)

    def evenly(self) -> np.ndarray:
        """Carried spins (C, 1, *N), linear in the height: the viscous answer without disorder."""
        height = np.linspace(0.0, 1.0, self.lattice.shape[-1])
        return self.imposed_on_top(self.every)[0][:, None, ..., None] * height

    def as_given(self, spin: np.ndarray, rounding: np.ndarray) -> Pair:
        return spin, rounding

    @cached_read_only
    def spin(self) -> np.ndarray:
        """Laboratory spins of the two planes, (*N), of spheres (*N, 3), 1/time."""
        return self.spins()[0]

    @cached_read_only
    def speed(self) -> np.ndarray:
        """u = R omega (N, C) of the components that a minimum needs, measured from the bottom: 0 but on the top."""
        axes = self.minimum_spin_axes
        u = np.zeros((*self.lattice.shape, 3))
        top = self.lattice.parity[..., -1, None] * np.moveaxis(self.imposed_on_top(axes)[0], 0, -1)
        u[..., -1, list(axes)] = self.lattice.radius * top
        return as_one_driving(u.reshape(-1, 3) if self.lattice.dimension == 3 else u[..., 2].reshape(-1, 1))

    @cached_property
    def jump(self) -> float:
        """|difference of the imposed staggered spins| where it is largest on the top plane, 1/time."""
        if self.in_units is not None:
            return float(self.unit[0][0])
        return float(np.linalg.norm(self.imposed_on_top(self.lattice.all_spin_axes)[0], axis=0).max())

    @property
    def sides(self) -> tuple[float, float]:
        """Spins of top and bottom, 1/time; where states are imposed, their largest sizes on the planes."""
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
        """The larger of the sizes of both spins, 1/time."""
        return max(map(abs, self.sides))

    @property
    def natural_spin(self) -> float:
        """The size of the spin of the top, of the bottom where the top is at rest, 1 where both are; 1/time."""
        top, bottom = self.sides
        return abs(top) or abs(bottom) or 1.0

    @property
    def largest_spin(self) -> float:
        return self.fastest

    def box(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """(2, C) lower and upper ends of the interval in which a minimiser has each component (equations.md, 4)."""
        top = self.imposed_on_top(spin_axes)[0].reshape(len(spin_axes), -1)
        return np.stack([top.min(axis=1, initial=0.0), top.max(axis=1, initial=0.0)])

    def cut_off(self, present: np.ndarray) -> np.ndarray:
        """(R,) True where absent contacts leave the two planes unconnected in all components that a minimum needs."""
        if present.all():
            return np.zeros(len(present), dtype=bool)
        sites, joined = self.lattice.sites, np.zeros(len(present), dtype=bool)
        sphere = np.arange(sites).reshape(self.lattice.shape)
        sphere[..., 0], sphere[..., -1] = 0, sites - 1
        body = sphere.ravel()[self.lattice.ends]
        for replica, felt in product(range(len(present)), self.lattice.tangential_mask(self.minimum_spin_axes)):
            label = pieces(sites, *body[:, felt & present[replica]])
            joined[replica] |= label[0] == label[-1]
        return ~joined

    def positions(self, component: int) -> np.ndarray:
        """x_k, (n,), of the layers of spheres along k, length; of discs (1,)."""
        if self.lattice.dimension == 2:
            return np.zeros(1)
        return 2 * self.lattice.radius * np.arange(self.lattice.shape[component])

    def _of_layers(self, state: BearingState, spin_axes: tuple[int, ...], shape: tuple[int, ...]) -> Pair:
        """A state at the spheres of the first layers, as many along each axis as `shape` says, (C, *shape), in twice
        the precision, 1/time; components along an axis that it lacks are those of the last layer."""
        found = np.empty((2, len(spin_axes), *shape))
        for slot, k in enumerate(spin_axes):
            position = self.positions(k)
            pair = state.along(k, position[: shape[k]] if k < len(shape) else position[-1:])
            for whole, part in zip(found, pair, strict=True):
                whole[slot] = part.reshape([-1 if a == k else 1 for a in range(len(shape))])
        return found[0], found[1]

    @cached_property
    def _all_on_top(self) -> Pair:
        """Jump at each sphere of the top plane by every component of the lattice."""
        return self._of_layers(self.difference, self.lattice.all_spin_axes, self.lattice.shape[:-1])

    def imposed_on_top(self, spin_axes: tuple[int, ...]) -> Pair:
        """The same of these components, (C, nx, ny), in 2D (C, nx)."""
        slots = [self.lattice.all_spin_axes.index(k) for k in spin_axes]
        high, low = self._all_on_top
        return high[slots], low[slots]

    def top_in_units(self, spin_axes: tuple[int, ...]) -> Pair:
        """The same over `unit`, a power of two where the jump varies."""
        if self.in_units is not None:
            return self._of_layers(self.in_units, spin_axes, self.lattice.shape[:-1])
        high, low = self.imposed_on_top(spin_axes)
        return high / self.unit[0], low / self.unit[0]

    def bottom_state(self, spin_axes: tuple[int, ...]) -> Pair:
        """Staggered spin of the bottom's state at all spheres, (C, 1, *N) or with sides of 1 where it does not vary, in
        twice the precision, 1/time."""
        varies = bool(self.bottom.rate[0][0])
        high, low = self._of_layers(
            self.bottom, spin_axes, self.lattice.shape if varies else (1,) * self.lattice.dimension
        )
        return high[:, None], low[:, None]


def as_one_driving(u: np.ndarray) -> np.ndarray:
    """Imposed speeds (N, C), changed in place: sizes of a component that differ by no more than 4 units in the last
    place are one driving, the least of them."""
    for part in u.T:
        size, place = np.unique(np.abs(part), return_inverse=True)
        for number in range(1, len(size)):
            if size[number] - size[number - 1] <= SAME_DRIVING * np.spacing(size[number]):
                size[number] = size[number - 1]
        part[:] = np.copysign(size[place.reshape(-1)], part)
    return u


def _unit_vector(vector: np.ndarray) -> Pair:
    """(3,) along a vector that is not 0, in twice the precision."""
    vector = np.asarray(vector, dtype=np.float64)
    vector = np.ldexp(vector, -int(np.frexp(np.abs(vector).max())[1]))
    squares = two_product(vector, vector)
    total = exactly(np.zeros(1))
    for k in range(3):
        total = add(total, (squares[0][k : k + 1], squares[1][k : k + 1]))
    return divide(exactly(vector), square_root(total))
