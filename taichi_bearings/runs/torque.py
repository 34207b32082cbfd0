"""A top that is driven by a torque instead of a spin: whether friction holds it, and how fast it turns if not.

The top has its imposed state times a number a, the strength, and the bottom is at rest. The motion dissipates the power
P(a). The torque that keeps it going is P(a) / a: its unit is such that a torque times a is a power.

* With friction alone P(a) = a P(1). A torque below the least P(1) moves nothing; a larger one is more than friction
  can balance. So bounds on P(1) are bounds on the yield torque, and the forces that prove the lower bound are in
  balance with a torque of that size.
* With viscosity alone P(a) = a^2 P(1), and every torque moves the plane.
* With both, P(a) / a grows without limit from its value for friction alone, and a is found by repeated solves.

For laws of one's own P(a) may be any function; runs/own_law_torque.py finds a from repeated solves, and proves it.

In a packing the top is the driven body of the largest number, and the bottom is all others.

If the bottom turns, less torque is needed. With friction the torque at the strength a is the slope of the potential
Phi(a), which is convex. So for any h > 0 a torque above (Phi(h) - Phi(0)) / h turns the top, and one below turns it by
no more than h in its direction; against it, the bottom may turn the top faster.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.own_law_torque import findings_with_own_law
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.law import LAWS, Law
from taichi_bearings.solvers.table import MethodOptions

Solve = Callable[[Bearing], Solution]
SURELY = 1 + 1e-13  # factor by which a power is raised to be an upper bound in spite of rounding
# an amplitude is sought if the torque exceeds the yield torque by so many times the difference of the latter's bounds
RESOLVED = 10.0
ROUNDED_SUM = 1e-13  # relative rounding error of the power of contacts between driven spheres
HELD_TURN = 1e-4  # a top counts as held if it turns by no more than this, relative to the spin of the bottom
AMPLITUDE_ERROR = 1e-13  # relative error of an amplitude that is found by repeated solves


def refuse_driven(settings: RunSettings, method: type[MethodOptions]) -> None:
    """Raise InputError if settings have a torque and also impose a motion that is not allowed beside it:

    * `spin_top`, as the torque and `top` alone say how the top moves;
    * `bottom`, unless `top` is given and not zero;
    * a motion of the bottom, under a law with which only the top may turn.

    settings : settings of the run; without a torque nothing is refused.
    method : class of the method that the settings name; nothing is refused for dynamics, which have no torque and say
        so themselves.
    """
    if settings.torque is None or method.is_dynamics:
        return
    for key in ("spin_top", *(() if any(settings.top or ()) else ("bottom",))):
        if key in settings.given:
            raise InputError(
                f"{key} is {settings.given[key]}, but with --torque only --top says how the top moves; leave {key} out"
            )
    driven = settings.spin_bottom or (any(settings.bottom or ()) and settings.bottom)
    if driven and not _may_turn_both(LAWS[settings.law]):
        raise InputError(
            f"the bottom has the spin {driven}; with --torque and the law {settings.law} it must be at rest"
        )


def _may_turn_both(law: Law) -> bool:
    """Return True if the bottom may turn beside a torque on the top: for friction, with viscosity or without."""
    return law.is_sum and law.has_friction


def _with_driven_contacts(found: Solution) -> Solution:
    """Return a copy of an answer in which power, objective and lower bound include contacts between driven spheres. In
    packings such contacts can slip.

    found : the answer.
    """
    scene, among, low = found.scene, found.state == ContactState.DRIVEN, found.lower_bound
    beside = float(scene.law.objective(scene.material, found.slip)[among].sum())
    low = (low + beside) * (1 - ROUNDED_SUM) if beside else low
    power = found.power + found.findings.get("driven_power", 0.0)
    return replace(found, power=power, objective=found.objective + beside, lower_bound=low)


def _by_friction(solution: Solution, solve: Solve) -> Solution:
    """Return the answer for the imposed motion of the top as if there were no viscosity. It is solved anew if the law
    has both friction and viscosity; with one of the two alone the given answer is returned.

    solution : the answer for the imposed motion.
    solve : function that solves another scene in the same way.
    """
    scene = solution.scene
    return solve(scene.with_friction_alone()) if scene.law.has_friction and scene.law.has_viscosity else solution


def under_torque(solution: Solution, torque: float, tolerance: float, solve: Solve) -> Solution:
    """Return an answer with four findings on a torque on the top added, (samples R,) each.

    solution : the answer with the top moved as imposed.
    torque : force*length, about the axis of the imposed motion; a negative one acts against it.
    tolerance : relative gap that was asked for; with a larger one no amplitude is given.
    solve : function that solves another scene or packing in the same way.

    The findings are:

    * yields: True if the torque exceeds `yield_torque`.
    * yield_torque: force*length; friction is proven not to hold a larger torque.
    * yield_torque_lower_bound: force*length; friction is proven to hold a torque up to this. Between the two neither is
      proven. If the bottom turns, both are of a motion in the direction of the torque alone.
    * amplitude: factor by which the imposed motion is multiplied, with the sign of the torque: 1 for the motion of the
      solution, 0 where friction is proven to hold the torque, not-a-number (null in `--json`) where nothing limits the
      motion or the factor is not known.

    Raises InputError if the imposed motion leaves the top at rest, or if the bottom turns with a law other than
    friction, with viscosity or without.
    """
    top, others = solution.scene.top_and_bottom
    if not top:
        raise InputError(
            f"torque is {torque:g}, but all imposed spins are 0; the torque acts about the axis of the top's spin, so "
            "give the top one"
        )
    if others and not _may_turn_both(law := solution.scene.law):
        raise InputError(f"torque is {torque:g}; with the law {law} all driven bodies but the last must be at rest")
    found = _torque_findings(
        _with_driven_contacts(solution), torque, tolerance, lambda other: _with_driven_contacts(solve(other))
    )
    return replace(solution, findings={**solution.findings, **found})


def _torque_findings(solution: Solution, torque: float, tolerance: float, solve: Solve) -> dict[str, np.ndarray]:
    """Return by name the four findings on a torque on the top that :func:`under_torque` explains, (samples R,) each.

    solution : the answer for the imposed motion of the top.
    torque : force*length, along the imposed motion of the top; negative against it.
    tolerance : relative gap that was asked for.
    solve : function that solves another scene or packing in the same way.
    """
    scene = solution.scene
    if scene.top_and_bottom[1]:
        return _findings_above_driven_bottom(scene, torque, solve)
    if not scene.law.is_sum:
        return findings_with_own_law(scene, torque, solve)
    friction = _by_friction(solution, solve)
    # Friction alone decides whether the top yields: bounds on its least power are the bounds on the torque.
    low, high = np.zeros(scene.replicas), np.zeros(scene.replicas)
    if scene.law.has_friction:
        low, high = friction.bound_of_all_spins, friction.power * SURELY
    yields, held = np.abs(torque) > high, np.abs(torque) <= low
    # The torque is held (0), or the factor is still unknown (NaN).
    amplitude = np.where(held, 0.0, np.nan)
    # Viscosity alone: the torque grows in proportion to the motion.
    limited = yields & (solution.power > 0) & (solution.gap <= tolerance) & scene.law.has_viscosity
    amplitude[limited] = np.abs(torque) / solution.power[limited]
    if scene.law.has_friction:
        # Friction and viscosity: solve for the factor, if the torque is clear of both bounds.
        resolved = np.abs(torque) - high >= RESOLVED * (high - low)
        amplitude[limited & ~resolved] = np.nan
        for number in np.flatnonzero(limited & resolved):
            viscous = scene.law.power(scene.material, friction.slip)[number].sum() - friction.power[number]
            least = (abs(torque) - high[number]) / (2 * viscous)
            amplitude[number] = _strength(scene.sample(int(number)), abs(torque), least, solve)
    return {
        "yields": yields,
        "yield_torque": high,
        "yield_torque_lower_bound": low,
        "amplitude": np.sign(torque) * amplitude + 0.0 if torque else amplitude,
    }


def _findings_above_driven_bottom(scene: Bearing, torque: float, solve: Solve) -> dict[str, np.ndarray]:
    """Return by name four findings on a torque on the top, (samples R,) each, if the bottom turns, too.

    * yields: True if the torque exceeds `yield_torque`.
    * yield_torque: force*length, in the direction of the torque, perhaps negative: a larger torque turns the top.
    * yield_torque_lower_bound: force*length; up to this torque the top turns by no more than HELD_TURN times the spin
      of the bottom in the direction of the torque. Against the torque the bottom may turn it faster.
    * amplitude: not-a-number, as it is not known.

    scene : what is solved, with the top moved as imposed.
    torque : force*length.
    solve : function that solves another scene or packing in the same way.
    """
    top, bottom = scene.top_and_bottom
    # bounds on the slope of the potential between the strengths 0 and `step`, as the head of this file explains
    step = HELD_TURN * bottom / abs(top)
    still, moving = (solve(scene.with_top(strength)) for strength in (0.0, step if torque >= 0 else -step))
    high = np.nextafter((moving.objective * SURELY - still.bound_of_all_spins) / step, np.inf)
    low = (moving.bound_of_all_spins - still.objective * SURELY) / step
    unknown = np.full(scene.replicas, np.nan)
    yields = abs(torque) > high
    return {"yields": yields, "yield_torque": high, "yield_torque_lower_bound": low, "amplitude": unknown}


def _strength(scene: Bearing, torque: float, least: float, solve: Solve) -> float:
    """Return the factor a, above 0, such that a torque keeps the top moving with a times the imposed motion; NaN if a
    solve misses its tolerance.

    `least` comes from a bound on the torque, the slope of the least potential Phi(a) at a times the imposed motion. Let
    P_f be the least power of friction alone, and Q the power that viscosity adds in that motion. Then Phi(a) lies
    between a P_f and a P_f + a^2 Q / 2. It is convex, so its slope is at most (Phi(2 a) - Phi(a)) / a <= P_f + 2 a Q.

    scene : one sample.
    torque : size of the torque, force*length, above what friction holds.
    least : a factor that is smaller than a.
    solve : function that solves another scene in the same way.
    """
    from scipy.optimize import brentq  # a third of a second that other runs do not need

    short = False

    def excess(strength: float) -> float:
        """Return the torque, force*length, that keeps the top in its imposed motion times `strength` going, less the
        given torque; 0 once a solve has missed its tolerance.
        """
        nonlocal short
        found = solve(scene.with_top(strength))
        short |= found.status is not Status.CERTIFIED
        return 0.0 if short else float(found.power[0]) / strength - torque

    most = 2 * least
    if excess(least) >= 0:  # only rounding of the power can make it too large
        return float("nan")
    while excess(most) < 0:
        least, most = most, 2 * most
    found = brentq(excess, least, most, rtol=AMPLITUDE_ERROR, xtol=AMPLITUDE_ERROR * most)
    return float("nan") if short else float(found)
