"""What the benchmark has measured, one row a thing, as the table, the CSV and the JSON show it."""

from dataclasses import asdict, dataclass, fields
from typing import Any

from .timing import Times

PARTS = {
    "memory": "bandwidth by working set",
    "kernels": "sweeps, steps and iterations",
    "methods": "one sample to a proven gap, beside conic solvers",
    "scans": "samples a second, beside conic solvers",
    "dynamics": "time steps, beside LAMMPS and YADE",
}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One thing measured. What a part does not know is None.

    part : of PARTS. what : the kernel, the method, the peer. seconds : of one sweep, step, solve or sample, the median;
    quickest, slowest : of the rounds; seconds_processor : of all threads. seconds_compile : to get ready at first, what
    getting ready takes anyway left out. contact_updates : a second.
    bytes, operations, roots : of one, as counted. bandwidth : bytes a second, of these. bandwidth_here : what the
    machine delivers from a working set of the same size, in the same rounds; operations_here, roots_here : what it
    reckons with at most, a second. roof : share of the speed that memory,
    operations and roots allow. limit : which of them. ratio : how many times as fast as this ours is.
    bytes_per_sphere : of the fields, or of all memory. gap : proven. proven : share of samples with all states proven.
    """

    part: str
    what: str
    shape: tuple[int, ...] | None = None
    law: str | None = None
    components: int | None = None
    precision: str = "f64"
    threads: int | None = None
    seconds: float
    quickest: float | None = None
    slowest: float | None = None
    seconds_processor: float | None = None
    seconds_compile: float | None = None
    rounds: int | None = None
    contact_updates: float | None = None
    working_set: float | None = None
    bytes: float | None = None
    operations: float | None = None
    roots: float | None = None
    passes: int | None = None
    bandwidth: float | None = None
    bandwidth_here: float | None = None
    operations_here: float | None = None
    roots_here: float | None = None
    roof: float | None = None
    limit: str | None = None
    ratio: float | None = None
    bytes_per_sphere: float | None = None
    iterations: int | None = None
    gap: float | None = None
    status: str | None = None
    samples: int | None = None
    proven: float | None = None
    load: float | None = None

    @property
    def size(self) -> str:
        return "x".join(map(str, self.shape)) if self.shape else ""

    def known(self) -> dict[str, Any]:
        """For JSON: what is known."""
        return {name: value for name, value in asdict(self).items() if value is not None}


COLUMNS = tuple(field.name for field in fields(Row))


def timing(times: Times) -> dict[str, Any]:
    """The columns of times that were taken in rounds."""
    return {
        "seconds": times.seconds,
        "quickest": times.quickest,
        "slowest": times.slowest,
        "seconds_processor": times.processor,
        "rounds": len(times.each),
    }
