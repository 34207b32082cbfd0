"""Dynamics and descent of packings: lattices step by step, exact courses, proven minima, and what is conserved."""

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.analysis.topology import topology_of
from taichi_bearings.errors import InputError
from taichi_bearings.fields.lists import Lists
from taichi_bearings.numerics.graphs import odd_pieces
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import drive
from taichi_bearings.solvers.recording import Recording
from taichi_bearings.solvers.stopping import StopRule
from tests.packing.twins import pair, random_packing
from tests.scenes import KNOWN_LAWS, some_of

EXPLICIT, VISCOUS = (tb.CundallStrack(energy=True, time_step=step) for step in (2e-5, 0.02))


CASES = [("coulomb", (5, 6)), ("coulomb", (4, 3, 5)), ("viscous", (5, 6)), ("coulomb-viscous", (4, 3, 5))]
STEPS = [
    *((EXPLICIT, "random", *case) for case in CASES), *((tb.GradientDescent(), "zero", *case) for case in CASES[1:]),
    (tb.GradientDescent(momentum=False), "zero", *CASES[0]),
]  # fmt: skip


@pytest.mark.parametrize(("options", "start", "law", "shape"), STEPS, ids=lambda part: getattr(part, "name", None))
def test_a_lattice_given_as_packing_follows_its_scene(options, start, shape, law, precision):
    """Step by step to rounding, with the energy books; in descent as long as the box of scenes holds no spin."""
    scene, packing = pair(shape, 3, law, spin_bottom=-1.0)
    options = VISCOUS if options is EXPLICIT and law == "viscous" else options
    rounding = 1e-13 if precision == "f64" else 1e-4
    for steps in (2, 60):
        stop = StopRule(iterations=steps, tolerance=1e-12)
        twin = drive.solve(scene, options.build(), initial_spin(scene, start), stop)
        found = tb.solve(packing, options, start=start, iterations=steps, tolerance=1e-12)
        assert found.history["iteration"][-1] == twin.iterations >= steps
        assert found.spin == pytest.approx(twin.spin[0].reshape(found.spin.shape), abs=steps * rounding)
        names = {"power"} | {name for name in twin.history if name.endswith("_energy")}
        for name in names:
            scale = np.abs(twin.history["power" if name == "power" else "kinetic_energy"]).max()
            assert found.history[name] == pytest.approx(twin.history[name][:, 0], abs=steps * rounding * scale), name
        if options.is_dynamics:  # of the motion, force * length
            largest = twin.force.max() * scene.lattice.radius
            left = pytest.approx(twin.largest_balance_residual[0], abs=steps * rounding * largest)
            assert found.largest_balance_residual == left
        if options.is_dynamics and law == "coulomb" and precision == "f64":
            assert (found.state == twin.state[0]).all()  # of its own motion
            assert (found.state == 1).any()
    assert (found.time or 0) == pytest.approx(60 * getattr(options, "time_step", 0))


def test_a_free_disc_is_driven_by_another_one_as_the_exact_solution_says(needs_f64):
    """I w' = -R2 eta (R1 w1 + R2 w2), unequal radii; and two spheres about an axis across their contact."""
    driver, free, eta, density, duration = 0.3, 0.7, 0.4, 5.0, 0.6
    for shape, place in ((0.5 * np.pi * free**4, [[0, 0], [1, 0]]), (8 / 15 * np.pi * free**5, [[0, 0, 0], [1, 0, 0]])):
        spin = np.zeros((2, 3) if len(place[0]) == 3 else 2)
        spin[0] = 2.0 if spin.ndim == 1 else [0.5, 0, 2.0]
        packing = tb.Packing(place, [[0, 1]], [0, -1], spin, [driver, free], friction=[eta], law="viscous")
        options = tb.CundallStrack(time_step=1e-3)
        found = tb.solve(packing, options, start="zero", density=density, duration=duration)
        expected = -driver * 2.0 / free * (1 - np.exp(-eta * free**2 / (density * shape) * found.time))
        assert found.spin.reshape(2, -1)[1, -1] == pytest.approx(expected, rel=1e-6)
        assert found.spin.reshape(2, -1)[1, :-1] == pytest.approx(0)  # about the contact nothing turns


