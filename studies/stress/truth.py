"""The least power (or potential) of a sample in 140 decimal digits: a truth that shares no code with any solver.

It is found in two ways. :func:`least` follows the central path of a small sample (minima of the cost plus a barrier
that goes to 0) in Python's decimals; the least value is enclosed by the cost of its spins from above and the work of
its balanced forces from below. :func:`layered` is for samples of any size in which all columns have equal contacts
along the height: all columns then slip between the same layers, no contact sideways slips or bears a force, and the
minimum of a column is known in closed form.

The path goes to the middle of all minima: a contact slips at some minimum just if its slip has a limit above 0.
(`tests/stress/minima.py` goes on from there to what all minima have in common.)

All numbers are exactly the doubles that are given. The cost of spins is what the law minimises: power or
potential, energy/time. Spins are staggered, relative to the bottom's state, in units of the jump, or of 1/time
where bearing states are imposed; so slips have the same unit, and forces are energy/time. Letters: E contacts, C spin
components.
"""

from dataclasses import dataclass, replace
from decimal import Decimal, localcontext

import numpy as np

from taichi_bearings.scene import Scene

DIGITS = 140
CLOSE, FINAL = Decimal("1e-6"), Decimal("1e-25")  # Newton's decrement that is reached on the way, and at the end
SHRINK, TARGET = Decimal("0.01"), Decimal("1e-60")  # factor of the barrier in a step, and in all
NOTHING = Decimal("1e-40")  # a least cost below this share of that of even spins is taken for zero
CLEAR = Decimal("1e-20")  # smaller slips over the jump, or margins over the friction, are taken for zero at the end
WANTED = Decimal("1e-20")  # relative width of the enclosure
MOST_STEPS = 4000
SLIPLESS, SLIPPING, UNCLEAR = range(3)  # states of contacts, the first two as in files


@dataclass(frozen=True)
class Truth:
    """An enclosure of the least objective (power or potential) of a sample, by decimals of 140 digits.

    lower, upper : bounds of the least objective, energy/time.
    state : states of the contacts, an array for each axis: SLIPLESS at every minimum, SLIPPING in the middle of the
        minima, or UNCLEAR; empty where states are not known.
    unit : energy/time, to which errors are relative if the least objective is 0; otherwise 0. It is the cost if each
        contact slipped by one unit of spins (`unit_of`; by the spin of the top, where top and bottom have the same).
    """

    lower: Decimal
    upper: Decimal
    state: tuple[np.ndarray, ...] = ()
    unit: Decimal = Decimal(0)


def _decimals(values: np.ndarray) -> np.ndarray:
    """Return an array (numbers,) of decimals that are exactly the doubles in `values`, an array of any shape."""
    return np.array([Decimal(float(value)) for value in np.ravel(values)], dtype=object)


