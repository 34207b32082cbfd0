"""Packings out of LAMMPS or LIGGGHTS: a `dump custom` of atoms and a `dump local` of their contacts (manual: dump,
compute pair/local)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.errors import FileError, InputError, warn
from taichi_bearings.lattice.grid import AXIS_NAMES, axis_numbers
from taichi_bearings.scene.checks import GAP, LEAST_SIZE, MOST_CONTACTS, MOST_SIZE, MOST_SPHERES, OVERLAP, misfit
from taichi_bearings.scene.periods import nearest_images
from taichi_bearings.scene.readers.dumps import Frame, Frames, read_frame
from taichi_bearings.scene.scene import periodic_axes
from taichi_bearings.text_lines import CutOff
from taichi_bearings.words import counted, shown

SPIN = ("omegax", "omegay", "omegaz")
KINDS_OF_PLACES = ("{}", "{}u", "{}s", "{}su")  # as they are, unwrapped, fractions of the box, unwrapped fractions
FLAT = 1e-6  # difference of the z of discs that may be rounding, relative to the largest coordinate


@dataclass(frozen=True)
class Asked:
    """What to read from dumps, in addition to the columns of contacts.

    step : the timestep; None for the last one that is complete in both files.
    driven : number of the body of each driven atom, by id; or an array (spheres N,) in the order of the ids, -1 for
        free atoms.
    driven_types : in place of `driven`, number of the body of all atoms of a type, by type.
    spin : imposed spin of each body, 1/time, by number of the body: a vector, or a number for discs. None to read the
        columns omegax, omegay and omegaz.
    dimension : 3, or 2 for discs in a plane z = const.
    radius : radius of all atoms, length, for dumps without a column of radii or diameters.
    periodic : names of the periodic axes, for dumps whose box does not say which they are.
    """

    step: int | None = None
    driven: Mapping[int, int] | ArrayLike | None = None
    driven_types: Mapping[int, int] | None = None
    spin: Mapping[int, ArrayLike] | None = None
    dimension: int = 3
    radius: float | None = None
    periodic: str | Sequence[str] | None = None

    def __post_init__(self) -> None:
        """Raise InputError for a dimension other than 2 or 3, and if it is not said which atoms are driven."""
        if self.dimension not in (2, 3):
            raise InputError(f"dimension is {shown(self.dimension)}; it must be 2 or 3")
        if (self.driven is None) == (self.driven_types is None):
            raise InputError(
                "give either driven (atoms) or driven_types (atom types), and not both, to say which atoms are driven"
            )

    @property
    def type_column(self) -> list[str]:
        """List with the name of the column of atom types; empty if types are not needed."""
        return ["type"] if self.driven_types is not None else []

    @property
    def spin_columns(self) -> list[str]:
        """List with the names of the columns of spins; empty if these are not needed."""
        return [] if self.spin is not None else list(SPIN if self.dimension == 3 else SPIN[2:])

    def size_column(self, names: Sequence[str]) -> list[str]:
        """Return a list with the name of the column of radii or diameters; empty if it is not needed.

        names : columns of the dump.
        """
        return ["radius" if "radius" in names else "diameter"] if self.radius is None else []

    def place_columns(self, names: Sequence[str]) -> list[str]:
        """Return the names of the columns of positions.

        names : columns of the dump.

        LAMMPS has four kinds of positions, KINDS_OF_PLACES; the first kind whose columns are all there is taken. The z
        of discs is read too, if it is there.
        """
        needed = AXIS_NAMES[: self.dimension]
        kind = next((kind for kind in KINDS_OF_PLACES if all(kind.format(axis) in names for axis in needed)), "{}")
        return [name for axis in AXIS_NAMES if (name := kind.format(axis)) in names or axis in needed]

    def columns(self, names: Sequence[str]) -> list[str]:
        """Return the names of all columns of atoms that are read.

        names : columns of the dump.

        Raises InputError if the dump has no spins and none are given.
        """
        if lacking := [name for name in self.spin_columns if name not in names]:
            example = "{0: (0, 0, 0), 1: (1, 1, 0)}" if self.dimension == 3 else "{0: 0, 1: 1}"
            raise InputError(
                f"the dump of the atoms has no column {lacking[0]}; give spin, the imposed spin of each body, such as "
                f"spin={example}"
            )
        return ["id", *self.type_column, *self.size_column(names), *self.place_columns(names), *self.spin_columns]


def read_dumps(atoms: Path, contacts: Path, columns: Sequence[str], asked: Asked) -> dict[str, np.ndarray]:
    """Return the arrays of a packing by name, with spheres in the order of their ids.

    atoms : dump with the columns id, radius or diameter, and positions: x y z, xu yu zu (unwrapped), or fractions of
        the box, xs ys zs or xsu ysu zsu.
    contacts : dump with the columns that `columns` names. Both files may be packed by gzip, bzip2 or xz.
    columns : names of the two columns with the ids of the atoms of a contact, such as ("c_pair[1]", "c_pair[2]"). That
        of the normal force may follow, or those of the components of the force on the first atom. Rows whose force
        does not press are left out, and counted in a warning.
    asked : options of the user.

    Normals go the shortest way around periodic sides ("pp"). An id printed as 1e+06 belongs to the only atom whose id
    prints so. Raises FileError or InputError, one sentence, with the line of the file and the atoms at fault.
    """
    most = 2 + asked.dimension
    if isinstance(columns, str) or len(columns) not in {2, 3, most, 5}:
        raise InputError(
            f"columns is {shown(columns)}; it must name columns of {contacts}: two with the ids of both atoms, and "
            "after them none, one with the normal force, or one for each of the two (in 2D) or three components of the "
            "force"
        )
    frame, rows = _frames(atoms, contacts, list(columns), asked)
    # sort the atoms by id; their columns are in the order of `Asked.columns`: id, type, size, positions, spins
    kinds, sizes, places = len(asked.type_column), len(asked.size_column(frame.names)), asked.place_columns(frame.names)
    order = np.argsort(frame.table[:, 0], kind="stable")
    _refuse_strange_rows(frame)
    table, number = frame.table[order], frame.table[order, 0].astype(np.int64)
    if (twice := number[1:] == number[:-1]).any():
        pair = sorted(order[int(np.argmax(twice)) :][:2].tolist())
        line, atom = frame.at(pair[1]), number[1:][twice][0]
        why = "; its ids have lost digits, so print them as whole numbers" if frame.is_rounded else ""
        raise FileError(f"{line} has atom {atom} a second time; each atom must be there once{why}")
    body = _bodies(number, asked, table[:, 1].astype(np.int64))
    center = _centers(frame, places, table[:, 1 + kinds + sizes :][:, : len(places)], asked)
    found: dict[str, Any] = {"center": center, "driven": body, "radius": _radii(frame, table[:, 1 + kinds], asked)}
    spin = (
        _imposed_spins(body, asked.spin, asked.dimension)
        if asked.spin is not None
        else table[:, -len(asked.spin_columns) :]
    )
    found["spin"] = spin if asked.dimension == 3 else spin.reshape(-1)
    _refuse_sizes(frame, order, found["radius"])
    return found | _contacts(rows, frame, number, found, asked)


def _frames(atoms: Path, contacts: Path, columns: list[str], asked: Asked) -> tuple[Frame, Frame]:
    """Return one timestep of both dumps, first of the atoms, then of their contacts: the one that is asked for, or the
    last one that is complete in both.

    atoms, contacts : the two files.
    columns : names of the columns of contacts.
    asked : options of the user. A warning tells of later timesteps that are left out.
    """
    first, second = Frames.of(atoms), Frames.of(contacts)
    cut = [str(part.cut) for part in (first, second) if part.cut is not None]
    # From the last timestep back, the first that is whole in both files.
    for step in dict.fromkeys(own for own, _ in reversed(first.starts)):
        if asked.step is not None and step != asked.step:
            continue
        if not second.of_step(step):
            cut.append(f"{contacts} has no timestep {step}")
            continue
        try:
            whole = 1 + len(asked.type_column)
            frame = _whole_frame(first, step, "ATOMS", MOST_SPHERES, asked.columns, whole)
            rows = _whole_frame(second, step, "", MOST_CONTACTS, lambda _: columns, 2)
        except CutOff as error:
            cut.append(str(error))
            continue
        if cut:
            words = "; ".join(dict.fromkeys(cut))
            warn(f"{words}; the timestep {step} is read instead")
        return frame, rows
    reasons = f": {'; '.join(dict.fromkeys(cut))}" if cut else ""
    if asked.step is None:
        raise FileError(f"no timestep is complete in both {atoms} and {contacts}{reasons}")
    asked_step = shown(asked.step)
    raise FileError(
        f"timestep {asked_step} must be complete in both {atoms} and {contacts}; it is missing or cut off in"
        f" at least one{reasons}"
    )


def _whole_frame(frames: Frames, step: int, *of: Any) -> Frame:
    """Return the last complete copy of a timestep, which a dump may hold several times; raise CutOff if none is
    complete.

    frames : where the timesteps of the dump begin.
    step : number of the timestep.
    of : further arguments of :func:`.dumps.read_frame`: what the rows of the dump are called, the largest number of
        rows, the function that picks the columns to read, and how many of these hold whole numbers.
    """
    error = CutOff(frames.path, 0, f"the file has no timestep {step}")
    for start in frames.of_step(step):
        try:
            return read_frame(frames.path, step, start, *of)
        except CutOff as found:
            error = found
    raise error


def _refuse_strange_rows(frame: Frame) -> None:
    """Raise FileError if a row of a timestep (`frame`) has a number that is not finite or too large."""
    strange = ~(np.abs(frame.table) <= MOST_INTEGER_OR_SIZE).all(axis=1)
    if strange.any():
        row = int(np.argmax(strange))
        number = next(value for value in frame.table[row].tolist() if not abs(value) <= MOST_INTEGER_OR_SIZE)
        line, atom = frame.at(row), f"{frame.table[row, 0]:.0f}"
        raise FileError(f"{line} has the value {number} for atom {atom}; numbers must be finite")


MOST_INTEGER_OR_SIZE = max(MOST_SIZE, 2.0**53)


def _centers(frame: Frame, names: list[str], place: np.ndarray, asked: Asked) -> np.ndarray:
    """Return the centres of the atoms, (spheres N, dimensions D), length.

    frame : timestep of the atoms, with its box.
    names : names of the columns of positions, which are lengths or fractions of the box.
    place : (N, columns), their numbers.
    asked : options of the user.
    """
    if "s" in names[0]:
        if frame.box is None:
            raise FileError(
                f"{frame.path} has scaled coordinates (xs, ys, zs), but at timestep {frame.step} no box to scale "
                "them with"
            )
        shares = np.column_stack([place, np.zeros((len(place), 3 - place.shape[1]))])
        place = frame.box.places(shares)
    if asked.dimension == 2 and place.shape[1] == 3 and len(place):
        low, high = float(place[:, 2].min()), float(place[:, 2].max())
        if high - low > FLAT * float(np.abs(place).max()):
            raise InputError(
                f"dimension is 2, but atoms of {frame.path} lie at z from {low:g} to {high:g}; in 2D all must have "
                "one z"
            )
    return np.asarray(place[:, : asked.dimension])


def _radii(frame: Frame, column: np.ndarray, asked: Asked) -> np.ndarray:
    """Return the radii (spheres N,), length.

    frame : the timestep of the atoms.
    column : (spheres N,), radii or diameters of the dump; not used if the user gives the radius.
    asked : options of the user, which may give one radius for all instead.
    """
    if asked.radius is None:
        return column * (1.0 if "radius" in frame.names else 0.5)
    if own := [name for name in ("radius", "diameter") if name in frame.names]:
        raise InputError(f"radius is {shown(asked.radius)}, but {frame.path} has a column {own[0]}; leave out radius")
    return np.full(len(frame.table), asked.radius, dtype=float)


def _refuse_sizes(frame: Frame, order: np.ndarray, radius: np.ndarray) -> None:
    """Raise FileError for a radius that is out of range.

    frame : the timestep of the atoms.
    order : (spheres N,), row of each atom.
    radius : (N,), in the same order.
    """
    wrong = ~((radius >= LEAST_SIZE) & (radius <= MOST_SIZE))
    if wrong.any():
        row = int(order[np.argmax(wrong)])
        line, atom, own = frame.at(row), f"{frame.table[row, 0]:.0f}", f"{radius[wrong][0]:g}"
        raise FileError(f"{line}: the radius of atom {atom} is {own}; it must be from {LEAST_SIZE:g} to {MOST_SIZE:g}")


def _contacts(
    rows: Frame, frame: Frame, number: np.ndarray, spheres: Mapping[str, np.ndarray], asked: Asked
) -> dict[str, np.ndarray]:
    """Return arrays of the contacts by name: contact (contacts E, 2), normal (E, dimensions D) and, where columns give
    it, normal_force (E,).

    rows : timestep of the dump of contacts.
    frame : the same timestep of the dump of atoms.
    number : (spheres N,), ids of the atoms in the order of the spheres.
    spheres : centres and radii by name.
    asked : options of the user.
    """
    if frame.box is not None and rows.box is not None and not frame.box.is_nearly(rows.box):
        raise FileError(
            f"the box in {rows.path} differs from that in {frame.path} at timestep {frame.step}; both dumps must be of "
            "one run"
        )
    strange = ~np.isfinite(rows.table).all(axis=1)
    if strange.any():
        line = rows.at(int(np.argmax(strange)))
        raise FileError(f"{line} has a force that is infinite or not a number")
    # no column of forces, the normal force, or the components of a vector; rows without any force are no contacts
    force, row, count = rows.table[:, 2:], np.arange(len(rows.table)), len(rows.table)
    has_forces, is_vector = force.shape[1] > 0, force.shape[1] > 1
    if has_forces:
        force = force if is_vector else _pressing_forces(rows, force[:, 0], count)[:, None]
        row, force = row[force.any(axis=1)], force[force.any(axis=1)]
    contact = _contacts_by_ids(rows, row, frame, number)
    normal = _normals(rows, row, contact, number, frame, spheres, asked)
    if is_vector:  # the force on the first atom presses if it points against the normal
        pressing = _pressing_forces(rows, -np.einsum("ed,ed->e", force[:, : normal.shape[1]], normal), count)
        acts = pressing > 0
        contact, normal, force = contact[acts], normal[acts], pressing[acts, None]
    return {"contact": contact, "normal": normal} | ({"normal_force": force[:, 0]} if has_forces else {})


def _normals(
    rows: Frame, row: np.ndarray, contact: np.ndarray, number: np.ndarray, frame: Frame,
    spheres: Mapping[str, np.ndarray], asked: Asked,
) -> np.ndarray:  # fmt: skip
    """Return the normals (contacts E, dimensions D) of the contacts, along the shortest way around periodic sides.

    rows, frame : timesteps of the dumps of contacts and of atoms.
    row : (E,), row of each contact in its dump.
    contact : (E, 2), numbers of its spheres.
    number : (spheres N,), ids of the atoms.
    spheres : centres and radii by name.
    asked : options of the user.

    Raises InputError for two atoms that do not touch, touch both ways around a periodic side, or come twice.
    """
    center, reach = spheres["center"], spheres["radius"][contact].sum(axis=1)
    # shortest vectors around periodic sides, and which contacts are wrong, doubtful or there twice
    vector = center[contact[:, 1]] - center[contact[:, 0]]
    vector, is_doubtful = nearest_images(vector, _periods(frame, asked), (1 + GAP) * reach)
    size = np.linalg.norm(vector, axis=1)
    is_near = size <= (1 + GAP) * reach
    wrong = ~(is_near & (size >= (1 - OVERLAP) * reach)) | is_doubtful
    pair = np.sort(contact, axis=1) @ np.array([len(number), 1])
    again = np.ones(len(pair), dtype=bool)
    again[np.unique(pair, return_index=True)[1]] = False
    if not (wrong | again).any():
        return np.asarray(vector / size[:, None])
    # The first contact at fault is named.
    own = int(np.argmax(wrong | again))
    i, j = number[contact[own]].tolist()
    line = rows.at(int(row[own]))
    if is_doubtful[own] and is_near[own]:
        raise InputError(
            f"{line}: atoms {i} and {j} touch both directly and across a periodic side, so it is not known which "
            "contact is meant; so narrow a box cannot be read"
        )
    if wrong[own]:
        unknown = frame.box is None or frame.box.periodic is None
        hint = "; if that is across a periodic side, name it by `periodic`" if unknown and not is_near[own] else ""
        distance_and_radii = misfit(size[own], reach[own])
        raise InputError(f"{line}: atoms {i} and {j} {distance_and_radii}{hint}")
    raise InputError(f"{line}: the contact of atoms {i} and {j} is there a second time; each must be there once")


def _periods(frame: Frame, asked: Asked) -> np.ndarray:
    """Return the vectors (periodic sides, dimensions D) by which the system repeats itself, length.

    frame : timestep of the atoms, with its box.
    asked : options of the user, which may say which axes are periodic.
    """
    box = frame.box
    if asked.periodic is not None:
        closed = set(axis_numbers(periodic_axes(asked.periodic, AXIS_NAMES[: asked.dimension])))
        if box is None:
            raise InputError(
                f"periodic is {shown(asked.periodic)}, but {frame.path} has no box at timestep {frame.step} that says "
                "how long the periodic sides are"
            )
        if box.periodic is not None:
            raise InputError(
                f"periodic is {shown(asked.periodic)}, but the box of {frame.path} says it already; leave it out"
            )
        box = replace(box, periodic=[axis in closed for axis in range(3)])
    periods = np.zeros((0, asked.dimension)) if box is None else box.periods(asked.dimension)
    return periods[periods.any(axis=1)]


def _pressing_forces(rows: Frame, force: np.ndarray, count: int) -> np.ndarray:
    """Return the normal forces (contacts,) that press spheres together: the given ones, with 0 in place of forces that
    pull. A warning says how many rows are left out because no pressing force acts.

    rows : timestep of the dump of contacts, for messages.
    force : (contacts,), positive where it presses. If none is positive and some are negative, the file counts forces
        the other way, and all signs are changed.
    count : number of rows of the dump; contacts without any force may be missing in `force`.
    """
    if (force < 0).any() and not (force > 0).any():
        warn(f"all forces of {rows.path} have the sign of those that pull; it is taken for that of pressing")
        force = -force
    pulling, idle = int((force < 0).sum()), count - int((force > 0).sum())
    if idle:
        which = f"{idle:,} of {counted(count, 'row')} of {rows.path}"
        warn(f"{which} bear no normal force that presses, of which {pulling} pull; they are left out")
    return np.where(force > 0, force, 0.0)


def _contacts_by_ids(rows: Frame, row: np.ndarray, frame: Frame, number: np.ndarray) -> np.ndarray:
    """Return the contacts (contacts E, 2) as numbers of spheres, from the ids of atoms in a dump.

    rows : timestep of the dump of contacts.
    row : (E,), numbers of its rows that are contacts.
    frame : timestep of the dump of atoms.
    number : (spheres N,), ids of the atoms in the order of the spheres, rising.

    Raises FileError for an id that no atom has, or that fits several atoms because it was printed with too few digits.
    """
    ids = rows.table[row, :2].astype(np.int64)
    # ids of the atoms in ascending order, and the sphere of each; rounded by %g if only the dump of contacts is
    keys, sphere = number, np.arange(len(number))
    if rows.is_rounded and not frame.is_rounded:
        keys = np.array([int(float(f"{one:g}")) for one in number.tolist()], dtype=np.int64)
        sphere = np.argsort(keys, kind="stable")
        keys = keys[sphere]
    # the first key that is no smaller than the id must be the id, and the next key must differ from it
    where = np.minimum(np.searchsorted(keys, ids), max(len(keys) - 1, 0))
    lost = (keys[where] != ids).any(axis=1) if len(keys) else np.ones(len(ids), dtype=bool)
    if lost.any():
        own = int(np.argmax(lost))
        missing = next(one for one in ids[own].tolist() if one not in keys)
        line, step = rows.at(int(row[own])), frame.step
        raise FileError(f"{line} has a contact of atom {missing}, which {frame.path} lacks at timestep {step}")
    after = np.minimum(where + 1, max(len(keys) - 1, 0))
    doubtful = ((keys[after] == ids) & (after != where)).any(axis=1)
    if doubtful.any():
        own = int(np.argmax(doubtful))
        end = int(np.argmax((keys[after] == ids)[own] & (after != where)[own]))
        one, two = number[sphere[[where[own, end], after[own, end]]]].tolist()
        raise FileError(
            f"{rows.at(int(row[own]))} has the id {ids[own, end]:g}, which can be atom {one} or {two}: it has lost "
            "digits; let `dump_modify format` write all of them"
        )
    return np.asarray(sphere[where])


def _bodies(number: np.ndarray, asked: Asked, kind: np.ndarray) -> np.ndarray:
    """Return the driven body of each atom, (spheres N,), -1 for free ones.

    number : (N,), ids of the atoms.
    asked : options of the user, which name driven atoms by id or by type.
    kind : (N,), types of the atoms.
    """
    if asked.driven is not None and not isinstance(asked.driven, Mapping):
        return np.asarray(asked.driven)
    table, keys = (asked.driven_types or {}, kind) if asked.driven is None else (asked.driven, number)
    body = np.full(len(number), -1)
    for key, own in table.items():
        if not (keys == key).any():
            raise InputError(f"driven names {shown(key)}, but the dump has no atom or type of that number")
        body[keys == key] = own
    return body


def _imposed_spins(body: np.ndarray, spin: Mapping[int, ArrayLike], dimension: int) -> np.ndarray:
    """Return the imposed spins of driven atoms, (spheres N, 3) or (N,) for discs, 1/time; 0 for others.

    body : (N,), driven body of each atom, -1 for free ones.
    spin : imposed spin by number of the body.
    dimension : 2 or 3.

    Raises InputError for a body without spin, and for a spin that is not a vector, or of discs not a number.
    """
    values = np.zeros((len(body), 3) if dimension == 3 else len(body))
    for own in np.unique(body[body >= 0]).tolist():
        if own not in spin:
            raise InputError(f"spin lacks body {own}; it must give the spin of each driven body")
        if np.shape(spin[own]) != values.shape[1:]:
            needed = "three numbers" if dimension == 3 else "one number"
            raise InputError(f"spin of body {own} is {shown(spin[own])}; it must be {needed}")
        values[body == own] = spin[own]
    return values
