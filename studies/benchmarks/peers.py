"""General conic solvers on the same scene: Clarabel (interior point) and SCS (operator splitting), judged as we are.

Both are optional (`pip install taichi-bearings[peers]`). Each is run with every linear solver that it has here:

* Clarabel: `qdldl` (its own, one thread), `faer` (multi-threaded), and `mkl` where it finds that library
  (MKL_PARDISO_PATH must name a folder that holds libmkl_rt.so).
* SCS: `qdldl` (one thread) and `mkl` (bundled on Linux; its threads follow MKL_NUM_THREADS). Its conjugate gradients,
  which need no factorisation, took 26 to 55 times as long at 10x10x10 and are left out.

The time is that of setting up and solving; building the matrices is left out. What a peer says about its own accuracy
is not used: its spins and multipliers go through the certificate.

They read the least power as a conic programme in sparse matrices:

    minimise  x.P.x / 2 + q.x   subject to   A x + s = b,   s in {0} x {s >= 0} x second-order cones of three

The first unknowns are those of a packing (`conic/contact_system.py`): velocities u of free spheres, here over R
times the imposed jump, from the bottom. With y = K u + b the slip of a contact, one tangential component or two:

    Coulomb:  minimise sum mu t,      |y| <= t        one component: t - y >= 0, t + y >= 0; two: (t, y) in a cone
    viscous:  minimise sum eta v.v,   y - v = 0

The multipliers z of the rows are the contact forces along y: for Coulomb, in units of the normal force, z_1 - z_2 of a
pair and minus the last two of a cone; for viscous contacts half of z, in units of R times the jump.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.lattice.grid import staggered_forces
from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.scene import Scene
from taichi_bearings.solvers.packing_states import forces_of

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)  # that peers are asked for, one after another
HOW_TO_INSTALL = "not installed; pip install taichi-bearings[peers]"


@dataclass(frozen=True)
class ConicProgramme:
    """The least power of a scene as a conic programme: minimise x.P.x / 2 + q.x subject to A x + s = b, where s is
    0 in the first rows, then not negative, then in second-order cones of three rows each.

    scene, system : the sample, and its contacts and unknown spins.
    slips : indices of the slip components of the programme among all d n of the system (n contacts that can slip, d
        components): first all contacts with one component; then, of all contacts with two, the first, then the second.
    quadratic, linear : P and q.
    matrix, offset : A and b.
    equalities, inequalities, cones : numbers of rows in which s is 0, of rows in which it is not negative, and of
        cones.
    """

    scene: Scene
    system: ContactSystem
    slips: np.ndarray
    quadratic: sparse.csc_matrix
    linear: np.ndarray
    matrix: sparse.csc_matrix
    offset: np.ndarray
    equalities: int = 0
    inequalities: int = 0
    cones: int = 0

    def spins(self, x: np.ndarray) -> np.ndarray:
        """Return the spins of a solution of the conic programme, (components C, 1, lattice shape *N), 1/time, staggered
        (times the sign of the sublattice).

        x : (columns,) solution of the programme; its first numbers are the unknown spins over the imposed jump.

        Numbers that are not finite become 0; free spins are limited to those of the planes, and driven spheres get
        their imposed ones.
        """
        scene, axes, lattice = self.scene, self.scene.minimum_spin_axes, self.scene.lattice
        spin = self.system.all_spins(scene.jump * np.nan_to_num(x[: self.system.unknowns]))
        spin = lattice.parity[..., None] * spin.reshape(*lattice.shape, -1)
        staggered = np.moveaxis(spin if lattice.dimension == 2 else spin[..., list(axes)], -1, 0)[:, None]
        return scene.impose_driving(scene.clip_to_box(staggered, axes), axes)

    def forces(self, z: np.ndarray) -> np.ndarray:
        """Return the contact forces (C components, 1, E contacts) for which the multipliers of a conic solver stand. A
        force is that on the lower sphere, times the sign of this sphere; signs alternate between neighbours.

        z : (rows,), multipliers of the constraints. With friction these are two inequalities for each contact with one
            slip component, then three rows of a cone for each other contact; without friction one row for each slip.
        """
        scene, pairs = self.scene, self.inequalities // 2
        if not scene.law.has_friction:
            found = scene.lattice.radius * scene.jump / 2 * z
        else:
            cones = z[2 * pairs :].reshape(-1, 3)
            found = scene.normal_force * np.concatenate([z[:pairs] - z[pairs : 2 * pairs], -cones[:, 1], -cones[:, 2]])
        force = np.zeros(self.system.offset.size)
        force[self.slips] = found
        friction = forces_of(self.system, force.reshape(self.system.offset.shape))[1]
        return staggered_forces(friction[None], scene.lattice, scene.minimum_spin_axes)

    def with_friction(self, scene: Scene) -> "ConicProgramme":
        """Return the programme of another Coulomb sample of the same lattice and driving: only the costs of the slips
        change, which are the last entries of `linear`, the linear part of the function to be minimised.

        scene : the other sample.
        """
        linear = self.linear.copy()
        costs = linear[self.system.unknowns :]
        costs[costs > 0] = scene.coefficient[0, self.system.contact][costs > 0]
        return replace(self, scene=scene, linear=linear)


def conic_programme(scene: Scene) -> ConicProgramme:
    """Return the least power of a scene of one sample as a conic programme. Its variables are the unknown spins, and
    for each contact a bound t on its slip |y| if it has friction, or its slip components v if it is viscous.
    Raises InputError for several samples, and for contacts with both friction and viscosity.
    """
    if scene.replicas != 1:
        raise InputError(
            f"the scene has {scene.replicas} samples; the conic programme for other solvers describes one, so give one "
            "of them, such as scene.sample(0)"
        )
    if scene.law.has_friction and scene.law.has_viscosity:
        raise InputError(
            f"law is {scene.law}; the conic programme for other solvers has friction or viscosity, not both"
        )
    system = ContactSystem.of(scene)
    system.operator.eliminate_zeros()
    d, count = system.offset.shape
    # slip components that are not 0 whatever the spins are, those of contacts with one such component first
    can_change = ((np.diff(system.operator.indptr) > 0) | (system.offset.ravel() != 0)).reshape(d, count)
    has_one = can_change.sum(axis=0) == 1
    slips = np.concatenate([np.flatnonzero(can_change & has_one), np.flatnonzero(can_change & ~has_one)])
    matrix, offset = system.operator[slips], system.offset.ravel()[slips] / (scene.lattice.radius * (scene.jump or 1.0))
    coefficient = np.where(can_change.any(axis=0), scene.coefficient[0, system.contact], 0.0)
    unknowns, nothing = system.unknowns, np.zeros(system.unknowns)
    if not scene.law.has_friction:  # y - v = 0
        rows = len(slips)
        return ConicProgramme(
            scene,
            system,
            slips,
            quadratic=sparse.diags(np.concatenate([nothing, 2 * coefficient[slips % count]]), format="csc"),
            linear=np.zeros(unknowns + rows),
            matrix=sparse.hstack([matrix, -sparse.identity(rows)], format="csc"),
            offset=-offset,
            equalities=rows,
        )
    size, scalars = unknowns + count, int(has_one.sum())  # unknowns with t; contacts with one slip component
    cones = (len(slips) - scalars) // 2
    y = sparse.hstack([matrix, sparse.csr_matrix((len(slips), count))]).tocsr()
    t = sparse.identity(size, format="csr")[unknowns + slips[: scalars + cones] % count]  # of each contact
    # s = t - y >= 0 and s = t + y >= 0 for contacts with one component; s = (t, y) in a cone for the others
    stacked = sparse.vstack([y[:scalars] - t[:scalars], -y[:scalars] - t[:scalars], -t[scalars:], -y[scalars:]])
    sides = np.concatenate([-offset[:scalars], offset[:scalars], np.zeros(cones), offset[scalars:]])
    order = np.arange(len(sides))
    order[2 * scalars :] = order[2 * scalars :].reshape(3, cones).T.ravel()  # t, y_1, y_2 of one cone together
    return ConicProgramme(
        scene,
        system,
        slips,
        quadratic=sparse.csc_matrix((size, size)),
        linear=np.concatenate([nothing, coefficient]),
        matrix=stacked.tocsr()[order].tocsc(),
        offset=sides[order],
        inequalities=2 * scalars,
        cones=cones,
    )


@dataclass(frozen=True)
class Answer:
    """What a conic solver has found for one tolerance.

    power, lower_bound : power and lower bound of its spins and forces, recomputed by the certificate, energy/time.
    seconds : wall time to set up and solve.
    iterations : number that the solver reports.
    status : how the solver says that it ended.
    done : True if it says that it reached the tolerance.
    """

    power: float
    lower_bound: float
    seconds: float
    iterations: int
    status: str
    done: bool


Raw = tuple[np.ndarray, np.ndarray, int, str, bool]
"""What a conic solver returns: unknowns x, multipliers z of the rows, iterations, status, and whether the tolerance was
reached."""


@dataclass(frozen=True)
class Peer:
    """A conic solver with one of its linear solvers.

    name : "clarabel" or "scs".
    linear_solver : name of the linear solver that it uses, one of LINEAR_SOLVERS.
    """

    name: str
    linear_solver: str

    def __str__(self) -> str:
        """Return the solver with its linear solver in brackets."""
        return f"{self.name} ({self.linear_solver})"

    def solve(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int = 0) -> Answer:
        """Return the answer at a tolerance, with power and lower bound recomputed from spins and forces, independently
        of the solver.

        programme : what is solved.
        tolerance : tolerance in the sense of the solver, not a relative gap.
        seconds : time limit.
        threads : number of threads, 0 for all; solvers without such an option ignore it.
        """
        began = time.perf_counter()
        x, z, iterations, status, done = self.run(programme, tolerance, seconds, threads)
        took = time.perf_counter() - began
        scene, axes = programme.scene, programme.scene.minimum_spin_axes
        power, bound = scene.power(programme.spins(x), axes)[0], lower_bound(scene, programme.forces(z), axes)[0]
        return Answer(float(power), float(bound), took, iterations, status, done)

    def run(self, programme: ConicProgramme, tolerance: float, seconds: float, threads: int) -> Raw:
        """Return what the solver returns at a tolerance, without recomputing power and bound: unknowns x, multipliers
        z, iterations, status, and whether the tolerance was reached.

        programme : what is solved.
        tolerance : tolerance in the sense of the solver, not a relative gap.
        seconds : time limit.
        threads : number of threads, 0 for all.
        """
        return _RUNS[self.name](programme, self.linear_solver, tolerance, seconds, threads)


def _clarabel(programme: ConicProgramme, linear_solver: str, tolerance: float, seconds: float, threads: int) -> Raw:
    """Return what Clarabel returns: unknowns x, multipliers z, iterations, status, and whether the tolerance was
    reached.

    programme : what is solved.
    linear_solver : name of its linear solver.
    tolerance : of gap (absolute and relative) and residuals.
    seconds : time limit.
    threads : number of threads, 0 for all.
    """
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
    """Return what SCS returns: unknowns x, multipliers z, iterations, status, and whether the tolerance was reached.

    programme : what is solved.
    linear_solver : name of its linear solver.
    tolerance : absolute and relative tolerance of its residuals and gap.
    seconds : time limit.
    threads : not used; SCS has no such option.
    """
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
    """Return the conic solvers that work here, and for the others the reason why they do not.

    Each is tried on six discs. The reasons are by name, or by name and linear solver.
    """
    here: list[Peer] = []
    missing: dict[str, str] = {}
    for peer in (Peer(name, solver) for name, solvers in LINEAR_SOLVERS.items() for solver in solvers):
        try:
            peer.run(conic_programme(Scene.random((2, 3))), 1e-3, 10.0, 1)
        except ModuleNotFoundError:
            missing[peer.name] = HOW_TO_INSTALL
        except Exception as error:  # each library raises its own kind
            missing[str(peer)] = str(error)
        else:
            here.append(peer)
    return here, missing
