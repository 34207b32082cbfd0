"""How many of how many samples a number, a curve or a figure rests on, and why the others are not in it."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Census:
    """used : samples that are in. left_out : why others are not -> how many, in words that follow a number."""

    used: int
    left_out: Mapping[str, int] = field(default_factory=dict)

    @staticmethod
    def of(reasons: Iterable[str]) -> "Census":
        """From the reason of each sample to be left out, empty if it is in."""
        counts = Counter(reasons)
        return Census(counts.pop("", 0), dict(sorted(counts.items(), key=lambda item: -item[1])))

    @property
    def asked(self) -> int:
        """Samples that were asked for."""
        return self.used + sum(self.left_out.values())

    @property
    def reasons(self) -> str:
        """``2 failed, 1 not computed yet``; empty if none is left out."""
        return ", ".join(f"{number:,} {reason}" for reason, number in self.left_out.items())

    @property
    def share(self) -> str:
        """``57 of 60 samples``."""
        if not self.left_out:
            return "1 sample" if self.used == 1 else f"all {self.used:,} samples"
        return f"{format(self.used, ',') if self.used else 'none'} of {self.asked:,} samples"

    def __str__(self) -> str:
        return f"{self.share} ({self.reasons})" if self.left_out else self.share
