"""How fast a torque turns the top if the contacts have a law of one's own, whose power may be any function of speed.

Let Phi(a) be the least potential with the top at a times its imposed state, and P(a) the power of that motion. The
torque that keeps it going is T(a) = P(a) / a. It is also the slope of Phi, which is convex, so T never falls; and the
strength that a given torque causes is where T(a) reaches that torque. Each solve gives bounds low(a) <= Phi(a) <=
high(a), and these prove an interval of strengths. For b < a < c

    high(a) - low(b) <= torque (a - b)  proves that the strength is b or more,
    low(c) - high(a) >= torque (c - a)  proves that it is c or less;

and a torque above Phi(a) / a turns the top, whatever a is.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from taichi_bearings.scene import Bearing, Solution, Status

Solve = Callable[[Bearing], Solution]
SHARP = 1e-3  # a strength is reported if it is proven within this, relatively
FOUND_ERROR = 1e-9  # relative error to which the strength is sought
FACTOR, MOST_TRIED = 10.0, 8  # the strength is sought between 1 / FACTOR^MOST_TRIED and FACTOR^MOST_TRIED
SUMMED = 1 + 1e-13  # factor that makes a bound true in spite of the rounding of sums


def moves_freely(scene: Bearing) -> bool:
    """Return True if any torque turns the top, as the law says that its force grows from 0 with a finite slope.

    scene : what is solved.
    """
    law, coefficients = scene.law, scene.material
    slopes = law.steepest(coefficients, scene.slip_radius * scene.jump)
    at_rest = law.force(coefficients, np.zeros_like(coefficients[0]))
    return bool(not law.has_friction and np.isfinite(slopes).all() and (at_rest == 0).all())


@dataclass(frozen=True)
class _Motion:
    """A motion of the top and what a solve proves of it.

    strength : factor of the imposed motion.
    torque : force*length, P / strength with the power P of the solve.
    low, high : bounds on the least potential, energy/time.
    reached : True if the solve has reached its tolerance.
    """

    strength: float
    torque: float
    low: float
    high: float
    reached: bool


@dataclass(frozen=True)
class Motions:
    """Motions of the top of one sample that were solved, by strength, their factor of the imposed motion.

    scene : the sample, with the top moved as imposed.
    solve : function that solves another scene in the same way.
    known : the motions so far.
    """

    scene: Bearing
    solve: Solve
    known: dict[float, _Motion] = field(default_factory=dict)

    def at(self, strength: float) -> _Motion:
        """Return the motion of the top at `strength` times its imposed motion; it is solved at the first call and kept.

        The torque is the power over `strength`. The bounds are those of the least potential: the objective, which a
        solver bounds, is `law.share` times the potential.
        """
        if strength not in self.known:
            found = self.solve(self.scene.with_top(strength))
            bounds = np.array([found.lower_bound[0], found.objective[0] * SUMMED]) / self.scene.law.share
            torque, reached = float(found.power[0]) / strength, found.status is Status.CERTIFIED
            self.known[strength] = _Motion(strength, torque, float(bounds[0]), float(bounds[1]), reached)
        return self.known[strength]

    @property
    def moving_torque(self) -> float:
        """The smallest torque found, force*length, above which the top is proven to turn."""
        return min(motion.high / motion.strength * SUMMED for motion in self.known.values())

    def strength_of(self, torque: float) -> float:
        """Return the factor of the imposed motion that a torque causes, proven within SHARP; NaN if there is none, or
        if it is not proven.

        torque : size of the torque, force*length, above 0.
        """
        ends = self._around(torque)
        if ends is None:
            return float("nan")
        from scipy.optimize import brentq  # a third of a second that other runs do not need

        found = float(brentq(lambda a: self.at(a).torque - torque, *ends, rtol=FOUND_ERROR, xtol=FOUND_ERROR * ends[1]))
        return found if self._is_proven(found, torque) else float("nan")

    def _around(self, torque: float) -> tuple[float, float] | None:
        """Return two factors of the imposed motion between which it needs this torque, the smaller one first; None if
        a solve misses its tolerance or none are found. They are sought from 1 on, upwards or downwards, by FACTOR.

        torque : size of the torque, force*length.
        """
        is_low = self.at(1.0).torque <= torque
        near = 1.0
        for _ in range(MOST_TRIED):
            far = near * FACTOR if is_low else near / FACTOR
            if not (self.at(near).reached and self.at(far).reached):
                return None
            if (self.at(far).torque <= torque) != is_low:
                return (near, far) if is_low else (far, near)
            near = far
        return None

    def _is_proven(self, strength: float, torque: float) -> bool:
        """Return True if the factor of the imposed motion that a torque causes is proven to differ from `strength` by
        at most SHARP, relatively, by the two inequalities at the head of this file.

        torque : size of the torque, force*length.
        """
        slower, found, faster = (self.at(strength * share) for share in (1 - SHARP, 1.0, 1 + SHARP))
        is_no_less = found.high - slower.low <= torque * (found.strength - slower.strength)
        is_no_more = faster.low - found.high >= torque * (faster.strength - found.strength)
        return is_no_less and is_no_more and all(one.reached for one in (slower, found, faster))


def findings_with_own_law(scene: Bearing, torque: float, solve: Solve) -> dict[str, np.ndarray]:
    """Return by name four findings on a torque on the top, (samples R,) each, for a law of one's own.

    * yields: True if the torque is proven to turn the top.
    * yield_torque: force*length; a larger torque is proven to turn the top. It is 0 if the force of the law grows from
      0 with a finite slope.
    * yield_torque_lower_bound: 0; a torque of 0 turns nothing.
    * amplitude: factor by which the imposed motion is multiplied, with the sign of the torque, proven within SHARP;
      not-a-number where nothing limits the motion, or where it is not proven.

    scene : what is solved, with the top moved as imposed.
    torque : force*length.
    solve : function that solves another scene in the same way.
    """
    high, amplitude = np.zeros(scene.replicas), np.zeros(scene.replicas)
    for number in range(scene.replicas):
        motions = Motions(scene.sample(number), solve)
        if torque:
            amplitude[number] = np.sign(torque) * motions.strength_of(abs(torque))
        if not moves_freely(motions.scene):
            motions.at(1.0)
            high[number] = motions.moving_torque
    low = np.zeros(scene.replicas)
    return {"yields": abs(torque) > high, "yield_torque": high, "yield_torque_lower_bound": low, "amplitude": amplitude}
