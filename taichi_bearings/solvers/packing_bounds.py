"""Lower bounds that methods prove on their way through a packing, from forces on the contacts that act."""

import numpy as np

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.packing.answer import forces_of, judgement_of
from taichi_bearings.packing.found import Found
from taichi_bearings.packing.rolling import rolled
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.packing import Packing


class PackingBounds:
    """What is proven of a packing so far.

    packing : with all contacts, of which `acting` are those that forces are given of. of_system : (A,), places of the
    contacts of the system among these.
    proven : the best bound. witness : u (C, 1, N) beside which it was proven. looked : iteration of the last look that
    cost a factorisation.
    """

    def __init__(self, packing: Packing) -> None:
        self.packing, self.acting, self.system = packing, packing.acting, ContactSystem.of(packing)
        self.matrix = NewtonMatrix(self.system, order_by_place(self.system))
        self.of_system = np.searchsorted(self.acting, self.system.numbers)
        self.proven, self.witness, self.looked = 0.0, np.zeros((packing.network.components, 1, packing.spheres)), 0

    def is_at_rest(self) -> np.ndarray:
        """(1,), True where a state without any slip is proven to exist."""
        system = self.system
        spins, rest = rolled(
            system, self.packing, exactly(np.zeros(system.unknowns)), np.ones(len(system.numbers), dtype=bool)
        )
        judgement = judgement_of(system, self.packing, Found(spins, np.zeros_like(system.offset), "", rest=rest))
        return judgement.slipless if judgement.can_be_judged else np.zeros(1, dtype=bool)

    def of(self, force: np.ndarray, spins: np.ndarray, whole: bool) -> tuple[float, np.ndarray]:
        """Proven lower bound on the objective from forces (d, 1, E), 0 where none follows, and forces that prove it.

        whole : also from the forces without the torques they leave, by a factorisation; where normals are oblique no
        others prove anything.
        """
        system = self.system
        if not system.offset.any() or not np.isfinite(force).all() or not np.isfinite(spins).all():
            return 0.0, force
        own = force[:, 0, self.of_system]
        candidates = [own] if system.network.along_axes(system.contact) else []
        candidates += [self._balanced(own)] if whole else []
        best, found = 0.0, own
        for candidate in candidates:
            value = self._proven_by(candidate, spins)
            best, found = (value, candidate) if value > best else (best, found)
        proving = force.copy()
        proving[:, 0, self.of_system] = found
        return best, proving

    def again(self, force: np.ndarray) -> float:
        """What the forces (d, 1, E) of the best bound prove; after a checkpoint, whose word for it is not taken."""
        if not self.proven > 0:
            return 0.0
        return min(self.proven, self._proven_by(force[:, 0, self.of_system], self.witness))

    def take(self, bound: float, spins: np.ndarray) -> None:
        """Keep a bound, if it is the best one, and the spins that it was proven beside."""
        if bound >= self.proven:
            self.proven, self.witness = bound, spins

    def _proven_by(self, force: np.ndarray, spins: np.ndarray) -> float:
        """What these forces (d, A) prove, beside spins (C, 1, N); energy/time."""
        packing, friction = self.packing, forces_of(self.system, force)[1]
        spin = packing.spins_of(exactly(spins[:, 0].T))
        judgement = Judgement(packing, *spin, friction)
        return float(judgement.lower_bound[0]) if judgement.can_be_judged else 0.0

    def _balanced(self, force: np.ndarray) -> np.ndarray:
        """Forces (d, A) of the system in balance; as they are where that needs a division by 0."""
        try:
            return self.matrix.balanced(force, isotropic(force, self.system.of_contacts(self.packing)[0]))
        except NotPositiveDefinite:
            return force
