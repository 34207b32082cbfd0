"""A claim of the paper, what was found, and the verdict. Sentences, limits and rules of a figure's claims stand in
claims/FIGURE.toml.

In that file a claim is a table with these keys:

* sentences: `claim`, `finding`, `paper` (by default "not given"), `ours`, `uncertainty` and `after_data`; a number in
  them is written as {name}, or {name:format} (:class:`_Sentences`);
* `limits`: numbers by name, which the rules use;
* Python expressions in the values that the study returns: `let`, further values by name, each of which may use those
  before; `numbers`, values that the report keeps for programs and sentences may use; the rules `holds`, `refined`,
  `samples` (how many it was judged by) and `needed` (how many it takes); `when`, whether the claim can be judged at
  all; and `cases`, a list of further values by name if the claim is judged once for each of them.
"""

import math
import string
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import betaincinv

from taichi_bearings.analysis.statistics import CONFIDENCE as MEAN_CONFIDENCE
from taichi_bearings.analysis.statistics import FEW_SAMPLES, LEAST_SAMPLES, MANY_SAMPLES, mean_interval
from taichi_bearings.runs.settings import read_toml
from taichi_bearings.words import counted

VERDICTS = {
    "confirmed": "it holds",
    "refined": "it holds with a condition or a correction, which the finding states",
    "refuted": "it does not hold",
    "too few samples": "what was computed cannot tell",
}
KINDS = {
    "samples": "holds for the samples drawn, and by their number for most others",
    "theorem": "follows from the equations; the samples check the program, not the claim",
}
"""Grounds on which a verdict can rest."""
CONFIDENCE = 0.95  # of each end of the interval of a share
SAMPLES, QUICK_SAMPLES = 200, 20  # default numbers of seeds for a statistical claim
MOST_DIGITS = 12  # after the point of a share
LEAST_EXPONENT = -4  # numbers with a smaller decimal exponent are written with it
ROUND_OFF = 1e-12  # relative difference by which the numbers of different samples may differ by rounding alone


def share(value: float, digits: int = 1) -> str:
    """Return a share as a text in percent. A share near 0 or 1 gets as many digits as are needed to tell it from these.

    value : the share, from 0 to 1.
    digits : least number of digits after the point.

    >>> share(0.5), share(0.99996), share(1.0), share(2e-5)
    ('50.0%', '99.996%', '100.0%', '0.002%')
    """
    whole = format(round(value), ".0%")
    while digits < MOST_DIGITS and value != round(value) and float(f"{value:.{digits}%}"[:-1]) == float(whole[:-1]):
        digits += 1
    return f"{value:.{digits}%}"


