"""A claim of the paper, what was found, and the verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from scipy.special import betaincinv

from taichi_bearings.analysis.statistics import CONFIDENCE as MEAN_CONFIDENCE
from taichi_bearings.analysis.statistics import FEW, LEAST, MANY, mean_interval
from taichi_bearings.words import counted, share

VERDICTS = ("confirmed", "refined", "refuted", "too few samples")
KINDS = {
    "samples": "holds for the samples drawn, and by their number for most others",
    "theorem": "follows from the equations; the samples check the program, not the claim",
}
"""What a verdict rests on."""
CONFIDENCE = 0.95
HALF = 0.5
SAMPLES, QUICK_SAMPLES = 200, 20  # seeds that a statistical claim may take, by default
FEWEST = 5  # samples without an exception that say, at this confidence, that most others are like them


@dataclass(frozen=True)
class Claim:
    """text : what the paper says. finding : what came out, and by which criterion. numbers : the same for programs.

    confirmed : it holds. refined : it holds with a condition or a correction, which the finding states.
    samples : how many it was judged by. needed : fewer say nothing. kind : what the verdict rests on, one of KINDS.
    paper, ours : the number of the paper and the one found, in a few words. uncertainty : of ours.
    after_data : limits and choices of the criterion that were made with results in view, if any.
    """

    text: str
    finding: str
    confirmed: bool
    numbers: Mapping[str, Any] = field(default_factory=dict)
    refined: bool = False
    samples: int = 1
    needed: int = 1
    kind: Literal["samples", "theorem"] = "samples"
    paper: str = ""
    ours: str = ""
    uncertainty: str = ""
    after_data: str = ""

    @property
    def verdict(self) -> str:
        if self.samples < self.needed:
            return "too few samples"
        if not self.confirmed:
            return "refuted"
        return "refined" if self.refined else "confirmed"

    def as_dict(self) -> dict[str, Any]:
        finding = self.finding
        if self.verdict == "too few samples":
            finding += f" No verdict: this needs {counted(self.needed, 'such sample')} and has {self.samples:,}."
        return {
            "claim": self.text,
            "verdict": self.verdict,
            "kind": self.kind,
            "paper": self.paper,
            "ours": self.ours,
            "uncertainty": self.uncertainty,
            "chosen_after_the_data": self.after_data,
            "samples": self.samples,
            "samples_needed": self.needed,
            "finding": finding,
            "numbers": dict(self.numbers),
        }


def is_claim(found: Any) -> bool:
    """True for what :meth:`Claim.as_dict` makes."""
    plain = Claim("", "", True).as_dict()
    if not isinstance(found, dict) or not all(type(found.get(key)) is type(value) for key, value in plain.items()):
        return False
    return found["verdict"] in VERDICTS and found["kind"] in KINDS and found.keys() == plain.keys()


@dataclass(frozen=True)
class Share:
    """A share of all samples, as a number of those drawn shows it. least, most : the exact interval (Clopper, Pearson),
    each end at the confidence CONFIDENCE."""

    hits: int
    samples: int

    @property
    def least(self) -> float:
        misses = self.samples - self.hits
        return float(betaincinv(self.hits, misses + 1, 1 - CONFIDENCE)) if self.hits else 0.0

    @property
    def most(self) -> float:
        misses = self.samples - self.hits
        return float(betaincinv(self.hits + 1, misses, CONFIDENCE)) if misses else 1.0

    def above(self, limit: float) -> dict[str, Any]:
        """What a Claim that the share is above `limit`, within (0, 1), is judged by."""
        return {"confirmed": self.least > limit, "samples": self.samples, "needed": self.needed_for(limit)}

    def needed_for(self, limit: float) -> int:
        """Number of samples from which such a share tells on which side of `limit` it is; no more than there are if it
        does already."""
        number = max(self.samples, 1)
        while True:
            scaled = Share(round(self.hits / max(self.samples, 1) * number), number)
            if scaled.least > limit or scaled.most <= limit:
                return number
            number = number + 1 if number < 100 else int(1.05 * number)
            if number > 10**6:
                return number

    @property
    def interval(self) -> str:
        """The uncertainty in words."""
        if not self.samples:
            return "no sample"
        return f"{share(self.least)} to {share(self.most)} of all, exact binomial, each end at {share(CONFIDENCE, 0)}"

    def __str__(self) -> str:
        ends = f"{share(self.least, 0)} to {share(self.most, 0)} of all"
        return f"{self.hits:,} of {counted(self.samples, 'sample')} ({ends})"


def every(samples: int) -> str:
    """What it says of all samples that each of so many does something, in words."""
    return "no sample" if not samples else f"in at least {share(Share(samples, samples).least)} of all, exact binomial"


def interval_of_mean(values: Sequence[float] | np.ndarray) -> str:
    """The uncertainty of a mean over samples in words: Student's t for few and for many, else a bootstrap (BCa)."""
    number, found = len(values), mean_interval(np.asarray(values, dtype=float))
    if number < LEAST:
        return f"{counted(number, 'sample')}: no interval"
    how = "bootstrap (BCa)" if FEW <= number <= MANY else "Student's t"
    return f"{found.low:.4g} to {found.high:.4g}, {share(MEAN_CONFIDENCE, 0)}, {how}"


@dataclass(frozen=True)
class Effort:
    """seed : first seed of all samples. samples : seeds that a statistical claim may take. quick : the short form, with
    fewer iterations and sizes too."""

    seed: int = 0
    samples: int = SAMPLES
    quick: bool = False
