"""Implicit dynamics of packings: the steps of lattices, for contacts as one group and spheres of any weight.

The unknowns of a stage are w = S^-1 u of the free spheres, S^2 = unit inertia R^2 / I, so that all have one inertia.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.conic.grouped import Arrays, Grouped
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.packing.motions import order_of
from taichi_bearings.packing.path import elimination, oblique
from taichi_bearings.packing.system import System, slips_of
from taichi_bearings.solvers.dynamics import RestWatch
from taichi_bearings.solvers.implicit_cundall_strack import ImplicitCundallStrackMethod
from taichi_bearings.solvers.network import OF_BOUND, Network, OnNetwork
from taichi_bearings.solvers.table import ImplicitCundallStrack


@dataclass(frozen=True)
class Stages:
    """What a stage asks of its contacts, all in one group. scale : S, (unknowns,), of u by component."""

    system: System
    scale: np.ndarray

    @classmethod
    def of(cls, network: Network, scale: np.ndarray) -> "Stages":
        """scale : of the free spheres."""
        packing, free, c = network.packing, np.flatnonzero(~network.lattice.is_driven), network.components
        moved = np.full((packing.spheres, c), -1)
        moved[free] = np.arange(len(free) * c).reshape(-1, c)
        matrix = slips_of(packing, network.acting, moved)
        offset, of = network.differences(packing.imposed.T[:, None])[:, 0], tuple(v[0] for v in network.contact)
        parts = partial(order_of, packing, network.acting, ~network.lattice.is_driven)
        sphere, known = np.repeat(free, c), packing.imposed
        system = System(packing, network.acting, moved, None, parts, sphere, known, matrix, offset, of)
        return cls(system, np.repeat(scale, c))

    @cached_property
    def offset(self) -> Arrays:
        return Grouped([self.system.offset])

    @cached_property
    def matrix(self) -> sparse.csr_array:
        return sparse.csr_array(self.system.matrix @ sparse.diags_array(self.scale))

    def change(self, step: np.ndarray) -> Arrays:
        return Grouped([(self.matrix @ step).reshape(self.system.offset.shape)])

    def differences(self, spins: np.ndarray) -> Arrays:
        return self.change(spins) + self.offset

    def torques(self, forces: Arrays) -> np.ndarray:
        return self.scale * self.system.torques(forces.parts[0])

    def gather(self, values: np.ndarray, replica: int) -> Arrays:
        return Grouped([values[replica]])

    def gather_vectors(self, values: np.ndarray, replica: int) -> Arrays:
        return Grouped([values[:, replica]])

    def scatter_vectors(self, vectors: Arrays, values: np.ndarray, replica: int) -> None:
        values[:, replica] = vectors.parts[0]


class StageMatrix:
    """S K^T stiffness K S + inertia, factorised as K^T stiffness K + inertia S^-2."""

    def __init__(self, stages: Stages) -> None:
        self.newton, self.scale = NewtonMatrix(oblique(stages.system), elimination(stages.system)), stages.scale

    def factorise(self, stiffness: Arrays, inertia: float) -> None:
        self.newton.factorise(stiffness, inertia / self.scale**2)

    def solve(self, right: np.ndarray) -> np.ndarray:
        return self.newton.solve(right / self.scale) / self.scale


class ImplicitCundallStrackOfPacking(OnNetwork, ImplicitCundallStrackMethod):
    """An iteration is one time step."""

    kept = (*ImplicitCundallStrackMethod.kept, *OF_BOUND)

    def __init__(self, options: ImplicitCundallStrack, density: Any = None) -> None:
        super().__init__(options)
        self.density = density

    def begin_on(self, network: Network, spins: np.ndarray) -> None:
        """spins : u (C, 1, N)."""
        self.scene, self.spin_axes = network, tuple(range(network.components))
        self.inertia = network.inertias(self.options.mass, self.options.inertia, self.density)
        self.iteration, self.time, self.halted = 0, 0.0, False
        self.rest = RestWatch(*self.checks, np.full(1, np.inf))
        self.free = ~network.lattice.is_driven
        self.system = Stages.of(network, np.sqrt(self.unit_inertia / self.inertia[self.free]))
        self._begin(spins)

    @property
    def unit_inertia(self) -> float:
        return float(self.inertia[self.free].mean()) if self.free.any() else 1.0

    def free_spins(self, staggered: np.ndarray) -> np.ndarray:
        return (staggered[:, 0, self.free].T.ravel() / self.system.scale)[None]

    def place_free_spins(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        staggered[:, 0, self.free] = (spins * self.system.scale).reshape(-1, len(staggered)).T

    def _matrix(self) -> StageMatrix:
        return StageMatrix(self.system)

    def _conserved(self) -> np.ndarray:
        return np.zeros((0, 0), dtype=np.int64)

    def is_believed(self, found: Any) -> bool:
        return self.scene.proven == 0 or super().is_believed(found)
