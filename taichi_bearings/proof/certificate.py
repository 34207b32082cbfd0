"""Bounds on what the stationary state minimises, from any spins and any contact forces: theorem 1 in float64.

Letters: R samples (also called replicas), N spheres, E contacts, C spin components; a the radius of the spheres, Omega
their spins.

The problem is convex and has a dual. With t_i the sum of the contact forces that pull on sphere i, and phi* the
conjugate of the potential of a contact (scene/law.py), for any forces f that the law admits

    least potential >= a [ sum_driven -(Omega_i - c) . t_i  -  sum_free |t_i| . w ]  -  sum_e phi*(|f_e|)

Here c and w are the middle and the half width of the interval between the spins of the two driven planes in each
component; where these depend on the coordinate x_k of component k, in each layer x_k = const. Some minimiser lies in
that box. So a torque that is left over on a free sphere is paid for, never ignored.

Candidates are made from the given forces and the best bound is kept. With friction there are three:
1. the forces capped at the friction limit, contact by contact;
2. the forces after a Poisson solve has removed the leftover torque, divided by one number so that all are within
   limits;
3. these balanced forces capped contact by contact.
Where the force grows with the slip all forces are admissible; the candidates are the given forces, and those without
the leftover torque. A law of the user's own may have a largest force, beyond which its phi* is infinite; forces beyond
it are shortened, contact by contact or all by one number, until phi* is finite. Rounding is subtracted, too: torques
are summed in twice the precision, so it is proportional to the leftover torques and the power, not to the much larger
sum of all forces times the imposed jump.
"""

from collections.abc import Callable, Iterator

import numpy as np

from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import contact_differences, torques
from taichi_bearings.numerics.poisson import solve_poisson
from taichi_bearings.proof.column_sums import (
    CACHED_PULLS,
    Share,
    column_sums,
    largest_torques,
    parts_in_cache,
    torques_on,
)
from taichi_bearings.scene.bearing import Bearing, inverse
from taichi_bearings.scene.scene import Scene, vector_length

Forces = np.ndarray  # (C, R, E), along the spin difference of each contact
SUM_ROUNDING = 32 * np.finfo(np.float64).eps  # relative allowance for the rounding of sums
# the same for the force on a sphere as a plain sum over its contacts: at most 6 of them, each counted at both its ends
PLAIN_ROUNDING = 8 * np.finfo(np.float64).eps
ROUNDED_PULL = 1e-13  # leftover force on a sphere, relative to the largest force, that counts as rounding
# relative distance from the bound below which it is worth computing what forces prove with all roundings
ENCLOSED_GAP = 1e-9
CERTIFIED_ERROR, MOST_PROJECTIONS = 1e-13, 100  # for certifying_forces: relative error, and most projections on discs
SHORTENINGS = 12  # halvings of the interval of the factor by which a force is shortened
LONG_BALANCE = 60_000  # spheres from which a projection on forces in balance takes as long as ten iterations