@pytest.mark.parametrize("seed", some_of(12, 5))
@pytest.mark.parametrize("method", ["cundall-strack", "gradient-descent"])
def test_random_networks_end_at_the_proven_minimum(method, seed, needs_f64):
    """Odd loops, several bodies, floating parts and rattlers, radii over two decades; all laws, in 2D and 3D."""
    law, dimension = KNOWN_LAWS[seed % len(KNOWN_LAWS)], 2 + seed // len(KNOWN_LAWS) % 2
    packing = random_packing(np.random.default_rng([44, seed]), dimension, law, contrast=1)
    least = tb.solve(packing)
    options = tb.CundallStrack(stiffness=1e3, damping=30.0) if method == "cundall-strack" else method
    weights = {} if method == "gradient-descent" else {"density": 1 / packing.radius**dimension}
    found = tb.solve(packing, options, start="random", iterations=200_000, tolerance=1e-6, **weights)
    natural = sum(values.sum() for values in packing.material) * (np.abs(packing.driven_speed).max() or 1.0)
    assert found.status == "certified"
    assert found.gap <= 1e-6
    assert found.potential == pytest.approx(least.potential, rel=2e-6, abs=1e-9 * natural)
    assert found.lower_bound <= least.potential * (1 + 1e-12)
    assert found.potential >= least.lower_bound * (1 - 1e-12)
    both = (found.state < 2) & (least.state < 2)
    assert (found.state[both] == least.state[both]).all()


@pytest.mark.parametrize("law", KNOWN_LAWS)
def test_the_energy_books_close_with_the_order_of_the_step(law, needs_f64):
    """Second order, while nothing begins or ceases to slip; unequal radii and weights."""
    rng = np.random.default_rng(8)
    packing = random_packing(rng, 3, law, spheres=12, contrast=0.3)
    arrays = packing.arrays() | {"radius": rng.uniform(0.5, 1.5, 12), "normal_force": 1e6}
    packing = tb.Packing(**arrays, law=law)
    missed = []
    for steps in (100, 200, 400):
        options = tb.CundallStrack(energy=True, stiffness=50.0, damping=1.0, time_step=0.4 / steps)
        found = tb.solve(packing, options, start="random", duration=0.4, density=1.0)
        assert found.history["iteration"][-1] == steps
        missed.append(abs(found.history["energy_residual"][-1]))
    assert missed[0] < 0.05
    assert 3.5 < missed[0] / missed[1] < 6
    assert 3.5 < missed[1] / missed[2] < 6


def free_packings(number, law):
    """A bcc block without its dangling corners, and a random network of two colours, none driven, four motions each."""
    rng = np.random.default_rng([16, number])
    block = tb.Packing.lattice("bcc", (2, 2, rng.integers(2, 4)))
    keep = np.bincount(block.contact.ravel(), minlength=block.spheres) > 1
    touching = keep[block.contact].all(axis=1)
    yield block.center[keep], (np.cumsum(keep) - 1)[block.contact[touching]], 0.5
    while True:
        count = int(rng.integers(10, 14))
        center, side = rng.uniform(0, count ** (1 / 3), (count, 3)), rng.integers(0, 2, count)
        pairs = np.argwhere(np.triu(side[:, None] != side[None], 1))
        apart = np.linalg.norm(center[pairs[:, 0]] - center[pairs[:, 1]], axis=1)
        pairs = pairs[np.argsort(apart)[: 5 * count]]
        radius = rng.uniform(0.5, 1.2, count)
        loose = loose_packing(center, pairs, radius, law, 0)
        if topology_of(loose).all_motions == 4 and topology_of(loose).parts == 1:
            yield center, pairs, radius
            return


def loose_packing(center, contact, radius, law, seed):
    vector = center[contact[:, 1]] - center[contact[:, 0]]
    normal, count = vector / np.linalg.norm(vector, axis=1)[:, None], len(center)
    return tb.Packing(
        center, contact, np.full(count, -1), np.zeros((count, 3)), radius, normal, law=law, seed=seed, schematic=True
    )  # fmt: skip


