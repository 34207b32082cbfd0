"""A claim of the paper, what was found, and the verdict."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Claim:
    """text : what the paper says. finding : what came out, and by which criterion. numbers : the same for programs.

    confirmed : it holds. refined : it holds with a condition or a correction, which the finding states.
    """

    text: str
    finding: str
    confirmed: bool
    numbers: Mapping[str, Any] = field(default_factory=dict)
    refined: bool = False

    @property
    def verdict(self) -> str:
        if not self.confirmed:
            return "refuted"
        return "refined" if self.refined else "confirmed"

    def as_dict(self) -> dict[str, Any]:
        return {"claim": self.text, "verdict": self.verdict, "finding": self.finding, "numbers": dict(self.numbers)}


@dataclass(frozen=True)
class Effort:
    """seed : first seed of all samples. samples : seeds that a statistical claim may take."""

    seed: int = 0
    samples: int = 200
