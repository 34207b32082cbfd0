"""General conic solvers on the same scene: Clarabel (interior point) and SCS (operator splitting), by our ruler.

Both are optional (`pip install taichi-bearings[peers]`). Each is run with every linear solver that it has here:

* Clarabel: `qdldl` (its own, one thread), `faer` (multi-threaded), and `mkl` where it finds that library
  (MKL_PARDISO_PATH must name a folder that holds libmkl_rt.so).
* SCS: `qdldl` (one thread) and `mkl` (bundled on Linux; its threads follow MKL_NUM_THREADS). Its conjugate gradients,
  which need no factorisation, took 26 to 55 times as long at 10x10x10 and are left out.

The time is that of setting up and solving; building the matrices is left out. What a peer says about its own accuracy
is not used: its spins and multipliers go through the certificate.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.scene import Scene

from .conic import ConicProgramme, conic_programme

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # asked for, one after another
HOW_TO_INSTALL = "not installed; pip install taichi-bearings[peers]"


@dataclass(frozen=True)
class Answer:
    """What a peer returned. power, lower_bound : of its spins and forces by the certificate, energy/time. done : it
    says that it reached the tolerance."""

    power: float
    lower_bound: float
    seconds: float
    iterations: int
    status: str
    done: bool


Raw = tuple[np.ndarray, np.ndarray, int, str, bool]  # unknowns, multipliers, iterations, status, done


@dataclass(frozen=True)
class Peer:
    """A conic solver with one of its linear solvers."""

    name: str
    linear_solver: str

    def __str__(self) -> str:
        return f"{self.name} ({self.linear_solver})"

    def solve(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int = 0) -> Answer:
        """Solve to `tolerance` within `seconds`; threads : 0 for all, as far as the solver can be told."""
        began = time.perf_counter()
        x, z, iterations, status, done = self.run(programme, tolerance, seconds, threads)
        took = time.perf_counter() - began
        scene, axes = programme.scene, programme.scene.minimum_spin_axes
        power, bound = scene.power(programme.spins(x), axes)[0], lower_bound(scene, programme.forces(z), axes)[0]
        return Answer(float(power), float(bound), took, iterations, status, done)

    def run(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int) -> Raw:
        """The same without judging the answer."""
        return _RUNS[self.name](programme, self.linear_solver, tolerance, seconds, threads)


def _clarabel(programme: ConicProgramme, linear_solver: str, tolerance: float, seconds: float, threads: int) -> Raw:
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.direct_solve_method = linear_solver
    settings.max_threads = threads
    settings.time_limit = seconds
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    cones: list[Any] = [clarabel.ZeroConeT(programme.equalities)] if programme.equalities else []
    cones += [clarabel.NonnegativeConeT(programme.inequalities)] if programme.inequalities else []
    cones += [clarabel.SecondOrderConeT(3)] * programme.cones
    answer = clarabel.DefaultSolver(
        programme.quadratic, programme.linear, programme.matrix, programme.offset, cones, settings
    ).solve()
    status = "time-limit" if answer.status == clarabel.SolverStatus.MaxTime else str(answer.status).lower()
    done = answer.status == clarabel.SolverStatus.Solved
    return np.asarray(answer.x), np.asarray(answer.z), answer.iterations, status, done


def _scs(programme: ConicProgramme, linear_solver: str, tolerance: float, seconds: float, threads: int) -> Raw:
    import scs

    described = {"A": programme.matrix, "b": programme.offset, "c": programme.linear}
    if programme.quadratic.nnz:
        described["P"] = programme.quadratic
    answer = scs.SCS(
        described,
        {"z": programme.equalities, "l": programme.inequalities, "q": [3] * programme.cones},
        linear_solver=linear_solver,
        eps_abs=tolerance,
        eps_rel=tolerance,
        max_iters=2**31 - 1,
        time_limit_secs=seconds,
        verbose=False,
    ).solve()
    end = answer["info"]
    if end["status_val"] == scs.SIGINT:
        raise KeyboardInterrupt
    status = "time-limit" if "time_limit" in end["status"] else end["status"]
    return answer["x"], answer["y"], end["iter"], status, end["status_val"] == scs.SOLVED


_RUNS: dict[str, Callable[[ConicProgramme, str, float, float, int], Raw]] = {"clarabel": _clarabel, "scs": _scs}
LINEAR_SOLVERS = {"clarabel": ("qdldl", "faer", "mkl"), "scs": ("qdldl", "mkl")}


def find_peers() -> tuple[list[Peer], dict[str, str]]:
    """The peers that work here, and why the others do not: name or name with linear solver -> reason."""
    here: list[Peer] = []
    missing: dict[str, str] = {}
    for name, linear_solvers in LINEAR_SOLVERS.items():
        if find_spec(name) is None:
            missing[name] = HOW_TO_INSTALL
            continue
        for peer in (Peer(name, linear_solver) for linear_solver in linear_solvers):
            reason = _why_not(peer)
            if reason is None:
                here.append(peer)
            else:
                missing[str(peer)] = reason
    return here, missing


def _why_not(peer: Peer) -> str | None:
    """Why a linear solver does not work here, seen by trying it on six discs; None if it does."""
    try:
        peer.run(conic_programme(Scene.random((2, 3))), 1e-3, 10.0, 1)
    except Exception as error:  # each library raises its own kind
        return str(error)
    return None
