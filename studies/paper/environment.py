"""The machine and the programs that numbers come from, for the record."""

import os
import platform
from pathlib import Path

from taichi_bearings import runtime
from taichi_bearings.runs.run import versions
from taichi_bearings.version import VERSION


def environment() -> dict[str, str]:
    """What to know of them, in words; nothing that names the machine or its owner."""
    return {
        "taichi_bearings": VERSION,
        **versions(),
        "system": f"{platform.system()}, {platform.machine()}",
        "processor": _processor(),
        "cores": str(os.cpu_count() or 1),
        "threads": f"{runtime.available_threads()}, double precision",
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        lines = []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return (named or [platform.processor() or "unknown"])[0]
