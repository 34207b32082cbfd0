"""A plane driven by a torque instead of a spin: whether it holds, and how fast it turns if it does not.

The top turns as a times its state of strength 1, the bottom rests. The motion of strength a dissipates P(a), so the
torque that keeps it up, the work for a unit of a, is P(a) / a.

* Friction alone: P(a) = a P(1). A torque below the least P(1) moves nothing; above it no motion holds it back. So
  what bounds P(1) bounds the torque of yield, and the forces that prove its lower bound are a safe load.
* Viscosity alone: P(a) = a^2 P(1), and every torque moves the plane.
* Both: P(a) / a rises without limit from its value for friction alone, and a is found by solving again and again.

Of a packing the top is the body of the largest number, which turns as a times its spins, and the bottom all others.

A bottom that turns loosens the top. With friction the torque for the strength a is then a slope of the potential
Phi(a), which is convex: beyond (Phi(h) - Phi(0)) / h it turns, and up to there by no more than h.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.table import MethodOptions

Solve = Callable[[Bearing], Solution]
SURELY = 1 + 1e-13  # factor that makes up for the rounding of the power
RESOLVED = 10.0  # times what is open of the yield torque, by which a torque exceeds it where an amplitude is sought
ROUNDED_SUM = 1e-13  # relative, of the power of contacts between driven spheres
HELD_TURN = 1e-4  # of the spin of the bottom, by which a top that counts as held may turn
AMPLITUDE_ERROR = 1e-13  # relative, of an amplitude that is found by solving again


def refuse_driven(settings: RunSettings, method: type[MethodOptions]) -> None:
    """InputError for settings with a torque that also say how fast the top turns, or that the bottom turns where the
    law viscous needs it at rest. method : the one that the settings stand for."""
    if settings.torque is None or method.is_dynamics:  # dynamics do not use a torque, and say so themselves
        return
    for key in ("spin_top", *(() if any(settings.top or ()) else ("bottom",))):
        if key in settings.given:
            raise InputError(f"{key} is {settings.given[key]}, but a torque turns the top, along its state --top")
    driven = settings.spin_bottom or (any(settings.bottom or ()) and settings.bottom)
    if driven and not LAWS[settings.law].holds:
        raise InputError(f"the bottom has the spin {driven}; under a torque the law viscous needs it at rest")


def _with_driven(found: Solution) -> Solution:
    """With what contacts between driven spheres take beside, as on packings they can."""
    scene, among, low = found.scene, found.state == ContactState.DRIVEN, found.lower_bound
    beside = float(scene.law.objective(scene.material, found.slip)[among].sum())
    low = (low + beside) * (1 - ROUNDED_SUM) if beside else low
    power = found.power + found.findings.get("driven_power", 0.0)
    return replace(found, power=power, objective=found.objective + beside, lower_bound=low)


def _by_friction(solution: Solution, solve: Solve) -> Solution:
    """The motion of strength 1 with friction alone, or the same where there is no friction or nothing else."""
    scene = solution.scene
    return solve(scene.with_friction_alone()) if scene.law.holds and scene.law.flows else solution


def under_torque(solution: Solution, torque: float, solve: Solve) -> Solution:
    """The motion of strength 1, with what the torque does beside it. solve : the same for other scenes or packings.

    yields : the torque exceeds `yield_torque`, which friction is proven not to hold. Up to `yield_torque_lower_bound`
    it is proven to be held; between the two, force*length, neither is proven. amplitude : strength of the motion, 1 for
    that of the solution; 0 where the torque is proven to be held, NaN, in files and `--json` null, where nothing limits
    the motion or it is not known.
    """
    top, others = solution.scene.sides
    if not top:
        raise InputError(f"torque is {torque:g}, but no body turns, along whose spins it would act")
    if others and not solution.scene.law.holds:
        raise InputError(f"torque is {torque:g}; with the law viscous all bodies but the last must be at rest")
    found = _found(_with_driven(solution), torque, lambda other: _with_driven(solve(other)))
    return replace(solution, findings={**solution.findings, **found})


def _found(solution: Solution, torque: float, solve: Solve) -> dict[str, np.ndarray]:
    scene = solution.scene
    if scene.sides[1]:
        return _beside_driven(scene, torque, solve)
    friction = _by_friction(solution, solve)
    low, high = np.zeros(scene.replicas), np.zeros(scene.replicas)
    if scene.law.holds:
        low, high = friction.lower_bound, friction.power * SURELY
    yields, held = np.abs(torque) > high, np.abs(torque) <= low
    amplitude = np.where(held, 0.0, np.nan)
    limited = yields & (solution.power > 0) & scene.law.flows
    amplitude[limited] = np.abs(torque) / solution.power[limited]
    if scene.law.holds:
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


def _beside_driven(scene: Bearing, torque: float, solve: Solve) -> dict[str, np.ndarray]:
    """The same findings of a top beside a bottom that turns. yield_torque, in the direction of the torque, of either
    sign: beyond it the top turns; yield_torque_lower_bound : up to it by no more than HELD_TURN of the bottom's spin.
    """
    top, bottom = scene.sides
    step = HELD_TURN * bottom / abs(top)
    still, moving = (solve(scene.with_top(strength)) for strength in (0.0, step if torque >= 0 else -step))
    high = np.nextafter((moving.objective * SURELY - still.lower_bound) / step, np.inf)
    low = (moving.lower_bound - still.objective * SURELY) / step
    unknown = np.full(scene.replicas, np.nan)
    yields = abs(torque) > high
    return {"yields": yields, "yield_torque": high, "yield_torque_lower_bound": low, "amplitude": unknown}


def _strength(scene: Bearing, torque: float, least: float, solve: Solve) -> float:
    """Strength a of the motion of one sample that the torque keeps up, above what friction holds; NaN if a solve falls
    short of its tolerance.

    least : a strength that is too small. P(a) / a is at most P_f + 2 a Q, with P_f the least power of friction and Q
    what viscosity adds in that motion: the potential is convex and no larger than a P_f + a^2 Q / 2.
    """
    from scipy.optimize import brentq  # a third of a second that other runs do not need

    short = False

    def excess(strength: float) -> float:
        nonlocal short
        found = solve(scene.with_top(strength))
        short |= found.status is not Status.CERTIFIED
        return 0.0 if short else float(found.power[0]) / strength - torque

    most = 2 * least
    if excess(least) >= 0:  # but for the rounding of the power it is too small
        return float("nan")
    while excess(most) < 0:
        least, most = most, 2 * most
    found = brentq(excess, least, most, rtol=AMPLITUDE_ERROR, xtol=AMPLITUDE_ERROR * most)
    return float("nan") if short else float(found)