def _costs(scene: Scene, wanted: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (contacts,), a and c, energy/time, of some contacts: a contact with the slip d costs a |d| + c
    |d|^2 / 2, where d is measured in the unit of spins (`unit_of`).

    scene : one sample.
    wanted : slice of the contacts that are wanted.
    """
    speed = Decimal(scene.radius) * unit_of(scene)
    values, *second = (_decimals(of[0, wanted]) for of in scene.named_coefficients.values())
    if not scene.law.has_friction:
        return 0 * values, values * 2 * speed**2  # the power is twice the potential
    return values * Decimal(scene.normal_force) * speed, second[0] * speed**2 if second else 0 * values


def unit_of(scene: Scene) -> Decimal:
    """Return the unit of spins for a scene, 1/time: the difference of the imposed spins of top and bottom, or 1 where
    bearing states are imposed.
    """
    if scene.top is not None:
        return Decimal(1)
    return abs(Decimal(scene.spin_top) - Decimal(scene.spin_bottom))


def jump_of(scene: Scene) -> dict[int, np.ndarray]:
    """Return the difference of the imposed spins, top minus bottom, by spin component k (0, 1; 2 in 2D), as decimals.
    Components that drive no slip are left out. Each is (columns,), one number for each sphere of the top, or (1,) if
    all are equal. The unit is that of `unit_of`: 1/time if the scene has `top` and `bottom`, else the difference of
    spin_top and spin_bottom, so that the numbers are components of the direction of the spins.
    """
    if scene.top is not None and scene.bottom is not None:
        (*high, rise), (*low, fall) = ([Decimal(part) for part in of] for of in (scene.top, scene.bottom))
        if scene.lattice.dimension == 2:
            return {2: np.array([rise - fall], dtype=object)} if rise != fall else {}
        found, spacing = {}, 2 * Decimal(scene.radius)
        for k, steps in enumerate(np.indices(scene.lattice.shape[:-1]).reshape(2, -1).tolist()):
            of_k = [high[k] - low[k] + (rise - fall) * spacing * step for step in steps]
            if any(of_k):
                found[k] = np.array(of_k if rise != fall else of_k[:1], dtype=object)
        return found
    if scene.spin_top == scene.spin_bottom:
        return {}
    if scene.lattice.dimension == 2:
        return {2: np.array([Decimal(1)], dtype=object)}
    parts = [Decimal(float(part)) for part in scene.direction]
    length = sum((part * part for part in parts), Decimal(0)).sqrt()
    return {k: np.array([parts[k] / length], dtype=object) for k in (0, 1) if parts[k]}


class Sample:
    """A small sample: its spins and contacts as arrays of decimals. C spin components drive slip.

    spin : (spins,), one after the other: components of the free spheres, a zero for the bottom, those of the top; over
        the unit of spins.
    jump : by spin component, spins of the top less those of the bottom, (columns,) or (1,) decimals.
    top : the same numbers in one row, column after column.
    unknowns : number of components of free spheres, which come first in `spin`.
    low, up : (E contacts, C), indices into `spin` of the components of the lower and of the upper sphere of a contact.
    makes_slip : (E, C), 1 for components that make the contact slip, else 0.
    a, c : (E, 1), energy/time: a contact with the slip d costs a |d| + c |d|^2 / 2.
    of : (E,), indices of these contacts among all contacts of the lattice: those without cost are left out.
    box : (unknowns,), largest value that each free component can have at a minimum.
    """

    def __init__(self, scene: Scene) -> None:
        """Set up the arrays of a scene of one sample; the spins to start from grow evenly with the height."""
        lattice, shape = scene.lattice, scene.lattice.shape
        self.jump = jump_of(scene)
        count, free = len(self.jump), int(np.prod(shape[:-1])) * (shape[-1] - 2)
        self.unknowns = free * count
        # index of each spin component in the array of spins: first the free ones, then the bottom's, then the top's
        place = np.empty((*shape, count), dtype=int)
        place[..., 1:-1, :] = np.moveaxis(np.arange(self.unknowns).reshape(-1, *shape[:-1], count), 0, -2)
        place[..., 0, :] = self.unknowns
        self.top = np.stack(list(self.jump.values()), axis=-1).ravel()  # one column of spheres after the other
        varies = len(self.top) > count  # the spin of the top differs between columns
        place[..., -1, :] = (
            self.unknowns + 1 + np.arange(len(self.top)).reshape((*shape[:-1], count) if varies else count)
        )
        # contacts that cost something, without those within the driven planes
        low, up = place.reshape(lattice.sites, count)[lattice.ends]
        a, c = _costs(scene)
        sideways = lattice.between_driven & (lattice.axis < lattice.dimension - 1)
        self.of = np.flatnonzero(~sideways & (a + c > 0))
        self.low, self.up, self.a, self.c = low[self.of], up[self.of], a[self.of, None], c[self.of, None]
        self.makes_slip = (lattice.axis[self.of, None] != list(self.jump)).astype(int)
        # spins that grow evenly with the height, and the largest value that each can have at the minimum
        layer = self.unknowns // max(shape[-1] - 2, 1)
        height = [Decimal(i // layer + 1) / (shape[-1] - 1) for i in range(self.unknowns)]
        parts = self.top[np.arange(self.unknowns) % len(self.top)]
        self.spin = np.concatenate([np.array(height, dtype=object) * parts, [Decimal(0)], self.top])
        self.box = np.abs(parts)

    def slips(self) -> np.ndarray:
        """Return the slips (E contacts, C components) of the contacts, in units of spin."""
        found: np.ndarray = (self.spin[self.up] - self.spin[self.low]) * self.makes_slip
        return found

    def torques(self, force: np.ndarray) -> np.ndarray:
        """Return the sum of the contact forces on each component of the free spins, (unknowns,).

        force : (E contacts, C components), forces.
        """
        total = np.full(len(self.spin), Decimal(0), dtype=object)
        np.add.at(total, self.up, force)
        np.subtract.at(total, self.low, force)
        return total[: self.unknowns]

    def forces(self, barrier: Decimal) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return at the present spins slips (E contacts, C components), their lengths (E, 1), friction (E, C), and
        friction over slip (E, 1).

        barrier : energy/time, how much the cost is smoothed. Friction is a slip / (width + root) with width = barrier /
            a and root = sqrt(width^2 + slip^2).

        Along the central path the cost a |slip| of a contact is replaced by a smooth function, which tends to it as
        `barrier` goes to 0; so friction never exceeds its limit.
        """
        slip = self.slips()
        length = np.sqrt((slip * slip).sum(axis=1, keepdims=True))
        width = np.divide(np.full_like(self.a, barrier), self.a, out=np.zeros_like(self.a), where=self.a > 0)
        self.root = np.sqrt(width * width + length * length)
        stiffness = np.divide(self.a, width + self.root, out=np.zeros_like(self.a), where=self.a > 0)
        return slip, length, stiffness * slip, stiffness

    def step(self, barrier: Decimal) -> Decimal:
        """Make a Newton step towards the minimum of the smoothed cost, and return its decrement, sqrt(gradient * step /
        barrier): a number without unit that goes to 0 at the minimum. While it is above 1/4, the step is divided by 1 +
        decrement, which makes the method converge from anywhere (Nesterov and Nemirovskii, 1994).

        barrier : energy/time, how much the cost is smoothed, as in `forces`.
        """
        slip, _, friction, stiffness = self.forces(barrier)
        # second derivatives of a contact: (stiffness + c) 1 - bend slip slip^T, added at its ends with signs
        matrix = np.full((len(self.spin), len(self.spin)), Decimal(0), dtype=object)
        bend = np.divide(stiffness * stiffness, self.a * self.root, out=np.zeros_like(self.a), where=self.a > 0)
        straight = (self.makes_slip * (stiffness + self.c))[:, :, None] * np.eye(slip.shape[1], dtype=int)
        block = straight - bend[:, :, None] * slip[:, :, None] * slip[:, None, :]
        for here, sign in ((self.up, 1), (self.low, -1)):
            np.add.at(matrix, (here[:, :, None], self.up[:, None]), sign * block)
            np.subtract.at(matrix, (here[:, :, None], self.low[:, None]), sign * block)
        gradient = self.torques(friction + self.c * slip)
        change = _solve(matrix[: self.unknowns, : self.unknowns], gradient)
        # a full step only where Newton's method converges quadratically, else a damped one
        decrement = (max(gradient @ change, Decimal(0)) / barrier).sqrt()
        self.spin[: self.unknowns] -= change / (1 + decrement if decrement > Decimal("0.25") else 1)
        found: Decimal = decrement
        return found

    def cost(self) -> Decimal:
        """Return the cost of the present spins, energy/time."""
        square = (self.slips() ** 2).sum(axis=1, keepdims=True)
        found: Decimal = (self.a * np.sqrt(square) + self.c * square / 2).sum()
        return found

    def enclosure(self, barrier: Decimal) -> tuple[Decimal, Decimal]:
        """Return a lower and an upper bound of the least cost, energy/time. The lower bound is the work of the driven
        planes, less c |d|^2 / 2 of all slips d, less the most that forces out of balance can take. The upper bound is
        the cost of the present spins.

        barrier : energy/time, how much the cost is smoothed.
        """
        slip, length, friction, _ = self.forces(barrier)
        force, viscous = friction + self.c * slip, (self.c * length * length).sum() / 2
        top = np.concatenate([np.full(self.unknowns + 1, Decimal(0), dtype=object), self.top])
        work = (force * (top[self.up] - top[self.low]) * self.makes_slip).sum()
        paid = np.abs(self.torques(force) * self.box).sum()
        return work - viscous - paid, self.cost()


def _solve(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return x with matrix x = right, by Gauss elimination. Unknowns without stiffness (of spheres that are cut off)
    are 0.

    matrix : (unknowns, unknowns), symmetric, of decimals.
    right : (unknowns,), of decimals.
    """
    n, scale = len(right), matrix.diagonal().copy()
    matrix, x = matrix.copy(), right.copy()
    for k in range(n):
        if matrix[k, k] <= scale[k] * Decimal("1e-90"):  # no stiffness but for rounding
            matrix[k, k:], x[k] = Decimal(0), Decimal(0)
            continue
        share = matrix[k + 1 :, k] / matrix[k, k]
        used = np.flatnonzero(share)  # rows that change, and columns: the matrix is symmetric
        below = k + 1 + used
        matrix[below[:, None], below] -= share[used, None] * matrix[k, below]
        x[below] -= share[used] * x[k]
    for k in reversed(range(n)):
        if matrix[k, k]:
            x[k] = (x[k] - matrix[k, k + 1 :] @ x[k + 1 :]) / matrix[k, k]
    found: np.ndarray = x
    return found


def least(scene: Scene) -> Truth:
    """Return the exact minimum of a scene with one small sample, by its central path. Raises ArithmeticError if the
    least value cannot be enclosed to the relative width WANTED.
    """
    with localcontext() as context:
        context.prec = DIGITS
        return followed(scene, Sample(scene))[0] if jump_of(scene) else _truth_without_slip(scene)


def followed(scene: Scene, sample: Sample) -> tuple[Truth, Decimal]:
    """Follow the central path of a sample to its end. Return the enclosure of the least value, and the last barrier
    (how much the cost was smoothed), energy/time.

    scene : what is solved.
    sample : its spins and contacts as decimals. The spins are changed: they end at the minimum.
    """
    barrier = first = sample.cost() / len(sample.a)
    steps, has_friction, before = 0, sample.a.any(), sample.spin
    while True:
        is_last = not has_friction or barrier < first * TARGET  # without friction the cost needs no barrier
        decrement = sample.step(barrier)
        steps += 1
        if decrement < (FINAL if is_last else CLOSE):
            lower, upper = sample.enclosure(barrier)
            if is_last or upper < first * TARGET:
                break
            # the next barrier, from spins that are extrapolated: they are smooth functions of the barrier
            barrier *= SHRINK
            here = sample.spin
            sample.spin = here + SHRINK * (here - before)
            before = here
        if steps > MOST_STEPS:
            raise ArithmeticError(f"the bounds on the least power of {scene} are not close enough after {steps} steps")
    if upper < first * NOTHING:
        return Truth(Decimal(0), upper, _states(scene, sample, barrier), _truth_without_slip(scene).unit), barrier
    if upper - lower > upper * WANTED:
        raise ArithmeticError(f"the least power of {scene} is only known to be from {lower:.25e} to {upper:.25e}")
    return Truth(lower, upper, _states(scene, sample, barrier)), barrier


def _truth_without_slip(scene: Scene) -> Truth:
    """Return bounds of 0 on the least objective of a scene in which no contact need slip, with the unit of errors."""
    # spins that are equal have no difference as their unit; a bottom at rest gives one
    moving = scene if scene.top is not None or scene.spin_top != scene.spin_bottom else replace(scene, spin_bottom=0.0)
    a, c = _costs(moving)
    return Truth(Decimal(0), Decimal(0), unit=(a + c / 2).sum())


def _states(scene: Scene, sample: Sample, barrier: Decimal) -> tuple[np.ndarray, ...]:
    """Return the state of each contact, an array for each axis; empty for a law without friction.

    scene : what is solved.
    sample : the sample; its spins are those at the end of the central path.
    barrier : weight of the barrier there, energy/time.

    A contact slips if its slip is clearly above 0 and its friction is at the limit; it is slipless if its slip is 0 and
    its friction is clearly below. Any other is UNCLEAR.
    """
    if not scene.law.has_friction:
        return ()
    state = np.full(scene.lattice.all_contacts, UNCLEAR, dtype=np.uint8)
    _, length, _, stiffness = sample.forces(barrier)
    ratio = np.divide(stiffness * length, sample.a, out=np.ones_like(sample.a), where=sample.a > 0)
    slips, has_margin = length[:, 0] > CLEAR, 1 - ratio[:, 0] > CLEAR
    known = (sample.a[:, 0] > 0) & (slips != has_margin)
    state[sample.of[known]] = np.where(slips, SLIPPING, SLIPLESS)[known]
    return scene.lattice.by_axis(state)


def layered(scene: Scene) -> Truth:
    """Return the exact least cost, as two equal bounds, of a scene of any size in which all columns of spheres have
    equal contacts along the height: each column is solved as a chain. Raises ValueError for friction with viscosity if
    the imposed spins vary over the plane.
    """
    with localcontext() as context:
        context.prec = DIGITS
        columns = int(np.prod(scene.lattice.shape[:-1]))
        squares = sum((part * part for part in jump_of(scene).values()), np.full(1, Decimal(0), dtype=object))
        across = np.broadcast_to(np.sqrt(squares), columns)
        if len(set(across.tolist())) > 1 and len(scene.law.quantities) > 1:
            raise ValueError(
                "with friction and viscosity the imposed spins of all spheres in a driven plane must be equal"
            )
        # costs of the first column, which stands for all; each distinct jump is solved once
        first = scene.lattice.spans[-1].start
        a, c = (costs.tolist() for costs in _costs(scene, slice(first, first + scene.lattice.shape[-1] - 1)))
        if not any(across):
            return _truth_without_slip(scene)
        cost = Decimal(0)
        for of in filter(None, set(across.tolist())):
            chain = _chain([friction * of for friction in a], [viscosity * of**2 for viscosity in c])
            cost += chain * int((across == of).sum())
        return Truth(cost, cost)


def _chain(friction: list[Decimal], viscosity: list[Decimal]) -> Decimal:
    """Return the least sum of friction * v + viscosity * v^2 / 2 over slips v >= 0 that add up to 1, for contacts in a
    row. At the minimum all contacts that slip bear the same force, friction + viscosity * v.

    friction, viscosity : coefficients of the contacts of a column, lists with one entry for each.
    """
    order = sorted(range(len(friction)), key=lambda k: friction[k])
    if not viscosity[order[0]]:
        return friction[order[0]]
    # the force at which slips of the contacts of least friction add up to 1; one more slips if its friction is less
    compliance, shift = Decimal(0), Decimal(0)
    force = Decimal("Infinity")
    for k in order:
        if friction[k] >= force:
            break
        compliance += 1 / viscosity[k]
        shift += friction[k] / viscosity[k]
        force = (1 + shift) / compliance
    slips = [max(force - f, Decimal(0)) / eta for f, eta in zip(friction, viscosity, strict=True)]
    return sum((f * v + eta * v * v / 2 for f, eta, v in zip(friction, viscosity, slips, strict=True)), Decimal(0))