def lower_bound(scene: Scene, force: Forces, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return a proven lower bound (R,) on the least objective of each of R samples (power, or potential with
    viscosity), energy/time; never below 0.

    scene : R samples of a lattice with E contacts each.
    force : (C, R, E), friction of the E contacts in C spin components, any values; those that are not finite prove
        nothing.
    spin_axes : the axes of the C components."""
    candidates = _candidates(scene, _finite(scene, force), spin_axes)
    best = np.max([dual_value(scene, candidate, spin_axes) for candidate in candidates], axis=0)
    found: np.ndarray = np.maximum(best, 0.0)
    return found


def _candidates(scene: Scene, force: Forces, spin_axes: tuple[int, ...]) -> Iterator[Forces]:
    """Yield forces made from the given ones, (C, R, E) each, that the contact law allows; any of them may prove the
    most. They are the forces as given, balanced, capped at the friction limit, or scaled to be within it, as the law
    needs. Each is made only when it is asked for.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts), finite.
    spin_axes : the axes of the C components."""
    balanced = None
    if not scene.law.is_rate_independent:  # every force is admissible, or nearly
        yield force
        yield (balanced := balance(scene, force, spin_axes))
        if not scene.law.is_sum:
            yield from _shortened(scene, force, one_by_one=True)
            yield from _shortened(scene, balanced, one_by_one=False)
            yield from _shortened(scene, balanced, one_by_one=True)
    if scene.law.is_sum and scene.law.has_friction:
        yield capped(force, saturation(scene, force))
        balanced = balance(scene, force, spin_axes) if balanced is None else balanced
        yield scaled(scene, balanced)
        yield capped(balanced, saturation(scene, balanced))


def _shortened(scene: Scene, force: Forces, one_by_one: bool) -> Iterator[Forces]:
    """Yield forces (C, R, E) shortened until the conjugate of the contact law is finite for all of them; yield nothing
    if it is finite for all given forces. Laws of the user's own may have a largest force, which forces in balance
    exceed by rounding.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts), finite.
    one_by_one : True to shorten each force by its own factor; False for one factor for each sample, so that forces in
        balance stay so."""
    share = _finite_share(scene, vector_length(force))
    if (share < 1).any():
        yield force * (share if one_by_one else share.min(axis=1)[:, None])


def _finite_share(scene: Scene, size: np.ndarray) -> np.ndarray:
    """Return for each force a factor, (R, E) from 0 to 1, with which the conjugate of the law is finite: about the
    largest one. The conjugate is convex and 0 without a force, so it is finite for all smaller factors, too.

    scene : R samples of a lattice with E contacts each.
    size : (R, E), sizes of the forces."""

    def is_finite(share: np.ndarray) -> np.ndarray:
        """Return a mask (R, E) of the forces that, times `share` (R, E), have a finite conjugate."""
        with np.errstate(all="ignore"):
            found: np.ndarray = np.isfinite(scene.law.conjugate(scene.material, size * share))
        return found

    whole = is_finite(np.ones(size.shape))
    if whole.all():
        return whole.astype(np.float64)
    # the factor is 1 - 2^-k, and the interval in which k lies is halved
    low, high = np.zeros(size.shape), np.full(size.shape, float(np.finfo(np.float64).nmant))
    for _ in range(SHORTENINGS):
        middle = (low + high) / 2
        is_fine = is_finite(1 - 2.0**-middle)
        low, high = np.where(is_fine, middle, low), np.where(is_fine, high, middle)
    found: np.ndarray = np.where(whole, 1.0, (1 - 2.0**-low) * (1 - SUM_ROUNDING))
    return found


def can_prove_no_state(scene: Scene, excess: np.ndarray) -> bool:
    """Return True if the gap of every sample is so wide that no contact state can follow from it.

    There are two bounds on the slip of a contact at any minimum. (1) It is at most excess / (w - |f|), with the
    friction limit w and the friction f. (2) It is at most the radius times the jump, the difference between the spins
    of both planes, as spins of minima lie between these. If the excess is at least the largest w times the speed of
    (2), then (1) says no more than (2) for any contact, whatever f is.

    scene : R samples of a lattice. The answer is False unless its contacts have friction alone.
    excess : (R,) for R samples, power less its proven lower bound, energy/time."""
    if not scene.law.is_rate_independent:
        return False
    strongest = scene.strength * scene.acting_coefficient.max(axis=1, initial=0.0)
    return bool((excess >= strongest * scene.lattice.radius * scene.jump).all() and scene.jump > 0)


def certifying_forces(
    scene: Scene, force: Forces, spin_axes: tuple[int, ...], bound: np.ndarray, excess: np.ndarray | None = None,
    are_states_asked: bool = True,
) -> Forces:  # fmt: skip
    """Return forces (C, R, E) near the given ones that prove a bound by themselves: C spin components, R samples, E
    contacts.

    They leave no torque on any free sphere but rounding, and with Coulomb friction none is above its limit. The bound
    is then the work of the driven planes, less the potential that is dual to each force. Where such forces prove less
    than `bound`, forces are returned that leave torques over, whose price is subtracted.

    scene : R samples of a lattice with E contacts each.
    force : (C, R, E), friction to begin with.
    spin_axes : the axes of the C components.
    bound : (R,), energy/time, lower bound on the objective that the forces should prove.
    excess : (R,), objective less bound; None if it is not known.
    are_states_asked : False if no contact state is to be proven by the forces.

    If no contact state can follow from `excess` (`can_prove_no_state`), or none is asked for on a large lattice with
    friction alone, any forces that prove `bound` are returned. Else forces are projected in turn on those in balance
    and, over-relaxed by 1.5, on the friction discs. Zero forces are in both sets, so this converges linearly (Bauschke
    and Borwein, SIAM Review 38, 1996). A sample ends after MOST_PROJECTIONS, or once its balanced forces, divided by
    their largest |f| / (mu F_n), prove `bound` or need no division."""
    given = force = _finite(scene, force)
    proves_none = excess is not None and can_prove_no_state(scene, excess)
    if proves_none or (not are_states_asked and scene.lattice.sites >= LONG_BALANCE and scene.law.is_rate_independent):
        return _most_proving(scene, given, np.full(scene.replicas, -np.inf), given, spin_axes, bound)
    # Balance the forces of samples that leave torques; without friction limits that is all.
    largest = np.abs(force).max(axis=(0, 2), initial=0.0)
    left_over = largest_unbalanced_torque(scene, force, spin_axes) / scene.lattice.radius
    in_balance = left_over <= ROUNDED_PULL * largest
    if not in_balance.all():
        force = _where(in_balance, force, balance(scene, force, spin_axes))
    if not scene.law.is_rate_independent:
        return _most_proving(scene, force, dual_value(scene, force, spin_axes), given, spin_axes, bound)
    # What balanced forces prove once divided by `worst`, but for rounding: the work of the planes against them.
    ratio = saturation(scene, force)
    worst, best = ratio.max(axis=1), force
    value_of_best, worst_of_best = _work_of_planes(scene, force, spin_axes) / np.maximum(worst, 1.0), worst
    whole = None  # the best forces divided by `worst`, and the bound that they prove with all roundings, once computed
    proven, better = np.zeros(scene.replicas), np.ones(scene.replicas, dtype=bool)
    done = ~better  # each replica ends by itself, whatever the others need
    for _ in range(MOST_PROJECTIONS):
        is_close = better & (value_of_best >= bound * (1 - ENCLOSED_GAP))
        if is_close.any():
            whole = whole or _as_a_whole(scene, best, worst_of_best, spin_axes)
            proven = np.where(is_close, whole[1], proven)
        done |= (proven >= bound * (1 - CERTIFIED_ERROR)) | (worst <= 1 + CERTIFIED_ERROR)
        if done.all():
            break
        force = _where(done, force, balance(scene, _over_relaxed(force, ratio), spin_axes))
        ratio = saturation(scene, force)
        worst = ratio.max(axis=1)
        value = _work_of_planes(scene, force, spin_axes) / np.maximum(worst, 1.0)
        better = ~done & (value > value_of_best)
        best, value_of_best, whole = _where(better, force, best), np.where(better, value, value_of_best), None
        worst_of_best = np.where(better, worst, worst_of_best)
    scaled_best, proven = whole or _as_a_whole(scene, best, worst_of_best, spin_axes)
    return _most_proving(scene, scaled_best, proven, given, spin_axes, bound)


def _work_of_planes(scene: Scene, force: Forces, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return the work (R,), energy/time, that the driven planes do against friction forces which balance on every free
    sphere. For laws of friction alone; the result is in plain doubles, with no allowance for rounding.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts).
    spin_axes : the axes of the C components."""
    top, work = scene.top_spin(spin_axes), np.zeros(scene.replicas)
    upward = scene.lattice.by_axis(force)[-1]
    for slot in tangential(scene.lattice.height_axis, spin_axes):
        ends = top[slot] / 2 * (upward[slot][..., 0] + upward[slot][..., -1])
        work += ends.reshape(scene.replicas, -1).sum(axis=1)
    return scene.lattice.radius * scene.law.share * work


