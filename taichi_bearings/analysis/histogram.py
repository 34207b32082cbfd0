"""Distribution of the power over the slipping contacts, in logarithmic bins."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taichi_bearings.contact_state import ContactState


@dataclass(frozen=True)
class PowerHistogram:
    """edges : (B + 1,) power, energy/time, evenly spaced in the logarithm. count : (B,) slipping contacts a bin.

    slipless, undecided : contacts left out of the bins. slip_threshold : length/time, of the coarsest run. samples :
    replicas pooled.
    """

    edges: np.ndarray
    count: np.ndarray
    slipless: int
    undecided: int
    slip_threshold: float
    samples: int

    @property
    def slipping(self) -> int:
        return int(self.count.sum())


def power_histogram(
    power: Sequence[np.ndarray],
    state: Sequence[np.ndarray],
    slip_threshold: float,
    bins_per_decade: int = 5,
    samples: int = 1,
) -> PowerHistogram:
    """Histogram of the power of slipping contacts.

    power, state : arrays of equal shapes, one an axis (and a run, if several are pooled). samples : for the record.
    """
    powers = np.concatenate([p.ravel() for p in power])
    states = np.concatenate([s.ravel() for s in state])
    chosen = powers[(states == ContactState.SLIPPING) & (powers > 0)]
    if len(chosen):
        low = np.floor(np.log10(chosen.min()) * bins_per_decade)
        high = np.floor(np.log10(chosen.max()) * bins_per_decade) + 1
        edges = 10.0 ** (np.arange(low, high + 1) / bins_per_decade)
        edges[0], edges[-1] = min(edges[0], chosen.min()), max(edges[-1], chosen.max())
    else:
        edges = np.zeros(0)
    return PowerHistogram(
        edges=edges,
        count=np.histogram(chosen, edges)[0] if len(chosen) else np.zeros(0, dtype=int),
        slipless=int((states == ContactState.SLIPLESS).sum()),
        undecided=int((states == ContactState.UNDECIDED).sum()),
        slip_threshold=slip_threshold,
        samples=samples,
    )


def write_csv(histogram: PowerHistogram, path: Path) -> None:
    """``power_low,power_high,count``; contacts that are in no bin are counted in the header."""
    partial = path.with_name(path.name + ".partial")
    with partial.open("w", newline="", encoding="utf-8") as file:
        file.write(f"# slipping {histogram.slipping}, slipless {histogram.slipless}, undecided {histogram.undecided}\n")
        file.write(f"# slip_threshold {histogram.slip_threshold!r}, samples {histogram.samples}\n")
        writer = csv.writer(file)
        writer.writerow(["power_low", "power_high", "count"])
        for low, high, number in zip(histogram.edges[:-1], histogram.edges[1:], histogram.count, strict=True):
            writer.writerow([repr(float(low)), repr(float(high)), int(number)])
    partial.replace(path)


def write_hdf5(histogram: PowerHistogram, path: Path) -> None:
    """Data sets `edges` and `count`; everything else as attributes."""
    import h5py

    partial = path.with_name(path.name + ".partial")
    with h5py.File(partial, "w") as file:
        edges = file.create_dataset("edges", data=histogram.edges)
        edges.attrs["units"], edges.attrs["description"] = "energy/time", "edges of the power bins"
        count = file.create_dataset("count", data=histogram.count)
        count.attrs["units"], count.attrs["description"] = "1", "slipping contacts in each bin"
        for name in ("slipping", "slipless", "undecided", "slip_threshold", "samples"):
            file.attrs[name] = getattr(histogram, name)
    partial.replace(path)
