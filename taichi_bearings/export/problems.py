"""The least power of a run as a problem for other solvers: `bearings export --format cbf` and `fclib`.

Lattices are read as packings. With u = R omega of the free spheres, K u + b the slip of a contact along its tangents
(packing/system.py), F the force that friction bears and eta the viscosity of a contact, both formats say

    minimise  share * sum_e (F t + eta s / 2)   with   t >= |K u + b|,  s >= |K u + b|^2,

share 2 with viscosity alone, whose power is twice its potential. As a second-order cone programme that is cbf,
the conic benchmark format (https://docs.mosek.com/latest/cmdtools/cbf-format.html): s is in a rotated cone. As
contacts with Coulomb's law it is fclib, the mixed local problem of the frictional contact library
(https://frictionalcontactlibrary.github.io, src/fclib.h), with friction alone:

    V^T r + s = 0,  velocity = V lambda + q,  W = R = 0,  r in the cone of friction, velocity opposite, as Coulomb says.

There lambda is u and then, for each contact, a velocity along its normal. Nothing but the given normal force balances
that one, so each normal force is the given one; where r is so, the normal velocity is 0.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import sparse

from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import write_hdf5, write_text
from taichi_bearings.packing import Packing
from taichi_bearings.packing.system import System
from taichi_bearings.runs.packing_run import is_packing_run, packing_to_draw
from taichi_bearings.runs.points_and_lines import opened_to_draw
from taichi_bearings.runs.run import settings_of
from taichi_bearings.scene import Scene
from taichi_bearings.stages import stage
from taichi_bearings.version import VERSION

PROBLEM_NAMES = {"cbf": "problem.cbf", "fclib": "problem.hdf5"}


def export_problem(
    run: Path, form: str, out: Path | None = None, force: bool = False, replica: int = 0
) -> dict[str, Any]:
    """Write the problem of one sample of a run, and say what the file holds; arguments as of vtkhdf.export.

    form : "cbf" or "fclib". Raises InputError for a problem that the format cannot say.
    """
    if is_packing_run(run):
        with packing_to_draw(run, out, PROBLEM_NAMES[form], force, replica) as (found, path):
            return _write(found.result.packing, form, path)
    with opened_to_draw(run, out, PROBLEM_NAMES[form], force) as (stored, path):
        if not 0 <= replica < stored.solution.scene.replicas:
            raise InputError(f"replica is {replica}; the run has {stored.solution.scene.replicas}, counted from 0")
        if (torque := settings_of(stored).torque) is not None:
            raise InputError(
                f"the run has a torque of {torque} on its top; a problem of imposed spins is written alone"
            )
        return _write(packing_of(stored.solution.scene.sample(replica)), form, path)


def packing_of(scene: Scene) -> Packing:
    """A lattice of one sample as a packing: driven bodies 0, the bottom at rest, and 1, the top with the difference."""
    lattice, axes = scene.lattice, list(scene.minimum_spin_axes)
    body, spin = np.full(lattice.shape, -1), np.zeros((*lattice.shape, 3))
    body[..., 0], body[..., -1] = 0, 1
    spin[..., -1, axes] = lattice.parity[..., -1, None] * np.moveaxis(scene.top_spin(tuple(axes)), 0, -1)
    of = [values[0] for values in scene.named_coefficients.values()]
    return Packing(
        center=2 * lattice.radius * np.argwhere(np.ones(lattice.shape, dtype=bool)),
        contact=lattice.ends.T, driven=body.ravel(),
        spin=spin.reshape(-1, 3) if lattice.dimension == 3 else spin[..., 2].ravel(),
        radius=lattice.radius, normal=np.eye(lattice.dimension)[lattice.axis], friction=of[0],
        viscosity=of[1] if len(of) > 1 else None, normal_force=scene.normal_force, law=scene.law,
    )  # fmt: skip


def _write(packing: Packing, form: str, path: Path) -> dict[str, Any]:
    with stage("writing"):
        system = System.of(packing)
        if not len(system.contact):
            raise InputError(
                f"{packing!r} has no contact between free and driven spheres; there is nothing to minimise"
            )
        if form == "cbf":
            write_text(path, cbf(system))
        else:
            if not packing.kind.is_rate_independent:
                raise InputError(f"law is {packing.law}; fclib has friction alone, and cbf all laws")
            write_hdf5(path, lambda file: write_fclib(file, system))
    told = {"unknowns": system.unknowns, "contacts": len(system.contact)}
    return {"file": str(path), "bytes": path.stat().st_size, **told}


def cbf(system: System) -> str:
    """The programme: unknowns u, then t, then s; a cone (t, slip) and a rotated one (s, 1/2, slip) for each contact.

    Components of a slip that are 0 whatever the spins are left out.
    """
    law, (d, contacts), unknowns = system.packing.kind, system.offset.shape, system.unknowns
    parts = (law.holding_force(system.coefficients), law.viscosity(system.coefficients) if law.flows else None)
    held, viscosity = (np.zeros(contacts) if part is None else part for part in parts)
    slips, beside = sparse.coo_array(system.matrix), sparse.eye_array(2 * contacts)
    rows = sparse.vstack([sparse.block_diag([slips, beside]), sparse.coo_array((1, unknowns + 2 * contacts))]).tocsr()
    constant = np.concatenate([system.offset.ravel(), np.zeros(2 * contacts), [0.5]])
    first, half = d * contacts, len(constant) - 1  # rows of t, after those of slips, and of 1/2
    live = (np.diff(system.matrix.indptr) > 0).reshape(d, -1) | (system.offset != 0)
    order, cones = [], list[str]()
    for acts, head, kind in ((held, lambda e: [first + e], "Q"),
                             (viscosity, lambda e: [first + contacts + e, np.full_like(e, half)], "QR")):  # fmt: skip
        for count in range(1, d + 1):
            e = np.flatnonzero((acts > 0) & (live.sum(axis=0) == count))
            tangent = np.nonzero(live[:, e].T)[1].reshape(-1, count)
            order.append(np.column_stack([*head(e), tangent * contacts + e[:, None]]))
            cones += [f"{kind} {order[-1].shape[1]}"] * len(e)
    chosen = np.concatenate([block.ravel() for block in order])
    matrix, constant = rows[chosen].tocoo(), constant[chosen]
    cost = law.share * np.concatenate([np.zeros(unknowns), held, viscosity / 2])
    items = {
        "VER": ["1"],
        "OBJSENSE": ["MIN"],
        "VAR": [f"{len(cost)} 1", f"F {len(cost)}"],
        "CON": [f"{len(constant)} {len(cones)}", *cones],
        "OBJACOORD": _listed(np.flatnonzero(cost), values=cost[cost != 0]),
        "ACOORD": _listed(matrix.row, matrix.col, values=matrix.data),
        "BCOORD": _listed(np.flatnonzero(constant), values=constant[constant != 0]),
    }
    notes = f"# taichi_bearings {VERSION}: {system.packing!r}\n# the optimum is the least {law.minimises}\n"
    return notes + "".join(f"\n{name}\n" + "\n".join(lines) + "\n" for name, lines in items.items())


def _listed(*places: np.ndarray, values: np.ndarray) -> list[str]:
    columns: Iterable[Any] = [*(place.tolist() for place in places), map(repr, values.tolist())]
    return [str(len(values)), *(" ".join(map(str, line)) for line in zip(*columns, strict=True))]


def write_fclib(file: h5py.File, system: System) -> None:
    """The problem, in the layout of fclib_write_local; local frames are the normal and then the tangents."""
    (d, contacts), unknowns = system.offset.shape, system.unknowns
    turn = np.concatenate([np.arange(contacts), contacts + np.arange(d * contacts)]).reshape(d + 1, -1).T.ravel()
    slips = sparse.block_array([[None, sparse.eye_array(contacts)], [system.matrix, None]]).tocsr()[turn]
    size, free = slips.shape
    root = file.create_group("fclib_local")
    root["spacedim"] = np.array([d + 1], dtype=np.int32)
    for name, matrix in (
        ("W", sparse.csc_array((size, size))),
        ("V", slips.tocsc()),
        ("R", sparse.csc_array((free,) * 2)),
    ):
        numbers = {"nzmax": [matrix.nnz], "m": [matrix.shape[0]], "n": [matrix.shape[1]], "nz": [-1]}  # -1: by columns
        for key, values in {**numbers, "p": matrix.indptr, "i": matrix.indices}.items():
            root[f"{name}/{key}"] = np.asarray(values, dtype=np.int32)
        root[f"{name}/x"] = matrix.data
    normal_force = np.broadcast_to(system.packing.normal_force, system.packing.contacts)[system.contact]
    root["vectors/q"] = np.concatenate([np.zeros(contacts), system.offset.ravel()])[turn]
    root["vectors/s"] = np.concatenate([np.zeros(unknowns), -normal_force])
    root["vectors/mu"] = system.coefficients[0] / normal_force
    root["info/title"] = np.bytes_(f"taichi_bearings {VERSION}")
    root["info/description"] = np.bytes_(f"{system.packing!r}; spins that dissipate least, given normal forces")
    root["info/math_info"] = np.bytes_("convex; solutions exist; forces at slipping contacts are unique")
