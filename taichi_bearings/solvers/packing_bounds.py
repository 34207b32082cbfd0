"""Lower bounds that methods prove on their way through a packing, from forces on its contacts.

Letters: d tangents of a contact (1 for discs, 2 for spheres), E contacts that take part, A contacts among them that are
in parts of the packing which touch a driven sphere, N spheres, C components of a spin, u = R omega.
"""

import numpy as np

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.conic.rolling import rolled
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers.packing_states import forces_of, judgement_of
from taichi_bearings.solvers.part import Found


class PackingBounds:
    """The best lower bound on the objective of a packing so far, and what proves it.

    packing : the packing with all contacts.
    acting : (E,), numbers of the contacts that can dissipate, for which forces are given.
    system : the A contacts among them that lie in parts of the packing which touch a driven sphere.
    of_system : (A,), places of the contacts of the system among the E contacts.
    matrix : Newton matrix of the system, for forces that are to be balanced.
    proven : the best bound, energy/time.
    witness : (C components, 1, N spheres), u = radius * spin with which it was proven.
    looked : iteration at which a bound was last computed by a factorisation.
    """

    def __init__(self, packing: Packing) -> None:
        """Build the contact system of a packing and its Newton matrix. Begin with the bound 0, proven by spins 0."""
        self.packing, self.acting, self.system = packing, packing.acting, ContactSystem.of(packing)
        self.matrix = NewtonMatrix(self.system, order_by_place(self.system))
        self.of_system = np.searchsorted(self.acting, self.system.numbers)
        self.proven, self.witness, self.looked = 0.0, np.zeros((packing.network.components, 1, packing.spheres)), 0

    def is_at_rest(self) -> np.ndarray:
        """Return a mask (1,) for the one sample, True if spins without any slip are proven to exist."""
        system = self.system
        spins, rest = rolled(
            system, self.packing, exactly(np.zeros(system.unknowns)), np.ones(len(system.numbers), dtype=bool)
        )
        judgement = judgement_of(system, [self.packing], [Found(spins, np.zeros_like(system.offset), "", rest=rest)])
        return np.zeros(1, dtype=bool) if judgement is None else judgement.can_all_rest

    def of(self, force: np.ndarray, spins: np.ndarray, factorises: bool) -> tuple[float, np.ndarray]:
        """Return a proven lower bound on the objective, 0 if none follows, and the forces (d, 1, E contacts) that prove
        it.

        If some normals are oblique, not along the axes, only balanced forces prove a bound.

        force : (d, 1, E), contact forces along d tangents.
        spins : (C components, 1, N spheres), u = radius * spin.
        factorises : True to try the forces also with their leftover torques balanced, which costs a factorisation.
        """
        system = self.system
        if not system.offset.any() or not np.isfinite(force).all() or not np.isfinite(spins).all():
            return 0.0, force
        own = force[:, 0, self.of_system]
        candidates = [own] if system.network.along_axes(system.numbers) else []
        candidates += [self._balanced(own)] if factorises else []
        best, found = 0.0, own
        for candidate in candidates:
            value = self._proven_by(candidate, spins)
            if value > best:
                best, found = value, candidate
        proving = force.copy()
        proving[:, 0, self.of_system] = found
        return best, proving

    def again(self, force: np.ndarray) -> float:
        """Compute anew, after a checkpoint, the lower bound that the forces of the best bound prove, and return it,
        energy/time.

        force : (d tangents, 1, E contacts), these forces.
        """
        if not self.proven > 0:
            return 0.0
        return min(self.proven, self._proven_by(force[:, 0, self.of_system], self.witness))

    def take(self, bound: float, spins: np.ndarray) -> None:
        """Store a bound in `proven` if no bound before was larger, and its spins in `witness`.

        bound : lower bound on the objective, energy/time.
        spins : (C components, 1, N spheres), u = radius * spin with which it was proven.
        """
        if bound >= self.proven:
            self.proven, self.witness = bound, spins

    def _proven_by(self, force: np.ndarray, spins: np.ndarray) -> float:
        """Return the lower bound, energy/time, that forces and spins prove; 0 if none follows.

        force : (d, A contacts), contact forces of the system along d tangents.
        spins : (C components, 1, N spheres), u = radius * spin.
        """
        packing, friction = self.packing, forces_of(self.system, force)[1]
        spin = packing.spins_of(exactly(spins[:, 0].T))
        judgement = Judgement.of(packing, *spin, friction)
        return 0.0 if judgement is None else float(judgement.lower_bound[0])

    def _balanced(self, force: np.ndarray) -> np.ndarray:
        """Return contact forces (d tangents, A contacts) with their leftover torques balanced, or as they are if the
        matrix is singular.

        force : (d, A), components of the forces along the d tangents of each contact.
        """
        try:
            return self.matrix.balanced(force, self.system.of_contacts(self.packing)[0])
        except NotPositiveDefinite:
            return force