def _as_a_whole(
    scene: Scene, force: Forces, worst: np.ndarray, spin_axes: tuple[int, ...]
) -> tuple[Forces, np.ndarray]:
    """Return the forces (C, R, E), those of each sample divided by one number so that none exceeds its limit; and the
    lower bounds (R,) that they prove, energy/time.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts).
    worst : (R,), the largest |f| / (mu F_n) of each sample; only numbers above 1 divide.
    spin_axes : the axes of the C components."""
    whole = _divided(force, worst)
    return whole, dual_value(scene, whole, spin_axes)


def _most_proving(
    scene: Scene, best: Forces, proven: np.ndarray, force: Forces, spin_axes: tuple[int, ...], bound: np.ndarray
) -> Forces:
    """Return the forces `best` (C, R, E), but in samples where they prove less than `bound` other candidates that prove
    more. Candidates are the forces balanced, capped at the friction limit, or scaled to be within it.

    scene : R samples of a lattice with E contacts each.
    best, proven : (C components, R samples, E contacts) forces, and the lower bounds (R,) that they prove.
    force : (C, R, E), from which the candidates are made.
    spin_axes : the axes of the C components.
    bound : (R,), what the forces should prove, energy/time."""
    candidates = _candidates(scene, force, spin_axes)
    while not (proven >= bound * (1 - CERTIFIED_ERROR)).all() and (candidate := next(candidates, None)) is not None:
        value = dual_value(scene, candidate, spin_axes)
        better = (proven < bound * (1 - CERTIFIED_ERROR)) & (value > proven)
        best, proven = _where(better, candidate, best), np.where(better, value, proven)
    return best


