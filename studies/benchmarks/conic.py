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

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem, lattice_system
from taichi_bearings.conic.grouped import Arrays, each
from taichi_bearings.errors import InputError
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class Differences:
    """The differences D = matrix @ spins + offset: contacts of one component, then the first of two, then the second.

    order : of each row, its place among those of the system, group by group. coefficient : of the contact of each row.
    scalars : number of rows of contacts with one component.
    """

    system: ContactSystem
    order: np.ndarray
    matrix: sparse.csr_matrix
    offset: np.ndarray
    coefficient: np.ndarray
    scalars: int

    @property
    def vectors(self) -> int:
        return (len(self.offset) - self.scalars) // 2

    def on_contacts(self, values: np.ndarray) -> Arrays:
        """Values of the rows as vectors (d, n) a group."""
        in_groups = np.empty_like(values)
        in_groups[self.order] = values
        return self.system.grouped(in_groups)


def build_differences(scene: Scene) -> Differences:
    """The differences of a scene of one replica, as functions of its free spins in units of the jump."""
    axes = scene.minimum_spin_axes
    system = lattice_system(scene.lattice, axes, scene.top_spin(axes) / (scene.jump or 1.0))
    components = each(lambda z: np.full(z.shape, len(z)), system.offset)
    part = each(lambda z: np.indices(z.shape)[0], system.offset)
    order = np.lexsort((_flat(part), _flat(components)))
    by_component = np.arange(system.unknowns).reshape(-1, len(axes)).T.ravel()
    return Differences(
        system,
        order,
        system.operator[order][:, by_component],
        _flat(system.offset)[order],
        _coefficients(system, scene)[order],
        scalars=int((_flat(components) == 1).sum()),
    )


def _coefficients(system: ContactSystem, scene: Scene) -> np.ndarray:
    """Of the contact of each difference, group by group."""
    return _flat(each(np.broadcast_to, system.gather(scene.coefficient, 0), each(np.shape, system.offset)))


def _flat(values: Arrays) -> np.ndarray:
    return np.concatenate([part.ravel() for part in values])


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
        for spins, values in zip(staggered, own, strict=True):
            spins[0, free] = scene.jump * values
        return scene.impose_driving(scene.clip_to_box(staggered, axes), axes)

    def forces(self, z: np.ndarray) -> np.ndarray:
        """Contact forces (C, 1, E) of the multipliers z of the rows."""
        scene, pairs = self.scene, self.inequalities // 2
        if not scene.law.holds:
            along = scene.lattice.radius * scene.jump / 2 * z
        else:
            cones = z[2 * pairs :].reshape(-1, 3)
            along = scene.normal_force * np.concatenate([z[:pairs] - z[pairs : 2 * pairs], -cones[:, 1], -cones[:, 2]])
        forces = np.zeros((len(scene.minimum_spin_axes), 1, scene.lattice.all_contacts))
        self.differences.system.scatter_vectors(self.differences.on_contacts(along), forces, 0)
        return forces


def with_coefficients(programme: ConicProgramme, scene: Scene) -> ConicProgramme:
    """The Coulomb programme of another sample of the same lattice and driving: nothing but the costs changes."""
    rows = programme.differences
    coefficient = _coefficients(rows.system, scene)[rows.order]
    linear = programme.linear.copy()
    linear[rows.matrix.shape[1] :] = coefficient[: rows.scalars + rows.vectors]
    return replace(
        programme, scene=scene, linear=linear, differences=replace(programme.differences, coefficient=coefficient)
    )


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
