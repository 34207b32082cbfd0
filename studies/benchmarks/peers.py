"""General conic solvers on the same scene: Clarabel and moreau (interior point) and SCS (operator splitting), judged by
our ruler.

Both are optional (`pip install taichi-bearings[peers]`). Each is run with every linear solver that it has here:

* Clarabel: `qdldl` (its own, one thread), `faer` (multi-threaded), and `mkl` or `panua` where it finds such a library
  (MKL: MKL_PARDISO_PATH must name a folder that holds libmkl_rt.so).
* SCS: `qdldl` (one thread) and `mkl` (bundled on Linux; its threads follow MKL_NUM_THREADS). Its conjugate gradients,
  which need no factorisation, took 26 to 55 times as long at 10x10x10 and are left out.
* moreau, made for many problems of one pattern at a time: `qdldl` and `faer-nt`; it takes all threads that it finds.

The time is that of setting up and solving; building the matrices is left out. What a peer says about its own accuracy
is not used: its spins and multipliers go through the certificate.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from taichi_bearings.lattice import Lattice
from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.scene import Scene

from .conic import ConicProgramme, conic_programme

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # asked for, one after another


@dataclass(frozen=True)
class Answer:
    """What a peer returned. power, lower_bound : of its spins and forces by the certificate, energy/time."""

    power: float
    lower_bound: float
    seconds: float
    iterations: int
    status: str
    done: bool  # it says that it reached the tolerance


@dataclass(frozen=True)
class Peer:
    """A conic solver with one of its linear solvers."""

    name: str
    linear_solver: str

    def solve(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int = 0) -> Answer:
        """Solve to `tolerance` within `seconds`; threads : 0 for all, as far as the solver can be told."""
        x, z, took, iterations, status, done = self.run(programme, tolerance, seconds, threads)
        scene, axes = programme.scene, programme.scene.minimum_spin_axes
        power = scene.power(programme.spins(x), axes)[0]
        bound = lower_bound(scene, programme.forces(z), axes)[0]
        return Answer(float(power), float(bound), took, iterations, status, done)

    def run(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int) -> "Raw":
        """The same without judging the answer: unknowns, multipliers, seconds, iterations, status, done."""
        return _RUNS[self.name](programme, self.linear_solver, tolerance, seconds, threads)


Raw = tuple[np.ndarray, np.ndarray, float, int, str, bool]


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
    began = time.perf_counter()
    solver = clarabel.DefaultSolver(
        programme.quadratic, programme.linear, programme.matrix, programme.offset, cones, settings
    )
    answer = solver.solve()
    took = time.perf_counter() - began
    solved = answer.status == clarabel.SolverStatus.Solved
    status = "time-limit" if answer.status == clarabel.SolverStatus.MaxTime else str(answer.status).lower()
    return np.asarray(answer.x), np.asarray(answer.z), took, answer.iterations, status, solved


def _scs(programme: ConicProgramme, linear_solver: str, tolerance: float, seconds: float, threads: int) -> Raw:
    import scs

    described = {"A": programme.matrix, "b": programme.offset, "c": programme.linear}
    if programme.quadratic.nnz:
        described["P"] = programme.quadratic
    cone = {"z": programme.equalities, "l": programme.inequalities, "q": [3] * programme.cones}
    began = time.perf_counter()
    solver = scs.SCS(
        described,
        cone,
        linear_solver=linear_solver,
        eps_abs=tolerance,
        eps_rel=tolerance,
        max_iters=2**31 - 1,
        time_limit_secs=seconds,
        verbose=False,
    )
    answer = solver.solve()
    took = time.perf_counter() - began
    end = answer["info"]
    if end["status_val"] == scs.SIGINT:
        raise KeyboardInterrupt
    solved = end["status_val"] == scs.SOLVED
    status = "time-limit" if "time_limit" in end["status"] else end["status"]
    return answer["x"], answer["y"], took, end["iter"], status, solved


def _moreau(programme: ConicProgramme, linear_solver: str, tolerance: float, seconds: float, threads: int) -> Raw:
    began = time.perf_counter()
    solver = moreau_solver(programme, 1, linear_solver, tolerance, seconds)
    answer = solver.solve(programme.linear[None], programme.offset[None])
    took = time.perf_counter() - began
    status = str(solver.info.status[0])
    return answer.x[0], answer.z[0], took, int(solver.info.iterations[0]), status.lower(), status == "Solved"


def moreau_solver(
    programme: ConicProgramme, batch: int, linear_solver: str = "auto", tolerance: float = 1e-8, seconds: float = np.inf
) -> Any:
    """A solver of so many programmes at a time that differ from this one in their costs only."""
    import moreau

    matrix, quadratic = programme.matrix.tocsr(), programme.quadratic.tocsr()
    tolerances = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance)
    solver = moreau.CompiledSolver(
        *reversed(matrix.shape),
        *(quadratic.indptr, quadratic.indices, matrix.indptr, matrix.indices),
        moreau.Cones(
            num_zero_cones=programme.equalities,
            num_nonneg_cones=programme.inequalities,
            so_cone_dims=[3] * programme.cones,
        ),
        moreau.Settings(
            solver="ipm",
            device="cpu",
            batch_size=batch,
            time_limit=seconds,
            ipm_settings=moreau.IPMSettings(direct_solve_method=linear_solver, **tolerances),
        ),
    )
    solver.setup(quadratic.data, matrix.data)
    return solver


_RUNS: dict[str, Callable[[ConicProgramme, str, float, float, int], Raw]] = {
    "clarabel": _clarabel,
    "scs": _scs,
    "moreau": _moreau,
}
LINEAR_SOLVERS = {
    "clarabel": ("qdldl", "faer", "mkl", "panua"),
    "scs": ("qdldl", "mkl"),
    "moreau": ("qdldl", "faer-nt"),
}
HOW_TO_INSTALL = "pip install taichi-bearings[peers]"


def find_peers() -> tuple[list[Peer], dict[str, str]]:
    """The peers that work here, and why the others do not: name or name with linear solver -> reason."""
    here: list[Peer] = []
    missing: dict[str, str] = {}
    for name, linear_solvers in LINEAR_SOLVERS.items():
        if find_spec(name) is None:
            missing[name] = f"not installed; {HOW_TO_INSTALL}"
            continue
        for linear_solver in linear_solvers:
            reason = _why_not(name, linear_solver)
            if reason is None:
                here.append(Peer(name, linear_solver))
            else:
                missing[f"{name} {linear_solver}"] = reason
    return here, missing


def _why_not(name: str, linear_solver: str) -> str | None:
    """Why a linear solver does not work here, seen by trying it on six discs; None if it does."""
    lattice = Lattice((2, 3))
    discs = Scene(tuple(np.ones(lattice.contact_shape(axis)) for axis in range(2)))
    try:
        _RUNS[name](conic_programme(discs), linear_solver, 1e-3, 10.0, 1)
    except Exception as error:  # each library raises its own kind
        return str(error)
    return None
