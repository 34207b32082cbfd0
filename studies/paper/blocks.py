"""Blocks of small samples, by as many processes as there are cores, kept until the end of a study."""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.files.scan_journal import Journal, read_journal
from taichi_bearings.stages import each

Draw = Callable[..., dict[str, Any]]  # of a module, so that other processes find it; the result is valid JSON


def drawn(draw: Draw, blocks: Sequence[tuple[Any, ...]], journal: Path) -> list[dict[str, Any]]:
    """`draw(*block)` of each block, in their order.

    journal : keeps what is done where the study is interrupted, until the end; blocks that it has are not drawn again.
    """
    keys = ["-".join(map(str, block)) for block in blocks]
    known = read_journal(journal)
    missing = [(key, block) for key, block in zip(keys, blocks, strict=True) if key not in known]
    with Journal(journal) as kept, ProcessPoolExecutor(runtime.available_threads(), get_context("spawn")) as pool:
        found = pool.map(draw, *zip(*(block for _, block in missing), strict=True)) if missing else iter(())
        for (key, _), numbers in zip(each(missing, "block"), found, strict=False):
            known[key] = {"key": key, "scalars": {"status": "solved"}, "numbers": numbers}
            kept.append([known[key]])
    journal.unlink()
    return [known[key]["numbers"] for key in keys]
