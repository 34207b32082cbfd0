"""Power laws through points: straight lines on two logarithmic axes."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant

LEAST_POINTS = 3
POWER_LAW = "power"


@dataclass(frozen=True)
class Fit:
    """y = e^offset x^slope, over [low, high].

    error : standard error of the slope; not-a-number for a slope that was given and so is a guide.
    chi_square : per degree of freedom, not-a-number where the points have no errors of their own.
    """

    offset: float
    slope: float
    error: float
    low: float
    high: float
    chi_square: float = math.nan

    def __call__(self, x: np.ndarray) -> np.ndarray:
        values: np.ndarray = np.exp(self.offset + self.slope * np.log(x))
        return values


def read_fit(text: str) -> float | None:
    """The slope of a guide, as in `power:1.5`, or None for `power`, which fits one; InputError."""
    name, colon, number = text.partition(":")
    try:
        slope = float(number) if colon else None
        if name != POWER_LAW or (slope is not None and not math.isfinite(slope)):
            raise ValueError
    except ValueError:
        raise InputError(
            f"fit is {text!r}; it must be power, or power with a slope for a guide, as in power:1.5"
            + meant(name, [POWER_LAW])
        ) from None
    return slope


def read_range(text: str) -> tuple[float, float]:
    """Two rising numbers such as 4,32; InputError."""
    try:
        low, high = map(float, text.split(","))
        if not low < high:
            raise ValueError
    except ValueError:
        raise InputError(f"fit-range is {text!r}; it must be two rising numbers of x such as 4,32") from None
    return low, high


def fit(x: np.ndarray, y: np.ndarray, error: np.ndarray | None = None, slope: float | None = None) -> Fit:
    """Least squares on logarithmic axes; error : standard errors of y, which weigh the points.

    With errors that of the slope follows from them, and is made larger where the points scatter more than they say
    (by the root of chi-square per degree of freedom); else from the scatter alone. slope : given, not fitted.
    InputError for fewer than three points, for a guide for none, or numbers whose logarithm there is not.
    """
    for values, name in ((x, "x"), (y, "y")):
        if len(values) and values.min() <= 0:
            raise InputError(
                f"fit is 'power', but the least {name} is {values.min():g}; a power law needs numbers above 0"
            )
    points, needed = len(np.unique(x)), LEAST_POINTS if slope is None else 1
    if points < needed:
        raise InputError(f"fit is 'power', but a curve has {points} points in its range; it needs {needed}")
    u, v = np.log(x), np.log(y)
    weighs = error is not None and bool((np.isfinite(error) & (error > 0)).all())
    sigma = error / y if weighs and error is not None else np.ones(len(x))
    weight = sigma**-2
    middle = _mean(weight)
    spread = float((weight * (u - middle(u)) ** 2).sum())
    fitted = slope if slope is not None else float((weight * (u - middle(u)) * v).sum() / spread)
    offset = middle(v) - fitted * middle(u)
    freedom = max(1, len(x) - (2 if slope is None else 1))
    chi_square = float((weight * (v - offset - fitted * u) ** 2).sum()) / freedom
    scatter = math.sqrt(max(1.0, chi_square) if weighs else chi_square)
    spread_of_slope = math.nan if slope is not None else scatter / math.sqrt(spread)
    return Fit(offset, fitted, spread_of_slope, float(x.min()), float(x.max()), chi_square if weighs else math.nan)


def _mean(weight: np.ndarray) -> Callable[[np.ndarray], float]:
    return lambda values: float((weight * values).sum() / weight.sum())
