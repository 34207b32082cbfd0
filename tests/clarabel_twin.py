"""The one cone programme of all slow twins: least friction and viscosity over spins, by Clarabel."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import sparse


@dataclass(frozen=True)
class Least:
    """objective : friction and half of what viscosity takes. spins (U,), slip (E,), force (E, k) along the slips.
    status : Clarabel's own word."""

    objective: float
    spins: np.ndarray
    slip: np.ndarray
    force: np.ndarray
    status: str


def least(slips, fixed, held, viscosity, tolerance=1e-11, inertia=0.0, before=0.0):
    """Spins that minimise sum held |v| + viscosity |v|^2 / 2 with v = slips @ spins + fixed, (E, k), and
    inertia / 2 |spins - before|^2."""
    clarabel = pytest.importorskip("clarabel")
    (contacts, k), unknowns = fixed.shape, slips.shape[1]
    slips, every, known = sparse.csc_matrix(slips), np.repeat(viscosity, k), fixed.ravel()
    bends = slips.T @ sparse.diags(every) @ slips + inertia * sparse.identity(unknowns)
    quadratic = sparse.block_diag([bends, sparse.csc_matrix((contacts, contacts))])
    linear = np.concatenate([slips.T @ (every * known) - inertia * np.broadcast_to(before, unknowns), held])
    rows = contacts * (k + 1)  # a bound of |v| and v itself, contact by contact
    first, rest = np.arange(contacts) * (k + 1), np.flatnonzero(np.arange(rows) % (k + 1))
    place = sparse.csc_matrix((np.ones(k * contacts), (rest, range(k * contacts))), (rows, k * contacts))
    heights = sparse.csc_matrix((np.ones(contacts), (first, range(contacts))), (rows, contacts))
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads, settings.max_iter = False, 1, 300
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    found = clarabel.DefaultSolver(
        sparse.triu(quadratic).tocsc(), linear, sparse.hstack([-place @ slips, -heights]).tocsc(), place @ known,
        [clarabel.SecondOrderConeT(k + 1)] * contacts, settings,
    ).solve()  # fmt: skip
    spins = np.nan_to_num(np.array(found.x)[:unknowns])
    moves = slips @ spins + known
    force = every * moves - np.nan_to_num(np.array(found.z))[rest]
    constant = (every * known**2).sum() / 2 + inertia / 2 * (np.broadcast_to(before, unknowns) ** 2).sum()
    slip = np.linalg.norm(moves.reshape(-1, k), axis=1)
    return Least(found.obj_val + constant, spins, slip, force.reshape(-1, k), str(found.status))
