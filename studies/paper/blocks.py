"""Blocks of small samples, by as many processes as there are cores, kept until the end of a study."""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.scan_journal import read_journal
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.engine import LocalEngine, run_samples
from taichi_bearings.scans.sample import failure

from .samples import kept_in

Draw = Callable[..., dict[str, list[float]]]  # of a module, so that workers find it
Columns = dict[str, np.ndarray]
Point = tuple[Any, Any, Any]
"""What a sample is drawn from."""


@dataclass(frozen=True)
class Block:
    """Samples of one point that are drawn together, from a seed on."""

    point: Point
    samples: int
    seed: int
    settings = RunSettings(threads=1)  # of the worker

    @property
    def key(self) -> str:
        return "-".join(map(str, (*self.point, self.seed)))

    label = key


def drawn(draw: Draw, wanted: Mapping[Point, int], block: int, seed: int, journal: Path) -> dict[Point, Columns]:
    """`draw(*point, samples, seed)` in blocks of samples: its lists put together, as arrays, point by point.

    wanted : samples of each point, from `seed` on. journal : keeps what is done where the study is interrupted, until
    the end; blocks that it has are not drawn again.
    """
    blocks = [
        Block(point, min(block, count - first), seed + first)
        for point, count in wanted.items()
        for first in range(0, count, block)
    ]
    known = read_journal(journal)
    missing = [part for part in blocks if part.key not in known]
    known |= kept_in(journal, _records(missing, draw), missing, "block")
    parts: dict[Point, list[dict[str, list[float]]]] = {point: [] for point in wanted}
    for part in blocks:
        parts[part.point].append(known[part.key]["numbers"])
    return {
        point: {name: np.concatenate([part[name] for part in several]) for name in several[0]}
        for point, several in parts.items()
    }


def _records(blocks: Sequence[Block], draw: Draw) -> Generator[dict[str, Any], None, None]:
    """A record of each as it comes from the workers of scans, which hear nothing of Ctrl-C."""
    with closing(LocalEngine(partial(_by_worker, draw=draw), runtime.available_threads())) as engine:
        for found in run_samples([(block,) for block in blocks], engine, lambda *_: None, failure):
            yield from found


def _by_worker(unit: Sequence[Block], draw: Draw) -> list[dict[str, Any]]:
    (block,) = unit
    try:
        numbers = draw(*block.point, block.samples, block.seed)
    except Exception as error:
        return [failure(block, error)]
    return [{"key": block.key, "scalars": {"status": "solved"}, "numbers": numbers}]
