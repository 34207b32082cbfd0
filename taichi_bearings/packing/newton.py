"""The matrix of a Newton step, sum K_e^T S_e K_e over the contacts, in an order of elimination from the centres."""

import numpy as np
from scipy import sparse

from taichi_bearings.numerics.cholesky import Cholesky, NotPositiveDefinite
from taichi_bearings.packing.motions import unknowns_of
from taichi_bearings.packing.system import System

RAISED_DIAGONALS = (0.0, 1e-15, 1e-13, 1e-11)  # relative additions to the diagonal, tried one after the other
REFINEMENTS = 3


class NewtonMatrix:
    """Factorised matrices of one system; its pattern is analysed once."""

    def __init__(self, system: System) -> None:
        self.system, self.factorisations = system, 0
        first, second, source, contact = _pairs(system)
        apart = first != second
        self.cholesky = Cholesky(
            system.unknowns,
            lambda: np.concatenate(unknowns_of(system.sphere, system.parts())),
            (first[apart], second[apart]),
        )
        components = system.moved.shape[1]
        size = components * (components + 1) // 2
        entry = self.cholesky.pattern.entry(first, second)
        shape = (self.cholesky.pattern.entries, size * len(system.contact))
        of = source * len(system.contact) + contact
        self._map = sparse.csr_array((np.ones(len(entry)), (entry, of)), shape=shape)
        across, (row, column) = system.across, np.tril_indices(components)
        self._outer = np.einsum("tec,sec->tsce", across[..., row], across[..., column])  # (d, d, pairs, A)
        self._outer = (self._outer + self._outer.transpose(1, 0, 2, 3)) / 2

    def entries(self, stiffness: np.ndarray) -> np.ndarray:
        """Those of the pattern, for symmetric stiffnesses (d, d, A)."""
        return self._map @ np.einsum("tse,tsce->ce", stiffness, self._outer).ravel()

    def factorise(self, stiffness: np.ndarray) -> None:
        """For symmetric positive stiffnesses (d, d, A). Raises NotPositiveDefinite where no small shift helps."""
        values = self.entries(stiffness)
        self._stiffness = stiffness
        for shift in RAISED_DIAGONALS:
            if self.factorise_entries(values, shift):
                return
        raise NotPositiveDefinite

    def factorise_entries(self, values: np.ndarray, shift: float = 0.0) -> bool:
        """True where a matrix with these entries, its diagonal raised by a share, is positive definite in floats."""
        factor, pattern = self.cholesky.factor(), self.cholesky.pattern
        self.factorisations += 1
        factor.entries[: pattern.entries, 0] = values
        factor.entries[pattern.diagonal, 0] *= 1 + shift
        return bool(np.isfinite(values).all() and factor.factorise()[0])

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Of the factorised matrix, (unknowns,)."""
        return self.cholesky.solve(right[:, None])[:, 0] if len(right) else right

    def refined(self, right: np.ndarray) -> np.ndarray:
        """Of the matrix of the last stiffnesses, corrected as long as that helps."""
        found = self.solve(right)
        last = np.inf
        for _ in range(REFINEMENTS):
            change = resisted(self._stiffness, self.system.change(found))
            left = right - self.system.torques(change)
            size = float(np.abs(left).max(initial=0.0))
            if not size < last / 2:
                break
            last, found = size, found + self.solve(left)
        return found

    def balanced(self, force: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """Forces (d, A) without the torques that they leave, which springs of these stiffnesses (d, d, A) take."""
        self.factorise(stiffness)
        for _ in range(REFINEMENTS):
            force = force - resisted(stiffness, self.system.change(self.solve(self.system.torques(force))))
        return force


def resisted(stiffness: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Forces (d, A) that stiffnesses (d, d, A) put up against a change (d, A) of the slips."""
    return np.einsum("tse,se->te", stiffness, change)


def isotropic(size: np.ndarray, d: int) -> np.ndarray:
    """Stiffnesses (d, d, A) that are the same in all directions, of sizes (A,)."""
    return np.eye(d)[:, :, None] * size


def _pairs(system: System) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Unknowns that a contact couples, in pairs, the place in the lower triangle of components, and the contact."""
    components = system.moved.shape[1]
    unknown = system.moved[system.packing.contact[system.contact]].reshape(-1, 2 * components)
    place = np.zeros((components, components), dtype=np.int64)
    row, column = np.tril_indices(components)
    place[row, column] = place[column, row] = np.arange(len(row))
    found = []
    for a in range(2 * components):
        for b in range(a, 2 * components):
            at = np.flatnonzero((unknown[:, a] >= 0) & (unknown[:, b] >= 0))
            source = np.full(len(at), place[a % components, b % components])
            found.append((unknown[at, a], unknown[at, b], source, at))
    first, second, source, contact = (np.concatenate(part) for part in zip(*found, strict=True))
    return first, second, source, contact
