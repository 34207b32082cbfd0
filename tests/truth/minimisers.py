"""All minimisers, from the one in their middle: how many dimensions they have, and what slips at every one.

Their slips point the same way, so they are a polyhedron: slips t_e >= 0 along fixed directions.
"""

import numpy as np
from flint import arb

from tests.truth.cones import dot, exact
from tests.truth.problem import Problem

SLIPLESS, SLIPPING, EITHER, DRIVEN, UNKNOWN = range(5)  # at every minimum; EITHER: slips at some, rests at others
RANK = 1e-25  # pivots below count as zero: directions are known to 1e-35 or better
NEVER = 1e-7  # share of its slip in the middle down to which a contact must be able to go for EITHER
MOVED = 1e-12  # change of a slip over that in the middle below which it is the same at all minimisers


def with_all_minimisers(problem: Problem, limits, direction, slips) -> tuple[int, list[int]]:
    """Dimension of the minimisers, and SLIPPING turned into EITHER where some minimiser rests."""
    basis = _freedom(problem, limits, direction)
    moving = [e for e, limit in enumerate(limits) if limit == SLIPPING]
    columns = []
    for spins in basis:
        changes = problem.changes(spins)
        columns.append([(dot(direction[e], changes[e]) / slips[e]).mid() for e in moving])
    columns = _orthonormal(columns)
    if not columns:
        return len(basis), limits
    from scipy.optimize import linprog

    rows = np.array([[float(x) for x in column] for column in columns]).T
    limits = list(limits)
    for number, e in enumerate(moving):
        if np.abs(rows[number]).max() < MOVED:
            continue
        # t_e / t_e(middle) = 1 + rows @ y >= 0: the least value of one of them
        found = linprog(rows[number], A_ub=-rows, b_ub=np.ones(len(rows)), bounds=(None, None), method="highs")
        limits[e] = UNKNOWN if found.status not in (0, 3) else EITHER if found.fun < -1 + NEVER else SLIPPING
    return len(basis), limits


def _orthonormal(columns):
    """The same space, columns of length 1 at right angles; columns of no length are left out."""
    kept = []
    for column in columns:
        for _ in range(2):
            for other in kept:
                along = dot(other, column)
                column = [(x - along * y).mid() for x, y in zip(column, other, strict=True)]
        norm = dot(column, column).sqrt()
        if norm.mid() > RANK:
            kept.append([(x / norm).mid() for x in column])
    return kept


def _freedom(problem: Problem, limits, direction):
    """Basis of the changes of the spins that keep resting contacts at rest and slips along their directions."""
    parent = list(range(problem.unknowns + 1))  # the last one: driven
    driven = problem.unknowns

    def root(i):
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for c, limit in zip(problem.contacts, limits, strict=True):
        if limit == SLIPLESS:
            for low, up in zip(c.lower, c.upper, strict=True):
                parent[root(up if up >= 0 else driven)] = root(low if low >= 0 else driven)
    clusters = sorted({root(i) for i in range(problem.unknowns)} - {root(driven)})
    place = {cluster: number for number, cluster in enumerate(clusters)}

    def column(i):
        return place.get(root(i)) if i >= 0 else None

    rows = []
    for c, limit, d in zip(problem.contacts, limits, direction, strict=True):
        if limit == SLIPPING and len(d) == 2:
            row = [arb(0)] * len(clusters)
            for part, low, up in zip((-d[1], d[0]), c.lower, c.upper, strict=True):
                if column(up) is not None:
                    row[column(up)] += part
                if column(low) is not None:
                    row[column(low)] -= part
            rows.append([x.mid() for x in row])
    basis = []
    for vector in _null_space(rows, len(clusters)):
        basis.append([vector[column(i)] if column(i) is not None else arb(0) for i in range(problem.unknowns)])
    return basis


def _null_space(rows, width):
    """Vectors x with rows . x = 0, by elimination with complete pivoting of rows scaled to largest entry 1."""
    rows = [row for row in (_scaled(row) for row in rows) if row is not None]
    pivots, left = [], list(range(width))
    done = []
    while rows and left:
        size, r, c = max((abs(float(row[c])), r, c) for r, row in enumerate(rows) for c in left)
        if size < RANK:
            break
        pivot = rows.pop(r)
        pivot = [(x / pivot[c]).mid() for x in pivot]
        rows = [
            [(x - row[c] * y).mid() for x, y in zip(row, pivot, strict=True)] if row[c] != 0 else row for row in rows
        ]
        done = [[(x - row[c] * y).mid() for x, y in zip(row, pivot, strict=True)] for row in done] + [pivot]
        pivots.append(c)
        left.remove(c)
    vectors = []
    for c in left:
        vector = [arb(0)] * width
        vector[c] = arb(1)
        for p, row in zip(pivots, done, strict=True):
            vector[p] = -row[c]
        vectors.append(vector)
    return vectors


def _scaled(row):
    size = max((abs(float(x)) for x in row), default=0.0)
    return [x / exact(size) for x in row] if size > RANK else None
