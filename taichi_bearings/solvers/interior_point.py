"""Primal-dual interior-point method for the Coulomb law: a proven minimum to round-off in about twenty Newton steps.

The least power is the minimum of sum_e mu_e b_e over spins and bounds b_e >= |slip_e|; its dual maximises the work of
the driven planes over balanced contact forces with |f_e| <= mu_e F_n (PHYSICS 4). Both are followed along the central
path with Mehrotra's predictor and corrector in the Nesterov-Todd scaling, and Gondzio's further correctors, which reuse
the factorisation. Bounds above the slips and zero forces are strictly inside, so that from the first step on there are
an upper and a lower bound.

Each step solves one weighted Laplacian over the free spins (taichi_bearings.cholesky). Eliminating the bounds from the
Newton system leaves exactly that, whatever the scene.
"""

from dataclasses import dataclass, field

import numpy as np

from taichi_bearings.certificate import largest_unbalanced_torque, lower_bound
from taichi_bearings.cholesky import LatticeCholesky
from taichi_bearings.cholesky.factor import NotPositiveDefinite
from taichi_bearings.errors import InputError
from taichi_bearings.fields.workspace import FieldSpec, Workspace
from taichi_bearings.scene import Progress, Scene
from taichi_bearings.solvers.cone import Point, Scaling, clipped_towards, inner, jordan_product, length, longest_step
from taichi_bearings.solvers.contact_system import ContactSystem, jump_of, stacked

CORRECTORS = 3  # Gondzio's, at most; each costs a solve and spares a part of a factorisation
LONG_ENOUGH = 0.9  # step length beyond which no further corrector is tried
STEP_SHARE = 0.9  # of the way to the boundary of the cones
SPREAD = 10.0  # correctors bring complementarities into [target / SPREAD, target * SPREAD]
CLOSEST = 1e-13  # relative gap at which double precision ends


@dataclass
class _Sample:
    """Iterate of one replica: spins (unknowns,), and per group bounds (n,), differences and minus forces (d, n)."""

    spins: np.ndarray
    friction: list[np.ndarray]
    unit: float
    bound: list[np.ndarray] = field(default_factory=list)
    difference: list[np.ndarray] = field(default_factory=list)
    dual: list[np.ndarray] = field(default_factory=list)
    done: bool = False

    @property
    def primal_points(self) -> list[Point]:
        return list(zip(self.bound, self.difference, strict=True))

    @property
    def dual_points(self) -> list[Point]:
        return list(zip(self.friction, self.dual, strict=True))

    @property
    def complementarity(self) -> float:
        """Mean over the contacts of (bound * friction - slip difference . force) / 2."""
        return _complementarity(self.primal_points, self.dual_points)

    @property
    def power(self) -> float:
        return sum(float(mu @ length(z)) for mu, z in zip(self.friction, self.difference, strict=True))

    @property
    def gap(self) -> float:
        """(power - work of the driven planes) / power, summed over contacts without cancellation."""
        excess = sum(
            float((mu * length(z) + inner(z, y)).sum())
            for mu, z, y in zip(self.friction, self.difference, self.dual, strict=True)
        )
        return excess / self.power


def _complementarity(primal: list[Point], dual: list[Point]) -> float:
    total = sum(float((p[0] * d[0] + inner(p[1], d[1])).sum()) for p, d in zip(primal, dual, strict=True))
    return total / (2 * sum(len(p[0]) for p in primal))


