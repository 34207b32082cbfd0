"""The matrix of a Newton step: a Laplacian over the spins with a d x d stiffness at every contact."""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem, stacked
from taichi_bearings.conic.grouped import Arrays, each
from taichi_bearings.conic.rows import ContactRows
from taichi_bearings.numerics.cholesky import FEW, Cholesky, NotPositiveDefinite, WholeCholesky
from taichi_bearings.numerics.cholesky.factor import Memory, compile_fronts
from taichi_bearings.numerics.cholesky.side_by_side import MANY, CholeskyAlone

REFINEMENTS = 4  # of balanced forces; two do where the springs are of one size
SHIFTS = (0.0, 1e-14, 1e-12, 1e-10)  # relative additions to the diagonal, tried one after the other


AnyCholesky = WholeCholesky | CholeskyAlone | Cholesky


def cholesky_of(
    unknowns: int, order: Callable[[], np.ndarray], couplings: tuple[np.ndarray, np.ndarray], memory: Memory | None
) -> AnyCholesky:
    """What is quickest for so many unknowns. order : of elimination. couplings : pairs that are coupled. memory : for
    large ones."""
    if unknowns <= FEW:
        return WholeCholesky(unknowns)
    return CholeskyAlone(order(), *couplings) if unknowns < MANY else Cholesky(order(), *couplings, memory)


def factorise_raised(cholesky: AnyCholesky, values: np.ndarray, inertia: float | np.ndarray = 0.0) -> None:
    """Factorise the matrix with these values at the entries of the pattern, and a spring at every spin, (unknowns,).

    Raises NotPositiveDefinite if no addition to the diagonal helps. The values are changed.
    """
    if isinstance(inertia, np.ndarray):
        inertia = inertia[cholesky.pattern.order]
    diagonal = values[cholesky.pattern.diagonal] + inertia
    for shift in SHIFTS:
        values[cholesky.pattern.diagonal] = diagonal * (1 + shift)
        try:
            return cholesky.factorise(values)
        except NotPositiveDefinite:
            if shift == SHIFTS[-1] or not np.isfinite(diagonal).all():
                raise


class NewtonMatrix:
    """Factorised weighted Laplacian of a contact system; the pattern is analysed once."""

    def __init__(self, system: ContactSystem, order: np.ndarray, memory: Memory | None = None) -> None:
        """order : of elimination of the unknowns of `system`. memory : that of a matrix which is not needed as long."""
        self._system, self.memory = system, memory or Memory()
        self._empty = system.unknowns == 0  # everything is tied to the driven planes
        if self._empty:
            return
        self._cholesky = cholesky_of(system.unknowns, lambda: order, system.couplings(), self.memory)
        pattern = self._cholesky.pattern
        self._map = system.laplacian_map(pattern.entry, pattern.entries)

    def compile(self) -> None:
        """Compile what it needs, before the clock starts."""
        if not self._empty and isinstance(self._cholesky, Cholesky):
            compile_fronts()

    def factorise(self, stiffness: Arrays, inertia: float | np.ndarray = 0.0) -> None:
        """Factorise for symmetric positive stiffnesses, (d, d, n) a group, and a spring at every spin, (unknowns,).

        Stiffnesses over twenty decades can leave a pivot that rounding made negative; then the diagonal is raised by
        as little as helps, and iterative refinement has to mend the rest.

        Raises NotPositiveDefinite if nothing helps.
        """
        self.factorise_stacked(stacked(stiffness), inertia)

    def factorise_stacked(self, stiffness: np.ndarray, inertia: float | np.ndarray = 0.0) -> None:
        """The same for upper triangles as `stacked` gives them."""
        if self._empty:
            return
        factorise_raised(self._cholesky, self._map @ stiffness, inertia)

    def rows(self, samples: int = 1) -> ContactRows:
        """Memory for Newton steps of a single sample."""
        return self._rows

    @cached_property
    def _rows(self) -> ContactRows:
        return self._system.rows(np.zeros((max(1, self._system.unknowns), 1)))

    def factorise_each(
        self, rows: ContactRows, wanted: np.ndarray, inertia: float, viscous: np.ndarray | None = None
    ) -> np.ndarray:
        """As that of NewtonMatrices."""
        stiffness = rows.upper_stiffness()[:, 0]
        try:
            self.factorise_stacked(stiffness if viscous is None else stiffness + viscous[:, 0], inertia)
        except NotPositiveDefinite:
            return np.zeros(1, dtype=bool)
        return wanted

    def factorise_given(self, stiffness: np.ndarray, inertia: np.ndarray) -> np.ndarray:
        """As that of NewtonMatrices."""
        try:
            self.factorise_stacked(stiffness[:, 0], inertia[:, 0])
        except NotPositiveDefinite:
            return np.zeros(1, dtype=bool)
        return np.ones(1, dtype=bool)

    def solve_given(self, right: np.ndarray) -> np.ndarray:
        """As that of NewtonMatrices."""
        return self.solve(right[:, 0])[:, None]

    def solve_each(self, rows: ContactRows) -> None:
        """In place."""
        rows.spins[: self._system.unknowns, 0] = self.solve(rows.spins[: self._system.unknowns, 0])

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Solution of the factorised system, (unknowns,)."""
        return right if self._empty else self._cholesky.solve(right)

    def forget(self) -> None:
        """Give the memory of a large factor back, until it is factorised anew."""
        if not self._empty:
            self._cholesky.forget()

    def balanced(self, dual: Arrays, stiffness: Arrays, load: np.ndarray | float = 0.0) -> Arrays:
        """The dual (d, n) a group with its torques taken away by springs of these stiffnesses (d, d, n), refined.

        load : torques (unknowns,) that are to stay. Raises NotPositiveDefinite if the springs do not hold every spin.
        """
        self.factorise(stiffness)
        for _ in range(REFINEMENTS):  # each from the forces of the last: what a stretch rounds falls with the stretch
            spins = self.solve(self._system.torques(dual) - load)
            dual = dual - resisted(stiffness, self._system.change(spins))
        return dual


def resisted(stiffness: Arrays, change: Arrays) -> Arrays:
    """Forces (d, n) a group that stiffnesses (d, d, n) put up against a change (d, n) of the differences."""
    return each(lambda k, dz: np.einsum("ijn,jn->in", k, dz), stiffness, change)
