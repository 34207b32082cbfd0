"""The layout of run.h5 and how it is written.

Arrays over the contacts of a lattice are written axis by axis, those of a packing in one piece. Other programs read
these files, so the layout does not change without a new version; :mod:`taichi_bearings.runs.run_file` reads it here.

A replica is one sample of several. Data sets have a leading axis of replicas if there are several.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.files.whole_file import layout_of, put, write_hdf5
from taichi_bearings.lattice.grid import friction_by_axis
from taichi_bearings.quantities import CHECK_ROWS, CONTACTS, FRICTION_QUANTITIES, SPHERES, found_in
from taichi_bearings.scene import Solution
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.scene.solution import stacked

AXES = "xyz"
PACKING_ARRAYS = {
    "center": ("length", "centres of the spheres"),
    "contact": ("1", "first and second sphere of each contact"),
    "driven": ("1", "-1 for a free sphere, else the number of its driven body"),
    "spin": ("1/time", "imposed on driven spheres, laboratory frame"),
    "radius": ("length", "of the spheres"),
    "normal": ("1", "unit vector of each contact from its first to its second sphere"),
    "friction": ("1", "coefficient of the law: friction, or with the law viscous damping, force*time/length"),
    "viscosity": ("force*time/length", "viscosity of the contacts"),
    "normal_force": ("force", "normal force of the contacts"),
    "schematic": ("1", "1: contacts need not lie where spheres touch"),
}
"""Units and descriptions of the data sets in the group /packing, by name."""
FRICTION_OF_SECOND = {
    2: "friction on the second disc, component along z x n",
    3: "friction on the second sphere, laboratory frame",
}
"""Descriptions of the friction of packings, by dimension. These forces prove the lower bound: they balance, and none
exceeds the friction limit."""
OF_VECTORS = 5  # axes of friction on cubic lattices: replicas, three of the lattice, and components, of which one is 0
MOST_OF_CHUNK = 32  # contacts along a side of a chunk of a data set; HDF5 reads larger chunks far more slowly

Row = tuple[str, np.ndarray, str, str]
"""Name, values with a leading axis of replicas, unit and description of a data set."""


def write_run_file(path: Path, solution: Solution, attributes: Mapping[str, object]) -> None:
    """Write run.h5, whole or not at all. With a single replica data sets have no axis of replicas.

    path : where it is written.
    solution : the answer to all samples.
    attributes : numbers and words, by name, that become attributes of the file.
    """
    one = solution.scene.replicas == 1

    def fill(file: h5py.File) -> None:
        """Write all data sets into an opened HDF5 file; whole numbers are compressed."""
        for name, values, unit, text in _rows(solution):
            values = values.astype(np.uint8) if values.dtype == bool else values
            are_vectors = name.endswith("/friction") and values.ndim == OF_VECTORS and values.size
            values = values[0] if one else values
            if are_vectors:
                _put_vectors(file, name, values, unit, text)
                continue
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
            put(file, name, values, unit, text, **(packed if values.dtype == np.uint8 and values.size else {}))

    write_hdf5(path, fill, {**layout_of("run"), **attributes, "findings": list(solution.findings)})


def _put_vectors(file: h5py.File, name: str, values: np.ndarray, unit: str, text: str) -> None:
    """Write a data set of vectors so that a component which is 0 everywhere takes no space: each chunk has numbers of
    one component, and HDF5 stores no chunk into which nothing was written, but reads it as zeros.

    file : the opened file.
    name, unit, text : name of the data set, and its attributes.
    values : (..., components), the vectors; if all are 0 one component is written, as files that claim far more than
        they hold are refused.
    """
    parts = [-(-side // MOST_OF_CHUNK) for side in values.shape[:-1]]
    chunk = *(-(-side // number) for side, number in zip(values.shape, parts, strict=False)), 1
    put(file, name, None, unit, text, shape=values.shape, dtype=values.dtype, chunks=chunk)
    for component in [k for k in range(values.shape[-1]) if values[..., k].any()] or [0]:
        file[name][..., component] = values[..., component]


def _rows(solution: Solution) -> Iterator[Row]:
    """Yield all data sets of the run.h5 of a solution, as tuples of name, values, unit and description: coefficients,
    contacts, spins, history and snapshots.
    """
    scene, replicas = solution.scene, solution.scene.replicas
    yield from (_rows_of_packings if scene.network.lattice is None else _rows_of_lattice)(solution)
    for row, found in found_in(solution, SPHERES):
        yield row.name, found, row.unit, row.text

    def of_each(column: np.ndarray, replica_axis: int) -> np.ndarray:
        """Return a column of the history as an array (R samples, times, ...).

        column : (times,), the same for all samples, which is repeated for each; or an array with an axis of samples.
        replica_axis : number of this axis; not used if there is none.
        """
        return np.moveaxis(column, replica_axis, 0) if column.ndim > 1 else np.tile(column, (replicas, 1))

    for key, column in solution.history.items():
        yield f"history/{key}", of_each(column, 1), CHECK_ROWS[key].unit, CHECK_ROWS[key].text
    if (kept := solution.snapshots) is not None:
        yield "snapshots/time", of_each(kept.time, 1), "time", "simulated time of each snapshot"
        text = f"{SPHERES['spin'].text} at these times"
        yield "snapshots/spin", of_each(kept.spin, 1), SPHERES["spin"].unit, text


def _rows_of_lattice(solution: Solution) -> Iterator[Row]:
    """Yield the data sets of coefficients and contacts of a solution on a lattice, one for each axis, as tuples of
    name, values, unit and description.
    """
    scene = of_lattice(solution.scene)
    lattice = scene.lattice
    friction = friction_by_axis(solution.friction, lattice)
    named = zip(scene.law.quantities, scene.named_coefficients.items(), strict=True)
    of_contacts = [
        *((f"{group}/{{}}", lattice.by_axis(values), quantity.unit, f"{quantity.name} coefficient of the {{}}-contacts")
          for quantity, (group, values) in named),
        *((f"contact/{{}}/{row.name}", lattice.by_axis(found), row.unit, row.text)
          for row, found in found_in(solution, CONTACTS)),
        ("contact/{}/friction", friction, "force", FRICTION_QUANTITIES[lattice.dimension]),
    ]  # fmt: skip
    for name, parts, unit, text in of_contacts:
        for axis, part in zip(AXES, parts, strict=False):
            yield name.format(axis), part, unit, text.format(axis)


def _rows_of_packings(solution: Solution) -> Iterator[Row]:
    """Yield the data sets of a packing and of its contacts, as tuples of name, values, unit and description.

    solution : the answer to all samples of the packing.
    """
    scene = solution.scene
    for name, values in stacked([scene.sample(number).arrays() for number in range(scene.replicas)]).items():
        yield f"packing/{name}", values, *PACKING_ARRAYS[name]
    for row, found in found_in(solution, CONTACTS):
        yield f"contact/{row.name}", found, row.unit, row.text
    yield "contact/friction", solution.friction, "force", FRICTION_OF_SECOND[scene.network.dimension]
