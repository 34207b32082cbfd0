"""Contacts with friction and viscosity: the least potential, found by Clarabel in the laboratory frame."""

import itertools

import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.analysis.interface import find_interface
from taichi_bearings.proof.certificate import lower_bound
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Scene, Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS
from tests.scenes import make_scene

clarabel = pytest.importorskip("clarabel")


def least_potential(scene):
    """Minimum over all spins of sum mu F_n |v| + eta |v|^2 / 2 with v = R (w_i + w_j) x n (paper Eq. 2).

    Written from the paper, in the laboratory frame, with a loop over the contacts; all components are free.
    """
    lattice, shape = scene.lattice, scene.lattice.shape
    radius, parts = lattice.radius, (2,) if lattice.dimension == 2 else (0, 1, 2)
    axis_of_spin = np.array([0.0, 0.0, 1.0] if lattice.dimension == 2 else scene.direction, dtype=float)
    axis_of_spin /= np.linalg.norm(axis_of_spin)
    number = {}
    for site in np.ndindex(shape):
        if 0 < site[-1] < shape[-1] - 1:
            for k in parts:
                number[site, k] = len(number)

    def spin(site, k):
        """Column of an unknown, or None, and the imposed value."""
        if (site, k) in number:
            return number[site, k], 0.0
        imposed = scene.spin_bottom if site[-1] == 0 else scene.spin_top
        return None, imposed * axis_of_spin[k] * (-1) ** sum(site)

    rows, fixed, friction, viscosity = [], [], [], []
    for axis in range(lattice.dimension):
        normal = np.eye(3)[axis]
        for site in np.ndindex(lattice.contact_shape(axis)):
            other = tuple(n + (a == axis) for a, n in enumerate(site))
            if lattice.is_driven[site] and lattice.is_driven[other]:
                continue
            across = [t for t in range(3) if t != axis]
            slips = [{}, {}]
            moved = [0.0, 0.0]
            for end in (site, other):
                for k in parts:
                    turned = radius * np.cross(np.eye(3)[k], normal)
                    column, imposed = spin(end, k)
                    for row, t in enumerate(across):
                        if column is None:
                            moved[row] += turned[t] * imposed
                        elif turned[t]:
                            slips[row][column] = turned[t]
            rows.append(slips)
            fixed.append(moved)
            friction.append(scene.normal_force * scene.coefficient[axis][0][site])
            viscosity.append(scene.viscosity[axis][0][site])
    count, spins = len(rows), len(number)
    size = spins + 3 * count  # spins, then for each contact t, v_1, v_2
    tie = sparse.lil_matrix((2 * count, size))
    for c, slips in enumerate(rows):
        for row in range(2):
            tie[2 * c + row, spins + 3 * c + 1 + row] = -1.0
            for column, value in slips[row].items():
                tie[2 * c + row, column] = value
    cones = sparse.hstack([sparse.csc_matrix((3 * count, spins)), -sparse.identity(3 * count)])
    quadratic, linear = np.zeros(size), np.zeros(size)
    linear[spins::3] = friction
    quadratic[spins + 1 :: 3] = quadratic[spins + 2 :: 3] = viscosity
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    solver = clarabel.DefaultSolver(
        sparse.diags(quadratic).tocsc(), linear, sparse.vstack([tie, cones]).tocsc(),
        np.concatenate([-np.ravel(fixed), np.zeros(3 * count)]),
        [clarabel.ZeroConeT(2 * count), *[clarabel.SecondOrderConeT(3)] * count], settings,
    )  # fmt: skip
    answer = solver.solve()
    assert str(answer.status) in ("Solved", "AlmostSolved")
    return answer.obj_val


def random_scene(rng):
    shape = tuple(int(n) for n in rng.integers(2, 5, int(rng.integers(2, 4))))
    shape = (*shape[:-1], shape[-1] + 1)
    driving = {
        "spin_top": float(rng.choice([1.0, 3.0, -0.5])),
        "spin_bottom": float(rng.choice([0.0, 0.9, -1.0])),
        "normal_force": float(10 ** rng.uniform(-1, 2)),
        "radius": float(rng.uniform(0.3, 2.0)),
    }
    if len(shape) == 3:
        driving["direction"] = tuple(float(d) for d in rng.integers(-2, 3, 3) + np.array([0.0, 0.5, 0.0]))
    scale = driving["normal_force"] / driving["radius"] * 10 ** rng.uniform(-2, 2)
    spread = rng.choice(["uniform:{:g},{:g}", "lognormal:{:g},1.5", "bimodal:{:g},{:g},0.5", "constant:{:g}"])
    return make_scene(
        shape, "coulomb-viscous", (int(rng.integers(1000)),), viscosity=spread.format(scale, 10 * scale), **driving
    )


