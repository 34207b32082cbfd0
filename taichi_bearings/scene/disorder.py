"""Random contact coefficients from a seed, the same on any machine. Only distributions that need an exponential or a
power may differ in the last digits, as their rounding depends on the processor.

Coefficients of a lattice are drawn axis by axis, x, y, z: one array for all contacts along an axis.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.words import meant, shown


def _power_law(
    rng: np.random.Generator, shape: tuple[int, ...], low: float, high: float, exponent: float
) -> np.ndarray:
    """Return random numbers x from `low` to `high` with a density proportional to x^exponent, by inverting its
    cumulative distribution.

    rng : generator of random numbers.
    shape : shape of the array that is returned.
    """
    level = rng.uniform(0.0, 1.0, shape)
    if abs(exponent + 1) < 1e-12:
        return low * (high / low) ** level
    a, b = low ** (exponent + 1), high ** (exponent + 1)
    found: np.ndarray = (a + (b - a) * level) ** (1 / (exponent + 1))
    return found


def _bimodal(rng: np.random.Generator, shape: tuple[int, ...], low: float, high: float, fraction: float) -> np.ndarray:
    """Return random numbers that are `high` with probability `fraction`, else `low`.

    rng : generator of random numbers.
    shape : shape of the array that is returned.
    """
    return np.where(rng.uniform(0.0, 1.0, shape) < fraction, high, low)


def _power_law_rounding(low: float, high: float, exponent: float) -> float:
    """Return the largest relative difference that a random number of a power law may have between machines.

    low, high, exponent : parameters of :func:`_power_law`. It mixes low^(exponent + 1) and high^(exponent + 1) by a
        random share. These powers may differ by a few units in the last place, of which 8 are taken. Their sum loses
        digits if their sizes differ, and the last power multiplies the error.
    """
    over = abs(exponent + 1)
    with np.errstate(over="ignore"):
        lost = 0.0 if over < 1e-12 else (float(np.power(high / low, over)) + 1) / over
    return 8 * EPSILON * (1 + lost)


EPSILON = float(np.finfo(float).eps)

DISTRIBUTIONS: dict[str, tuple[tuple[str, ...], Callable[..., np.ndarray], Callable[..., float]]] = {
    "uniform": (("low", "high"), lambda rng, shape, low, high: rng.uniform(low, high, shape), lambda low, high: 0.0),
    "lognormal": (
        ("median", "sigma"),
        lambda rng, shape, median, sigma: median * np.exp(sigma * rng.standard_normal(shape)),
        lambda median, sigma: 8 * EPSILON * (1 + 8 * sigma),  # no normal number that occurs is larger than 8
    ),
    "power-law": (("low", "high", "exponent"), _power_law, _power_law_rounding),
    "bimodal": (("low", "high", "fraction"), _bimodal, lambda low, high, fraction: 0.0),
    "constant": (("value",), lambda rng, shape, value: np.full(shape, value), lambda value: 0.0),
}
"""The distributions by name. A row has the names of the parameters; a function (rng, shape, *parameters) that draws an
array; and a function of the parameters that returns the largest relative difference of a drawn number between machines.
A new distribution is a row here; help texts and messages follow from it."""


@dataclass(frozen=True)
class Distribution:
    """A distribution of positive coefficients, written ``name:parameter,parameter``.

    ============================== ===========================================================================
    ``uniform:low,high``           uniform in [low, high)
    ``lognormal:median,sigma``     logarithm normal with standard deviation sigma
    ``power-law:low,high,a``       density proportional to x^a on [low, high]; a = -1 is uniform in the logarithm
    ``bimodal:low,high,fraction``  `high` with probability `fraction`, else `low`
    ``constant:value``             all equal
    ============================== ===========================================================================
    """

    name: str
    parameters: tuple[float, ...]

    PARAMETERS: ClassVar[dict[str, tuple[str, ...]]] = {name: row[0] for name, row in DISTRIBUTIONS.items()}

    @classmethod
    def parse(cls, text: str) -> "Distribution":
        """Return the distribution that a text such as ``uniform:0.1,1.0`` describes.

        Raises InputError with the expected form for other texts.
        """
        if not isinstance(text, str):
            raise InputError(f"distribution is {shown(text)}; it must be a text such as uniform:0.1,1.0 or a function")
        name, _, rest = text.partition(":")
        if name not in cls.PARAMETERS:
            raise InputError(
                f"distribution is {text!r}; allowed are {', '.join(cls.forms())}{meant(name, cls.PARAMETERS)}"
            )
        try:
            parameters = tuple(float(word) for word in rest.split(","))
        except ValueError:
            parameters = ()
        if len(parameters) != len(cls.PARAMETERS[name]):
            raise InputError(f"distribution is {text!r}; {name} is written {name}:{','.join(cls.PARAMETERS[name])}")
        return cls(name, parameters)

    @classmethod
    def forms(cls) -> list[str]:
        """Return how each distribution is written, such as ``uniform:low,high``."""
        return [f"{name}:{','.join(words)}" for name, words in cls.PARAMETERS.items()]

    def __post_init__(self) -> None:
        """Raise InputError for a parameter that is out of its range."""
        values = dict(zip(self.PARAMETERS[self.name], self.parameters, strict=True))
        for word, value in values.items():
            signed = word in ("exponent", "sigma", "fraction")
            if not np.isfinite(value) or (value <= 0 and not signed):
                raise InputError(f"{word} of distribution {self} is {value}; it must be a positive number")
        if "high" in values and not values["low"] <= values["high"]:
            raise InputError(f"distribution {self} has low above high; low must be the smaller number")
        if values.get("sigma", 0.0) < 0:
            raise InputError(f"sigma of distribution {self} is {values['sigma']}; it must be 0 or more")
        if not 0 <= values.get("fraction", 0.0) <= 1:
            raise InputError(f"fraction of distribution {self} is {values['fraction']}; it must be between 0 and 1")

    def __str__(self) -> str:
        """Return the text that describes the distribution, such as "uniform:0.1,1"."""
        return f"{self.name}:{','.join(format(value, 'g') for value in self.parameters)}"

    def __call__(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Return an array of this shape with numbers drawn from the distribution.

        rng : generator of random numbers.

        Extreme parameters may give infinities or not-a-number, which scenes and packings refuse.
        """
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            return self._draw(rng, shape)

    def _draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Return an array of this shape with numbers drawn from the distribution.

        rng : generator of random numbers.
        shape : shape of the array.
        """
        return DISTRIBUTIONS[self.name][1](rng, shape, *self.parameters)

    @property
    def rounding(self) -> float:
        """The largest relative difference that a random number of this distribution may have between machines."""
        return DISTRIBUTIONS[self.name][2](*self.parameters)


Draw = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]
"""What returns random coefficients as an array of a given shape: a distribution, or a function of one's own."""


def draw_coefficients(lattice: Lattice, distribution: Draw, seed: int, second: bool = False) -> tuple[np.ndarray, ...]:
    """Return random coefficients of all contacts of a lattice, one array for each axis, drawn from
    ``default_rng(seed)``.

    distribution : distribution of friction coefficients, pure numbers, or damping coefficients, force * time/length.
    second : True to draw the second coefficient of a law that has two, the viscosity, from ``default_rng([seed, 2])``.

    Raises InputError if a function of the user returns an array of another shape.
    """
    rng, found = np.random.default_rng([seed, 2] if second else seed), []
    for shape in map(lattice.contact_shape, range(lattice.dimension)):
        values = own_array("values of the distribution", distribution(rng, shape))
        if values.shape != shape:
            raise InputError(
                f"the function given as distribution returned an array of shape {values.shape}; it must return shape "
                f"{shape}"
            )
        found.append(values)
    return tuple(found)
