"""Primal-dual interior-point method for the Coulomb law: a proven minimum to round-off in about twenty Newton steps.

The least power is the minimum of sum_e mu_e b_e over spins and bounds b_e >= |slip_e|; its dual maximises the work of
the driven planes over balanced contact forces with |f_e| <= mu_e F_n (PHYSICS 4). Both are followed along the central
path (central_path.py). Bounds above the slips and zero forces are strictly inside, so that from the first step on there
are an upper and a lower bound. Eliminating the bounds from the Newton system leaves a weighted Laplacian over the free
spins, which is factorised once a step (taichi_bearings.cholesky).
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.certificate import largest_unbalanced_torque, lower_bound
from taichi_bearings.cholesky import NotPositiveDefinite, dissect
from taichi_bearings.errors import InputError
from taichi_bearings.fields.workspace import FieldSpec, Workspace
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.central_path import Iterate, newton_step
from taichi_bearings.solvers.contact_system import free_shape, jump_of, lattice_system
from taichi_bearings.solvers.newton_matrix import NewtonMatrix

CLOSEST = 1e-13  # relative gap at which double precision ends


@dataclass
class _Sample:
    """One replica: its iterate, and the mean coefficient in which its friction is measured."""

    iterate: Iterate
    unit: float
    done: bool = False


class InteriorPoint:
    """See the module docstring. An iteration is one Newton step of every replica that is not yet done."""

    name = "interior-point"
    keeps_best = True
    needs_taichi = True  # fills the fronts of the factorisation

    def plan(self, scene: Scene, spin: np.ndarray) -> FieldSpec:
        if scene.law != "coulomb":
            raise InputError(f"method is 'interior-point' and law is {scene.law!r}; it must be coulomb")
        return ()

    def begin(self, scene: Scene, spin: np.ndarray, fields: Workspace | None) -> None:
        self.scene, self.spin_axes = scene, scene.minimum_spin_axes
        jump = jump_of(scene)
        self.system = lattice_system(scene.lattice, self.spin_axes, jump)
        self.frustrated = bool((jump != 0).any())
        self.iteration = 0
        self.samples = [self._sample(replica, spins) for replica, spins in enumerate(self._start(spin))]
        if self.frustrated:
            self.parts = dissect(free_shape(scene.lattice), self.spin_axes)
            self.matrix = NewtonMatrix(self.system, self.parts)
            self.matrix.factorise(
                [np.eye(len(g.below))[:, :, None] * np.ones(g.below.shape[1]) for g in self.system.groups]
            )

    def _start(self, spin: np.ndarray) -> np.ndarray:
        """Free spins (R, unknowns) from the bottom in units of the jump, inside the interval of the driven ones."""
        scene = self.scene
        staggered = scene.staggered_spin(spin, self.spin_axes)
        bottom, top = (v.reshape(-1, *(1,) * (staggered.ndim - 1)) for v in scene.driven_values(self.spin_axes))
        inside = np.clip(staggered, np.minimum(bottom, top), np.maximum(bottom, top))
        return np.moveaxis(((inside - bottom) / (scene.jump or 1.0))[..., 1:-1], 0, -1).reshape(scene.replicas, -1)

    def _sample(self, replica: int, spins: np.ndarray) -> _Sample:
        friction = [self.scene.coefficient[g.axis][replica].ravel()[g.acting] for g in self.system.groups]
        unit = float(np.mean(np.concatenate(friction)))
        slack = 1.0 / (self.scene.lattice.shape[-1] - 1)
        return _Sample(Iterate.start(self.system, spins, [mu / unit for mu in friction], slack), unit)

    def next_check(self, iteration: int) -> int:
        return iteration + 1

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            for sample in self.samples:
                if not sample.done:
                    try:
                        newton_step(sample.iterate, self.matrix)
                        sample.done = not sample.iterate.gap > CLOSEST
                    except NotPositiveDefinite:
                        sample.done = True
            self.iteration += 1

    def progress(self) -> Progress:
        scene = self.scene
        bottom, _ = scene.driven_values(self.spin_axes)
        staggered = np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        force = tuple(
            np.zeros((sum(k != axis for k in self.spin_axes), scene.replicas, *scene.lattice.contact_shape(axis)))
            for axis in range(scene.lattice.dimension)
        )
        for replica, sample in enumerate(self.samples):
            spins = np.moveaxis(sample.iterate.spins.reshape(*free_shape(scene.lattice), -1), -1, 0)
            staggered[:, replica, ..., 1:-1] = bottom.reshape(-1, *(1,) * scene.lattice.dimension) + scene.jump * spins
            for group, dual in zip(self.system.groups, sample.iterate.dual, strict=True):
                values = force[group.axis][:, replica].reshape(len(dual), -1)
                values[:, group.acting] = -dual * (sample.unit * scene.normal_force)
        scene.impose_driving(staggered, self.spin_axes)
        product = max(sample.iterate.complementarity for sample in self.samples) if self.frustrated else 0.0
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=self.spin_axes,
            force=force,
            power=scene.power(staggered, self.spin_axes),
            lower_bound=lower_bound(scene, force, self.spin_axes),
            resolution=scene.lattice.radius * scene.jump * float(np.sqrt(product)),
            unbalanced_torque=largest_unbalanced_torque(scene, force, self.spin_axes),
            exhausted=not self.frustrated or all(sample.done for sample in self.samples),
        )
