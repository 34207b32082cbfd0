"""Any bearing: spheres or discs at fixed places, what touches what, and which of them are driven.

With u = R omega the slip at a contact with unit normal n, from the first to the second sphere, is -(u_i + u_j) x n:
radii drop out, and a packing out of a simulation, a space-filling bearing and a lattice are the same convex problem.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.errors import FileError, InputError, WriteError
from taichi_bearings.numerics.double_double import Pair, divide, exactly
from taichi_bearings.options import SEED, SHAPE, finite_number
from taichi_bearings.plain_files import writing
from taichi_bearings.read_only import read_only
from taichi_bearings.scene import checks, geometry
from taichi_bearings.scene.array_files import read_arrays
from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.disorder import Distribution, Draw
from taichi_bearings.scene.driving import Driving
from taichi_bearings.scene.generators import random_packing, space_filling
from taichi_bearings.scene.generators.lattices import KINDS, Built, built, driven_bodies
from taichi_bearings.scene.law import COULOMB, LAWS, Law, law_named
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.readers.found import TOLERANCE, Sides, completed, from_centers
from taichi_bearings.scene.readers.found import told as contacts_told
from taichi_bearings.scene.readers.lammps import Asked, read_dumps
from taichi_bearings.scene.readers.tables import read_contacts, read_spheres
from taichi_bearings.scene.scene import bearing_state, imposed_direction
from taichi_bearings.text_lines import is_table
from taichi_bearings.words import html_table, meant, shown

NEEDED, OPTIONAL = (
    ("center", "contact", "driven", "spin"),
    ("radius", "normal", "friction", "viscosity", "normal_force", "schematic"),
)
DISTRIBUTION = "uniform:0.1,1.0"
OF_ALL_SAMPLES = ("center", "contact", "driven", "spin", "radius", "normal", "law", "schematic")
OF_SAMPLES = ("friction", "viscosity", "normal_force")
SIDES_GIVEN = [item.name for item in fields(Sides)]


@dataclass(frozen=True, eq=False, repr=False)
class Packing(Bearing):
    """Spheres (D = 3) or discs (D = 2) that touch; N of them, with E contacts. Arrays are copied and read-only.

    center : (N, D), length. contact : (E, 2) integers, the first and the second sphere of each contact.
    driven : (N,) integers, -1 for a free sphere, else the number of the driven body that it belongs to.
    spin : (N, 3), of discs (N,), 1/time; laboratory frame; imposed on driven spheres, ignored on others. Driven spheres
        whose radius times spin differs by rounding alone have one surface speed, see ``driven_speed``.
    radius : (N,) or one for all, length. normal : (E, D), unit vectors from the first to the second sphere; from the
        centres if None. A contact across a periodic side needs it, and so do several contacts of the same two spheres.
    friction : (E,), the coefficient of the law: friction, a pure number, or of the law "viscous" damping,
        force * time / length; 0 where nothing acts. If None drawn in the order of the contacts from ``distribution``.
    viscosity : (E,), of the law "coulomb-viscous", force * time / length, or what they are drawn from, as a
        `distribution`, the usual one if None. normal_force : (E,) or one for all, force.
    law : "coulomb", "viscous" or "coulomb-viscous"; if None the last one where a viscosity is given, else the first.
    distribution, seed : of coefficients that are not given: a text such as "uniform:0.1,1.0" or a function
        (rng, shape), and the seed of ``default_rng``; viscosities take ``default_rng([seed, 2])``.
    schematic : True for a network whose centres only say where it is drawn: contacts then need not lie where spheres
        touch, and normals that are given are taken as they are.

    Raises InputError, one sentence that names the value, for what is no packing.
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
        object.__setattr__(self, "normals_given", self.normal is not None)
        object.__setattr__(self, "schematic", bool(np.any(self.schematic)))
        put = lambda name, values: object.__setattr__(self, name, values)  # noqa: E731
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
            raise InputError(f"law is {self.law.name!r}; packings have {known}, laws of one's own are for lattices")
        put("normal_force", checks.pressing(self.normal_force, self.contacts))
        self._take_coefficients(put)

    def _checked_normals(self) -> np.ndarray:
        places = (self.center, self.contact, self.radius)
        if self.normal is None:
            normal = geometry.from_places(*places)
        else:
            normal, error = checks.normals(self.normal, self)
            normal = normal if self.schematic else geometry.agreed(*places, normal, error)
        normal.setflags(write=False)
        return normal

    def _take_coefficients(self, put: Any) -> None:
        two = len(self.law.quantities) > 1
        if self.viscosity is not None and not two:
            raise InputError(f"viscosity is given, but the law {self.law} does not use it; it needs coulomb-viscous")
        seed = SEED.named("seed", self.seed)
        put("seeds", (seed,))
        usual: list[Any] = [("friction", seed, self.distribution), ("viscosity", [seed, 2], DISTRIBUTION)]
        for name, state, values in usual[: 1 + two]:
            given: Any = getattr(self, name)
            values = values if given is None else given
            if isinstance(values, str) or callable(values):
                draw = Distribution.parse(values) if isinstance(values, str) else values
                values = draw(np.random.default_rng(state), (self.contacts,))
            put(name, checks.sizes(name, values, self.contacts, "contact", may_vanish=True))

    @property
    def spheres(self) -> int:
        return len(self.center)

    @property
    def contacts(self) -> int:
        return len(self.contact)

    @cached_property
    def network(self) -> Network:
        """Who touches whom."""
        assert self.normal is not None
        return Network(self.center, np.asarray(self.radius), self.contact.T, self.normal, self.driven)

    @cached_property
    def driving(self) -> Driving:
        """The spins that are imposed on driven spheres."""
        return Driving(self.network, self.spin, self.acting)

    @property
    def dimension(self) -> int:
        return self.center.shape[1]

    @property
    def named_coefficients(self) -> dict[str, np.ndarray]:
        given = {"coefficient": self.friction, "viscosity": self.viscosity}
        return {name: np.reshape(v, (self.replicas, -1)) for name, v in given.items() if v is not None}

    def slip_speeds(self, spin: np.ndarray) -> np.ndarray:
        """(E,) of spins (N, 3), of discs (N,); length/time."""
        return self.network.slips(spin.reshape(self.spheres, -1) * self.network.radius[:, None])

    def spins_of(self, u: Pair) -> Pair:
        """Spins (N, 3), of discs (N,), of u = R omega (N, C); those of driven spheres bit by bit as imposed."""
        held, shape = self.is_driven, self.spin.shape
        spin, rest = (part.reshape(shape) for part in divide(u, exactly(self.network.radius[:, None])))
        spin[held], rest[held] = self.spin[held], 0.0
        return spin, rest

    def inertias(self, mass: float, inertia: float | None, density: Any = None) -> np.ndarray:
        """I / R^2 (N,), mass, of spheres whose mean one has this mass, or moment of inertia, or all of this density,
        (N,) or one, mass / length^D."""
        radius, shape = self.network.radius, 0.5 if self.dimension == 2 else 0.4
        if density is not None:
            if inertia is not None:
                raise InputError(f"inertia is {inertia:g} and density is given; one of them says how heavy spheres are")
            volume = np.pi * radius**2 if self.dimension == 2 else 4 / 3 * np.pi * radius**3
            return shape * volume * checks.sizes("density", density, self.spheres, "sphere")
        mean = radius.mean()
        return (shape * mass if inertia is None else inertia / mean**2) * (radius / mean) ** self.dimension

    def as_stepped(self, spins: np.ndarray, at_rest: np.ndarray) -> "Packing":
        """The contacts that act alone, for methods that step all of them.

        spins : u (C, 1, N) at the start, the natural unit of speeds where nothing is driven unlike.
        at_rest : (R,), True where a state without any slip is proven to exist.
        """
        own = self.acting
        of = {name: None if (v := getattr(self, name)) is None else v[..., own] for name in OF_SAMPLES}
        found = self._with(contact=self.contact[own], normal=self.network.normal[own], **of)
        del vars(found)["network"]
        vars(found).update(jump=self.jump or float(np.abs(spins).max(initial=0.0)), is_cut_off=at_rest)
        return found

    def with_top(self, strength: float) -> "Packing":
        top = self.driving.is_top.reshape(-1, *(1,) * (self.spin.ndim - 1))
        return replace(self, spin=np.where(top, strength, 1.0) * self.spin)

    def with_friction_alone(self) -> "Packing":
        return replace(self, law=COULOMB, viscosity=None)

    @classmethod
    def together(cls, samples: Sequence["Packing"]) -> "Packing":
        """Packings that differ in their coefficients alone as the samples of one, whose arrays of the contacts then
        have a leading axis R. InputError where they differ in anything else."""
        first = samples[0]
        if len(samples) == 1:
            return first
        for name in OF_ALL_SAMPLES:
            if not all(np.array_equal(getattr(first, name), getattr(one, name)) for one in samples):
                raise InputError(f"{name} differs between samples; samples of one run differ in coefficients alone")
        changes = {name: [getattr(one, name) for one in samples] for name in OF_SAMPLES}
        stacked = {name: None if of[0] is None else read_only(np.stack(of)) for name, of in changes.items()}
        return first._with(**stacked, seeds=tuple(one.seed for one in samples))

    def _as_samples(self, pick: int | slice, seeds: tuple[int, ...]) -> "Packing":
        given = {name: getattr(self, name) for name in OF_SAMPLES}
        some = {name: None if values is None else values[pick] for name, values in given.items()}
        return self._with(**some, seed=seeds[0], seeds=seeds)

    def _with(self, **changes: Any) -> "Packing":
        """The same with other values of fields, which are not checked."""
        other = object.__new__(type(self))
        vars(other).update({item.name: getattr(self, item.name) for item in fields(self)} | changes)
        vars(other)["network"] = self.network
        return other

    def __repr__(self) -> str:
        what = "discs" if self.dimension == 2 else "spheres"
        held = int((self.driven >= 0).sum())
        return f"<Packing of {self.spheres:,} {what}, {self.contacts:,} contacts, {held:,} driven, {self.law}>"

    def _repr_html_(self) -> str:
        """For notebooks."""
        bodies = len(np.unique(self.driven[self.driven >= 0]))
        given = {name: getattr(self, name) for name in ("radius", "friction", "viscosity", "normal_force")}
        ranges = [
            (name, f"{np.min(v):g} to {np.max(v):g}") for name, v in given.items() if v is not None and np.size(v)
        ]
        return html_table(repr(self), [("driven_bodies", bodies), *ranges])

    @classmethod
    def lattice(cls, kind: str, cells: Any, periodic: Any = (), seed: int = 0, **others: Any) -> "Packing":
        """Spheres of a lattice, two bodies of them driven: 0, the bottom, and 1, the top.

        kind : "square", "triangular", "honeycomb" (discs), "cubic", "bcc", "fcc", "diamond". cells : how many
            along each axis; a rectangular cell of these lattices has 1, 2, 4, 1, 2, 4 and 8 spheres.
        periodic : names of axes that close on themselves, ("x", "y"); with the last one among them nothing is driven.
        seed : of the coefficients.
        others : `radius`, one for all, length; `spin_top`, `spin_bottom` (1/time; 1 and 0) about `direction` (of
            spheres; (1, 1, 0)), with the sign of the sublattice where there are two, or the bearing states `top`,
            `bottom`, (A_x, A_y, A_z, C) as of scenes; `driven`, what the bodies are: "planes", the lowest and the
            highest layer along the last axis; "walls", those along x; "shaft:r", all walls along x and y and the
            spheres within r diameters of the vertical axis through the middle, of discs of the middle; and fields of
            this class.
        """
        if not isinstance(kind, str) or kind not in KINDS:
            raise InputError(f"kind is {shown(kind)}; allowed are {', '.join(KINDS)}{meant(kind, KINDS)}")
        place, contact, normal, sign, closed = built(kind, SHAPE.named("cells", cells), periodic)
        body = driven_bodies(place, closed, others.pop("driven", "planes"))
        return cls._between_sides(1.0, (place, contact, normal, sign, body), 2.0, seed, others)

    @classmethod
    def random(
        cls, spheres: int, dimension: int = 3, ratio: float = 1.4, large: float = 0.5, width: float | None = None,
        seed: int = 0, **others: Any,
    ) -> "Packing":  # fmt: skip
        """Spheres of two sizes, put one by one into the lowest pocket on a floor of spheres at random; sides periodic.

        Each touches D earlier ones, to rounding, so that contacts are as many as hold it. Driven are the floor, as body
        0, and the spheres at the surface, as body 1. ratio : of the radii. large : share of large spheres.
        width : of the box in diameters of small spheres; if None about its height. seed : of places and coefficients.
        others : as of :meth:`lattice`; `radius` is that of the small spheres.
        """
        seed = SEED.named("seed", seed)
        radius, found = random_packing.built(spheres, dimension, ratio, large, width, np.random.default_rng([seed, 3]))
        return cls._between_sides(radius, found, 1.0, seed, others)

    @classmethod
    def space_filling(
        cls, m: int = 0, n: int = 0, least_radius: float = 0.01, periods: int = 1, seed: int = 0, **others: Any
    ) -> "Packing":
        """Discs that fill a strip of height 1, the first family of Herrmann, Mantica and Bessis (1990); x is periodic.

        m, n : numbers of the family. least_radius : of the discs, all others left out. No loop is odd: neighbours can
        turn against each other everywhere. Driven are the discs on the lower line, body 0, and on the upper, body 1.
        others : `spin_top`, `spin_bottom` (surface speeds, length/time; 1 and 0), with the sign of the kind; fields.
        """
        radius, found = space_filling.built(m, n, least_radius, periods)
        if "radius" in others:
            raise InputError("radius is no part of a space-filling bearing; its height is 1")
        return cls._between_sides(radius, found, 1.0, seed, {"radius": 1.0, "at_surface": True} | others)

    @classmethod
    def from_lammps(cls, atoms: str | Path, contacts: str | Path, columns: Any, **others: Any) -> "Packing":
        """From a `dump custom` of atoms and the named columns of a `dump local` of their contacts at the same timestep.

        others : of :class:`taichi_bearings.scene.readers.lammps.Asked`, and fields of this class.
        """
        known = {item.name for item in fields(Asked)}
        asked = Asked(**{name: others.pop(name) for name in list(others) if name in known})
        return cls(**{**read_dumps(Path(atoms), Path(contacts), columns, asked), **others})

    @classmethod
    def _between_sides(cls, size: Any, found: Built, unit: float, seed: int, others: dict[str, Any]) -> "Packing":
        """Of places and sides: lengths are in `unit` radii, `size` is that of each sphere in radii."""
        radius = finite_number("radius", others.pop("radius", 0.5))
        place, contact, normal, sign, body = found
        at_surface = others.pop("at_surface", False)
        state = _states(others, place.shape[1])[np.maximum(body, 0)]  # (N, 4)
        spin = sign[:, None] * (body >= 0)[:, None] * (state[:, :3] + state[:, 3:] * unit * radius * _in_space(place))
        spin = spin if place.shape[1] == 3 else spin[:, 2]
        known = {f.name for f in fields(cls) if f.init} - {"center", "contact", "driven", "spin", "normal", "radius"}
        if strange := [name for name in others if name not in known]:
            raise InputError(f"{strange[0]} is no part of a lattice{meant(strange[0], known)}")
        spin = spin / size if at_surface else spin
        return cls(unit * radius * place, contact, body, spin, radius * size, normal, seed=seed, **others)

    @classmethod
    def from_centers(
        cls, center: Any, radius: Any = 0.5, tolerance: float = TOLERANCE, driven: Any = None, spin: Any = None,
        periodic: Any = None, **others: Any,
    ) -> "Packing":  # fmt: skip
        """Spheres or discs that touch where |d - R_i - R_j| <= tolerance (R_i + R_j), d being between their centres.

        center : (N, D), length. radius : (N,), or one for all. driven, spin : as of this class. Without `driven` those
            within tolerance radii of the lowest and of the highest along the last axis are driven, as body 0, the
            bottom, and 1, the top. periodic : lengths of the periodic sides, 0 along other axes, as (4.0, 4.0, 0).
        others : without `spin`, `spin_bottom`, `spin_top` (0 and 1, 1/time) and, of spheres, `direction` ((1, 1, 0));
            and fields of this class.

        Raises InputError for two spheres that overlap by more than the tolerance. A log line tells how many contacts
        were found and how many spheres touch nothing, a warning if there are such.
        """
        sides = Sides(**{name: others.pop(name) for name in SIDES_GIVEN if name in others})
        given = {name: values for name, values in (("driven", driven), ("spin", spin)) if values is not None}
        found = from_centers(center, radius, tolerance, given, sides, periodic)
        sentence, alone = contacts_told(found["contact"], len(found["center"]), tolerance)
        logging.getLogger(__name__).log(logging.WARNING if alone else logging.INFO, "bearings: %s", sentence)
        return cls(**{**found, **others})

    @classmethod
    def load(cls, path: str | Path, contacts: str | Path | None = None, **others: Any) -> "Packing":
        """From an npz or HDF5 file with arrays of the names above, in HDF5 also below ``packing``; or a table (.csv) of
        centres, as of :meth:`from_centers`, and one of `contacts`, if they are not to be found.

        others : what the file does not hold, such as `law`, `seed`, or a `radius` for all; of tables also what
        :meth:`from_centers` takes. Raises FileError for what cannot be read, InputError for what is no packing.
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
        """The arrays of such files by name, no more than they hold; FileError if they cannot be read."""
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
        except FileError as error:
            if "lacks" not in str(error) or path.suffix == ".npz":
                raise
            group = [f"packing/{name}" for name in (*NEEDED, *OPTIONAL)]
            stored = read_arrays(path, group[: len(NEEDED)], group[len(NEEDED) :])
            found = {name.rpartition("/")[2]: values for name, values in stored.items()}
        return checks.columns_as_rows(found)

    def save(self, path: str | Path) -> Path:
        """Write the arrays into a new file, npz or HDF5 by its name; WriteError if it is there or cannot be written."""
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


def _states(given: dict[str, Any], dimension: int) -> np.ndarray:
    """Bearing states (2, 4) of bottom and top: A and C. given : what says so is taken out."""
    spins = [finite_number(n, given.pop(n, d)) for n, d in (("spin_bottom", 0.0), ("spin_top", 1.0))]
    direction = np.array(imposed_direction(given.pop("direction", (1.0, 1.0, 0.0))))
    states = {name: given.pop(name, None) for name in ("bottom", "top")}
    if all(state is None for state in states.values()):
        axis = direction / np.linalg.norm(direction) if dimension == 3 else np.array([0.0, 0.0, 1.0])
        return np.column_stack([np.outer(spins, axis), np.zeros(2)])
    parts = [bearing_state(name, 0.0 if state is None else state, dimension) for name, state in states.items()]
    return np.array([part if dimension == 3 else (0.0, 0.0, *part, 0.0) for part in parts])


def _in_space(place: np.ndarray) -> np.ndarray:
    return place if place.shape[1] == 3 else np.column_stack([place, np.zeros(len(place))])


def of_packing(bearing: Bearing) -> Packing:
    """Return the same, where packings alone are spoken of."""
    assert isinstance(bearing, Packing)
    return bearing
