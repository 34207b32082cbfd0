"""The least power as a conic programme in sparse matrices, as Clarabel, SCS and moreau read it.

    minimise  x.P.x / 2 + q.x   subject to   A x + s = b,   s in {0} x {s >= 0} x second-order cones of three

The first unknowns are those of a packing (`packing/system.py`): velocities u of free spheres, here over R times the
imposed jump, measured from the bottom. With y = K u + b the slip of a contact, one tangential component or two:

    Coulomb:  minimise sum mu t,      |y| <= t        one component: t - y >= 0, t + y >= 0; two: (t, y) in a cone
    viscous:  minimise sum eta v.v,   y - v = 0

The multipliers z of the rows are the contact forces along y: for Coulomb, in units of the normal force, z_1 - z_2 of a
pair and minus the last two of a cone; for viscous contacts half of z, in units of R times the jump.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from taichi_bearings.errors import InputError
from taichi_bearings.export.problems import lattice_as_packing
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.packing.answer import forces_of
from taichi_bearings.packing.system import System
from taichi_bearings.scene import Scene


@dataclass(frozen=True)
class ConicProgramme:
    """Matrices as in the module docstring; rows of A: `equalities`, then `inequalities`, then three a cone.

    slips : numbers of the slips that there are, among the d A of the system: contacts of one component, then the first
    of two, then the second.
    """

    scene: Scene
    system: System
    slips: np.ndarray
    quadratic: sparse.csc_matrix
    linear: np.ndarray
    matrix: sparse.csc_matrix
    offset: np.ndarray
    equalities: int = 0
    inequalities: int = 0
    cones: int = 0

    def spins(self, x: np.ndarray) -> np.ndarray:
        """Staggered spins (C, 1, *N) of a solution x: finite, in the interval of the driven ones, and driven."""
        scene, axes, lattice = self.scene, self.scene.minimum_spin_axes, self.scene.lattice
        own = self.system.all_spins(scene.jump * np.nan_to_num(x[: self.system.unknowns]))
        own = lattice.parity[..., None] * own.reshape(*lattice.shape, -1)
        staggered = np.moveaxis(own if lattice.dimension == 2 else own[..., list(axes)], -1, 0)[:, None]
        return scene.impose_driving(scene.clip_to_box(staggered, axes), axes)

    def forces(self, z: np.ndarray) -> np.ndarray:
        """Contact forces (C, 1, E) of the multipliers z of the rows."""
        scene, pairs = self.scene, self.inequalities // 2
        if not scene.law.holds:
            along = scene.lattice.radius * scene.jump / 2 * z
        else:
            cones = z[2 * pairs :].reshape(-1, 3)
            along = scene.normal_force * np.concatenate([z[:pairs] - z[pairs : 2 * pairs], -cones[:, 1], -cones[:, 2]])
        force = np.zeros(self.system.offset.size)
        force[self.slips] = along
        friction = forces_of(self.system, force.reshape(self.system.offset.shape))[1]
        return staggered_forces(friction[None], scene.lattice, scene.minimum_spin_axes)

    def with_friction(self, scene: Scene) -> "ConicProgramme":
        """The Coulomb programme of another sample of the same lattice and driving: nothing but the costs changes."""
        linear = self.linear.copy()
        linear[self.system.unknowns :] = scene.coefficient[0, self.system.contact]
        return replace(self, scene=scene, linear=linear)


def conic_programme(scene: Scene) -> ConicProgramme:
    """The least power of `scene`, which must have one replica, as a conic programme."""
    if scene.replicas != 1:
        raise InputError(f"the scene has {scene.replicas} replicas; a conic programme describes one")
    if scene.law.holds and scene.law.flows:
        raise InputError(f"law is {scene.law}; only one coefficient a contact can be written as a conic programme")
    system = System.of(lattice_as_packing(scene))
    system.matrix.eliminate_zeros()
    d, count = system.offset.shape
    live = ((np.diff(system.matrix.indptr) > 0) | (system.offset.ravel() != 0)).reshape(d, count)
    one = live.sum(axis=0) == 1
    slips = np.concatenate([np.flatnonzero(live & one), np.flatnonzero(live & ~one)])
    matrix, offset = system.matrix[slips], system.offset.ravel()[slips] / (scene.lattice.radius * (scene.jump or 1.0))
    coefficient, unknowns, nothing = scene.coefficient[0, system.contact], system.unknowns, np.zeros(system.unknowns)
    if not scene.law.holds:
        rows = len(slips)
        return ConicProgramme(
            scene,
            system,
            slips,
            quadratic=sparse.diags(np.concatenate([nothing, 2 * coefficient[slips % count]]), format="csc"),
            linear=np.zeros(unknowns + rows),
            matrix=sparse.hstack([matrix, -sparse.identity(rows)], format="csc"),
            offset=-offset,
            equalities=rows,
        )
    size, scalars, cones = unknowns + count, int(one.sum()), (len(slips) - int(one.sum())) // 2
    slide = sparse.hstack([matrix, sparse.csr_matrix((len(slips), count))]).tocsr()
    least = sparse.identity(size, format="csr")[unknowns + slips[: scalars + cones] % count]  # t of each contact
    stacked = sparse.vstack(
        [slide[:scalars] - least[:scalars], -slide[:scalars] - least[:scalars], -least[scalars:], -slide[scalars:]]
    )
    sides = np.concatenate([-offset[:scalars], offset[:scalars], np.zeros(cones), offset[scalars:]])
    order = np.arange(len(sides))
    order[2 * scalars :] = order[2 * scalars :].reshape(3, cones).T.ravel()  # t, y_1, y_2 of one cone together
    return ConicProgramme(
        scene,
        system,
        slips,
        quadratic=sparse.csc_matrix((size, size)),
        linear=np.concatenate([nothing, coefficient]),
        matrix=stacked.tocsr()[order].tocsc(),
        offset=sides[order],
        inequalities=2 * scalars,
        cones=cones,
    )
