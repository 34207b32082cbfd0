"""Lines through points that are straight on some pair of axes: power laws, exponentials and logarithms."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.words import meant

LEAST_POINTS = 3


@dataclass(frozen=True)
class Kind:
    """What y(x) is, in words; on which axes it is straight; and what its slope there is called."""

    words: str
    log_x: bool
    log_y: bool
    slope: str


KINDS = {
    "power": Kind("a power law", True, True, "exponent"),
    "exponential": Kind("an exponential", False, True, "rate"),
    "log": Kind("a logarithm", True, False, "slope"),
}


@dataclass(frozen=True)
class Fit:
    """y = A x^s (power), A e^(s x) (exponential) or A + s ln x (log), over [low, high].

    slope, error : s and its standard error; not-a-number for a slope that was given and so is a guide.
    chi_square : per degree of freedom, not-a-number where the points have no errors of their own.
    """

    kind: str
    offset: float
    slope: float
    error: float
    low: float
    high: float
    chi_square: float = math.nan

    def __call__(self, x: np.ndarray) -> np.ndarray:
        kind = KINDS[self.kind]
        line = self.offset + self.slope * (np.log(x) if kind.log_x else x)
        values: np.ndarray = np.exp(line) if kind.log_y else line
        return values


def read_fit(text: str) -> tuple[str, float | None]:
    """Kind and, if it is given, slope of `power` or `power:1.5`; InputError."""
    name, colon, number = text.partition(":")
    try:
        slope = float(number) if colon else None
        if name not in KINDS or (slope is not None and not math.isfinite(slope)):
            raise ValueError
    except ValueError:
        raise InputError(
            f"fit is {text!r}; it must be {', '.join(KINDS)}, or one of them with a slope for a guide, as in power:1.5"
            + meant(name, KINDS)
        ) from None
    return name, slope


def read_range(text: str) -> tuple[float, float]:
    """Two rising numbers such as 4,32; InputError."""
    try:
        low, high = map(float, text.split(","))
        if not low < high:
            raise ValueError
    except ValueError:
        raise InputError(f"fit-range is {text!r}; it must be two rising numbers of x such as 4,32") from None
    return low, high


def fit(kind: str, x: np.ndarray, y: np.ndarray, error: np.ndarray | None = None, slope: float | None = None) -> Fit:
    """Least squares on the axes where the line is straight; error : standard errors of y, which weigh the points.

    With errors that of the slope follows from them, and is made larger where the points scatter more than they say
    (by the root of chi-square per degree of freedom); else from the scatter alone. slope : given, not fitted.
    InputError for fewer than three points, for a guide for none, or numbers whose logarithm there is not.
    """
    row = KINDS[kind]
    for values, name, is_log in ((x, "x", row.log_x), (y, "y", row.log_y)):
        if is_log and len(values) and values.min() <= 0:
            raise InputError(
                f"fit is {kind!r}, but the least {name} is {values.min():g}; {row.words} needs numbers above 0"
            )
    points, needed = len(np.unique(x)), LEAST_POINTS if slope is None else 1
    if points < needed:
        raise InputError(f"fit is {kind!r}, but a curve has {points} points in its range; it needs {needed}")
    u, v = np.log(x) if row.log_x else x, np.log(y) if row.log_y else y
    weighs = error is not None and bool((np.isfinite(error) & (error > 0)).all())
    sigma = (error / y if row.log_y else error) if weighs and error is not None else np.ones(len(x))
    weight = sigma**-2
    middle = _mean(weight)
    spread = float((weight * (u - middle(u)) ** 2).sum())
    fitted = slope if slope is not None else float((weight * (u - middle(u)) * v).sum() / spread)
    offset = middle(v) - fitted * middle(u)
    freedom = max(1, len(x) - (2 if slope is None else 1))
    chi_square = float((weight * (v - offset - fitted * u) ** 2).sum()) / freedom
    scatter = math.sqrt(max(1.0, chi_square) if weighs else chi_square)
    spread_of_slope = math.nan if slope is not None else scatter / math.sqrt(spread)
    return Fit(
        kind, offset, fitted, spread_of_slope, float(x.min()), float(x.max()), chi_square if weighs else math.nan
    )


def _mean(weight: np.ndarray) -> Callable[[np.ndarray], float]:
    return lambda values: float((weight * values).sum() / weight.sum())
