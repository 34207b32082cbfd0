"""A packing as methods see it that step through time or descend: what they ask of a scene, for contacts in lists.

With u = R omega the radii drop out of the slips y = T (u_i + u_j), and the motion of a sphere is

    (I / R^2) du/dt = -sum T^T f,        I / R^2 = 2 m / 5, of a disc m / 2.
"""

from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import cg

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contraction import order_by_place
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.errors import InputError
from taichi_bearings.fields.lists import Lists
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.cholesky import NotPositiveDefinite
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.packing.answer import forces_of, judgement_of, spins_of
from taichi_bearings.packing.checks import sizes
from taichi_bearings.packing.interface import Interface
from taichi_bearings.packing.packing import Packing
from taichi_bearings.packing.path import oblique
from taichi_bearings.packing.rolling import rolled
from taichi_bearings.packing.system import Found, System
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.scene.bearing import inverse
from taichi_bearings.scene.initial_spins import STARTS
from taichi_bearings.scene.scene import vector_length
from taichi_bearings.words import meant, shown

START_RESIDUAL = 1e-12  # of the torques at the start, relative
PERRON_STEPS, LEAST_SHARE = 30, 1e-3  # of the vector that bounds an eigenvalue: improvements, and its smallest entries


class Network:
    """A packing with the words of a `Scene` of one sample, spins u (C, 1, N) of all spheres, and contacts that act.

    density : (N,) or one, mass / length^D; None for that which gives a sphere of the mean radius the mass, or the
    moment of inertia, of a dynamics. acting : (E,) their numbers in the packing; shapes below have these.
    across : T, (d, E, C).
    jump : how far imposed u differ, length/time, the natural unit of slips; else the largest u at the start.
    """

    replicas, strength, normal_force, imposed = 1, 1.0, 1.0, (0.0,)

    def __init__(self, packing: Packing, density: Any = None) -> None:
        self.packing, self.law, self.acting, self.density = packing, packing.law, packing.acting, density
        self.across = packing.network.tangents[:, self.acting]
        self.material = tuple(values[:, self.acting] for values in packing.material)
        self.acting_coefficient, self.viscosities = self.material[0], self.law.viscosity(self.material)
        self.coefficient = self.positive_coefficient = self.acting_coefficient
        self.inverse_limit = inverse(self.strength * self.acting_coefficient)
        self.idle = np.zeros(self.coefficient.shape, dtype=bool)
        self.viscosity_beside_friction = self.viscosities if self.law.holds else None
        self.components, held = packing.driven_speed.shape[1], packing.driven >= 0
        self.minimum_spin_axes = tuple(range(self.components))
        self.lattice = SimpleNamespace(radius=1.0, is_driven=held, shape=held.shape, dimension=packing.dimension)
        numbers = np.arange(packing.spheres * self.components).reshape(-1, self.components)
        self.matrix = packing.network.operator(self.acting, numbers)
        self.transposed = self.matrix.T.tocsr()
        self.jump = packing.jump
        # the best bound so far, spins that it is proven with, and the iteration of the last whole look
        self.proven, self.witness, self.looked = 0.0, np.zeros((self.components, 1, packing.spheres)), 0

    @cached_property
    def is_cut_off(self) -> np.ndarray:
        """(1,), True where a state without any slip is proven to exist."""
        system = self.proof[0]
        spins, rest = rolled(system, exactly(np.zeros(system.unknowns)), np.ones(len(system.contact), dtype=bool))
        still = Found(spins, np.zeros_like(system.offset), "", rest=rest)
        judgement = judgement_of(system, still)
        return judgement.slipless if judgement.can_be_judged else np.zeros(1, dtype=bool)

    @cached_property
    def lists(self) -> Lists:
        return Lists.of(self.packing.spheres, self.packing.contact[self.acting])

    @cached_property
    def proof(self) -> tuple[System, NewtonMatrix]:
        """What bounds follow from."""
        system = System.of(self.packing)
        contacts = oblique(system)
        return system, NewtonMatrix(contacts, order_by_place(contacts, system.place))

    @cached_property
    def of_system(self) -> np.ndarray:
        """Places of the contacts of the system."""
        return np.searchsorted(self.acting, self.proof[0].contact)

    def differences(self, spins: np.ndarray) -> np.ndarray:
        """y (d, 1, E) of spins (C, 1, N)."""
        return (self.matrix @ spins.reshape(self.components, -1).T.ravel()).reshape(len(self.across), 1, -1)

    def pulls(self, force: np.ndarray) -> np.ndarray:
        """-sum T^T f (C, 1, N) of (d, 1, E)."""
        return -(self.transposed @ force.ravel()).reshape(-1, 1, self.components).T

    def slips(self, spins: np.ndarray, spin_axes: object = None) -> np.ndarray:
        """Slip speeds (1, E)."""
        return vector_length(self.differences(spins))

    def power(self, spins: np.ndarray, spin_axes: object = None) -> np.ndarray:
        return self.law.power(self.material, self.slips(spins)).sum(axis=1)

    def staggered_spin(self, spins: np.ndarray, spin_axes: object = None) -> np.ndarray:
        """They are given as u."""
        return spins

    clip_to_box = staggered_spin  # no box holds the spins, which on oblique networks would be wrong

    def box(self, spin_axes: object = None) -> float:
        return 0.0

    def impose_driving(self, spins: np.ndarray, spin_axes: object = None) -> np.ndarray:
        spins[:, 0, self.lattice.is_driven] = self.packing.driven_speed[self.lattice.is_driven].T
        return spins

    def laboratory_spin(self, spins: np.ndarray, spin_axes: object = None) -> np.ndarray:
        """omega (1, N, 3), of discs (1, N)."""
        return spins_of(self.packing, exactly(spins[:, 0].T))[0][None]

    def start(self, start: str | np.ndarray) -> np.ndarray:
        """u (C, 1, N) at the start. start : "zero", "random", "minimum-cut" and "linear", the viscous answer for even
        contacts, as of scenes; or omega (N, 3), of discs (N,), 1/time."""
        packing, shape = self.packing, (self.packing.spheres, self.components)[: self.components]
        if isinstance(start, str):
            if start not in STARTS:
                raise InputError(
                    f"start is {shown(start)}; it can be {', '.join(STARTS)} or spins{meant(start, STARTS)}"
                )
            spin = packing.spin.reshape(packing.spheres, -1)[packing.driven >= 0]
            largest = float(np.linalg.norm(spin, axis=1).max(initial=0.0)) or 1.0
            draw = np.random.default_rng([packing.seed, 1]).uniform(-largest, largest, shape)
            given = draw if start == "random" else np.zeros(shape)
        else:
            given = own_array("the spins in start", start)
            if given.shape != shape or not np.isfinite(given).all():
                raise InputError(f"start has shape {given.shape}; it must be {shape} and finite")
        spins = (given.reshape(packing.spheres, -1) * packing.radius[:, None]).T[:, None].copy()
        if isinstance(start, str) and start == "linear":
            spins = self._viscous_start()
        if isinstance(start, str) and start == "minimum-cut":
            if (cut := Interface.of(packing)) is None:
                raise InputError(
                    "start is 'minimum-cut', but this packing has none: that needs no odd loops, and a jump between "
                    "two driven bodies, each in a bearing state"
                )
            spins = cut.spins.T[:, None].copy()
        self.impose_driving(spins)
        self.jump = self.jump or float(np.abs(spins).max(initial=0.0))
        return spins

    def _viscous_start(self) -> np.ndarray:
        """Spins (C, 1, N) of least power with the same viscosity in all contacts, by conjugate gradients: no factor of
        a matrix, which a GPU has not, and which is large."""
        moved = np.repeat(self.packing.driven < 0, self.components)
        matrix, given = self.matrix[:, moved], np.where(moved, 0.0, self.packing.driven_speed.ravel())
        found = given.copy()
        with one_thread():  # sums do not depend on the number of threads
            found[moved], _ = cg(matrix.T @ matrix, -(matrix.T @ (self.matrix @ given)), rtol=START_RESIDUAL)
        return found.reshape(-1, self.components).T[:, None].copy()

    def inertias(self, mass: float, inertia: float | None) -> np.ndarray:
        """I / R^2 (N,), mass."""
        packing, shape = self.packing, 0.5 if self.components == 1 else 0.4
        radius = np.asarray(packing.radius)
        if (density := self.density) is not None:
            if inertia is not None:
                raise InputError(f"inertia is {inertia:g} and density is given; one of them says how heavy spheres are")
            volume = np.pi * radius**2 if self.components == 1 else 4 / 3 * np.pi * radius**3
            return shape * volume * sizes("density", density, packing.spheres, "sphere")
        mean = radius.mean()
        return (shape * mass if inertia is None else inertia / mean**2) * (radius / mean) ** packing.dimension

    def largest_eigenvalue(self, weight: np.ndarray, inertia: np.ndarray) -> float:
        """No eigenvalue of M^-1 K^T W K over the free spheres is larger. weight : W, (E,). inertia : M, (N,).

        Of a matrix A none exceeds max (|A| x)_i / x_i, for any x > 0 (Gershgorin's circles are x = 1; Collatz and
        Wielandt); x is brought near the vector for which that is least.
        """
        scale = np.repeat(np.where(self.lattice.is_driven, 0.0, 1 / np.sqrt(inertia)), self.components)
        half = sparse.diags_array(np.tile(np.sqrt(weight), len(self.across))) @ self.matrix @ sparse.diags_array(scale)
        size = abs(half.T.tocsr() @ half)
        vector, least = np.ones(size.shape[0]), np.inf
        for _ in range(PERRON_STEPS):
            image = size @ vector
            least = min(least, float((image / vector).max(initial=0.0)))
            if least == 0:
                break
            vector = np.maximum(image / image.max(), LEAST_SHARE)
        return least * (1 + 1e-9)

    def bound(self, force: np.ndarray, spins: np.ndarray, whole: bool) -> tuple[float, np.ndarray]:
        """Proven lower bound on the objective from forces (d, 1, E), 0 where none follows, and forces that prove it.

        whole : also from the forces without the torques they leave, by a factorisation; where normals are oblique no
        others prove anything.
        """
        system, _ = self.proof
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

    def proven_again(self, force: np.ndarray) -> float:
        """What the forces (d, 1, E) of the best bound prove; after a checkpoint, whose word for it is not taken."""
        if not self.proven > 0:
            return 0.0
        return min(self.proven, self._proven_by(force[:, 0, self.of_system], self.witness))

    def _proven_by(self, force: np.ndarray, spins: np.ndarray) -> float:
        """What these forces (d, A) prove, beside spins (C, 1, N); energy/time."""
        packing, friction = self.packing, forces_of(self.proof[0], force)[1]
        spin = spins_of(packing, exactly(spins[:, 0].T))
        judgement = Judgement(packing, *spin, friction)
        return float(judgement.lower_bound[0]) if judgement.can_be_judged else 0.0

    def _balanced(self, force: np.ndarray) -> np.ndarray:
        """Forces (d, A) of the system in balance; as they are where that needs a division by 0."""
        system, matrix = self.proof
        try:
            return matrix.balanced(force, isotropic(force, system.coefficients[0]))
        except NotPositiveDefinite:
            return force