def with_error(value: float, error: float) -> str:
    """Return a value and its error as a text, both rounded to the first digit of the error, or to the second if the
    first is 1.

    value : the number, in any unit.
    error : its standard error in the same unit; not-a-number or 0 if there is none, then only the value is returned.

    >>> with_error(135.278, 41.2), with_error(0.51972, 0.0121), with_error(2.0, 0.577), with_error(1.0, math.nan)
    ('140 +- 40', '0.520 +- 0.012', '2.0 +- 0.6', '1')
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.6g}"
    size = math.floor(math.log10(max(abs(value), error)))
    if size < LEAST_EXPONENT:
        return f"({with_error(value / 10.0**size, error / 10.0**size)})e{size}"
    place = math.floor(math.log10(error))
    place -= error < 2 * 10.0**place
    return " +- ".join(f"{round(number, -place):.{max(-place, 0)}f}" for number in (value, error))


@dataclass(frozen=True)
class Claim:
    """A claim of the paper with what was found.

    claim : what the paper says.
    finding : what came out, and by which criterion.
    confirmed : True if the claim holds.
    refined : True if it holds with a condition or a correction, which the finding states.
    numbers : values of the finding, for programs.
    samples : number of samples that it was judged by.
    samples_needed : least number of samples for a verdict.
    kind : what the verdict rests on, one of KINDS.
    paper, ours : the number of the paper and the one found, in a few words.
    uncertainty : uncertainty of `ours`, in words.
    chosen_after_the_data : limits and choices of the criterion that were made with results in view, in words; "" if
        none.
    """

    claim: str
    finding: str
    confirmed: bool
    numbers: Mapping[str, Any] = field(default_factory=dict)
    refined: bool = False
    samples: int = 1
    samples_needed: int = 1
    kind: Literal["samples", "theorem"] = "samples"
    paper: str = ""
    ours: str = ""
    uncertainty: str = ""
    chosen_after_the_data: str = ""

    @property
    def verdict(self) -> str:
        """The verdict: "confirmed", "refined", "refuted" or "too few samples"."""
        if self.samples < self.samples_needed:
            return "too few samples"
        if not self.confirmed:
            return "refuted"
        return "refined" if self.refined else "confirmed"

    def as_dict(self) -> dict[str, Any]:
        """Return the attributes by name for a report, with the `verdict` in place of `confirmed` and `refined`. The
        finding says so if there were too few samples for a verdict.
        """
        found = {name: value for name, value in vars(self).items() if name not in ("confirmed", "refined")}
        if self.verdict == "too few samples":
            needed = counted(self.samples_needed, "such sample")
            found["finding"] += f" No verdict: this needs {needed} and has {self.samples:,}."
        return found | {"verdict": self.verdict}


@dataclass(frozen=True)
class Effort:
    """How much is computed.

    seed : first seed of all samples.
    samples : number of seeds for a statistical claim.
    quick : True for the short form, with fewer iterations and sizes, too.
    """

    seed: int = 0
    samples: int = SAMPLES
    quick: bool = False

    def seeds(self, number: int) -> range:
        """Return `number` consecutive seeds, beginning with the first."""
        return range(self.seed, self.seed + number)


@dataclass(frozen=True)
class Share:
    """The share of all samples that have a property, estimated from those drawn.

    hits : number of samples drawn that have it.
    samples : number of samples drawn.

    `least` and `most` are the ends of the exact binomial interval (Clopper and Pearson); each is right with the
    probability CONFIDENCE.
    """

    hits: int
    samples: int

    @classmethod
    def of(cls, hits: Any) -> "Share":
        """Return the share of samples that have a property; `hits` is True for each sample that has it."""
        return cls(int(np.sum(hits)), len(hits))

    @property
    def least(self) -> float:
        """The lower end of the interval: with the probability CONFIDENCE at least this share of all samples has the
        property.
        """
        misses = self.samples - self.hits
        return float(betaincinv(self.hits, misses + 1, 1 - CONFIDENCE)) if self.hits else 0.0

    @property
    def most(self) -> float:
        """The upper end of the interval: with the probability CONFIDENCE at most this share of all samples has the
        property.
        """
        misses = self.samples - self.hits
        return float(betaincinv(self.hits + 1, misses, CONFIDENCE)) if misses else 1.0

    def needed_for(self, limit: float) -> int:
        """Return about how many samples would show that the true share lies above, or below, `limit`, if the same part
        of them has the property as of those drawn.

        limit : a share, between 0 and 1.

        If the samples drawn show that already, their number is returned; if more than 10^6 were needed, a number above
        that.
        """
        number = max(self.samples, 1)
        while True:
            scaled = Share(round(self.hits / max(self.samples, 1) * number), number)
            if scaled.least > limit or scaled.most <= limit:
                return number
            number = number + 1 if number < 100 else int(1.05 * number)  # to within 5 %
            if number > 10**6:
                return number

    @property
    def interval(self) -> str:
        """The interval in words."""
        if not self.samples:
            return "no sample"
        return f"{share(self.least)} to {share(self.most)} of all, exact binomial, each end at {share(CONFIDENCE, 0)}"

    def __str__(self) -> str:
        """Return hits, number of samples and the interval in words."""
        ends = f"{share(self.least, 0)} to {share(self.most, 0)} of all"
        return f"{self.hits:,} of {counted(self.samples, 'sample')} ({ends})"


def every(samples: int) -> str:
    """Return a text on what follows if each of `samples` samples has a property: which share of all possible samples
    has it at least (exact binomial bound).
    """
    return "no sample" if not samples else f"in at least {share(Share(samples, samples).least)} of all, exact binomial"


def interval_of(values: Any) -> str:
    """Return the uncertainty of a share, or of the mean of numbers, in words.

    values : a :class:`Share`, or (samples,) numbers. The interval of a mean is Student's t for few and for many
        samples, else a bootstrap (BCa).
    """
    if isinstance(values, Share):
        return values.interval
    number, found = len(values), mean_interval(np.asarray(values, dtype=float))
    if number < LEAST_SAMPLES:
        return f"{counted(number, 'sample')}: no interval"
    how = "bootstrap (BCa)" if FEW_SAMPLES <= number <= MANY_SAMPLES else "Student's t"
    return f"{found.low:.4g} to {found.high:.4g}, {share(MEAN_CONFIDENCE, 0)}, {how}"


def mean(values: Sequence[float] | np.ndarray) -> str:
    """Return mean and standard error of some numbers as a text; without the error if there are fewer than LEAST_SAMPLES
    of them, or if they differ by rounding alone.

    values : (samples,), one number for each sample.
    """
    found = np.asarray(values, dtype=float)
    if len(found) < LEAST_SAMPLES or np.ptp(found) <= ROUND_OFF * np.abs(found).max():
        return with_error(found.mean(), np.nan)
    return with_error(found.mean(), found.std(ddof=1) / np.sqrt(len(found)))


def span(values: np.ndarray) -> str:
    """Return the least and the largest one of some values as a text; a single value stands alone."""
    return f"{values.min():.4f} ... {values.max():.4f}" if len(values) > 1 else f"{values[0]:.4f}"


# ways to reduce an array to one number, and ways to write a value, for sentences
REDUCED: dict[str, Callable[[Any], Any]] = {"max": np.max, "min": np.min, "mean": np.mean, "median": np.median,
                                            "sum": np.sum, "len": len}  # fmt: skip
WRITTEN: dict[str, Callable[[Any], str]] = {
    "interval": interval_of, "every": every, "error": mean, "span": span,
    "share": lambda values: str(Share.of(values)), "hits": lambda values: f"{int(np.sum(values))} of {len(values)}",
    "percent": lambda value: share(value, 0), "percent1": share,
}  # fmt: skip


class _Sentences(string.Formatter):
    """Fills numbers into the sentences of a claim. A number is written as {name}, or as {name:WAY FORMAT}, with one of
    these ways:

    * one of REDUCED (`max`, `mean`, `len`, ...) reduces an array to a number, which is then written by FORMAT;
    * one of WRITTEN (`interval`, `share`, `percent`, ...) writes a value or an array in its own manner;
    * `count WORD` writes a number with a noun: 3 words;
    * `list FORMAT` writes the entries of a list, separated by commas;
    * `by FORMAT` writes the entries of a dictionary with their keys; integer keys are sides of cubes, L^3. `by COLUMN
      FORMAT` first splits a table by the values of this column;
    * `each PHRASE` writes for each entry of a dictionary the phrase of that name in the claim, in which {name} is the
      key and {it}, or the names of the entry, are the value;
    * anything else is a format of Python, such as `.2f`.
    """

    def __init__(self, phrases: Mapping[str, str], named: Mapping[str, Any]) -> None:
        """Set what can be filled into sentences.

        phrases : further sentences by name, which are filled in for each of several values.
        named : the values that sentences use, by name.
        """
        self.phrases, self.named = phrases, named

    def fill(self, text: str, **more: Any) -> str:
        """Return a sentence with all its numbers filled in.

        text : the sentence, with {name} or {name:format} in place of each number.
        more : values by name, in addition to those of the claim.
        """
        return self.vformat(text, (), {**self.named, **more})

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as a text; `string.Formatter` calls this for each {name:format_spec} of a sentence.

        value : what the name stands for: a number, an array, a list, a dictionary or a table of samples.
        format_spec : how to write it: one of the ways that the class lists, and a format after it, such as "mean .2f",
            "count sample" or "by side interval"; or a format of Python alone.
        """
        way, _, rest = format_spec.partition(" ")
        if way in REDUCED:
            return self.format_field(REDUCED[way](value) if len(value) or way in ("sum", "len") else math.nan, rest)
        if way in WRITTEN:
            return WRITTEN[way](value)
        if way == "count":
            return counted(int(value), rest)
        if way == "list":
            return ", ".join(self.format_field(part, rest) for part in value) or "none"
        if way == "by" and not isinstance(value, Mapping):  # a table becomes a dictionary by the values of the column
            column, _, rest = rest.partition(" ")
            value = value.by(column)
        if way == "by":  # integer keys are sides of cubes; the number of samples of each is added
            parts = [(key, self.format_field(part, rest)) for key, part in value.items()]
            if all(isinstance(key, int) for key in value):
                number = {} if rest == "hits" else {side: f" ({len(part)})" for side, part in value.items()}
                return ", ".join(f"{text} at {side}^3{number.get(side, '')}" for side, text in parts)
            return "; ".join(f"{name}{':' if 'interval' in rest else ''} {text}" for name, text in parts)
        if way == "each":  # the phrase named by `rest`, filled in for each entry
            named = ((name, of if isinstance(of, dict) else {"it": of}) for name, of in value.items())
            return "; ".join(self.fill(self.phrases[rest], name=name, **of) for name, of in named)
        return str(super().format_field(value, format_spec))


