"""Packings: spheres or discs at fixed places, the contacts between them, and which of them are driven.

With u = R omega (radius times spin) the slip at a contact with unit normal n, from the first sphere i to the second
sphere j, is -(u_i + u_j) x n. Radii drop out, so a packing from a simulation, a space-filling bearing and a lattice are
the same convex problem.

Letters: N spheres, E contacts, D = 2 or 3 dimensions, C spin components (1 of discs, 3 of spheres), R samples.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.errors import FileError, InputError, WriteError
from taichi_bearings.numerics.double_double import Pair, divide, exactly
from taichi_bearings.options import SEED, SHAPE, finite_number
from taichi_bearings.plain_files import Json, writing
from taichi_bearings.read_only import read_only
from taichi_bearings.scene import checks, geometry
from taichi_bearings.scene.array_files import LackingArrayError, TextFileError, read_arrays
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.disorder import Distribution, Draw
from taichi_bearings.scene.driving import Driving
from taichi_bearings.scene.generators import random_packing, space_filling
from taichi_bearings.scene.generators.lattices import KINDS, Built, built, driven_bodies
from taichi_bearings.scene.law import COULOMB, LAWS, Law, law_named
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.readers.found import TOLERANCE, Lengths, Sides, completed, contact_summary, from_centers
from taichi_bearings.scene.readers.lammps import Asked, read_dumps
from taichi_bearings.scene.readers.tables import read_contacts, read_spheres
from taichi_bearings.scene.scene import bearing_state, imposed_direction
from taichi_bearings.text_lines import is_table
from taichi_bearings.words import html_table, meant, shown

# names of the arrays that a file of a packing must hold, and of those that it may hold
NEEDED, OPTIONAL = (
    ("center", "contact", "driven", "spin"),
    ("radius", "normal", "friction", "viscosity", "normal_force", "schematic"),
)
DISTRIBUTION = "uniform:0.1,1.0"  # of coefficients for which none is given
# fields that all samples of a packing share, and fields of which each sample has its own numbers
OF_ALL_SAMPLES = ("center", "contact", "driven", "spin", "radius", "normal", "law", "schematic")
OF_SAMPLES = ("friction", "viscosity", "normal_force")
SIDES_GIVEN = [item.name for item in fields(Sides)]  # arguments that say how the lowest and highest spheres turn


@dataclass(frozen=True, eq=False, repr=False)
class Packing(Bearing):
    """Spheres or discs that touch: the general bearing, of which a lattice is a special case.

    N is the number of spheres, E that of contacts, and D the dimension, 3 for spheres and 2 for discs. All arrays are
    copied and read-only.

    Parameters
    ----------
    center : (N, D) array
        Centres, length.
    contact : (E, 2) array of int
        The first and the second sphere of each contact, counted from 0.
    driven : (N,) array of int or bool
        -1 for a free sphere, else the number of the driven body that it belongs to; True drives a sphere as body 0.
    spin : (N, 3) array, in 2D (N,)
        Imposed spins of driven spheres in the laboratory frame, 1/time; those of free spheres are ignored. Driven
        spheres whose radius times spin differs by rounding alone have one surface speed, see ``driven_speed``.
    radius : float or (N,) array
        Radii, length.
    normal : (E, D) array, optional
        Unit vectors from the first to the second sphere, by default along the centres. They are needed for contacts
        across a periodic side, and for several contacts of the same two spheres.
    friction : (E,) array, optional
        First coefficient of the law at each contact: friction, a pure number, or damping of the law "viscous",
        force * time/length. It is 0 where nothing acts. By default it is drawn from `distribution`.
    viscosity : (E,) array or str or callable, optional
        Second coefficient, of the law "coulomb-viscous", force * time/length, or the distribution it is drawn from; by
        default "uniform:0.1,1.0".
    normal_force : float or (E,) array
        Normal forces, force.
    law : str or Law, optional
        "coulomb", "viscous" or "coulomb-viscous". Default: "coulomb", or "coulomb-viscous" with a viscosity.
    distribution : str or callable
        Where friction is drawn from: a text such as "uniform:0.1,1.0", or a function (rng, shape) -> array. Numbers are
        drawn in the order of the contacts.
    seed : int
        Seed of ``default_rng`` for friction; the viscosity takes ``default_rng([seed, 2])``.
    schematic : bool
        True for a network whose centres only say where it is drawn. Spheres of a contact then need not touch, and
        normals that are given are taken as they are.

    Raises
    ------
    InputError
        For arrays that make no packing: one sentence that names the value.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> places, contacts = [[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]]
    >>> tb.Packing(places, contacts, driven=[0, -1, 1], spin=[0, 0, 1], friction=[0.2, 0.5])
    <Packing of 3 discs, 2 contacts, 2 driven, coulomb>
    """

    center: np.ndarray
    contact: np.ndarray
    driven: np.ndarray
    spin: np.ndarray
    radius: Any = 0.5
    normal: np.ndarray | None = None
    friction: np.ndarray | None = None
    viscosity: Any = None
    normal_force: Any = 50.0
    law: Law = None  # type: ignore[assignment]  # the usual one
    distribution: str | Draw = DISTRIBUTION
    seed: int = 0
    schematic: bool = False
    normals_given: bool = field(init=False)
    seeds: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Check all fields, store them as read-only arrays, and find or draw what is not given; raise InputError for
        what makes no packing.
        """
        object.__setattr__(self, "normals_given", self.normal is not None)
        object.__setattr__(self, "schematic", bool(np.any(self.schematic)))
        put = self._put
        put("center", checks.places(self.center))
        put("contact", checks.pairs(self.contact, self.spheres))
        put("driven", checks.bodies(self.driven, self.spheres))
        put("spin", checks.spins(self.spin, self.spheres, self.dimension, self.driven >= 0))
        put("radius", checks.sizes("radius", self.radius, self.spheres, "sphere"))
        put("normal", self._checked_normals())
        checks.refuse_repeated(self)
        usual = "coulomb" if self.viscosity is None else "coulomb-viscous"
        put("law", law_named(usual if self.law is None else self.law))
        if not self.law.is_sum:
            known = ", ".join(name for name, law in LAWS.items() if law.is_sum)
            raise InputError(
                f"law is {self.law.name!r}; packings can have {known}; a law of your own works on lattices only"
            )
        put("normal_force", checks.pressing(self.normal_force, self.contacts))
        self._take_coefficients()

    def _checked_normals(self) -> np.ndarray:
        """Return the normals (contacts E, dimensions D), computed from the centres if none are given; raise InputError
        where given ones contradict the centres.
        """
        places = (self.center, self.contact, self.radius)
        if self.normal is None:
            normal = geometry.from_places(*places)
        else:
            normal, error = checks.normals(self.normal, self)
            normal = normal if self.schematic else geometry.agreed(*places, normal, error)
        normal.setflags(write=False)
        return normal

    def _put(self, name: str, value: object) -> None:
        """Set a field of this object. It is frozen, so this is done only while it is made.

        name, value : name and value of the field.
        """
        object.__setattr__(self, name, value)

    def _take_coefficients(self) -> None:
        """Check friction and viscosity, or draw them from the seed where none are given, and store both as
        arrays (contacts E,).
        """
        # friction is drawn from the seed itself, viscosity from [seed, 2]
        two = len(self.law.quantities) > 1
        if self.viscosity is not None and not two:
            raise InputError(f"viscosity is given, but the law {self.law} does not use it; it needs coulomb-viscous")
        seed = SEED.named("seed", self.seed)
        self._put("seeds", (seed,))
        usual: list[Any] = [("friction", seed, self.distribution), ("viscosity", [seed, 2], DISTRIBUTION)]
        for name, state, values in usual[: 1 + two]:
            given: Any = getattr(self, name)
            values = values if given is None else given
            if isinstance(values, str) or callable(values):
                draw = Distribution.parse(values) if isinstance(values, str) else values
                values = draw(np.random.default_rng(state), (self.contacts,))
            self._put(name, checks.sizes(name, values, self.contacts, "contact", may_vanish=True))

    @property
    def spheres(self) -> int:
        """Number N of spheres."""
        return len(self.center)

    @property
    def contacts(self) -> int:
        """Number E of contacts."""
        return len(self.contact)

    @property
    def imposed_in_words(self) -> str:
        """What is imposed, in words that end a message: how many driven bodies there are."""
        return f"driven bodies are {len(self.network.bodies)}"

    @property
    def facts(self) -> Json:
        """Numbers of spheres and of driven spheres, by name."""
        return {"spheres": self.spheres, "driven_spheres": int((~self.network.free).sum())}

    @cached_property
    def network(self) -> Network:
        """The spheres, their contacts, and which spheres are driven."""
        assert self.normal is not None
        return Network(self.center, np.asarray(self.radius), self.contact.T, self.normal, self.driven)

    @cached_property
    def driving(self) -> Driving:
        """The spins that are imposed on driven spheres."""
        return Driving(self.network, self.spin, self.acting)

    @property
    def dimension(self) -> int:
        """Number D of dimensions: 2 for discs, 3 for spheres."""
        found: int = self.center.shape[1]
        return found

    @property
    def named_coefficients(self) -> dict[str, np.ndarray]:
        """The coefficients of the law, (samples R, contacts E) each: `friction` under the name "coefficient", and
        "viscosity".
        """
        given = {"coefficient": self.friction, "viscosity": self.viscosity}
        return {name: np.reshape(v, (self.replicas, -1)) for name, v in given.items() if v is not None}

    def slip_speeds(self, spin: np.ndarray) -> np.ndarray:
        """Return the slip speed of each contact at spins of your own.

        Parameters
        ----------
        spin : (N, 3) array, in 2D (N,)
            Laboratory spins, 1/time.

        Returns
        -------
        (E,) array
            Slip speeds, length/time.

        Examples
        --------
        >>> import numpy as np
        >>> import taichi_bearings as tb
        >>> row = tb.Packing([[0, 0], [1, 0]], [[0, 1]], driven=[0, 1], spin=[1, 1], friction=[0.2])
        >>> row.slip_speeds(np.array([1.0, 1.0])), row.slip_speeds(np.array([1.0, -1.0]))
        (array([1.]), array([0.]))
        """
        return self.network.slips(spin.reshape(self.spheres, -1) * self.network.radius[:, None])

    def spins_of(self, u: Pair) -> Pair:
        """Return laboratory spins u / R, (spheres N, 3) of spheres or (N,) of discs, 1/time, in twice the precision.
        Driven spheres get exactly their imposed spins.

        u : surface speeds R omega, (N, components C), length/time, in twice the precision.
        """
        held, shape = self.is_driven, self.spin.shape
        spin, rest = (part.reshape(shape) for part in divide(u, exactly(self.network.radius[:, None])))
        spin[held], rest[held] = self.spin[held], 0.0
        return spin, rest

    def inertias(self, mass: float, inertia: float | None, density: ArrayLike | None = None) -> np.ndarray:
        """Return the moments of inertia of all spheres over their squared radii.

        Masses grow with the radius to the power of the dimension.

        Parameters
        ----------
        mass : float
            Mass of a sphere of the mean radius, used if neither of the others is given.
        inertia : float or None
            Moment of inertia of a sphere of the mean radius, mass * length^2.
        density : float or (N,) array, optional
            Mass / length^D.

        Returns
        -------
        (N,) array
            Moments of inertia over squared radii, mass.

        Raises
        ------
        InputError
            If both inertia and density are given.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.lattice("square", (2, 3)).inertias(mass=1.0, inertia=None)
        array([0.5, 0.5, 0.5, 0.5, 0.5, 0.5])
        """
        radius, shape = self.network.radius, 0.5 if self.dimension == 2 else 0.4
        if density is not None:
            if inertia is not None:
                raise InputError(f"inertia is {inertia:g} and density is given; give only one of the two")
            volume = np.pi * radius**2 if self.dimension == 2 else 4 / 3 * np.pi * radius**3
            found: np.ndarray = shape * volume * checks.sizes("density", density, self.spheres, "sphere")
            return found
        mean = radius.mean()
        found = (shape * mass if inertia is None else inertia / mean**2) * (radius / mean) ** self.dimension
        return found

    def as_stepped(self, spins: np.ndarray, at_rest: np.ndarray) -> "Packing":
        """Return a copy for methods that make steps. It has only the contacts that can slip, which are neither absent
        nor between driven spheres, and `jump` and `is_cut_off` are set.

        spins : radius * spin at the start, (components C, 1, spheres N), length/time. Their largest size becomes
            `jump`, the unit of speeds, if imposed spins do not differ.
        at_rest : (samples R,) mask of the samples for which a state without any slip is proven to exist; it becomes
            `is_cut_off`.
        """
        own = self.acting
        of = {name: None if (v := getattr(self, name)) is None else v[..., own] for name in OF_SAMPLES}
        found = self._with(contact=self.contact[own], normal=self.network.normal[own], **of)
        del vars(found)["network"]
        vars(found).update(jump=self.jump or float(np.abs(spins).max(initial=0.0)), is_cut_off=at_rest)
        return found

    def with_top(self, strength: float) -> "Packing":
        """Return a copy whose top, the driven body of the largest number, has its spins multiplied by a number.

        Parameters
        ----------
        strength : float
            The number.

        Returns
        -------
        Packing
            The copy.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> row = tb.Packing([[0, 0], [1, 0]], [[0, 1]], driven=[0, 1], spin=[1, 1], friction=[0.2])
        >>> row.with_top(3.0).spin
        array([1., 3.])
        """
        top = self.driving.is_top.reshape(-1, *(1,) * (self.spin.ndim - 1))
        return replace(self, spin=np.where(top, strength, 1.0) * self.spin)

    def with_friction_alone(self) -> "Packing":
        """Return a copy with friction but without viscosity."""
        return replace(self, law=COULOMB, viscosity=None)

    @classmethod
    def together(cls, samples: Sequence["Packing"]) -> "Packing":
        """Return one packing with several samples, made of packings that differ in their coefficients alone.

        Parameters
        ----------
        samples : sequence of Packing
            The packings, one sample each.

        Returns
        -------
        Packing
            Its friction, viscosity and normal force have a leading axis of samples.

        Raises
        ------
        InputError
            If the packings differ in anything else.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.together([tb.Packing.lattice("square", (3, 4), seed=seed) for seed in (1, 2)]).seeds
        (1, 2)
        """
        first = samples[0]
        if len(samples) == 1:
            return first
        for name in OF_ALL_SAMPLES:
            if not all(np.array_equal(getattr(first, name), getattr(one, name)) for one in samples):
                raise InputError(f"{name} differs between samples; in one run only coefficients may differ")
        changes = {name: [getattr(one, name) for one in samples] for name in OF_SAMPLES}
        stacked = {name: None if of[0] is None else read_only(np.stack(of)) for name, of in changes.items()}
        return first._with(**stacked, seeds=tuple(one.seed for one in samples))

    def _as_samples(self, pick: int | slice, seeds: tuple[int, ...]) -> "Packing":
        """Return a copy with some of the samples.

        pick : number of one sample, or a slice of several.
        seeds : seeds of these samples.
        """
        given = {name: getattr(self, name) for name in OF_SAMPLES}
        some = {name: None if values is None else values[pick] for name, values in given.items()}
        return self._with(**some, seed=seeds[0], seeds=seeds)

    def _with(self, **changes: object) -> "Packing":
        """Return a copy in which some fields have other values, given by name; these are not checked. Both objects
        share the network.
        """
        other = object.__new__(type(self))
        vars(other).update({item.name: getattr(self, item.name) for item in fields(self)} | changes)
        vars(other)["network"] = self.network
        return other

    def __repr__(self) -> str:
        """Return one line with the numbers of spheres, contacts and driven spheres, and the law."""
        what = "discs" if self.dimension == 2 else "spheres"
        held = int((self.driven >= 0).sum())
        return f"<Packing of {self.spheres:,} {what}, {self.contacts:,} contacts, {held:,} driven, {self.law}>"

    def _repr_html_(self) -> str:
        """Return a table of the packing for notebooks."""
        bodies = len(np.unique(self.driven[self.driven >= 0]))
        given = {name: getattr(self, name) for name in ("radius", "friction", "viscosity", "normal_force")}
        ranges = [
            (name, f"{np.min(v):g} to {np.max(v):g}") for name, v in given.items() if v is not None and np.size(v)
        ]
        return html_table(repr(self), [("driven_bodies", bodies), *ranges])

    @classmethod
    def lattice(
        cls, kind: str, cells: object, periodic: str | Sequence[str] = (), seed: int = 0, **others: Any
    ) -> "Packing":
        """Return the spheres of a lattice with two driven bodies: 0, the bottom, and 1, the top.

        Parameters
        ----------
        kind : str
            "square", "triangular" or "honeycomb", of discs, or "cubic", "bcc", "fcc", "diamond" or "hcp".
        cells : sequence of int
            Number of rectangular cells along each axis. A cell of these lattices, in the order above, has 1, 2, 4, 1,
            2, 4, 8 and 4 spheres.
        periodic : sequence of str
            Names of axes that close on themselves, such as ("x", "y"). With the last axis among them nothing is driven.
        seed : int
            Seed of the coefficients.
        **others
            `radius`, one for all, length. `spin_top` and `spin_bottom` (1/time; 1 and 0) about `direction` (of
            spheres; (1, 1, 0)), times the sign of the sublattice where there are two; or in their place the bearing
            states `top` and `bottom`, (A_x, A_y, A_z, C) as of :class:`Scene`. `driven`, which spheres the bodies are:
            "planes", the lowest and the highest layer along the last axis; "walls", those along x; or "shaft:r", body
            0 at all ends of x and y, and body 1 within r diameters of the middle (of spheres, of the vertical axis
            through it). Also other fields of this class.

        Returns
        -------
        Packing
            The spheres in the order of their cells, with random coefficients.

        Raises
        ------
        InputError
            For arguments that make no packing: one sentence that names the value.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.lattice("triangular", (3, 2), seed=1)
        <Packing of 12 discs, 23 contacts, 6 driven, coulomb>
        """
        if not isinstance(kind, str) or kind not in KINDS:
            raise InputError(f"kind is {shown(kind)}; allowed are {', '.join(KINDS)}{meant(kind, KINDS)}")
        place, contact, normal, sign, closed = built(kind, SHAPE.named("cells", cells), periodic)
        body = driven_bodies(place, closed, others.pop("driven", "planes"))
        return cls._between_sides(1.0, (place, contact, normal, sign, body), 2.0, seed, others)

    @classmethod
    def random(
        cls, spheres: int, dimension: int = 3, ratio: float = 1.4, large: float = 0.5, width: float | None = None,
        seed: int = 0, **others: object,
    ) -> "Packing":  # fmt: skip
        """Return spheres of two sizes that were put one by one into the lowest pocket on a floor of spheres.

        Sides are periodic. Each sphere touches D earlier ones, to rounding, so that there are just as many contacts as
        hold it. Driven are the floor, as body 0, and the spheres at the surface, as body 1.

        Parameters
        ----------
        spheres : int
            Number of spheres.
        dimension : int
            3, or 2 for discs.
        ratio : float
            Radius of the large spheres over that of the small ones.
        large : float
            Fraction of the spheres that are large.
        width : float, optional
            Width of the box in diameters of small spheres; by default about its height.
        seed : int
            Seed of places and coefficients.
        **others
            As of :meth:`lattice`, without `driven`; `radius` is that of the small spheres.

        Returns
        -------
        Packing
            The spheres in the order in which they were put, with random coefficients.

        Raises
        ------
        InputError
            For arguments that make no packing: one sentence that names the value.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.random(50, dimension=2, seed=1).spheres
        50
        """
        seed = SEED.named("seed", seed)
        radius, found = random_packing.built(spheres, dimension, ratio, large, width, np.random.default_rng([seed, 3]))
        return cls._between_sides(radius, found, 1.0, seed, others)

    @classmethod
    def space_filling(
        cls, m: int = 0, n: int = 0, least_radius: float = 0.01, periods: int = 1, seed: int = 0, **others: object
    ) -> "Packing":
        """Return discs that fill a strip of height 1: the first family of Herrmann, Mantica and Bessis (1990).

        No loop of contacts is odd, so neighbours can turn against each other everywhere. Driven are the discs on the
        lower line, as body 0, and those on the upper line, as body 1. The strip is periodic along x.

        Parameters
        ----------
        m, n : int
            Numbers that pick a bearing of the family: m + 3 discs touch both the upper line and the large disc on the
            lower one, n + 3 the lower line and the large disc on the upper one (the opposite line counts as a disc).
        least_radius : float
            Radius of the smallest discs that are kept, length.
        periods : int
            Number of periods of the strip along x.
        seed : int
            Seed of the coefficients.
        **others
            `spin_top` and `spin_bottom`: here surface speeds, length/time, 1 and 0, times the sign of the sublattice.
            Also other fields of this class.

        Returns
        -------
        Packing
            The discs, large ones first, with random coefficients.

        Raises
        ------
        InputError
            For arguments that make no packing: one sentence that names the value.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.space_filling(least_radius=0.05).dimension
        2
        """
        radius, found = space_filling.built(m, n, least_radius, periods)
        if "radius" in others:
            raise InputError(
                "radius is given, but the height of a space-filling bearing is 1, which fixes all radii; leave it out"
            )
        return cls._between_sides(radius, found, 1.0, seed, {"radius": 1.0, "at_surface": True} | others)

    @classmethod
    def from_lammps(cls, atoms: str | Path, contacts: str | Path, columns: Sequence[str], **others: Any) -> "Packing":
        """Return the packing in two dumps of LAMMPS or LIGGGHTS at the same timestep.

        Parameters
        ----------
        atoms : str or Path
            A `dump custom` of the atoms.
        contacts : str or Path
            A `dump local` of their contacts.
        columns : sequence of str
            Names of columns of `contacts`: the ids of both atoms, then none, or the normal force, or the components of
            the force on the first atom, as :func:`taichi_bearings.scene.readers.lammps.read_dumps` describes.
        **others
            Fields of :class:`taichi_bearings.scene.readers.lammps.Asked`, such as `step` and `driven_types`, and fields
            of this class that dumps do not hold.

        Returns
        -------
        Packing
            The atoms in the order of their ids.

        Raises
        ------
        FileError
            For a dump that cannot be read.
        InputError
            For what makes no packing.
        """
        known = {item.name for item in fields(Asked)}
        asked = Asked(**{name: others.pop(name) for name in list(others) if name in known})
        return cls(**{**read_dumps(Path(atoms), Path(contacts), columns, asked), **others})

    @classmethod
    def _between_sides(cls, size: float | np.ndarray, found: Built, unit: float, seed: int, others: Json) -> "Packing":
        """Return the packing of spheres that a generator has placed, with two driven bodies, bottom and top.

        size : radius of each sphere, (spheres N,) or one number, divided by `radius`.
        found : places (N, dimensions D), contacts (contacts E, 2), normals (E, D), signs of the sublattice (N,), and
            driven bodies (N,).
        unit : number that, times `radius`, turns the places into lengths.
        seed : seed of the coefficients.
        others : arguments of the caller by name: `radius`, length; imposed spins or states; `at_surface`, True if these
            are surface speeds; and fields of the packing. All but the fields are removed.

        Raises InputError for an argument that is unknown.
        """
        radius = finite_number("radius", others.pop("radius", 0.5))
        place, contact, normal, sign, body = found
        at_surface = others.pop("at_surface", False)
        state = _states(others, place.shape[1])[np.maximum(body, 0)]  # (N, 4)
        spin = sign[:, None] * (body >= 0)[:, None] * (state[:, :3] + state[:, 3:] * unit * radius * _in_space(place))
        spin = spin if place.shape[1] == 3 else spin[:, 2]
        known = {f.name for f in fields(cls) if f.init} - {"center", "contact", "driven", "spin", "normal", "radius"}
        if strange := [name for name in others if name not in known]:
            of_sides = {"radius", "spin_bottom", "spin_top", "direction", "bottom", "top"}
            allowed = ", ".join(sorted(known | of_sides))
            raise InputError(f"unknown argument {strange[0]!r}{meant(strange[0], known)}; allowed are {allowed}")
        spin = spin / size if at_surface else spin
        return cls(unit * radius * place, contact, body, spin, radius * size, normal, seed=seed, **others)

    @classmethod
    def from_centers(
        cls, center: ArrayLike, radius: ArrayLike = 0.5, tolerance: float = TOLERANCE, driven: ArrayLike | None = None,
        spin: ArrayLike | None = None, periodic: Lengths = None, **others: Any,
    ) -> "Packing":  # fmt: skip
        """Return spheres or discs that are in contact wherever they touch.

        Two of them touch where ``abs(d - R_i - R_j) <= tolerance * (R_i + R_j)``, with d between their centres.
        A log line says how many contacts were found; it is a warning if some spheres touch nothing.

        Parameters
        ----------
        center : (N, D) array
            Centres, length.
        radius : float or (N,) array
            Radii, length.
        tolerance : float
            Relative gap or overlap at which spheres still touch.
        driven, spin : array, optional
            As of this class. Without `driven`, spheres within `tolerance` radii of the lowest one along the last axis
            are driven as body 0, the bottom, and those of the highest one as body 1, the top.
        periodic : sequence of float, optional
            Length of the periodic side along each axis, 0 for other axes, as in (4.0, 4.0, 0).
        **others
            Without `spin`: `spin_bottom` and `spin_top` (0 and 1, 1/time) and, of spheres, `direction` ((1, 1, 0)).
            Also other fields of this class.

        Returns
        -------
        Packing
            The spheres in the order given, with the contacts that were found.

        Raises
        ------
        InputError
            For two spheres that overlap by more than the tolerance, and for what makes no packing.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.Packing.from_centers([[0, 0], [1, 0], [0.5, 0.75**0.5]], seed=1)
        <Packing of 3 discs, 3 contacts, 3 driven, coulomb>
        """
        sides = Sides(**{name: others.pop(name) for name in SIDES_GIVEN if name in others})
        given = {name: values for name, values in (("driven", driven), ("spin", spin)) if values is not None}
        found = from_centers(center, radius, tolerance, given, sides, periodic)
        sentence, alone = contact_summary(found["contact"], len(found["center"]), tolerance)
        logging.getLogger(__name__).log(logging.WARNING if alone else logging.INFO, "bearings: %s", sentence)
        return cls(**{**found, **others})

    @classmethod
    def load(cls, path: str | Path, contacts: str | Path | None = None, **others: Any) -> "Packing":
        """Return the packing in a file.

        Parameters
        ----------
        path : str or Path
            An npz or HDF5 file with arrays named as the fields, in HDF5 also below ``packing``; or a table (.csv)
            of centres, whose contacts are found as by :meth:`from_centers`.
        contacts : str or Path, optional
            Beside a table of centres, a table of contacts.
        **others
            Fields that the file does not hold, such as `law`, `seed`, or one `radius` for all; with a table also the
            arguments of :meth:`from_centers`.

        Returns
        -------
        Packing
            The packing, with random coefficients where the file has none.

        Raises
        ------
        FileError
            For what cannot be read.
        InputError
            For what makes no packing.

        Examples
        --------
        >>> import tempfile
        >>> import taichi_bearings as tb
        >>> discs = tb.Packing.lattice("square", (3, 4))
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tb.Packing.load(discs.save(folder + "/mine.npz"))
        <Packing of 12 discs, 17 contacts, 6 driven, coulomb>
        """
        found = cls.read(path, contacts)
        if not is_table(path):
            return cls(**{**found, **others})
        sides = Sides(**{name: others.pop(name) for name in SIDES_GIVEN if name in others})
        of = {"radius": others.pop("radius", 0.5)} if "radius" not in found else {}
        share, periodic = others.pop("tolerance", TOLERANCE), others.pop("periodic", None)
        return cls(**{**completed({**of, **found}, share, sides, periodic), **others})

    @staticmethod
    def read(path: str | Path, contacts: str | Path | None = None) -> dict[str, np.ndarray]:
        """Return the arrays of the file of a packing by name, without those that it lacks.

        Parameters
        ----------
        path : str or Path
            An npz or HDF5 file with arrays named as the fields, or a table (.csv) of centres.
        contacts : str or Path, optional
            Beside a table of centres, a table of contacts.

        Returns
        -------
        dict
            Arrays by name: center, contact, driven, spin and others.

        Raises
        ------
        FileError
            For what cannot be read.

        Examples
        --------
        >>> import tempfile
        >>> import taichi_bearings as tb
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = tb.Packing.lattice("square", (3, 4)).save(folder + "/mine.npz")
        ...     sorted(tb.Packing.read(path))
        ['center', 'contact', 'driven', 'friction', 'normal', 'normal_force', 'radius', 'spin']
        """
        path = Path(path)
        if is_table(path):
            found = read_spheres(path)
            ids = found.pop("id", None)
            return found | ({} if contacts is None else read_contacts(Path(contacts), ids, len(found["center"])))
        if contacts is not None:
            raise InputError(
                f"contacts is {shown(str(contacts))}, but {path} already holds contacts; only a table "
                "(.csv) takes them from another file"
            )
        try:
            found = read_arrays(path, NEEDED, OPTIONAL)
        except TextFileError:
            raise FileError(
                f"{path} is a text file, but its name does not end in .csv; a table of centres is a .csv file "
                "whose first line names its columns, such as x,y,z,radius"
            ) from None
        except LackingArrayError:
            if path.suffix == ".npz":
                raise
            group = [f"packing/{name}" for name in (*NEEDED, *OPTIONAL)]
            stored = read_arrays(path, group[: len(NEEDED)], group[len(NEEDED) :])
            found = {name.rpartition("/")[2]: values for name, values in stored.items()}
        return checks.columns_as_vectors(found)

    def save(self, path: str | Path) -> Path:
        """Write the arrays of the packing into a new file, and return its path.

        Parameters
        ----------
        path : str or Path
            Of a file that does not exist, with the ending .npz, .h5 or .hdf5.

        Returns
        -------
        Path
            The path of the file.

        Raises
        ------
        WriteError
            If the file exists, or cannot be written, or has another ending.

        Examples
        --------
        >>> import tempfile
        >>> import taichi_bearings as tb
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tb.Packing.lattice("square", (3, 4)).save(folder + "/mine.npz").name
        'mine.npz'
        """
        path = Path(path)
        with writing(path):
            if path.suffix == ".npz":
                with open(path, "xb") as file:
                    np.savez(file, **self.arrays())  # type: ignore[arg-type]
            elif path.suffix in (".h5", ".hdf5"):
                with h5py.File(path, "x", locking=False) as stored:
                    for name, values in self.arrays().items():
                        stored[name] = values
            else:
                raise WriteError(f"{path} must end in .npz, .h5 or .hdf5")
        return path


