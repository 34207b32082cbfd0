"""The rigid limit of packings: single steps by Clarabel, lattices step by step, stiff springs, and proven minima."""

import numpy as np
import pytest
from scipy import sparse

import taichi_bearings as tb
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import drive
from taichi_bearings.solvers.stopping import StopRule
from tests.clarabel_twin import least
from tests.cli.commands import bearings
from tests.packing.twins import laboratory_slips, pair, random_packing
from tests.scenes import KNOWN_LAWS, some_of

pytestmark = pytest.mark.usefixtures("needs_f64")


def inertia_of(packing, density):
    """Moments of inertia (N,) of solid spheres or discs."""
    radius = packing.radius
    return 0.5 * np.pi * radius**4 * density if packing.dimension == 2 else 8 / 15 * np.pi * radius**5 * density


@pytest.mark.parametrize("seed", some_of(18, 6))
def test_a_step_is_the_minimum_that_clarabel_finds(seed):
    """Of the potential and inertia / (2 h) |change|^2 in the laboratory frame; unequal radii and weights, odd loops,
    floating parts and spheres that touch nothing."""
    rng, law = np.random.default_rng([51, seed]), KNOWN_LAWS[seed % 3]
    packing = random_packing(rng, 2 + seed // 3 % 2, law, spheres=10, contrast=1)
    density = 10 ** rng.uniform(-0.5, 0.5, packing.spheres) / packing.radius**packing.dimension
    free, inertia = packing.driven < 0, inertia_of(packing, density)
    start = np.where(free.reshape(-1, *(1,) * (packing.spin.ndim - 1)), rng.standard_normal(packing.spin.shape), 0.0)
    force = sum(values.mean() for values in packing.material)
    duration = 10 ** rng.uniform(-1, 1) * float((inertia / packing.radius)[free].mean()) / force
    found = tb.solve(
        packing, tb.RigidLimit(time_step=duration), start=start, density=density, iterations=1, tolerance=1e-15
    )
    matrix, constant = laboratory_slips(packing)
    acts = (packing.driven[packing.contact] < 0).any(axis=1)
    of, k = [values[0, acts] for values in packing.material], constant.shape[1]
    nothing = np.zeros(acts.sum())
    weight = np.repeat(inertia[free] / duration, k)
    scale = 1 / np.sqrt(weight)  # Clarabel has an easier time with unknowns of one size
    before = start[free].ravel() / scale
    slips = sparse.csc_matrix(matrix)[np.repeat(acts, k)] @ sparse.diags(scale)
    held, viscosity = nothing if law == "viscous" else of[0], nothing if law == "coulomb" else of[-1]
    expected = scale * least(slips, constant[acts], held, viscosity, 1e-12, 1.0, before).spins
    size = np.abs(expected - start[free].ravel()).max() + np.abs(start).max()
    assert found.spin[free].ravel() == pytest.approx(expected, abs=2e-5 * size)


@pytest.mark.parametrize("law", KNOWN_LAWS)
@pytest.mark.parametrize("shape", [(5, 6), (4, 3, 5)])
def test_a_lattice_given_as_packing_takes_the_steps_of_its_scene(law, shape):
    scene, packing = pair(shape, 3, law, spin_bottom=-1.0)
    options = tb.RigidLimit(time_step=3e-4)
    for steps in (1, 12):
        stop = StopRule(iterations=steps, tolerance=1e-12)
        twin = drive.solve(scene, options.build(), initial_spin(scene, "random"), stop)
        found = tb.solve(packing, options, start="random", iterations=steps, tolerance=1e-12)
        assert found.time == pytest.approx(steps * 3e-4)
        assert found.spin == pytest.approx(twin.spin.reshape(found.spin.shape), abs=1e-9)
        assert found.history["power"] == pytest.approx(twin.history["power"][:, 0], rel=1e-9)
        assert found.history["kinetic_energy"] == pytest.approx(twin.history["kinetic_energy"][:, 0], rel=1e-8)
        assert np.abs(found.history["energy_residual"]).max() < 1e-12


def test_stiff_springs_come_near_it():
    """By Cundall and Strack, which shares no step with it: ten times stiffer, several times nearer."""
    packing = tb.Packing.lattice("triangular", (3, 4), seed=3, spin_bottom=0.3)
    given = {"start": "random", "duration": 2e-3, "tolerance": 1e-15}
    coarse, rigid = (tb.solve(packing, tb.RigidLimit(time_step=2e-3 / steps), **given).spin for steps in (50, 100))
    apart = []
    for factor in (10.0, 100.0):
        options = tb.CundallStrack(stiffness=1e5 * factor, damping=1e3 * factor)
        apart.append(np.sqrt(np.mean((tb.solve(packing, options, **given).spin - (2 * rigid - coarse)) ** 2)))
    moved = np.sqrt(np.mean((rigid - tb.solve(packing, tb.RigidLimit(), **{**given, "duration": 1e-9}).spin) ** 2))
    assert apart[0] < 0.05 * moved
    assert apart[1] < apart[0] / 3


@pytest.mark.parametrize("seed", some_of(12, 5))  # of each law one
def test_random_networks_come_to_rest_at_the_proven_minimum(seed):
    law = KNOWN_LAWS[seed % len(KNOWN_LAWS)]
    packing = random_packing(np.random.default_rng([44, seed]), 2 + seed // 3 % 2, law, contrast=1)
    best = tb.solve(packing)
    found = tb.solve(packing, "rigid-limit", start="random", tolerance=1e-8)
    natural = sum(values.sum() for values in packing.material) * (np.abs(packing.driven_speed).max() or 1.0)
    # beside a least power of 0 a power that is not exactly 0, but tiny, has no small relative gap
    assert found.status == "certified" or (best.potential == 0 and found.status == "stationary")
    assert found.potential == pytest.approx(best.potential, rel=2e-8, abs=1e-9 * natural)
    assert found.lower_bound <= best.potential * (1 + 1e-12)
    both = (found.state < 2) & (best.state < 2) & found.proven & best.proven
    assert (found.state[both] == best.state[both]).all()


def test_at_rest_it_says_so_and_tells_when():
    """A disc between two driven ones, of unequal friction: it turns at a constant rate until it sticks."""
    packing = tb.Packing([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [0, -1, 1], [0.0, 0, -1.0], friction=[0.1, 0.3])
    found = tb.solve(packing, tb.RigidLimit(inertia=0.2), start="zero", tolerance=1e-13)
    assert found.status in ("certified", "stationary")
    assert found.spin[1] == pytest.approx(1.0, abs=1e-9)
    arrival = 0.2 * 1.0 / (0.5 * 50.0 * 0.2)  # I omega = t R F_n (0.3 - 0.1)
    assert found.findings["rest_time"] == pytest.approx(arrival, rel=0.02)


def test_the_command_line_follows_it_and_goes_on(tmp_path):
    np.savez(tmp_path / "fcc.npz", **tb.Packing.lattice("fcc", (2, 2, 2), seed=3, spin_bottom=0.3).arrays())
    words = ("run", "--packing", "fcc.npz", "--method", "rigid-limit", "--initial", "random", "--figures", "none")
    for name, steps in (("whole", "14"), ("part", "6")):
        more = ("--checkpoint-every", "100", "--iterations", steps, "--tolerance", "1e-12", "--out", name)
        assert bearings(*words, *more, cwd=tmp_path).returncode == 1  # not yet there
    assert bearings("run", "--resume", "part", "--iterations", "14", cwd=tmp_path).returncode == 1
    whole, part = tb.load(tmp_path / "whole"), tb.load(tmp_path / "part")
    assert whole.method == "rigid-limit"
    assert np.array_equal(whole.spin, part.spin)
    assert np.array_equal(whole.history["power"], part.history["power"])