@pytest.mark.parametrize("number", range(3))
def test_a_free_bearing_ends_where_its_invariants_say(number, needs_f64):
    """No friction takes from sum s_i m_i U . u_i for a slipless U = a + b x: the final spins are the projection of the
    first ones on the slipless motions, in the metric of the moments of inertia (Staeger, Araujo, Herrmann 2016)."""
    law, rng = KNOWN_LAWS[number], np.random.default_rng(number)
    for center, contact, radius in free_packings(number, law):
        packing = loose_packing(center, contact, radius, law, number)
        assert topology_of(packing).all_motions == 4
        count, density = packing.spheres, 10 ** rng.uniform(-0.5, 0.5, packing.spheres)
        start, radii = rng.standard_normal((count, 3)), packing.radius[:, None]
        sign = odd_pieces(count, *contact.T)[1][:, None]
        motions = np.stack([*(sign * axis * np.ones((count, 1)) for axis in np.eye(3)), sign * center], axis=2)
        weight = 0.4 * density * 4 / 3 * np.pi * packing.radius**3  # I / R^2
        products = np.einsum("ikm,i,ikn->mn", motions, weight, motions)
        shares = np.linalg.solve(products, np.einsum("ikm,i,ik->m", motions, weight, radii * start))
        duration = 1000.0 if law == "viscous" else 0.6
        found = tb.solve(packing, "cundall-strack", start=start, density=density, duration=duration)
        assert found.slip.max() < 1e-9
        assert found.spin == pytest.approx(motions @ shares / radii, abs=1e-10)
        assert found.status == "certified"


def test_what_floats_keeps_its_momentum_and_what_touches_nothing_its_spin(needs_f64):
    packing = tb.Packing(
        [[0, 0], [1, 0], [5, 0], [6, 0], [9, 0]], [[0, 1], [2, 3]], [0, -1, -1, -1, -1], [1.0, 0, 0, 0, 0],
        friction=[0.5, 0.3],
    )  # fmt: skip
    found = tb.solve(packing, "cundall-strack", start=np.array([0, 0, 3.0, 1.0, 7.0]), duration=1.0)
    assert found.spin == pytest.approx([1.0, -1.0, 1.0, -1.0, 7.0], abs=1e-9)
    assert found.slip.max() < 1e-9


def test_the_bound_on_the_stiffest_mode_is_one(needs_f64):
    for seed in range(8):
        packing = random_packing(np.random.default_rng([7, seed]), 2 + seed % 2)
        network, rng = packing.as_stepped(np.zeros(1), np.zeros(1, dtype=bool)).network, np.random.default_rng(seed)
        weight, inertia = rng.uniform(0.1, 2, network.contacts), 10 ** rng.uniform(-2, 1, packing.spheres)
        free = np.repeat(network.free, network.components)
        slips = network.slip_matrix.toarray()[:, free] / np.sqrt(np.repeat(inertia, network.components)[free])
        rows = np.tile(weight, len(network.tangents))[:, None]
        largest = np.linalg.eigvalsh(slips.T @ (rows * slips)).max(initial=0.0)
        circles = np.abs(slips.T @ (rows * slips)).sum(axis=1).max(initial=0.0)
        bound = network.largest_eigenvalue(weight, inertia)
        assert largest * (1 - 1e-12) <= bound <= circles * (1 + 1e-8)


def test_a_step_beyond_the_bound_is_refused_and_one_just_within_is_stable():
    packing = tb.Packing.lattice("fcc", (2, 2, 3), seed=2, normal_force=1e9)
    with pytest.raises(InputError, match="stable only for time steps up to") as refused:
        tb.solve(packing, tb.CundallStrack(time_step=1.0), iterations=1)
    step = 0.999 * float(str(refused.value).rpartition(" ")[2])
    found = tb.solve(packing, tb.CundallStrack(time_step=step), start="random", iterations=3000, tolerance=1e-15)
    assert found.history["power"][-1] < found.history["power"][0]


