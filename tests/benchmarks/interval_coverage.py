"""How often intervals that state 95 % hold the mean: the table of docs/histograms.md.

python -m tests.benchmarks.interval_coverage [trials]
"""

import sys

import numpy as np

from taichi_bearings.analysis.statistics import CONFIDENCE, FEW_SAMPLES, LEAST_SAMPLES, RESAMPLES, _bootstrap, _student

DRAWS = {  # name -> (samples from a generator, their mean)
    "normal": (lambda rng, n: rng.normal(1.0, 1.0, n), 1.0),
    "exponential": (lambda rng, n: rng.exponential(1.0, n), 1.0),
    "lognormal, sigma 1": (lambda rng, n: rng.lognormal(0.0, 1.0, n), np.exp(0.5)),
    "yes or no, 30 %": (lambda rng, n: (rng.random(n) < 0.3).astype(float), 0.3),
}
NUMBERS = (2, 3, 5, 10, 20, 50, 200)


def covers(interval, mean: float) -> bool:
    return interval[0] - 1e-12 <= mean <= interval[1] + 1e-12


def main(trials: int) -> None:
    print("| samples | " + " | ".join(DRAWS) + " |\n|---|" + "---|" * len(DRAWS))
    for number in NUMBERS:
        cells = []
        for draw, mean in DRAWS.values():
            held = np.zeros(2)  # by the t interval, by BCa
            for trial in range(trials):
                values, ones = draw(np.random.default_rng([number, trial]), number), np.ones(number)
                if np.ptp(values) > 0:  # else neither has a width
                    held[0] += covers(_student(values, ones, CONFIDENCE), mean)
                    held[1] += covers(_bootstrap(values, ones, CONFIDENCE, RESAMPLES, trial), mean)
            cells.append(" / ".join(f"{100 * share:.0f}" for share in held / trials))
        given = "none" if number < LEAST_SAMPLES else "t" if number < FEW_SAMPLES else "BCa"
        print(f"| {number} ({given}) | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