@lru_cache
def sentences(figure: str) -> dict[str, dict[str, Any]]:
    """Return the claims of a figure by name, as its file has them: for each a dictionary with the keys that the head
    of this module lists.
    """
    return read_toml(Path(__file__).parent / "claims" / f"{figure}.toml")


def claims_of(figure: str, named: Mapping[str, Any]) -> list[Claim]:
    """Return the claims of a figure with their verdicts, in the order of its file. Claims that cannot be judged by
    these values (whose rule `when` is false) are left out.

    named : the values that sentences and rules use, by name.
    """
    return [claim for name in sentences(figure) for claim in judged(f"{figure}.{name}", **named)]


def judge(claim: str, /, **named: Any) -> Claim:
    """Return one claim with its verdict.

    claim : "FIGURE.NAME".
    named : the values that its sentences and rules use, by name.

    Raises ValueError if it has not exactly one case.
    """
    (found,) = judged(claim, **named)
    return found


def judged(claim: str, /, **named: Any) -> list[Claim]:
    """Return one claim with its verdict, once for each of its cases; an empty list if its rule `when` is false.

    claim : "FIGURE.NAME", the name of its file and its name there.
    named : the values that its sentences and rules use, by name.
    """
    figure, _, name = claim.partition(".")
    text = {"paper": "not given"} | sentences(figure)[name]
    scope = {"np": np, "Share": Share, "span": span, **text.get("limits", {}), **named}

    def rule(key: str, default: Any = None) -> Any:
        """Return the value that the claim's table has for a key; a text is evaluated as a Python expression in the
        names known so far.

        default : value if the table lacks the key.
        """
        found = text.get(key, default)
        return eval(found, scope) if isinstance(found, str) else found

    if not rule("when", True):
        return []
    found = []
    for case in rule("cases", [{}]):
        # Names that rules and sentences of this case use: its own, then those of `let`, then its numbers.
        scope |= case
        for key, expression in text.get("let", {}).items():
            scope[key] = eval(expression, scope)
        numbers = rule("numbers", {})
        scope |= numbers
        written = _Sentences(text.get("phrases", {}), scope)
        words = {key: written.fill(text[key]) for key in ("claim", "finding", "paper", "ours", "uncertainty")}
        found.append(
            Claim(
                **words,
                confirmed=bool(rule("holds")),
                refined=bool(rule("refined", False)),
                numbers=_plain(numbers),
                samples=int(rule("samples")),
                samples_needed=int(rule("needed", 1)),
                kind=text.get("kind", "samples"),
                chosen_after_the_data=written.fill(text.get("after_data", "")) if rule("chosen", True) else "",
            )
        )
    return found


def _plain(value: Any) -> Any:
    """Return a value in types that JSON has: arrays become lists, and NumPy's numbers those of Python, in lists and
    mappings, too.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(part) for part in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return value.item() if isinstance(value, np.generic) else value