def _where(chosen: np.ndarray, force: Forces, other: Forces) -> Forces:
    """Return the forces `force` in the samples of the mask `chosen` (R,), and `other` in the rest; (C components, R
    samples, E contacts) each."""
    if chosen.all() or not chosen.any():
        return force if chosen.all() else other
    return np.where(chosen[:, None], force, other)


def _finite(scene: Scene, force: Forces) -> Forces:
    """Return forces in float64, set to 0 at contacts that take no part, and all 0 in a sample that has a force which is
    not finite.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R, E), as is the result."""
    force = _without_driven_contacts(scene, np.asarray(force, dtype=np.float64))
    finite = np.isfinite(force).all(axis=(0, 2))
    return force if finite.all() else np.where(finite[:, None], force, 0.0)


def work_and_bound(scene: Scene, balanced: Forces, spin_axes: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays (R,), energy/time: the power of the driven planes against given Coulomb forces; and a lower
    bound on the least power. It is proven by these forces, each capped at its friction limit, or all scaled down by one
    number until none exceeds its limit, whichever proves more.

    The bound holds for any finite forces, with all roundings; the power has plain roundings. Methods that check often
    use this function, since it solves no Poisson problem: their forces leave practically no torque.

    scene : R samples of a lattice with E contacts each, whose law is Coulomb's.
    balanced : (C components, R samples, E contacts), the forces.
    spin_axes : the axes of the C components."""
    ratio = saturation(scene, balanced)
    return work_and_bound_within(scene, balanced, capped(balanced, ratio), ratio.max(axis=1), spin_axes)


def work_and_bound_within(
    scene: Scene, balanced: Forces, within: Forces, worst: np.ndarray, spin_axes: tuple[int, ...], enough: float = 0.0,
    share: Share = map,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return two arrays (R,), energy/time: the power of the driven planes against given Coulomb forces; and a lower
    bound on the least power. It is proven by these forces, each capped at its friction limit, or all scaled down by one
    number until none exceeds its limit, whichever proves more.

    scene : R samples of a lattice with E contacts each, whose law is Coulomb's.
    balanced : (C components, R samples, E contacts), the forces.
    within : (C, R, E), these forces after each is capped at its friction limit.
    worst : (R,), the largest force of each sample over its friction limit; it only decides whether scaled forces are
        tried.
    spin_axes : the axes of the C components.
    enough : 0 to sum torques exactly. Above 0 they are summed in plain doubles first, which is quicker; that is enough
        if the allowance for rounding is at most `enough` times (power - bound).
    share : a function like `map`, which may share the calls among threads."""
    work = _work_of_planes(scene, balanced, spin_axes)
    bound = dual_value(scene, within, spin_axes, enough > 0, share)
    if enough > 0:
        lost = PLAIN_ROUNDING * scene.lattice.radius * scene.jump * _sum_of_sizes(within, share)
        if not (lost <= enough * (work - bound)).all():
            bound = np.maximum(bound, dual_value(scene, within, spin_axes, share=share))
    as_a_whole = work / np.maximum(worst, 1.0)
    if (as_a_whole > bound).any():
        proven = dual_value(scene, scaled(scene, balanced), spin_axes, share=share)
        bound = np.where(as_a_whole > bound, np.maximum(proven, bound), bound)
    return work, np.maximum(bound, 0.0)


def relative_gap(scene: Bearing, objective: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """Return the relative gap of each of R samples, (objective - lower bound) / unit, (R,); NaN where one of the two is
    not a number, so that nothing follows from it.

    The unit is the objective. But where the least objective is 0 (there is no jump, or absent contacts cut the bottom
    from the top), the unit is at least the objective that a slip of all contacts by the jump would have (without a
    jump, by the imposed spin).

    scene : the R samples.
    objective : (R,), power, or potential with viscosity, energy/time.
    bound : (R,), its proven lower bound."""
    unit, idle = objective, scene.is_cut_off | (scene.jump == 0)
    if idle.any():
        speed = np.full((), scene.slip_radius * (scene.jump or scene.top_and_bottom[0]))
        unit = np.where(idle, np.maximum(objective, scene.law.objective(scene.material, speed).sum(axis=1)), objective)
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.divide(objective - bound, unit, out=np.full(np.shape(objective), np.nan), where=unit > 0)
    return np.where((objective == 0) & (bound == 0), 0.0, gap)


def largest_unbalanced_torque(
    scene: Scene, force: Forces, spin_axes: tuple[int, ...], share: Share = map
) -> np.ndarray:
    """Return the largest torque (R,) that forces (C components, R samples, E contacts) leave on a free sphere, force *
    length.

    scene : R samples of a lattice with E contacts each.
    spin_axes : the axes of the C components.
    share : a function like `map`, which may share the calls among threads."""
    found: np.ndarray = scene.lattice.radius * largest_torques(force, scene.lattice, spin_axes, share)
    return found


def dual_value(
    scene: Scene, force: Forces, spin_axes: tuple[int, ...], plain: bool = False, share: Share = map
) -> np.ndarray:
    """Return the lower bound (R,) on the objective that forces prove, balanced or not, energy/time: the work of the
    driven planes, less the price of torques left on free spheres, less the potential that is dual to each force, less
    an allowance for rounding.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts), within their friction limits.
    spin_axes : the axes of the C components.
    plain : sum the torques in plain doubles, which is quicker; the allowance then grows with the sum of all forces.
        Else they are summed in twice the precision.
    share : a function like `map`, which may share the calls among threads."""
    pulls = column_sums(force, scene.lattice, spin_axes, plain, share)
    work, allowance = np.zeros(scene.replicas), np.zeros(scene.replicas)
    for slot, half_width in enumerate(scene.top_spin(spin_axes) / 2):
        # Work of both planes, and the price of torques that are left over on free spheres.
        planes = (half_width * (pulls.top[slot] - pulls.bottom[slot])).reshape(scene.replicas, -1)
        left_over = (np.abs(half_width) * pulls.left_over[slot]).reshape(scene.replicas, -1).sum(axis=1)
        work -= planes.sum(axis=1) + left_over
        allowance += SUM_ROUNDING * (np.abs(planes).sum(axis=1) + left_over)
    total = _sum_of_sizes(force, share)
    allowance += (PLAIN_ROUNDING if plain else SUM_ROUNDING**2) * total * scene.jump
    work, allowance = work * scene.lattice.radius, allowance * scene.lattice.radius
    if not scene.law.is_rate_independent:  # else the conjugate of admissible forces is 0
        with np.errstate(all="ignore"):  # functions of a user
            cost = scene.law.conjugate(scene.material, vector_length(force)).sum(axis=1)
        cost = np.where(np.isnan(cost), np.inf, cost)
        work, allowance = work - cost, allowance + SUM_ROUNDING * cost
    return scene.law.share * (work - allowance)


def _sum_of_sizes(force: Forces, share: Share = map) -> np.ndarray:
    """Return the sum (R,) of the absolute values of forces (C components, R samples, E contacts) over components and
    contacts, added up in pieces that fit the caches.

    force : (C, R, E), the forces.
    share : a function like `map`, which may share the calls among threads.
    """
    pieces = range(0, force.shape[2], CACHED_PULLS)
    sums = list(share(lambda first: np.abs(force[..., first : first + CACHED_PULLS]).sum(axis=(0, 2)), pieces))
    return np.sum(sums, axis=0) if sums else np.zeros(force.shape[1])


def precise_torques(scene: Scene, force: Forces, spin_axes: tuple[int, ...]) -> np.ndarray:
    """Return the sum of the contact forces that pull on each sphere, as if summed in twice the precision: (C
    components, R samples, *N), with *N the shape of the lattice.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts).
    spin_axes : the axes of the C components."""
    total = np.empty((len(spin_axes), scene.replicas, *scene.lattice.shape))
    for part in parts_in_cache(total.shape[1:]):
        total[:, part[0], part[1]] = torques_on(part, force, scene.lattice, spin_axes, plain=False)
    return total


def capped(force: Forces, ratio: np.ndarray) -> Forces:
    """Return the forces (C components, R samples, E contacts), each at most as long as its friction limit: longer ones
    are shortened to it.

    ratio : (R, E), |force| over friction limit."""
    return _changed(force, ratio, lambda f, share: f * share)


def _over_relaxed(force: Forces, ratio: np.ndarray) -> Forces:
    """Return the forces (C components, R samples, E contacts), those above their friction limit shortened by one and a
    half times what they exceed it by.

    force : (C, R, E).
    ratio : (R, E), |force| over friction limit."""
    return _changed(force, ratio, lambda f, share: f + 1.5 * (f * share - f))


def _changed(force: Forces, ratio: np.ndarray, change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Forces:
    """Return the forces (C components, R samples, E contacts) after the function `change` of each, computed in parts
    that fit the caches.

    force : (C, R, E).
    ratio : (R, E), |force| over friction limit.
    change : function that returns the new value of a component of forces. It takes the component, and for each force
        the factor, at most 1, that brings it back to its friction limit (0 for a force of 0)."""
    found = np.empty(force.shape)
    for part in parts_in_cache(ratio.shape):
        share = inverse(ratio[part])
        np.minimum(1.0, share, out=share)
        for whole, given in zip(found, force, strict=True):
            whole[part] = change(given[part], share)
    return found


def scaled(scene: Scene, force: Forces) -> Forces:
    """Return the forces (C components, R samples, E contacts), those of each sample divided by the largest |f| / (mu
    F_n) of its contacts where that exceeds 1. So all are within their limits, and forces in balance stay so.

    scene : the R samples, with their friction limits.
    force : (C, R, E), 0 at contacts that take no part."""
    return _divided(force, saturation(scene, force).max(axis=1))


def _divided(force: Forces, worst: np.ndarray) -> Forces:
    """Return the forces (C components, R samples, E contacts), those of each sample divided by its number in `worst`
    (R,) where that exceeds 1.

    force : (C, R, E)."""
    if (worst <= 1.0).all():
        return force
    found: Forces = force * (1.0 / np.maximum(worst, 1.0))[:, None]
    return found


def saturation(scene: Bearing, force: Forces) -> np.ndarray:
    """Return |f| / (mu F_n) of every contact, (R samples, E contacts), rounded up: 0 at contacts that take no part,
    infinite for a force at an absent contact.

    scene : the R samples, with their friction limits mu F_n.
    force : (C components, R, E), f, 0 at contacts that take no part.
    """
    size, absent = vector_length(force), scene.coefficient == 0
    ratio = size * (1 + 4 * np.finfo(np.float64).eps)
    ratio *= scene.inverse_limit
    if absent.any():
        ratio[absent & (size > 0)] = np.inf
    found: np.ndarray = ratio
    return found


def balance(scene: Scene, force: Forces, spin_axes: tuple[int, ...]) -> Forces:
    """Return the forces (C, R, E) plus the smallest correction (in the sum of squares) that leaves no torque on any
    free sphere.

    The correction is the gradient of a potential u with -Laplace u = leftover torque on the free spheres and u = 0 on
    the driven ones: one constant-coefficient Poisson problem for each component, solved by cosine and sine transforms.
    Component k is coupled only by the contacts that are not along k.

    scene : R samples of a lattice with E contacts each.
    force : (C components, R samples, E contacts).
    spin_axes : the axes of the C components."""
    lattice = scene.lattice
    pull = torques(force, lattice, spin_axes)
    potential = np.zeros_like(pull)
    for slot, component in enumerate(spin_axes):
        potential[slot][..., 1:-1] = solve_poisson(pull[slot][..., 1:-1], lattice, component)
    found = contact_differences(potential, lattice, spin_axes)
    found += force
    np.copyto(found, 0.0, where=scene.idle)
    return found


def _without_driven_contacts(scene: Scene, force: Forces) -> Forces:
    """Return the forces (C components, R samples, E contacts), set to 0 at contacts that take no part: those without a
    coefficient or without a free sphere.

    scene : the R samples, with the coefficients of their contacts.
    force : (C, R, E)."""
    return np.where(scene.idle, 0.0, force)
