"""Writes a stored run as a VTKHDF file, which ParaView and VTK open: `bearings export`.

The file holds one PolyData: the spheres are its points, the contacts its lines, and what is known of them point data
and cell data (https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html). The snapshots of a
dynamics are time steps, its end is the last one; what does not change is written once. The arrays of run.h5 cannot be
linked to: there each axis has contacts of its own, and VTK wants all lines in one array.

Letters: P points, L lines.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.files.whole_file import Finding, put, put_attributes, refuse_ending, write_hdf5
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.points_and_lines import Moments, points_and_lines
from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn
from taichi_bearings.scene.network import Network
from taichi_bearings.stages import stage

VTK_NAME = "run.vtkhdf"
VTK_VERSION = (2, 2)
TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
FILE_ATTRIBUTES = ("command", "version")  # attributes of a run file that are passed on
STORED_FACTS = ("method", "status", "law", "power", "lower_bound", "seed", "replica", *FILE_ATTRIBUTES)

UNKNOWN_THEN = "; not-a-number in snapshots, with which it is not kept"
IN_SNAPSHOTS = {
    "power": UNKNOWN_THEN,
    "force": UNKNOWN_THEN,
    "state": "; in snapshots by slip alone, see snapshot_threshold",
}


@dataclass(frozen=True)
class Geometry:
    """Points and lines of the file. A line across a periodic side leads to an *image*: its second sphere drawn once
    more, on the other side.

    sphere : (points P,) number of the sphere of each point: first all spheres, then one for each image.
    place : (P, 3) length. The height is along z in 3D and along y in 2D.
    ends : (lines L, 2) the two points of each line.
    spheres : number of spheres.
    """

    sphere: np.ndarray
    place: np.ndarray
    ends: np.ndarray
    spheres: int

    @classmethod
    def of(cls, network: Network) -> "Geometry":
        """Return the points and lines of a network: spheres and their contacts."""
        center, ends = network.center, network.contact.T.copy()
        distance = network.radius[ends].sum(axis=1)
        step = network.normal * distance[:, None]  # from the first sphere of a contact to the second
        error = np.linalg.norm(center[ends[:, 1]] - center[ends[:, 0]] - step, axis=1)
        crossing = np.flatnonzero(error > distance / 2)  # contacts across a periodic side: their second sphere is away
        sphere = np.append(np.arange(len(center)), ends[crossing, 1])
        images = center[ends[crossing, 0]] + step[crossing]
        ends[crossing, 1] = len(center) + np.arange(len(crossing))
        places = np.zeros((len(sphere), 3))
        places[:, : center.shape[1]] = np.concatenate([center, images])
        return cls(sphere, places, ends, len(center))

    def on_points(self, columns: Mapping[str, Finding]) -> dict[str, Finding]:
        """Return columns of the spheres as columns of the points. A point that is an image (a sphere drawn once more on
        the other side of a periodic lattice) has the values of its sphere; if there are images, the column `image` is
        True for them.

        columns : values of the spheres with units, by name.
        """
        found = {name: replace(column, values=column.values[self.sphere]) for name, column in columns.items()}
        if len(self.sphere) > self.spheres:
            image = np.arange(len(self.sphere)) >= self.spheres
            found["image"] = Finding(image, "1", "sphere once more, where a contact across a periodic side leads to it")
        return found


def export(
    run: str | Path, out: str | Path | None = None, force: bool = False, replica: int = 0, analyse: bool = False
) -> Json:
    """Write one sample of a run for ParaView, and return what the file holds, by name.

    run : a run directory or its run.h5.
    out : the file; an earlier one is replaced only with `force`. None for run.vtkhdf in the run directory, where an
        earlier one is replaced.
    force : True to replace a file `out`.
    replica : number of the sample, from 0.
    analyse : True to compute the structure of the sample (domains, network, cut); False to write of it only what the
        run file holds.

    Raises InputError or FileError before anything is computed.
    """
    out = None if out is None else Path(out)
    refuse_ending(out, ".vtkhdf")
    with opened_to_draw(run, out, VTK_NAME, force, replica) as (stored, path):
        found = stored.sample(replica)
        drawn = points_and_lines(stored, replica, analyse)
        geometry, moments = Geometry.of(drawn.structure.whole), drawn.moments
        of_file = {key: found.attributes[key] for key in FILE_ATTRIBUTES if key in found.attributes}
        known = found.summary | of_file | {"replica": replica}
        facts = {key: known[key] for key in STORED_FACTS if key in known}
        if moments is not None:
            facts["snapshot_threshold"] = moments.threshold
        with stage("writing"):
            write_vtkhdf(path, geometry, drawn.spheres, drawn.contacts, facts, moments, drawn.time)
    steps = 1 if moments is None else len(moments.time) + 1
    counts = {"analysed": drawn.drawn.is_known, "points": geometry.spheres, "lines": len(geometry.ends), "steps": steps}
    images = len(geometry.sphere) - geometry.spheres
    counts |= replica_drawn(stored, replica)
    return {"file": str(path), "bytes": path.stat().st_size, **counts, **({"images": images} if images else {})}


def write_vtkhdf(
    path: Path,
    geometry: Geometry,
    spheres: Mapping[str, Finding],
    contacts: Mapping[str, Finding],
    attributes: Mapping[str, object],
    moments: Moments | None = None,
    end: float | None = None,
) -> None:
    """Write a VTKHDF file, in full or not at all.

    path : where it is written.
    geometry : points and lines.
    spheres, contacts : columns by name.
    attributes : further facts, written on the group /VTKHDF; VTK ignores them.
    moments, end : snapshots of a dynamics, and the simulated time of its end; None for other methods.
    """

    def fill(file: h5py.File) -> None:
        """Write all groups of the file."""
        root = file.create_group("VTKHDF")
        root.attrs["Version"], root.attrs["Type"] = VTK_VERSION, np.bytes_("PolyData")
        put_attributes(root, attributes)
        _write_geometry(root, geometry)
        steps = None if moments is None or end is None else _start_steps(root, moments, end)
        course: dict[str, np.ndarray] = {}  # columns at the snapshots, (snapshots, rows, ...)
        if moments is not None:
            unknown = np.full(moments.slip.shape, np.nan)  # power and force are not kept with a snapshot
            course = {"spin": moments.spin, "slip": moments.slip, "state": moments.state, "power": unknown}
            course |= {"force": unknown, "proven": np.zeros(moments.slip.shape, contacts["proven"].values.dtype)}
        for name, column in geometry.on_points(spheres).items():
            before = course["spin"][:, geometry.sphere] if name == "spin" and course else None
            _put_column(root, steps, "PointData", name, column, before)
        for name, column in contacts.items():
            _put_column(root, steps, "CellData", name, column, course.get(name))

    write_hdf5(path, fill)


def _write_geometry(root: h5py.Group, geometry: Geometry) -> None:
    """Write the points, and the contacts as lines between them.

    root : group of the file that holds the data.
    geometry : points and lines.
    """
    _store(root, "Points", geometry.place, "length", "centres of the spheres")
    root["NumberOfPoints"] = [len(geometry.place)]
    for name in TOPOLOGIES:
        pairs = geometry.ends if name == "Lines" else np.empty((0, 2), dtype=np.int64)
        group = root.create_group(name)
        group["NumberOfCells"], group["NumberOfConnectivityIds"] = [len(pairs)], [pairs.size]
        _store(group, "Offsets", 2 * np.arange(len(pairs) + 1), "1", "first of the points of each line")
        _store(group, "Connectivity", pairs.ravel(), "1", "points of the lines")


def _start_steps(root: h5py.Group, moments: Moments, end: float) -> h5py.Group:
    """Write the times of the snapshots and of the end, and return the group of these time steps. All of them have the
    same points and lines.

    root : the group /VTKHDF.
    moments : the snapshots.
    end : simulated time of the last step.
    """
    steps = root.create_group("Steps")
    number = len(moments.time) + 1
    steps.attrs["NSteps"] = number
    _store(steps, "Values", np.append(moments.time, end), "time", "simulated time of each step")
    steps["NumberOfParts"] = np.ones(number, dtype=np.int64)
    for name in ("PartOffsets", "PointOffsets"):
        steps[name] = np.zeros(number, dtype=np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps[name] = np.zeros((number, len(TOPOLOGIES)), dtype=np.int64)
    return steps


def _put_column(
    root: h5py.Group, steps: h5py.Group | None, group: str, name: str, column: Finding, before: np.ndarray | None
) -> None:
    """Write a column of point or cell data, and for each time step where its rows begin.

    root : the group /VTKHDF.
    steps : the group of the time steps; None if there is only one state.
    group : "PointData" or "CellData".
    name : name of the data set.
    column : its values in the final state, with unit and description.
    before : (steps - 1, rows, ...), values at the snapshots before that; None if they are the same at all steps.
    """
    rows = column.values if before is None else np.concatenate([*before, column.values])
    text = column.description + (IN_SNAPSHOTS.get(name, "") if before is not None else "")
    _store(root.require_group(group), name, rows, column.units, text)
    if steps is not None:
        number = len(steps["Values"])
        first = np.zeros(number, dtype=np.int64) if before is None else len(column.values) * np.arange(number)
        steps[f"{group}Offsets/{name}"] = first


def _store(group: h5py.Group, name: str, values: np.ndarray, units: str, description: str) -> None:
    """Write an array as a compressed data set of a type that VTK knows, with its unit and a description.

    group, name : where it is written: the group, and the name of the data set in it.
    values : the array; truth values are written as 0 and 1.
    units, description : texts that become its attributes.
    """
    known = values.astype(np.uint8) if values.dtype == bool else values
    packed = {"compression": "gzip", "shuffle": True} if known.size else {}
    put(group, name, known, units, description, **packed)
