"""Blocks of small samples, by as many processes as there are cores, kept until the end of a study."""

from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.stages import each

Draw = Callable[..., dict[str, list[float]]]  # of a module, so that other processes find it
Columns = dict[str, np.ndarray]


Point = tuple[Any, Any, Any]
"""What a sample is drawn from."""


def drawn(draw: Draw, wanted: Mapping[Point, int], block: int, seed: int, journal: Path) -> dict[Point, Columns]:
    """`draw(*point, samples, seed)` in blocks of samples: its lists put together, as arrays, point by point.

    wanted : samples of each point, from `seed` on. journal : keeps what is done where the study is interrupted, until
    the end; blocks that it has are not drawn again.
    """
    blocks = {
        "-".join(map(str, (*point, first))): (*point, min(block, count - first), seed + first)
        for point, count in wanted.items()
        for first in range(0, count, block)
    }
    known = read_journal(journal)
    missing = [key for key in blocks if key not in known]
    with Journal(journal) as kept, ProcessPoolExecutor(runtime.available_threads(), get_context("spawn")) as pool:
        found = pool.map(draw, *zip(*(blocks[key] for key in missing), strict=True)) if missing else iter(())
        for key, numbers in zip(each(missing, "block"), found, strict=False):
            known[key] = {"key": key, "scalars": {"status": "solved"}, "numbers": numbers}
            kept.append([known[key]])
    journal.unlink()
    parts: dict[Point, list[dict[str, list[float]]]] = {point: [] for point in wanted}
    for key, of in blocks.items():
        parts[of[:3]].append(known[key]["numbers"])
    return {
        point: {name: np.concatenate([part[name] for part in several]) for name in several[0]}
        for point, several in parts.items()
    }