class InteriorPoint:
    """See the module docstring. An iteration is one Newton step: one factorisation, a few solves."""

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
        self.system = system = ContactSystem(scene.lattice, self.spin_axes, jump)
        self.frustrated = bool((jump != 0).any())
        self.iteration = 0
        start = self._start(spin)
        self.samples = [self._sample(replica, start[replica]) for replica in range(scene.replicas)]
        if self.frustrated:
            self.cholesky = LatticeCholesky(system.free_shape, self.spin_axes, *system.couplings())
            self.laplacian = system.laplacian_map(self.cholesky.pattern.entry)
            self.cholesky.factorise(self.laplacian @ stacked(self._unit_stiffness()))

    def _unit_stiffness(self) -> list[np.ndarray]:
        return [np.eye(len(g.slots))[:, :, None] * np.ones(len(g.below)) for g in self.system.groups]

    def _start(self, spin: np.ndarray) -> np.ndarray:
        """Free spins (R, unknowns) from the bottom in units of the jump, inside the interval of the driven ones."""
        scene = self.scene
        bottom, top = scene.driven_values(self.spin_axes)
        staggered = scene.staggered_spin(spin, self.spin_axes)
        shape = (-1, *(1,) * (staggered.ndim - 1))
        low, high = np.minimum(bottom, top).reshape(shape), np.maximum(bottom, top).reshape(shape)
        inside = (np.clip(staggered, low, high) - bottom.reshape(shape)) / (scene.jump or 1.0)
        return np.moveaxis(inside[..., 1:-1], 0, -1).reshape(scene.replicas, -1)

    def _sample(self, replica: int, spins: np.ndarray) -> _Sample:
        groups = self.system.groups
        friction = [self.scene.coefficient[g.axis][replica][g.acting] for g in groups]
        unit = float(np.mean(np.concatenate(friction)))
        sample = _Sample(spins, [mu / unit for mu in friction], unit)
        slack = 1.0 / (self.scene.lattice.shape[-1] - 1)
        sample.difference = [g.differences(spins) for g in groups]
        sample.bound = [np.hypot(length(z), slack) for z in sample.difference]
        sample.dual = [np.zeros_like(z) for z in sample.difference]
        return sample

    def next_check(self, iteration: int) -> int:
        return iteration + 1

    def advance(self, steps: int) -> None:
        for _ in range(steps):
            for sample in self.samples:
                if not sample.done:
                    self._newton_step(sample)
            self.iteration += 1

    def _newton_step(self, sample: _Sample) -> None:
        primal, dual = sample.primal_points, sample.dual_points
        scalings = [Scaling.of(p, d) for p, d in zip(primal, dual, strict=True)]
        blocks = [s.newton_blocks() for s in scalings]
        try:
            self.cholesky.factorise(self.laplacian @ stacked([k for _, _, k in blocks]))
        except NotPositiveDefinite:
            sample.done = True
            return
        direction = _Direction(self, sample, scalings, blocks)
        direction.predict()
        direction.correct()
        for _ in range(CORRECTORS):
            if not direction.recentre():
                break
        direction.take()
        sample.done = not sample.gap > CLOSEST

    def progress(self) -> Progress:
        scene, samples = self.scene, self.samples
        bottom, _ = scene.driven_values(self.spin_axes)
        staggered = np.zeros((len(self.spin_axes), scene.replicas, *scene.lattice.shape))
        force = tuple(
            np.zeros((sum(k != axis for k in self.spin_axes), scene.replicas, *scene.lattice.contact_shape(axis)))
            for axis in range(scene.lattice.dimension)
        )
        for replica, sample in enumerate(samples):
            spins = np.moveaxis(sample.spins.reshape(*self.system.free_shape, -1), -1, 0)
            staggered[:, replica, ..., 1:-1] = bottom.reshape(-1, *(1,) * scene.lattice.dimension) + scene.jump * spins
            for group, dual in zip(self.system.groups, sample.dual, strict=True):
                force[group.axis][:, replica, group.acting] = -dual * (sample.unit * scene.normal_force)
        scene.impose_driving(staggered, self.spin_axes)
        if self.frustrated:
            centre = np.sqrt(max(2 * sample.complementarity for sample in samples))
        else:
            centre = 0.0
        return Progress(
            iteration=self.iteration,
            staggered=staggered,
            spin_axes=self.spin_axes,
            force=force,
            power=scene.power(staggered, self.spin_axes),
            lower_bound=lower_bound(scene, force, self.spin_axes),
            resolution=scene.lattice.radius * scene.jump * centre,
            unbalanced_torque=largest_unbalanced_torque(scene, force, self.spin_axes),
            exhausted=not self.frustrated or all(sample.done for sample in samples),
        )


