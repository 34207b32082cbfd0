"""The least power as a conic programme in sparse matrices, as Clarabel and SCS read it.

    minimise  x.P.x / 2 + q.x   subject to   A x + s = b,   s in {0} x {s >= 0} x second-order cones of three

The first unknowns are the staggered spins of the free spheres, above the bottom's and in units of the imposed jump; the
driven ones are put in as numbers, and components that the driving does not need are left out. With D the difference
across a contact (one tangential component or two):

    Coulomb:  minimise sum mu t,      |D| <= t        one component: t - D >= 0, t + D >= 0; two: (t, D) in a cone
    viscous:  minimise sum eta v.v,   D - v = 0

The multipliers z of the rows are the contact forces along D: for Coulomb, in units of the normal force, z_1 - z_2 of a
pair and minus the last two of a cone; for viscous contacts half of z, in units of R times the jump.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from taichi_bearings.errors import InputError
from taichi_bearings.lattice.grid import contact_differences, lower, tangential, upper
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class Differences:
    """The differences D = matrix @ spins + offset: contacts of one component, then the first of two, then the second.

    blocks : (axis, component) of each stretch of rows; a stretch runs over the contacts of its axis that can slip.
    coefficient : of the contact of each row. scalars : number of rows of contacts with one component.
    """

    matrix: sparse.csr_matrix
    offset: np.ndarray
    blocks: tuple[tuple[int, int], ...]
    coefficient: np.ndarray
    scalars: int

    @property
    def vectors(self) -> int:
        return (len(self.offset) - self.scalars) // 2


def build_differences(scene: Scene) -> Differences:
    """The differences of a scene of one replica, as functions of its free spins in units of the jump."""
    lattice, axes = scene.lattice, scene.minimum_spin_axes
    slots = [tangential(axis, axes) for axis in range(lattice.dimension)]
    blocks = [
        (axis, part)
        for parts, part in ((1, 0), (2, 0), (2, 1))
        for axis in range(lattice.dimension)
        if len(slots[axis]) == parts
    ]
    free = ~lattice.is_driven
    number = np.full(lattice.shape, -1)
    number[free] = np.arange(free.sum())
    driven = scene.impose_driving(np.zeros((len(axes), 1, *lattice.shape)), axes)
    fixed = contact_differences(driven / (scene.jump or 1.0), lattice, axes)
    matrices, offsets, coefficients = [], [], []
    for axis, part in blocks:
        can_slip = ~lattice.between_driven(axis)
        rows, columns, values = [], [], []
        for side, sign in ((upper, 1.0), (lower, -1.0)):
            sphere = side(number, axis, lattice.dimension)[can_slip]
            moves = np.flatnonzero(sphere >= 0)
            rows.append(moves)
            columns.append(sphere[moves] + slots[axis][part] * free.sum())
            values.append(np.full(len(moves), sign))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        matrices.append(sparse.csr_matrix(entries, shape=(can_slip.sum(), len(axes) * free.sum())))
        offsets.append(fixed[axis][part, 0][can_slip])
        coefficients.append(scene.coefficient[axis][0][can_slip])
    scalars = sum(len(values) for (axis, _), values in zip(blocks, offsets, strict=True) if len(slots[axis]) == 1)
    return Differences(
        sparse.csr_matrix(sparse.vstack(matrices)),
        np.concatenate(offsets),
        tuple(blocks),
        np.concatenate(coefficients),
        scalars,
    )


@dataclass(frozen=True)
class ConicProgramme:
    """Matrices as in the module docstring; rows of A: `equalities`, then `inequalities`, then three a cone."""

    scene: Scene
    differences: Differences
    quadratic: sparse.csc_matrix
    linear: np.ndarray
    matrix: sparse.csc_matrix
    offset: np.ndarray
    equalities: int
    inequalities: int
    cones: int

    def spins(self, x: np.ndarray) -> np.ndarray:
        """Staggered spins (C, 1, *N) of a solution x: finite, in the interval of the driven ones, and driven."""
        scene, axes = self.scene, self.scene.minimum_spin_axes
        staggered = np.zeros((len(axes), 1, *scene.lattice.shape))
        free = ~scene.lattice.is_driven
        own = np.nan_to_num(x[: len(axes) * free.sum()]).reshape(len(axes), -1)
        for spins, values, top in zip(staggered, own, scene.driven_values(axes)[1], strict=True):
            spins[0, free] = np.clip(scene.jump * values, min(0.0, top), max(0.0, top))
        return scene.impose_driving(staggered, axes)

    def forces(self, z: np.ndarray) -> tuple[np.ndarray, ...]:
        """Contact forces, one array (T, 1, *contacts) an axis, of the multipliers z of the rows."""
        scene, lattice, pairs = self.scene, self.scene.lattice, self.inequalities // 2
        if not scene.law.holds:
            along = lattice.radius * scene.jump / 2 * z
        else:
            cones = z[2 * pairs :].reshape(-1, 3)
            along = scene.normal_force * np.concatenate([z[:pairs] - z[pairs : 2 * pairs], -cones[:, 1], -cones[:, 2]])
        axes = range(lattice.dimension)
        parts = [len(tangential(axis, scene.minimum_spin_axes)) for axis in axes]
        forces = tuple(np.zeros((parts[axis], 1, *lattice.contact_shape(axis))) for axis in axes)
        start = 0
        for axis, part in self.differences.blocks:
            can_slip = ~lattice.between_driven(axis)
            forces[axis][part, 0, can_slip] = along[start : start + can_slip.sum()]
            start += can_slip.sum()
        return forces


def conic_programme(scene: Scene) -> ConicProgramme:
    """The least power of `scene`, which must have one replica, as a conic programme."""
    if scene.replicas != 1:
        raise InputError(f"the scene has {scene.replicas} replicas; a conic programme describes one")
    differences = build_differences(scene)
    if not scene.law.holds:
        return _viscous(scene, differences)
    if scene.law.flows:
        raise InputError(f"law is {scene.law}; only one coefficient a contact can be written as a conic programme")
    return _coulomb(scene, differences)


def _viscous(scene: Scene, differences: Differences) -> ConicProgramme:
    rows, unknowns = differences.matrix.shape
    return ConicProgramme(
        scene,
        differences,
        quadratic=sparse.diags(np.concatenate([np.zeros(unknowns), 2 * differences.coefficient]), format="csc"),
        linear=np.zeros(unknowns + rows),
        matrix=sparse.hstack([differences.matrix, -sparse.identity(rows)], format="csc"),
        offset=-differences.offset,
        equalities=rows,
        inequalities=0,
        cones=0,
    )


def _coulomb(scene: Scene, differences: Differences) -> ConicProgramme:
    scalars, vectors, unknowns = differences.scalars, differences.vectors, differences.matrix.shape[1]
    size = unknowns + scalars + vectors
    slide = sparse.hstack([differences.matrix, sparse.csr_matrix((len(differences.offset), scalars + vectors))]).tocsr()
    least = sparse.identity(size, format="csr")[unknowns:]
    fixed = differences.offset
    matrix = sparse.vstack(
        [slide[:scalars] - least[:scalars], -slide[:scalars] - least[:scalars], -least[scalars:], -slide[scalars:]]
    )
    offset = np.concatenate([-fixed[:scalars], fixed[:scalars], np.zeros(vectors), fixed[scalars:]])
    cone_rows = 2 * scalars + np.arange(3 * vectors).reshape(3, vectors).T.ravel()  # t, D_1, D_2 of one cone together
    order = np.concatenate([np.arange(2 * scalars), cone_rows])
    return ConicProgramme(
        scene,
        differences,
        quadratic=sparse.csc_matrix((size, size)),
        linear=np.concatenate([np.zeros(unknowns), differences.coefficient[: scalars + vectors]]),
        matrix=matrix.tocsr()[order].tocsc(),
        offset=offset[order],
        equalities=0,
        inequalities=2 * scalars,
        cones=vectors,
    )