def test_neighbours_stand_near_each_other_whatever_the_order_was():
    packing = tb.Packing.lattice("cubic", (8, 8, 8))
    mixed = np.random.default_rng(1).permutation(packing.spheres)[packing.contact]
    lists = Lists.of(packing.spheres, mixed)
    first, second = lists.ends.reshape(2, -1)[:, : packing.contacts]
    assert np.abs(second - first).max() <= 2 * 8 * 8
    assert (np.diff(first) >= 0).all()
    assert sorted(lists.sphere) == list(range(packing.spheres))
    of_sphere = lists.incident[lists.start[5] : lists.start[6]]
    assert set(of_sphere) == {e for e in range(packing.contacts) if 5 in (first[e], second[e])}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"method": "operator-splitting"}, "method is 'operator-splitting'; of a packing it can be auto, planar-cut"),
        ({"method": "cundall-strack", "start": "nearby"}, "start is 'nearby'"),
        ({"method": "cundall-strack", "start": np.zeros(4)}, r"spin in start has shape \(4,\); it must be \(27, 3\)"),
        ({"method": "cundall-strack", "density": -1.0}, "density"),
        (
            {"method": "gradient-descent", "density": 1.0},
            "density is given, but method gradient-descent does not use it",
        ),
        ({"method": tb.CundallStrack(inertia=1.0), "density": 1.0}, "inertia is 1 and density is given"),
        ({"method": "cundall-strack", "torque": 1.0}, "torque is 1.0, but cundall-strack .* does not use it"),
        ({"method": "cundall-strack", "record": "often"}, "record is 'often'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        tb.solve(tb.Packing.lattice("cubic", (3, 3, 3)), **arguments)


def test_snapshots_of_a_lattice_given_as_packing_are_those_of_its_scene(needs_f64):
    options, times = tb.CundallStrack(time_step=2e-5), np.array([0.0, 4e-4, 1e-3])
    scene, packing = pair((4, 3, 5), 3, spin_bottom=-1.0)
    stop, recording = StopRule(iterations=60, tolerance=1e-12), Recording(snapshots=times)
    twin = drive.solve(scene, options.build(), initial_spin(scene, "random"), stop, recording=recording).snapshots
    asked = {"start": "random", "iterations": 60, "tolerance": 1e-12, "snapshots": times}
    found = tb.solve(packing, options, **asked).snapshots
    assert found.time == pytest.approx(times)
    assert (found.time == twin.time).all()
    assert found.spin == pytest.approx(twin.spin.reshape(found.spin.shape), abs=60 * 1e-13)


@pytest.mark.parametrize("method", ["cundall-strack", "gradient-descent"])
def test_torques_in_the_history_are_those_of_the_lattice(method, needs_f64):
    """They are force * length, also where spheres have another radius than 1."""
    scene, packing = pair((4, 5), 3, radius=0.25)
    asked = {"start": "zero", "iterations": 60, "tolerance": 1e-12, "threads": 1}
    found, twin = (tb.solve(of, method, **asked).history["largest_balance_residual"] for of in (packing, scene))
    assert len(twin) > 1
    assert found[: len(twin)] == pytest.approx(np.ravel(twin)[: len(found)], rel=1e-6)


def test_times_asked_for_are_rows_of_the_history():
    packing = tb.Packing.lattice("cubic", (3, 3, 4), seed=1)
    found = tb.solve(packing, "cundall-strack", start="random", duration=0.01, record="linear:0.002,0.01,5")
    assert found.history["time"] == pytest.approx([0.002, 0.004, 0.006, 0.008, 0.01], abs=5e-5)
    assert found.status == "finished"
    assert found.time == found.history["time"][-1]


@pytest.mark.parametrize("method", ["cundall-strack", "gradient-descent", "rigid-limit"])
@pytest.mark.parametrize(
    ("driven", "contact"), [([0, 1], [[0, 1]]), ([-1, -1], [[0, 1]]), ([0, -1], np.zeros((0, 2), int))]
)
def test_nothing_free_nothing_driven_and_no_contact(driven, contact, method):
    packing = tb.Packing([[0, 0], [1, 0]], contact, driven, [1.0, 0.5], friction=[0.5] * len(contact))
    found = tb.solve(packing, method, iterations=50)
    assert (found.power, found.lower_bound, found.status) == (0, 0, "certified")
    assert found.spin.tolist() == np.where(np.array(driven) >= 0, [1.0, 0.5], 0.0).tolist()