def _states(given: Json, dimension: int) -> np.ndarray:
    """Return the bearing states of bottom and top, (2, 4): A_x, A_y, A_z in 1/time, and C in 1/(time length).

    given : arguments of the caller by name; `spin_bottom`, `spin_top`, `direction`, `bottom` and `top` are removed from
        it.
    dimension : 2 or 3.
    """
    spins = [finite_number(n, given.pop(n, d)) for n, d in (("spin_bottom", 0.0), ("spin_top", 1.0))]
    direction = np.array(imposed_direction(given.pop("direction", (1.0, 1.0, 0.0))))
    states = {name: given.pop(name, None) for name in ("bottom", "top")}
    if all(state is None for state in states.values()):
        axis = direction / np.linalg.norm(direction) if dimension == 3 else np.array([0.0, 0.0, 1.0])
        return np.column_stack([np.outer(spins, axis), np.zeros(2)])
    parts = [bearing_state(name, 0.0 if state is None else state, dimension) for name, state in states.items()]
    return np.array([part if dimension == 3 else (0.0, 0.0, *part, 0.0) for part in parts])


def _in_space(place: np.ndarray) -> np.ndarray:
    """Return places (spheres N, 2) or (N, 3) as (N, 3), with z = 0 in 2D.

    place : (N, 2) or (N, 3), the places, length.
    """
    return place if place.shape[1] == 3 else np.column_stack([place, np.zeros(len(place))])


def of_packing(bearing: Bearing) -> Packing:
    """Return the bearing itself, typed as a packing; it must be one."""
    assert isinstance(bearing, Packing)
    return bearing
