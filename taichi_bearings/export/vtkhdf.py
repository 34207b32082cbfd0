"""A stored run as a VTKHDF file, which ParaView and VTK open: `bearings export`.

One PolyData: the spheres are its points, the contacts its lines, and what is known of them point data and cell data
(https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html). The snapshots of a dynamics are time
steps and its end the last one; what does not change is written once. The arrays of run.h5 cannot be linked to: there
each axis has contacts of its own, and VTK wants all lines in one array.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.files.analysis_file import Finding
from taichi_bearings.files.whole_file import refuse_ending, storable, write_hdf5
from taichi_bearings.lattice import Lattice
from taichi_bearings.runs.points_and_lines import Moments, PointsAndLines, opened_to_draw, points_and_lines
from taichi_bearings.stages import stage

VTK_NAME = "run.vtkhdf"
VTK_VERSION = (2, 2)
TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
TOLD = ("command", "method", "status", "law", "power", "lower_bound", "seed", "version")  # attributes of the run

UNKNOWN = "; not-a-number in snapshots, with which it is not kept"
IN_SNAPSHOTS = {"power": UNKNOWN, "force": UNKNOWN, "state": "; in snapshots by slip alone, see snapshot_threshold"}


def export(run: Path, out: Path | None = None, force: bool = False, replica: int = 0) -> dict[str, Any]:
    """Write one sample of a run directory or its run.h5 for ParaView, and say what the file holds.

    out : the file, an earlier one is replaced with `force` only; default: run.vtkhdf in the run directory, which is.
    Raises InputError or FileError before anything is computed.
    """
    refuse_ending(out, ".vtkhdf")
    with opened_to_draw(run, out, VTK_NAME, force) as (stored, path):
        drawn = points_and_lines(stored, replica)
        told = {key: stored.attributes[key] for key in TOLD if key in stored.attributes} | {"replica": replica}
        if drawn.moments is not None:
            told["snapshot_threshold"] = drawn.moments.threshold
        with stage("writing"):
            write_vtkhdf(path, drawn, told)
    steps = 1 if drawn.moments is None else len(drawn.moments.time) + 1
    counts = {"points": drawn.scene.lattice.sites, "lines": len(drawn.ends), "steps": steps}
    images = len(_over(drawn.scene.lattice))
    return {"file": str(path), "bytes": path.stat().st_size, **counts, **({"images": images} if images else {})}


def write_vtkhdf(path: Path, drawn: PointsAndLines, attributes: Mapping[str, Any]) -> None:
    """Write the file in full or not at all. attributes : for the group /VTKHDF, where VTK does not look at them."""

    def fill(file: h5py.File) -> None:
        root = file.create_group("VTKHDF")
        root.attrs["Version"], root.attrs["Type"] = VTK_VERSION, np.bytes_("PolyData")
        for key, value in attributes.items():
            root.attrs[key] = storable(value)
        _write_geometry(root, drawn)
        steps = None if drawn.moments is None or drawn.time is None else _start_steps(root, drawn.moments, drawn.time)
        way = {} if drawn.moments is None else _on_the_way(drawn.moments, drawn.contacts)
        points = _points(drawn.scene.lattice)
        for name, column in _of_points(drawn, points).items():
            _put(root, steps, "PointData", name, column, way["spin"][:, points] if name == "spin" and way else None)
        for name, column in drawn.contacts.items():
            _put(root, steps, "CellData", name, column, way.get(name))

    write_hdf5(path, fill)


def _over(lattice: Lattice) -> np.ndarray:
    """Contacts across periodic sides: their lines lead on to images of the first spheres, behind the last ones."""
    return np.flatnonzero(lattice.ends[1] < lattice.ends[0])


def _points(lattice: Lattice) -> np.ndarray:
    """Sphere of each point: all of them, then one an image."""
    return np.append(np.arange(lattice.sites), lattice.ends[1, _over(lattice)])


def _of_points(drawn: PointsAndLines, points: np.ndarray) -> dict[str, Finding]:
    """Columns of point data; on periodic lattices they say which points are images."""
    columns = {name: replace(column, values=column.values[points]) for name, column in drawn.spheres.items()}
    if len(points) > drawn.scene.lattice.sites:
        image = np.arange(len(points)) >= drawn.scene.lattice.sites
        columns["image"] = Finding(image, "1", "sphere once more, where a contact across a periodic side leads to it")
    return columns


def _write_geometry(root: h5py.Group, drawn: PointsAndLines) -> None:
    """Points at their places, height along z in 3D and along y in 2D, and the contacts as lines between them."""
    lattice, over, ends = drawn.scene.lattice, _over(drawn.scene.lattice), drawn.ends.copy()
    cells = np.argwhere(np.ones(lattice.shape, dtype=bool))
    beyond = cells[ends[over, 0]] + np.eye(lattice.dimension, dtype=int)[lattice.axis[over]]
    ends[over, 1] = lattice.sites + np.arange(len(over))
    places = np.zeros((lattice.sites + len(over), 3))
    places[:, : lattice.dimension] = 2 * lattice.radius * np.concatenate([cells, beyond])
    _store(root, "Points", places, "length", "centres of the spheres")
    root["NumberOfPoints"] = [len(places)]
    for name in TOPOLOGIES:
        pairs = ends if name == "Lines" else np.empty((0, 2), dtype=np.int64)
        group = root.create_group(name)
        group["NumberOfCells"], group["NumberOfConnectivityIds"] = [len(pairs)], [pairs.size]
        _store(group, "Offsets", 2 * np.arange(len(pairs) + 1), "1", "first of the points of each line")
        _store(group, "Connectivity", pairs.ravel(), "1", "points of the lines")


def _start_steps(root: h5py.Group, moments: Moments, end: float) -> h5py.Group:
    """The times, all with the same points and lines."""
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


def _on_the_way(moments: Moments, contacts: Mapping[str, Finding]) -> dict[str, np.ndarray]:
    """What changes: (steps, rows, ...) before the end. Power and force are not kept with a snapshot."""
    unknown = np.full(moments.slip.shape, np.nan)
    unproven = np.zeros(moments.slip.shape, dtype=contacts["proven"].values.dtype)
    known = {"spin": moments.spin, "slip": moments.slip, "state": moments.state}
    return {**known, "power": unknown, "force": unknown, "proven": unproven}


def _put(
    root: h5py.Group, steps: h5py.Group | None, group: str, name: str, column: Finding, before: np.ndarray | None
) -> None:
    """A column of point or cell data, and where each step finds it."""
    rows = column.values if before is None else np.concatenate([*before, column.values])
    text = column.description + (IN_SNAPSHOTS.get(name, "") if before is not None else "")
    _store(root.require_group(group), name, rows, column.units, text)
    if steps is not None:
        number = len(steps["Values"])
        first = np.zeros(number, dtype=np.int64) if before is None else len(column.values) * np.arange(number)
        steps[f"{group}Offsets/{name}"] = first


def _store(group: h5py.Group, name: str, values: np.ndarray, units: str, description: str) -> None:
    """A packed array in numbers that VTK knows, with its unit."""
    known = values.astype(np.uint8) if values.dtype == bool else values
    packed = {"compression": "gzip", "shuffle": True} if known.size else {}
    stored = group.create_dataset(name, data=known, **packed)
    stored.attrs["units"], stored.attrs["description"] = units, description
