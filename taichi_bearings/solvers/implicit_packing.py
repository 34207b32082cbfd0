"""Implicit dynamics of packings: the steps of lattices, for contacts as one group and spheres of any weight.

The unknowns of a stage are w = S^-1 u of the free spheres, S^2 = unit inertia R^2 / I, so that all have one inertia.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.packing.motions import order_of
from taichi_bearings.packing.path import elimination, oblique
from taichi_bearings.packing.system import System, slips_of
from taichi_bearings.solvers.implicit_cundall_strack import ImplicitCundallStrackMethod
from taichi_bearings.solvers.network import OF_BOUND, Network, OnNetwork


class ImplicitCundallStrackOfPacking(OnNetwork, ImplicitCundallStrackMethod):
    """An iteration is one time step."""

    kept = (*ImplicitCundallStrackMethod.kept, *OF_BOUND)

    def begin(self, network: Any, spins: np.ndarray, fields: Any) -> None:
        self.free = ~network.lattice.is_driven
        self.scale = np.repeat(np.sqrt(self.unit_inertia / self.inertia[self.free]), network.components)
        self.system, self.order = self._contacts(network)
        self._begin(spins)

    def _contacts(self, network: Network) -> tuple[ContactSystem, np.ndarray]:
        """What a stage asks of its contacts, over w, and the order of elimination. scale : S, of u by component."""
        packing, free, c = network.packing, np.flatnonzero(self.free), network.components
        moved = np.full((packing.spheres, c), -1)
        moved[free] = np.arange(len(free) * c).reshape(-1, c)
        matrix = slips_of(packing, network.acting, moved)
        offset, of = network.differences(packing.imposed.T[:, None])[:, 0], tuple(v[0] for v in network.contact)
        parts, known = partial(order_of, packing, network.acting, self.free), packing.imposed
        sphere = np.repeat(free, c)
        system = System(packing, network.acting, moved, None, parts, sphere, known, matrix, offset, of)
        whole = oblique(system)
        (group,) = whole.groups
        operator = sparse.csr_array(group.operator @ sparse.diags_array(self.scale))
        factor = group.factor * np.append(self.scale, 0.0)[group.unknown]
        return replace(whole, groups=(replace(group, operator=operator, factor=factor),)), elimination(system)

    @property
    def unit_inertia(self) -> float:
        return float(self.inertia[self.free].mean()) if self.free.any() else 1.0

    def free_spins(self, staggered: np.ndarray) -> np.ndarray:
        return (staggered[:, 0, self.free].T.ravel() / self.scale)[None]

    def place_free_spins(self, staggered: np.ndarray, replica: int, spins: np.ndarray) -> None:
        staggered[:, 0, self.free] = (spins * self.scale).reshape(-1, len(staggered)).T

    def _matrix(self) -> NewtonMatrix:
        return NewtonMatrix(self.system, self.order)

    def _conserved(self) -> np.ndarray:
        return np.zeros((0, 0), dtype=np.int64)

    def is_believed(self, found: Any) -> bool:
        return self.scene.proven == 0 or super().is_believed(found)
