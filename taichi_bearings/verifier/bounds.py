"""Upper and lower bound of the least power, rigorously, from spins and from friction.

With g = n x F the torques of a contact are -R g on both its spheres, so what the friction does on any spins that obey
the driving is R times the sum over contacts of g . (w_i + w_j), and

    least potential >= that least work - sum max(|F| - mu F_n, 0)^2 / (2 eta),

with no friction but viscous contacts for mu = 0, and for Coulomb friction alone, eta = 0, if no |F| exceeds mu F_n.

The work is that of the driven planes where all free spheres are in balance. Where they are not, some minimum has its
signed spins between those of the planes, component by component: the least that the torque left over can do there
counts. A friction that exceeds its limit is made admissible by dividing all by the largest excess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taichi_bearings.verifier.enclosure import UP, Enclosure, row_sum
from taichi_bearings.verifier.motion import length, spread
from taichi_bearings.verifier.samples import Samples

DOUBLE_ERROR = 1e-12  # more than doubles are off


@dataclass(frozen=True)
class Work:
    """(R,) each: work of the driven planes against the friction; price, what torques left over on free spheres may take
    from it; cost, the sum over viscous contacts; all in the units of `Motion.power`.

    saturation : (R,), largest |F| / (mu F_n), rounded up (Coulomb alone, else 0).
    largest_torque : (R,), left over on a free sphere in the components that are driven, over the radius and in units of
    `force_unit`, rounded up.
    size : |F| of every contact, (R, *contacts) an axis, in units of `force_unit`.
    """

    work: Enclosure
    price: Enclosure
    cost: Enclosure
    saturation: np.ndarray
    largest_torque: np.ndarray
    size: list[Enclosure]


def work_of(samples: Samples) -> Work:
    """What the friction of the samples proves."""
    count = samples.count
    work = price = cost = Enclosure.exact(np.zeros(count))
    largest, saturation = np.zeros(count), np.zeros(count)
    for k, torque in samples.torques.items():  # nothing that turns about others does any work
        signed = torque.signed(samples.sublattice)
        top, free = signed[..., -1], signed[..., 1:-1]
        on_top, everywhere = (samples.jump_over(k, axes) for axes in (samples.dimension - 1, samples.dimension))
        work = work + row_sum((top * on_top).reshaped((count, -1)))
        largest = np.maximum(largest, free.most.reshape(count, -1).max(axis=1, initial=0.0))
        # the least of torque * spin for a spin from 0 to the jump: 0 where the two have the same sign for sure
        taken = np.where(np.sign(everywhere.high) * free.high < free.error + np.abs(free.low), free.most, 0.0)
        price = price + row_sum((Enclosure.exact(taken) * abs(everywhere)).reshaped((count, -1)))
    sizes = [length([Enclosure.exact(part) for part in turning.values()]) for turning in samples.turning]
    for axis, whole in enumerate(sizes):
        acts = ~samples.idle(axis)
        if not samples.flows:
            saturation = np.maximum(saturation, _largest_share(whole, samples.strength[axis], acts))
            continue
        size = Enclosure(*(np.where(acts, part, 0.0) for part in whole.parts))
        if samples.holds:  # no less than what is beyond the friction
            size = Enclosure.exact(np.where(acts, np.maximum((size - samples.strength[axis]).upper(), 0.0), 0.0))
        cost = cost + row_sum((size * size / _or_one(samples.slope[axis], acts)).signed(0.5).reshaped((count, -1)))
    if not samples.holds:  # a force is damping * radius * spin
        speed = spread(Enclosure.exact([samples.radius * samples.spin_unit]), count)
        work, price, cost = work / speed, price / speed, cost / speed / speed
    return Work(work, price, cost, saturation, largest, sizes)


def _largest_share(size: Enclosure, strength: Enclosure, acts: np.ndarray) -> np.ndarray:
    """Largest size / strength of the contacts that take part, (R,), rounded up: of those that are about as large."""
    about = np.divide(size.high, strength.high, out=np.zeros(size.high.shape), where=acts).reshape(len(acts), -1)
    first = about.max(axis=1, initial=0.0, keepdims=True)
    large = np.flatnonzero(acts & ~(about < first * (1 - DOUBLE_ERROR)).reshape(acts.shape))
    found = np.zeros(len(about))
    np.maximum.at(found, large // about.shape[1], (size.at(large) / strength.at(large)).most)
    return found


def _or_one(values: Enclosure, acts: np.ndarray) -> Enclosure:
    """The values, and 1 for contacts that take no part."""
    return Enclosure(*(np.where(acts, part, other) for part, other in zip(values.parts, (1.0, 0.0, 0.0), strict=True)))


def lower_bound(samples: Samples, work: Work) -> np.ndarray:
    """Of the least objective, (R,), in the units of `Motion.power`; not below 0."""
    return np.maximum(_proven(samples, work).lower(), 0.0)


def _proven(samples: Samples, work: Work) -> Enclosure:
    """The same, and below 0 where the friction proves less than nothing."""
    left = work.work - work.price
    if samples.flows:
        return (left - work.cost).signed(samples.share)
    return left / Enclosure.exact(np.maximum(work.saturation, 1.0))


def slip_bounds(samples: Samples, work: Work, objective: np.ndarray) -> list[np.ndarray]:
    """No minimum slips faster: (R, *contacts) an axis, over radius * `spin_unit`, rounded up; of laws with friction.

    objective : (R,), of any spins, rounded up. Nor does any slip more than the spins between those of the planes allow.
    """
    excess = np.maximum(((objective - _proven(samples, work).lower()) * UP).reshape(-1, *(1,) * samples.dimension), 0.0)
    worst = np.maximum(work.saturation, 1.0).reshape(excess.shape)  # no disc is exceeded without viscosity
    found = []
    for axis, size in enumerate(work.size):
        if not samples.flows and (worst > 1).any():
            size = size / Enclosure.exact(np.broadcast_to(worst, size.high.shape))
        slope = samples.slope[axis].least if samples.flows else np.zeros(1)
        bound = slip_bound((samples.strength[axis] - size).lower(), slope, excess)
        box = np.sqrt(sum(samples.jump_over(k, samples.dimension).most ** 2 for k in samples.felt(axis)))
        bound = np.fmin(bound, box) * UP
        found.append(np.where(samples.between_driven(axis), 0.0, bound))
    return found


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def slip_bound(room: np.ndarray, slope: np.ndarray, excess: np.ndarray) -> np.ndarray:
    """No contact slips faster at any minimum; nearly rounded up, or no number. room : m = mu F_n - |F|, rounded down.

    Let E, the excess, be the potential of any spins less what the friction F proves. At a minimum no contact has
    phi(v) + phi*(F) - |F| v below 0, and all together have no more than E. With room in its disc a contact of Coulomb's
    has m v <= E, one with viscosity eta as well eta v^2 / 2 + m v <= E, and where F exceeds the disc
    eta (v + m / eta)^2 / 2 <= E.
    """
    inside = np.maximum(room, 0.0)
    root = np.sqrt(inside**2 + 2 * slope * excess)
    beyond = np.where(room < 0, -room / slope, 0.0)  # infinite without viscosity
    return np.where((excess > 0) | (slope == 0), 2 * excess / (inside + root), 0.0) + beyond
