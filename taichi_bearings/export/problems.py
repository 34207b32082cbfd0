"""The least power of a run as a problem for other solvers: `bearings export --format cbf` and `fclib`.

Lattices are read as packings. With

* u = R omega of the free spheres, radius times spin,
* K u + b the slip of a contact along its tangents (conic/contact_system.py),
* F the force that friction bears, and eta the viscosity of a contact,

the problem is to

    minimise  share * sum_e (F t + eta s / 2)   with   t >= |K u + b|,  s >= |K u + b|^2,

where share is 2 with viscosity alone, else 1. cbf, the conic benchmark format
(https://docs.mosek.com/latest/cmdtools/cbf-format.html), says that in cones. fclib
(https://frictionalcontactlibrary.github.io, src/fclib.h) has friction alone, as a mixed local problem: V^T r + s = 0,
velocity = V lambda + q, W = R = 0, r in its cone against the velocity. There lambda is u, followed for each contact by
a velocity along its normal: only a given normal force balances it, so that is the normal force.

Letters: d tangents of a contact.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import write_hdf5, write_text
from taichi_bearings.plain_files import Json
from taichi_bearings.runs.run_file import opened_to_draw, replica_drawn
from taichi_bearings.scene import Bearing
from taichi_bearings.stages import stage
from taichi_bearings.version import VERSION

PROBLEM_NAMES = {"cbf": "problem.cbf", "fclib": "problem.hdf5"}


def export_problem(run: str | Path, form: str, out: str | Path | None, force: bool = False, replica: int = 0) -> Json:
    """Write the minimisation problem of one sample of a run as a file for other solvers, and return what the file
    holds, by name.

    run : a run directory or its run.h5.
    form : "cbf" or "fclib".
    out : the file; an earlier one is replaced only with `force`. None for problem.cbf or problem.hdf5 in the run
        directory, where an earlier one is replaced.
    force : True to replace a file `out`.
    replica : number of the sample, from 0.

    Raises InputError for a problem that the format cannot express.
    """
    with opened_to_draw(run, out, PROBLEM_NAMES[form], force, replica) as (stored, path):
        found, which = stored.sample(replica), replica_drawn(stored, replica)
        torque = found.asked.torque
        if torque is not None and found.scene.network.lattice is not None:
            raise InputError(
                f"the top of the run is driven by a torque of {torque}; only runs with imposed spins can be exported"
            )
        return write_problem(found.solution.scene, form, path) | which


def write_problem(bearing: Bearing, form: str, path: Path) -> Json:
    """Write the minimisation problem of a bearing into a file, replacing it; return its path and its numbers of
    unknowns and contacts, by name.

    bearing : the lattice or packing, one sample.
    form : "cbf", the conic benchmark format, or "fclib", that of the frictional contact library.
    path : the file.

    Raises InputError if no contact can slip, and for the form "fclib" with viscosity.
    """
    with stage("writing"):
        system = ContactSystem.of(bearing)
        system.operator.eliminate_zeros()
        if not len(system.numbers):
            raise InputError(f"{bearing!r} has no contact of a free sphere that can slip; there is nothing to minimise")
        if form == "cbf":
            write_text(path, cbf(system, bearing))
        elif bearing.law.is_rate_independent:
            write_hdf5(path, lambda file: write_fclib(file, system, bearing))
        else:
            raise InputError(f"law is {bearing.law}; the format fclib has friction only; use --format cbf")
    return {"file": str(path), "unknowns": system.unknowns, "contacts": len(system.numbers)}


def cbf(system: ContactSystem, bearing: Bearing) -> str:
    """Return the minimisation problem as text in the conic benchmark format.

    The unknowns are u (radius * spin of free spheres), and for each contact t >= |slip| for friction and s >= |slip|^2
    for viscosity: a cone (t, slip), and a rotated cone (s, 1/2, slip). Components of slips that are 0 whatever the
    spins are left out, and so are contacts without other components.

    system : matrix and constant part of the slips.
    bearing : the lattice or packing that is to be solved.
    """
    law, (d, count), unknowns = bearing.law, system.offset.shape, system.unknowns
    can_change = (np.diff(system.operator.indptr) > 0).reshape(d, count) | (system.offset != 0)  # slip components
    coefficients = system.of_contacts(bearing)
    forces = (law.holding_force(coefficients), law.viscosity(coefficients))
    friction, viscosity = (
        np.zeros(count) if some is None else np.where(can_change.any(axis=0), some, 0.0) for some in forces
    )
    # the unknowns are u, then t and then s of each contact; the rows are the slips K u + b, then t, then s, then 1/2
    cost = law.share * np.concatenate([np.zeros(unknowns), friction, viscosity / 2])
    rows = sparse.block_diag([system.operator, sparse.eye_array(2 * count), sparse.csr_array((count, 0))], format="csr")
    constant = np.concatenate([system.offset.ravel(), np.zeros(2 * count), np.full(count, 0.5)])
    # choose the rows of each cone: its heads, t or (s, 1/2), and then the components of the slip that can change
    # (rows form blocks with a row for every contact: d blocks of slip components, then one each of t, s and 1/2)
    order, cones = [], list[str]()
    for force, heads, kind in ((friction, [d], "Q"), (viscosity, [d + 1, d + 2], "QR")):  # a cone, a rotated cone
        contacts = np.flatnonzero(force)
        cone_of_slip, tangent = np.nonzero(can_change[:, contacts].T)
        cone = np.concatenate([np.tile(np.arange(len(contacts)), len(heads)), cone_of_slip])
        block = np.concatenate([np.repeat(heads, len(contacts)), tangent])
        order.append((block * count + contacts[cone])[np.argsort(cone, kind="stable")])
        cones += [f"{kind} {len(heads) + size}" for size in can_change[:, contacts].sum(axis=0)]
    used = (np.arange(len(cost)) < unknowns) | (cost > 0)
    matrix, constant, cost = rows[np.concatenate(order)][:, used].tocoo(), constant[np.concatenate(order)], cost[used]
    items: dict[str, list[Any]] = {"VER": [1], "OBJSENSE": ["MIN"], "VAR": [f"{len(cost)} 1", f"F {len(cost)}"]}
    items["CON"] = [f"{len(constant)} {len(cones)}", *cones]
    for name, parts in (("OBJACOORD", cost), ("ACOORD", (matrix.row, matrix.col, matrix.data)), ("BCOORD", constant)):
        columns = parts if isinstance(parts, tuple) else (np.flatnonzero(parts), parts[parts != 0])
        lines = zip(*(column.tolist() for column in columns), strict=True)
        items[name] = [len(columns[0]), *(" ".join(map(repr, line)) for line in lines)]
    notes = f"# taichi_bearings {VERSION}: {bearing!r}\n# the optimum is the least {law.minimises}\n"
    return notes + "".join("\n".join(["", name, *map(str, lines), ""]) for name, lines in items.items())


def write_fclib(file: h5py.File, system: ContactSystem, bearing: Bearing) -> None:
    """Write the minimisation problem in the layout of fclib_write_local: velocity = V lambda + q, V^T r + s = 0, where
    r are the contact forces, W = R = 0, and lambda are radius * spin of the free spheres and then, for each contact, a
    velocity along its normal. The local frame of a contact is its normal, then its tangents.

    file : the opened file.
    system : matrix and constant part of the slips.
    bearing : the lattice or packing that is to be solved.
    """
    d, count = system.offset.shape
    by_contact = np.arange((d + 1) * count).reshape(d + 1, count).T.ravel()  # all components of a contact together
    slips = sparse.block_array([[None, sparse.eye_array(count)], [system.operator, None]], format="csr")[by_contact]
    file["fclib_local/spacedim"] = np.array([d + 1], dtype=np.int32)
    nothing = {name: sparse.csc_array((size, size)) for name, size in zip("WR", slips.shape, strict=True)}
    for name, matrix in {"V": slips.tocsc(), **nothing}.items():
        sizes = {"nzmax": [matrix.nnz], "m": matrix.shape[:1], "n": matrix.shape[1:], "nz": [-1]}  # -1: by columns
        for key, values in {**sizes, "p": matrix.indptr, "i": matrix.indices}.items():
            file[f"fclib_local/{name}/{key}"] = np.asarray(values, dtype=np.int32)
        file[f"fclib_local/{name}/x"] = matrix.data
    normal_force = np.broadcast_to(bearing.normal_force, system.network.contacts)[system.contact]
    file["fclib_local/vectors/q"] = np.concatenate([np.zeros(count), system.offset.ravel()])[by_contact]
    file["fclib_local/vectors/s"] = np.concatenate([np.zeros(system.unknowns), -normal_force])
    file["fclib_local/vectors/mu"] = system.of_contacts(bearing)[0] / normal_force
    file["fclib_local/info/title"] = np.bytes_(f"taichi_bearings {VERSION}: {bearing!r}")
