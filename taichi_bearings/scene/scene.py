"""What is solved: a lattice, a contact law, a coefficient for every contact, and the imposed bearing states.

Letters: R samples, E contacts, C spin components; nx, ny, nz spheres along the axes of the lattice, the last of them
the height. spin_axes : as an argument, the spin components, 0 to 2, along the first axis of an array (C, ...).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.lattice.grid import AXIS_NAMES, MOST_SITES, axis_numbers
from taichi_bearings.options import COUNT, SEED, SHAPE, finite_number
from taichi_bearings.plain_files import Json
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.bearing import vector_length as vector_length
from taichi_bearings.scene.disorder import Distribution, Draw, draw_coefficients
from taichi_bearings.scene.driving import Planes
from taichi_bearings.scene.exact_driving import ExactDriving
from taichi_bearings.scene.law import COULOMB, LAWS, Law, check_law, law_named
from taichi_bearings.words import html_table, shown

if TYPE_CHECKING:
    from taichi_bearings.scene.network import Network

LEAST_DIRECTION = 1e-100  # smallest part of a direction that is not 0, relative to its largest part
LEAST_COEFFICIENT, MOST_COEFFICIENT = 1e-15, 1e15  # limits of coefficients that are not 0
ALIKE = ("lattice", "network", "driving", "exact_driving")  # what all samples of a scene share


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Bearing):
    """A frustrated bearing on a lattice, or several samples of it that differ in their coefficients alone.

    Parameters
    ----------
    coefficients : tuple of arrays
        One array for each axis, x, y(, z), of shape (nx-1, ny, nz), (nx, ny-1, nz), (nx, ny, nz-1), in 2D (nx-1, ny),
        (nx, ny-1). Several samples have a leading axis R; for a single one it may be left out. The last axis of the
        lattice is the height, bottom first.
        Entry [i, j, k] belongs to the contact of sphere (i, j, k) with its upper neighbour along that axis: friction, a
        pure number, or damping of the viscous law, force * time/length. Numbers are from 1e-15 to 1e15, or 0 where
        spheres do not touch.
    law : str or Law
        "coulomb", "viscous" or "coulomb-viscous".
    spin_top, spin_bottom : float
        Imposed spins of the top and the bottom plane, 1/time; the spin of each sphere has the sign of its sublattice.
    direction : sequence of float
        Axis of the imposed spins in 3D, of any length but 0; ignored in 2D, where spins point along z.
    normal_force : float
        Force at every contact, for laws with friction.
    radius : float
        Radius of the spheres, length.
    seeds : sequence of int
        Seed of each sample, for the record and for random initial spins. Default: 0, 1, ...
    viscosity : tuple of arrays
        Second coefficient, of the law "coulomb-viscous", force * time/length, in the layout of `coefficients`.
    top, bottom : sequence of float, optional
        Bearing states (A_x, A_y, A_z, C) that are imposed instead of spins, in 2D one number: the staggered spin is A +
        C x, with x from the centre of sphere (0, 0, 0). A is in 1/time; C, 1/(time length), may be left out. If only
        one of the two is given, the other is 0.
    periodic : sequence of str
        Names of the axes that close on themselves, ("x",), ("y",) or both, not the height. Along such an axis n is even
        and the array has n entries: entry [i] belongs to the contact of i with i + 1 mod n.

    Attributes
    ----------
    drawn : mapping
        Distributions that the coefficients were drawn from with the seeds, by the name of the option of `bearings run`;
        empty for coefficients that are given.
    file : str
        Name of the file that the coefficients were read from, if any.

    Raises
    ------
    InputError
        For values that make no scene: one sentence that names the value.

    Examples
    --------
    >>> import numpy as np
    >>> import taichi_bearings as tb
    >>> tb.Scene((np.full((3, 5), 0.2), np.full((4, 4), 0.5)), spin_bottom=0.1)
    <Scene 4x5 coulomb, coefficients given, top 1, bottom 0.1>
    """

    coefficients: tuple[np.ndarray, ...]
    law: Law = COULOMB
    spin_top: float = 1.0
    spin_bottom: float = 0.0
    direction: tuple[float, float, float] = (1.0, 1.0, 0.0)
    normal_force: float = 50.0
    radius: float = 0.5
    seeds: tuple[int, ...] = ()
    viscosity: tuple[np.ndarray, ...] = ()
    top: tuple[float, ...] | None = None
    bottom: tuple[float, ...] | None = None
    periodic: tuple[str, ...] = ()
    drawn: Mapping[str, str] = field(init=False, default_factory=dict)
    file: str = field(init=False, default="")
    DRAWN: ClassVar = ("distribution", "viscosity")
    BY_SPINS: ClassVar = ("spin_top", "spin_bottom", "direction")
    PARAMETERS: ClassVar = (*BY_SPINS, "top", "bottom", "periodic", "normal_force", "radius")  # settings of a run too

    @classmethod
    def random(
        cls, shape: Sequence[int], seed: int = 0, distribution: str | Draw = "uniform:0.1,1.0",
        law: str | Law = COULOMB, spin_top: float = 1.0, spin_bottom: float = 0.0,
        direction: tuple[float, float, float] = (1.0, 1.0, 0.0), **others: Any,
    ) -> "Scene":  # fmt: skip
        """Return a scene whose coefficients are drawn from its seed: the same on any machine (those of `lognormal` and
        `power-law` but for rounding).

        Parameters
        ----------
        shape : sequence of int
            Spheres along each axis, (nx, ny) or (nx, ny, nz), height last.
        seed : int
            Seed of the first sample; the others have seed + 1, seed + 2, ...
        distribution : str or callable
            "uniform:low,high", "lognormal:median,sigma", "power-law:low,high,exponent", "bimodal:low,high,fraction" or
            "constant:value", or a function (rng, shape) -> array of coefficients.
        law, spin_top, spin_bottom, direction
            Contact law, imposed spins of both planes, 1/time, and the axis of these spins, as of :class:`Scene`.
        **others
            `replicas`, the number of samples; `viscosity`, the distribution of viscosities; and, as of :class:`Scene`,
            `normal_force`, `radius`, `periodic`, `top` and `bottom`.

        Returns
        -------
        Scene
            The scene, with all samples.

        Raises
        ------
        InputError
            For values that make no scene.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Scene.random((4, 5), seed=3)
        <Scene 4x5 coulomb, seed 3, top 1, bottom 0>
        """
        seed, replicas = SEED.named("seed", seed), COUNT.named("replicas", others.pop("replicas", 1))
        given = {"spin_top": spin_top, "spin_bottom": spin_bottom, "direction": direction, **others}
        return cls.of_seeds(shape, range(seed, seed + replicas), distribution, law, **given)

    @classmethod
    def of_seeds(
        cls, shape: Sequence[int], seeds: Sequence[int], distribution: str | Draw = "uniform:0.1,1.0",
        law: str | Law = COULOMB, **others: Any,
    ) -> "Scene":  # fmt: skip
        """Return a scene with one sample for each seed: the same samples that :meth:`random` gives for each alone.

        Parameters
        ----------
        shape : sequence of int
            Spheres along each axis, (nx, ny) or (nx, ny, nz), height last.
        seeds : sequence of int
            The seed of each sample.
        distribution : str or callable
            Distribution of the coefficients, as of :meth:`random`.
        law : str or Law
            Contact law.
        **others
            `viscosity`, the distribution of viscosities; and, as of :class:`Scene`, `spin_top`, `spin_bottom`,
            `direction`, `normal_force`, `radius`, `periodic`, `top` and `bottom`.

        Returns
        -------
        Scene
            The scene, with all samples.

        Raises
        ------
        InputError
            For values that make no scene.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Scene.of_seeds((4, 5), seeds=(3, 8)).seeds
        (3, 8)
        """
        law, replicas = law_named(law), len(seeds)
        if (viscosity := others.pop("viscosity", None)) is not None and len(law.quantities) == 1:
            laws = " or ".join(name for name, other in LAWS.items() if len(other.quantities) > 1)
            raise InputError(f"viscosity is {shown(viscosity)}, but the law {law} does not use it; it needs law {laws}")
        others["periodic"] = periodic_axes(others.get("periodic", ()))
        radius = finite_number("radius", others.get("radius", cls.radius))
        lattice = Lattice(SHAPE.named("shape", shape), radius, axis_numbers(others["periodic"]))
        if replicas > (most := MOST_SITES // 8 // lattice.sites):
            raise InputError(f"replicas is {replicas}; with this shape it must be at most {most} (32-bit indices)")
        others["seeds"] = _seeds(seeds)
        # texts or functions from which friction and, if the law has it, viscosity are drawn
        sources = dict(zip(cls.DRAWN, (distribution, viscosity or "uniform:0.1,1.0"), strict=True))
        values = [source if callable(source) else Distribution.parse(source) for source in sources.values()]
        given = values[: len(law.quantities)]
        found = [_drawn(lattice, value, others["seeds"], bool(second)) for second, value in enumerate(given)]
        if len(found) > 1:
            others["viscosity"] = found[1]
        texts = {name: source for name, source in sources.items() if isinstance(source, str)}
        return cls(found[0], law, **others).drawn_from(texts if len(texts) == len(sources) else {})

    def drawn_from(self, distributions: Mapping[str, str]) -> "Scene":
        """Record the distributions from which the coefficients were drawn, and return this scene.

        distributions : the distributions by the name of the option of `bearings run`; an empty mapping for coefficients
            that were not drawn. Copies of the scene with other values do not inherit the record.
        """
        object.__setattr__(self, "drawn", distributions)
        return self

    def read_from(self, file: str) -> "Scene":
        """Store the name of the file from which the coefficients were read, and return this scene."""
        object.__setattr__(self, "file", file)
        return self

    @property
    def source(self) -> str:
        """Where the coefficients come from, in words for a title: seeds, a file, or "coefficients given"."""
        if self.drawn:
            return f"seed {self.seeds[0]}" if self.replicas == 1 else f"seeds {self.seeds[0]} to {self.seeds[-1]}"
        return f"coefficients of {self.file}" if self.file else "coefficients given"

    def __post_init__(self) -> None:
        """Check all fields and store them in their final form, arrays as read-only copies; raise InputError for values
        that make no scene.
        """
        # law, numbers, driving and periodic axes
        object.__setattr__(self, "law", law_named(self.law))
        for name in ("spin_top", "spin_bottom", "normal_force", "radius"):
            object.__setattr__(self, name, finite_number(name, getattr(self, name)))
        if self.normal_force <= 0:
            raise InputError(f"normal_force is {self.normal_force}; it must be positive")
        object.__setattr__(self, "direction", imposed_direction(self.direction))
        object.__setattr__(self, "periodic", periodic_axes(self.periodic))
        self._read_states()
        # coefficients, whose shapes give the lattice and the number of samples
        object.__setattr__(self, "coefficients", _arrays("coefficients", self.coefficients))
        object.__setattr__(self, "viscosity", _arrays("viscosities", self.viscosity))
        if bool(self.viscosity) != (len(self.law.quantities) > 1):
            raise InputError(
                f"law is {self.law}, which has {len(self.law.quantities)} coefficients a contact; "
                f"viscosities {'must not' if self.viscosity else 'must'} be given beside the coefficients"
            )
        if len(self.coefficients) not in (2, 3):
            raise InputError(
                f"coefficients are {len(self.coefficients)} arrays; there must be one for each axis, two or three"
            )
        first, dimension = self.coefficients[0].shape, len(self.coefficients)
        if not dimension <= len(first) <= dimension + 1:
            raise InputError(
                f"coefficients along x have shape {first}; in {dimension}D they must have {dimension} axes, or one "
                "more for several samples"
            )
        samples = first[0] if len(first) > dimension else 1
        object.__setattr__(self, "seeds", _seeds(self.seeds) or tuple(range(samples)))
        # their values: some contact must act, and friction and viscosity must be absent together
        for kind, coefficients in (("coefficients", self.coefficients), ("viscosities", self.viscosity)):
            self._check(kind, coefficients)
        if self.idle.all(axis=1).any():
            raise InputError("coefficients are 0 at all contacts that could slip; at least one must be positive")
        for name, held, flowing in zip(AXIS_NAMES, self.coefficients, self.viscosity, strict=False):
            if ((held == 0) != (flowing == 0)).any():
                raise InputError(
                    f"along {name} a contact has friction without viscosity or viscosity without friction; "
                    "both must be positive, or both 0 for a contact that is absent"
                )
        if not self.law.is_sum:
            check_law(self.law, self.material, self.lattice.radius * (self.jump or 1.0))

    def _read_states(self) -> None:
        """Check `top` and `bottom`, the bearing states of the planes, if one is given, and store both as tuples of 1
        (2D) or 4 numbers.

        Raises InputError if spins are given, too.
        """
        if self.top is None and self.bottom is None:
            return
        for name in self.BY_SPINS:
            if getattr(self, name) != getattr(type(self), name):
                raise InputError(
                    f"{name} is {getattr(self, name)}, but the states top or bottom replace it; leave {name} out, or "
                    "top and bottom"
                )
        dimension = len(self.coefficients)
        for name in ("top", "bottom"):
            given = getattr(self, name)
            object.__setattr__(self, name, bearing_state(name, (0.0,) if given is None else given, dimension))

    def _fits_exchanged(self, coefficients: tuple[np.ndarray, ...]) -> bool:
        """Return True if the coefficients would fit a lattice without periodic axes if the arrays of x and y were
        exchanged.

        coefficients : for each axis an array of the contacts along it, with a leading axis of samples if there are
            several.
        """
        dimension = len(coefficients)
        shapes = [list(values.shape[-dimension:]) for values in (coefficients[1], coefficients[0], *coefficients[2:])]
        if any(len(shape) != dimension for shape in shapes):
            return False
        sites = [[n + (axis == other) for other, n in enumerate(shape)] for axis, shape in enumerate(shapes)]
        return all(shape == sites[0] for shape in sites)

    def _check(self, kind: str, coefficients: tuple[np.ndarray, ...]) -> None:
        """Raise InputError if coefficients have a wrong shape or a value out of range.

        kind : "coefficients" or "viscosities", for messages.
        coefficients : one array for each axis, with a leading axis of samples if there are several.
        """
        for axis, values in enumerate(coefficients):
            name, one = AXIS_NAMES[axis], self.lattice.contact_shape(axis)
            if values.shape != (len(self.seeds), *one) and (values.shape != one or self.replicas > 1):
                expected = one if self.replicas == 1 else (self.replicas, *one)
                hint = "; x and y may be exchanged" if self._fits_exchanged(coefficients) else ""
                raise InputError(f"{kind} along {name} have shape {values.shape}; this lattice needs {expected}{hint}")
            bad = ~((values == 0) | (values >= LEAST_COEFFICIENT) & (values <= MOST_COEFFICIENT))
            if bad.any():
                where = tuple(int(i) for i in np.argwhere(bad)[0])
                word = {"coefficients": "coefficient", "viscosities": "viscosity"}[kind]
                raise InputError(
                    f"{word} {values[where]} at {list(where[-len(one) :])} along {name} is not allowed; "
                    f"every {word} must be a number from 1e-15 to 1e15, or 0 for a contact that is absent"
                )

    def __repr__(self) -> str:
        """Return one line with shape, law, source of the coefficients, and what is imposed on top and bottom."""
        shape = "x".join(map(str, self.lattice.shape))
        seeds = f"{self.replicas} samples" if self.replicas > 1 else self.source
        top, bottom = (f"{spin:g}" for spin in self.imposed) if self.top is None else (self.top, self.bottom)
        return f"<Scene {shape} {self.law}, {seeds}, top {top}, bottom {bottom}{self.periodic_in_words}>"

    def _repr_html_(self) -> str:
        """Return a table of the scene for notebooks."""
        names = [name for name in self.PARAMETERS if self.top is None or name not in self.BY_SPINS]
        given = [(name, value) for name in names if (value := getattr(self, name)) not in (None, ())]
        counts = [("spheres", self.lattice.sites), ("contacts", self.lattice.all_contacts)]
        drawn = [(name, words) for name, words in self.drawn.items() if name != "viscosity" or self.viscosity]
        return html_table(repr(self), [*counts, *drawn, *given])

    @property
    def periodic_in_words(self) -> str:
        """The words ", periodic along x and y", with the periodic axes, which end a list; empty if there are none."""
        return f", periodic along {' and '.join(self.periodic)}" if self.periodic else ""

    @cached_property
    def lattice(self) -> Lattice:
        """The lattice: its shape, the radius of the spheres, and the periodic axes."""
        along_x, closed = self.coefficients[0].shape[-len(self.coefficients) :], axis_numbers(self.periodic)
        return Lattice((along_x[0] + (0 not in closed), *along_x[1:]), self.radius, closed)

    @cached_property
    def network(self) -> "Network":
        """The spheres, their contacts, and which are driven; its arrays are made when they are asked for."""
        from taichi_bearings.scene.network import Network  # and with it SciPy, which takes a third of a second

        return Network.of(self.lattice)

    @cached_property
    def coefficient(self) -> np.ndarray:
        """(samples R, contacts E) first coefficient of the law at all contacts: friction, a pure number, or damping,
        force * time/length.
        """
        return self._of_contacts(self.coefficients)

    def _of_contacts(self, parts: tuple[np.ndarray, ...]) -> np.ndarray:
        """Return coefficients of all contacts as one array (samples R, contacts E).

        parts : one array for each axis, in the layout of `coefficients`.
        """
        values = self.lattice.flat(parts).reshape(self.replicas, -1)
        values.setflags(write=False)
        return values

    @cached_property
    def named_coefficients(self) -> dict[str, np.ndarray]:
        """The coefficients of the law, (samples R, contacts E) each, by name: "coefficient", and "viscosity" if the law
        has both.
        """
        beside = {"viscosity": self._of_contacts(self.viscosity)} if self.viscosity else {}
        return {"coefficient": self.coefficient, **beside}

    def drawn_again(self) -> Iterator[tuple[str, int, np.ndarray, float]]:
        """Yield the coefficients that the seeds give, as far as they are known to be drawn: the name of a coefficient
        as in files, the number of the sample, the coefficients (contacts E,), and by how much, relatively, they may
        differ between machines.
        """
        for second, name in enumerate(self.named_coefficients):
            if (words := self.drawn.get(self.DRAWN[second])) is None:
                continue
            source = Distribution.parse(words)
            for number, seed in enumerate(self.seeds):
                drawn = draw_coefficients(self.lattice, source, seed, bool(second))
                yield name, number, np.ravel(self.lattice.flat(drawn)), source.rounding

    def _as_samples(self, pick: int | slice, seeds: tuple[int, ...]) -> "Scene":
        """Return a copy with some of the samples.

        pick : number of one, or a slice.
        seeds : seeds of these samples.
        """
        found = object.__new__(Scene)
        vars(found).update({name: getattr(self, name) for name in (*(item.name for item in fields(self)), *ALIKE)})
        vars(found).update(
            coefficients=tuple(values[pick] for values in self.coefficients),
            viscosity=tuple(values[pick] for values in self.viscosity),
            seeds=seeds,
        )
        return found

    @cached_property
    def driving(self) -> Planes:
        """The states that are imposed on the two planes, with the conversion from laboratory spins to those that
        solvers store.
        """
        if self.top is not None and self.bottom is not None:
            return Planes.by_states(self.lattice, self.top, self.bottom)
        return Planes.by_spins(self.lattice, self.spin_top, self.spin_bottom, self.direction)

    @cached_property
    def exact_driving(self) -> ExactDriving:
        """What is imposed on the two planes, to 300 digits, as proofs need it."""
        if self.top is not None and self.bottom is not None:
            return ExactDriving.by_states(self.lattice, self.top, self.bottom)
        return ExactDriving.by_spins(self.lattice, self.spin_top, self.spin_bottom, self.direction)

    @property
    def imposed(self) -> tuple[float, float]:
        """The imposed spins of top and bottom, 1/time; where bearing states are imposed, their largest sizes on the two
        planes.
        """
        return self.driving.top_and_bottom

    @property
    def imposed_in_words(self) -> str:
        """What is imposed on the planes, in words that end a message: the direction of their spins, or their states."""
        if self.top is None:
            return f"direction is {list(self.direction)}"
        return f"top is {self.top}, bottom {self.bottom}"

    @property
    def facts(self) -> Json:
        """Shape, imposed spins, normal force and radius, by name."""
        top, bottom = self.imposed
        given = {"normal_force": self.normal_force, "radius": self.slip_radius}
        return {"shape": self.lattice.shape, "spin_top": top, "spin_bottom": bottom, **given}

    def with_top(self, strength: float) -> "Scene":
        """Return a copy whose top has its spin, or its bearing state, multiplied by a number.

        Parameters
        ----------
        strength : float
            The number.

        Returns
        -------
        Scene
            The copy.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Scene.random((4, 5), seed=3).with_top(2.0).spin_top
        2.0
        """
        if self.top is None:
            return replace(self, spin_top=strength * self.spin_top)
        return replace(self, top=tuple(strength * part for part in self.top))

    def with_friction_alone(self) -> "Scene":
        """Return a copy with friction but without viscosity."""
        return replace(self, law=COULOMB, viscosity=())

    def top_spin(self, spin_axes: tuple[int, ...]) -> np.ndarray:
        """Return the imposed spin of the top plane, (C, nx, ny), in 2D (C, nx), 1/time, in the form that solvers store:
        with signs that alternate between neighbours, and less the bearing state of the bottom.

        As the state of the bottom, in which no contact slips, is subtracted, slips keep their digits even if bottom and
        top are driven nearly alike (docs/equations.md, 1).

        spin_axes : numbers of the C components.
        """
        return self.driving.imposed_on_top(spin_axes)[0]


def _drawn(lattice: Lattice, source: Draw, seeds: tuple[int, ...], second: bool) -> tuple[np.ndarray, ...]:
    """Return coefficients drawn at random, one array for each axis, with a leading axis of samples if there are several
    seeds.

    lattice : lattice of the contacts.
    source : distribution, a function (rng, shape) -> array.
    second : True for the second coefficient of a law that has two, the viscosity.
    """
    parts = zip(*(draw_coefficients(lattice, source, seed, second) for seed in seeds), strict=True)
    return tuple(np.stack(part) if len(seeds) > 1 else part[0] for part in parts)


def imposed_direction(given: Any) -> tuple[float, float, float]:
    """Return the direction of the imposed spins as a tuple of three finite numbers, not all 0; raise InputError for
    anything else.

    given : what the user has passed.
    """
    try:
        parts = tuple(finite_number("direction", part) for part in given)
    except (TypeError, InputError):
        parts = ()
    sizes = np.abs(parts)
    if len(parts) != 3 or not sizes.any():
        given = list(given) if isinstance(given, tuple) else given
        raise InputError(f"direction is {shown(given)}; it must be three finite numbers, not all zero")
    if ((sizes > 0) & (sizes / sizes.max() < LEAST_DIRECTION)).any():
        raise InputError(
            f"direction is {list(parts)}; each part must be 0, or at least {LEAST_DIRECTION:g} times the largest"
        )
    return parts


def bearing_state(name: str, given: object, dimension: int) -> tuple[float, ...]:
    """Return the state of a plane as (A_x, A_y, A_z, C), in 2D as (A_z,); raise InputError for anything else.

    name : "top" or "bottom", for messages.
    given : three or four numbers, in 2D one; a single 0 is the state at rest.
    dimension : dimension of the lattice, 2 or 3.
    """
    try:
        parts = tuple(finite_number(name, part) for part in (given if isinstance(given, Iterable) else (given,)))
    except (TypeError, InputError):
        parts = ()
    if dimension == 2 and len(parts) == 1:
        return parts
    if dimension == 3 and (len(parts) in (3, 4) or parts == (0.0,)):
        return (*parts, 0.0) if len(parts) == 3 else parts if len(parts) == 4 else (0.0,) * 4
    needed = "one number, the spin about z" if dimension == 2 else "A_x, A_y, A_z, and C if it is not 0"
    raise InputError(f"{name} is {shown(given)}; the motion of a driven plane must be given by {needed}")


def periodic_axes(given: Any, allowed: tuple[str, ...] = AXIS_NAMES[:2]) -> tuple[str, ...]:
    """Return the names of the periodic axes, in the order of the axes; raise InputError for names that are not allowed.

    given : one name, a list of several, or a text such as "x,y".
    allowed : names that periodic axes may have.
    """
    parts = (given.split(",") if given else ()) if isinstance(given, str) else given
    is_one = not isinstance(parts, Iterable) or (isinstance(parts, np.ndarray) and parts.ndim == 0)
    parts = (parts,) if is_one else tuple(parts)
    if any(part not in allowed for part in parts) or len(set(parts)) < len(parts):
        names = f"names of axes that close on themselves, among {', '.join(allowed)}, each once"
        raise InputError(f"periodic is {shown(given)}; it must be {names}")
    return tuple(name for name in AXIS_NAMES if name in parts)


def _seeds(given: Any) -> tuple[int, ...]:
    """Return the seeds of the samples as a tuple of integers; raise InputError for anything else.

    given : what the user has passed.
    """
    try:
        return tuple(SEED.read(seed) for seed in given)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"seeds are {shown(given)}; each must be {SEED.allowed}") from None


def _arrays(kind: str, given: object) -> tuple[np.ndarray, ...]:
    """Return coefficients of the user as read-only copies, one array for each axis.

    kind : "coefficients" or "viscosities", for messages.
    given : the arrays.
    """
    is_one = isinstance(given, str) or (isinstance(given, np.ndarray) and given.ndim == 0)
    if is_one or not isinstance(given, Iterable):
        raise InputError(f"{kind} are {shown(given)}; they must be arrays, one for each axis, two or three")
    found = tuple(given)
    if len(found) > len(AXIS_NAMES):
        raise InputError(f"{kind} are {len(found)} arrays; there must be one for each axis, two or three")
    return tuple(own_array(f"{kind} along {name}", values) for name, values in zip(AXIS_NAMES, found, strict=False))


def of_lattice(bearing: Bearing) -> Scene:
    """Return the bearing itself, typed as a scene on a lattice; it must be one."""
    assert isinstance(bearing, Scene)
    return bearing