class _Direction:
    """Search direction of one Newton step, refined by right-hand sides that share the factorisation."""

    def __init__(self, method: InteriorPoint, sample: _Sample, scalings: list[Scaling], blocks: list) -> None:
        self.groups, self.system, self.cholesky = method.system.groups, method.system, method.cholesky
        self.sample, self.scalings, self.blocks = sample, scalings, blocks
        self.mean = sample.complementarity
        self.target = 0.0

    def predict(self) -> None:
        """Straight at the solution: complementarity zero."""
        self._solve([(-mu, -y) for mu, y in self.sample.dual_points])

    def correct(self) -> None:
        """Mehrotra: aim at a complementarity that the predictor makes credible, and mend its second-order error."""
        primal, dual = self._after(min(1.0, self.primal_length), min(1.0, self.dual_length))
        remaining = max(_complementarity(primal, dual), 0.0) / self.mean
        self.target = min(1.0, remaining**2) * self.mean
        right = []
        for s, step, (mu, y) in zip(self.scalings, self.steps, self.sample.dual_points, strict=True):
            dbound, ddifference, ddual = step
            second = jordan_product(
                s.apply((np.zeros_like(mu), ddual)), s.apply_inverse((dbound, ddifference))
            )
            head, tail = s.apply_inverse(s.divide((second[0] - self.target, second[1])))
            right.append((-mu - head, -y - tail))
        self._solve(right)

    def recentre(self) -> bool:
        """Gondzio: bring outlying complementarities of a longer step closer to the target. True if that pays."""
        if min(self.primal_length, self.dual_length) > LONG_ENOUGH:
            return False
        before = self.primal_length, self.dual_length, self.steps, self.spins, self.right
        primal, dual = self._after(
            min(1.0, 1.5 * self.primal_length + 0.1), min(1.0, 1.5 * self.dual_length + 0.1)
        )
        right = []
        for s, p, d, (head, tail) in zip(self.scalings, primal, dual, self.right, strict=True):
            product = jordan_product(s.apply(d), s.apply_inverse(p))
            change = clipped_towards(product, self.target / SPREAD, self.target * SPREAD)
            more = s.apply_inverse(s.divide(change))
            right.append((head + more[0], tail + more[1]))
        self._solve(right)
        if min(1.0, self.primal_length) + min(1.0, self.dual_length) < min(1.0, before[0]) + min(1.0, before[1]) + 0.02:
            self.primal_length, self.dual_length, self.steps, self.spins, self.right = before
            return False
        return True

    def take(self) -> None:
        """Go most of the way to the boundary."""
        self._refine()
        sample = self.sample
        along = min(1.0, STEP_SHARE * self.primal_length)
        dual_along = min(1.0, STEP_SHARE * self.dual_length)
        sample.spins = sample.spins + along * self.spins
        sample.difference = [g.differences(sample.spins) for g in self.groups]
        sample.bound = [b + along * step[0] for b, step in zip(sample.bound, self.steps, strict=True)]
        sample.dual = [y + dual_along * step[2] for y, step in zip(sample.dual, self.steps, strict=True)]

    def _solve(self, right: list[Point]) -> None:
        """Steps for W^-2 d(primal) + d(dual) = right, with balanced forces; `right` (n,), (d, n) a group."""
        self.right = right
        self.spins = self.cholesky.solve(self._load(right))
        self._expand()

    def _load(self, right: list[Point]) -> np.ndarray:
        pull = [
            y + tail - off * (head / diagonal)
            for (head, tail), y, (diagonal, off, _) in zip(right, self.sample.dual, self.blocks, strict=True)
        ]
        return self.system.torques(pull)

    def _expand(self) -> None:
        """Steps of bounds, differences and duals that belong to a step of the spins."""
        self.steps = []
        for group, (head, tail), (diagonal, off, stiffness) in zip(self.groups, self.right, self.blocks, strict=True):
            difference = (group.difference @ self.spins).reshape(tail.shape)
            bound = (head - inner(off, difference)) / diagonal
            dual = tail - off * (head / diagonal) - np.einsum("ijn,jn->in", stiffness, difference)
            self.steps.append((bound, difference, dual))
        self._measure()

    def _refine(self) -> None:
        """One step of iterative refinement of the last solve, which keeps the forces balanced to round-off."""
        imbalance = self.system.torques([y + step[2] for y, step in zip(self.sample.dual, self.steps, strict=True)])
        self.spins = self.spins + self.cholesky.solve(imbalance)
        self._expand()

    def _measure(self) -> None:
        sample = self.sample
        self.primal_length = min(
            longest_step(p, step[:2]) for p, step in zip(sample.primal_points, self.steps, strict=True)
        )
        self.dual_length = min(
            longest_step(d, (np.zeros_like(d[0]), step[2]))
            for d, step in zip(sample.dual_points, self.steps, strict=True)
        )

    def _after(self, along: float, dual_along: float) -> tuple[list[Point], list[Point]]:
        primal = [
            (p[0] + along * step[0], p[1] + along * step[1])
            for p, step in zip(self.sample.primal_points, self.steps, strict=True)
        ]
        dual = [
            (d[0], d[1] + dual_along * step[2]) for d, step in zip(self.sample.dual_points, self.steps, strict=True)
        ]
        return primal, dual