@pytest.mark.parametrize("seed", range(20))
def test_any_spins_and_forces_enclose_the_least_potential(seed):
    """Bound <= minimum <= potential, whatever the spins and forces, and however far from the minimum."""
    rng = np.random.default_rng([seed, 5])
    for _ in range(10):
        scene = random_scene(rng)
        least = least_potential(scene)
        axes = scene.minimum_spin_axes
        force = scene.no_force(axes)
        for part in force:
            part += scene.normal_force * rng.normal(size=part.shape) * rng.choice([0.0, 0.1, 1.0])
        spin = scene.staggered_spin(initial_spin(scene, str(rng.choice(["random", "linear", "minimum-cut"]))), axes)
        assert lower_bound(scene, force, axes)[0] <= least * (1 + 1e-9)
        assert scene.objective(spin, axes)[0] >= least * (1 - 1e-9)


@pytest.mark.parametrize("method", ["gradient-descent", "cundall-strack", "implicit-cundall-strack"])
@pytest.mark.parametrize("shape", [(5, 6), (3, 4, 5)], ids=str)
def test_methods_end_at_the_least_potential(method, shape, precision):
    tolerance = 2e-5 if precision == "f64" else 3e-3
    for seed in range(3):
        scene = make_scene(shape, "coulomb-viscous", (seed,), viscosity="uniform:5,60", spin_bottom=0.2)
        least = least_potential(scene)
        stop = StopRule(tolerance, 400_000)
        solution = solve(scene, METHODS[method]().build(), initial_spin(scene, "random"), stop)
        assert solution.status is Status.CERTIFIED
        assert solution.lower_bound[0] <= least * (1 + 1e-9)
        assert least * (1 - 1e-9) <= solution.objective[0] <= least * (1 + tolerance)
        assert solution.power[0] > solution.objective[0]


@pytest.mark.parametrize("viscosity", ["uniform:5,60", "uniform:1e-4,1e-3", "lognormal:1,5"])
@pytest.mark.parametrize("shape", [(10, 10), (4, 4, 4), (6, 6, 6)], ids=str)
def test_the_interior_point_method_finds_the_least_potential_to_ten_digits(shape, viscosity):
    scene = make_scene(shape, "coulomb-viscous", (3,), viscosity=viscosity, spin_bottom=-0.4)
    least = least_potential(scene)
    solution = solve(scene, METHODS["interior-point"]().build(), initial_spin(scene, "random"), StopRule(1e-11))
    assert solution.status is Status.CERTIFIED
    assert solution.objective[0] == pytest.approx(least, rel=1e-10)
    assert solution.lower_bound[0] == pytest.approx(least, rel=1e-10)
    assert solution.unbalanced_torque[0] < 1e-10 * scene.normal_force
    assert solution.iterations < 25


@pytest.mark.parametrize(
    "options",
    [
        {"shape": (10, 10), "viscosity": "constant:1e6", "replicas": 4},
        {"shape": (6, 6, 6), "viscosity": "constant:1e6", "seed": 1},
        {"shape": (2, 2, 4), "viscosity": "uniform:0.1,1", "distribution": "bimodal:1e-6,1e6,0.5", "seed": 2},
        {"shape": (2, 3), "viscosity": "uniform:0.1,1", "distribution": "bimodal:1e-6,1e6,0.5", "seed": 1},
    ],
    ids=str,
)
def test_what_contrasts_leave_open_is_not_claimed(options, tmp_path, needs_f64):
    """States of contacts that hardly slip against large viscous forces, and powers of slips that spins round away."""
    settings = RunSettings(law="coulomb-viscous", tolerance=1e-5, figures="none", threads=1, **options)
    run(settings, tmp_path / "a")
    assert verify(tmp_path / "a")["contradictions"] == []


def test_power_over_that_of_the_cut_compares_powers():
    """All cuts of a small scene by hand: the one of least potential, and its power."""
    scene = Scene.random((3, 4), seed=0, law="coulomb-viscous", viscosity="uniform:5,60", spin_bottom=0.25)
    speed, found = scene.lattice.radius * 0.75, []
    for above in itertools.product((False, True), repeat=6):
        side = np.zeros((3, 4), dtype=bool)
        side[:, 1:3], side[:, 3] = np.reshape(above, (3, 2)), True
        cut = [np.diff(side, axis=axis) for axis in range(2)]
        friction = 50 * sum(c[k].sum() for c, k in zip(scene.coefficients, cut, strict=True))
        viscosity = sum(v[k].sum() for v, k in zip(scene.viscosity, cut, strict=True))
        found.append((friction * speed + viscosity * speed**2 / 2, friction * speed + viscosity * speed**2))
    least, power = min(found)
    interface = find_interface(scene)
    assert interface.power == pytest.approx(power, rel=1e-12)
    assert interface.lower_bound == pytest.approx(least, rel=1e-12)
