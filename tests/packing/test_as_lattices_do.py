"""What lattices have, of packings: a lattice given as packing has the answers of its scene, and laws of any network."""

from functools import partial
from itertools import combinations

import h5py
import networkx
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings import runtime
from taichi_bearings.analysis.bottlenecks import Bottlenecks
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.checksums import ATTRIBUTE
from taichi_bearings.errors import DeviceError, FileError, InputError
from taichi_bearings.quantities import STRUCTURE
from taichi_bearings.runs.figures import draw_figure
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.histogram import pooled, read_source
from taichi_bearings.scene import Solution
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers import packing_paths
from tests.cli.commands import bearings
from tests.packing.twins import pair

pytestmark = pytest.mark.usefixtures("needs_f64")


solve = partial(tb.solve, threads=1)


DRIVINGS = [{"spin_bottom": 0.2}, {"direction": (1.0, 0.0, 0.0)}, {"top": (1.0, 0.3, 0.0, 0.5)}]


FREE_CHOICE = {"most_loaded", "mean_saturation"}  # the first of equals, and forces that are not unique


@pytest.mark.parametrize(("shape", "driving"), [((5, 5, 6), driving) for driving in DRIVINGS] + [((7, 8), {})])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
def test_domains_torque_and_self_stress_are_those_of_the_lattice(shape, driving, seed):
    scene, packing = pair(shape, seed, **driving)
    expected, found = tb.analyse(solve(scene)).report, tb.analyse(solve(packing)).numbers
    for section in ("rigid domains", "bottlenecks", "forces"):
        for row in STRUCTURE[section]:
            one, other = expected[row.name], found[row.name]
            if row.name == "driving_torque":  # of a lattice without the components that are not needed
                assert other == pytest.approx(one + [0.0] * (len(other) - len(one)), abs=1e-9 * max(one))
            elif row.name not in FREE_CHOICE:
                assert other == pytest.approx(one, abs=1e-12), row.name


@pytest.mark.parametrize(("law", "seed", "slips"), [
    ("coulomb", 31, 3641), pytest.param("coulomb-viscous", 1, 4113, marks=pytest.mark.thorough),
])  # fmt: skip
def test_slips_far_below_the_rounding_of_the_spins_are_proven(law, seed, slips, tmp_path):
    """Of 16^3 the smallest are 2e-17 and 7e-15 of the fastest; in the file, too, with what rounding leaves out."""
    scene, packing = pair((16, 16, 16), seed, law=law)
    expected, found = solve(scene), solve(packing)
    assert (found.state == 1).sum() == slips
    assert (found.proven == np.concatenate([np.ravel(part) for part in expected.proven])).all()
    assert found.states_proven
    found.save(tmp_path / "run")
    report = verify(tmp_path / "run")
    assert report["states_proven"]["slipping"] == slips
    assert report["states_proven"]["unproven"] == 0
    with h5py.File(tmp_path / "run" / "run.h5", "r+") as file:
        file["spin_rounding"][0] = np.nan
        del file.attrs[ATTRIBUTE]
    with pytest.raises(FileError, match=r"spin_rounding in .* is damaged"):
        tb.load(tmp_path / "run")
    with h5py.File(tmp_path / "run" / "run.h5", "r+") as file:
        del file["spin_rounding"]
    lost = verify(tmp_path / "run")["states_proven"]["unproven"] > 0
    assert lost == (law == "coulomb")


def test_domains_turn_between_their_bodies_where_these_agree_in_a_component():
    """Bodies of a bcc network turn alike about z, but for rounding, and all between them turns less than they do."""
    packing = tb.Packing.lattice("bcc", (4, 4, 4), seed=0, spin_bottom=0.1)
    domains = tb.analyse(solve(packing)).rigid_domains
    turn = domains.turn[:, domains.jump.any(axis=0)]
    assert turn.shape[1] == 2
    assert turn.min() >= -1e-9
    assert turn.max() <= 1 + 1e-9
    assert (turn[domains.domain[packing.driven == 1]] == 1).all()


def in_three_bodies(packing):
    """The top in two parts that turn alike."""
    x = packing.center[:, 0]
    return tb.Packing(**packing.arrays() | {"driven": packing.driven + ((packing.driven == 1) & (x > x.mean()))})


def test_what_drives_the_bodies_is_the_power_and_torques_of_a_network_without_odd_loops_add_up_to_nothing():
    """Spins of free spheres store none of it, oblique normals or not; with odd loops the signs are missing."""
    bcc, fcc = (tb.Packing.lattice(kind, (3, 3, 3), seed=4, spin_bottom=0.3) for kind in ("bcc", "fcc"))
    for packing in (bcc, in_three_bodies(bcc), fcc):
        best = solve(packing)
        flow = tb.analyse(best).torque_flow
        assert flow.power.sum() == pytest.approx(best.lower_bound, rel=1e-12)
        if len(flow.power) == 3:
            assert np.abs(flow.total.sum(axis=0)).max() < 1e-12 * np.abs(flow.total).max()
            assert np.abs(flow.total[0]).max() > 1
    unlike = tb.Packing(  # a chain: force, not torque, is handed on, so the larger driven disc needs the larger torque
        [[0, 0], [3, 0], [5, 0]], [[0, 1], [1, 2]], [0, -1, 1], [0.0, 0.0, 1.0], [2.0, 1.0, 1.0], friction=[1.0, 0.3]
    )
    assert tb.analyse(solve(unlike)).torque_flow.total == pytest.approx(0.3 * 50.0)


def test_self_stress_is_what_a_loop_holds_and_a_tree_does_not():
    """An even ring of discs on a wall that turns with it has one loop; without a contact none."""
    ring = [[0, 0], [1, 0], [1, 1], [0, 1]]
    contacts = [[0, 1], [1, 2], [2, 3], [3, 0]]
    for left_out, states in ((0, 1), (1, 0)):
        chosen = contacts[left_out:]
        packing = tb.Packing(ring, chosen, [0, -1, -1, -1], [1.0, 0, 0, 0], friction=np.ones(len(chosen)))
        assert tb.analyse(solve(packing)).self_stress == states


@pytest.mark.parametrize("seed", range(3))
def test_bottlenecks_between_three_bodies_are_those_of_networkx(seed):
    packing = in_three_bodies(tb.Packing.lattice("bcc", (2, 2, 3), seed=1))
    free = (packing.driven[packing.contact] < 0).any(axis=1)
    slipless = free & (np.random.default_rng(seed).random(packing.contacts) < 0.45)
    network = SliplessNetwork(packing.network, slipless)
    found, graph = Bottlenecks(network), networkx.Graph(list(network.ends.T))
    expected, pairs = dict.fromkeys(map(frozenset, graph.edges), 0.0), 0
    for sides in combinations([set(np.flatnonzero(packing.driven == body)) & set(graph) for body in range(3)], 2):
        pairs += sum(networkx.has_path(graph, s, t) for s in sides[0] for t in sides[1])
        for edge, load in networkx.edge_betweenness_centrality_subset(graph, *sides).items():
            expected[frozenset(edge)] += 2 * load
    loads = [expected[frozenset(edge)] / max(pairs, 1) for edge in network.ends.T]
    assert pairs == found.betweenness.pairs > 0
    assert found.share == pytest.approx(loads)
    joined, on_path = networkx.Graph(), set()
    for edge, ends in enumerate(network.body[network.ends].T):
        joined.add_edge(*ends)
        joined.edges[tuple(ends)].setdefault("own", []).append(edge)
    for start, end in combinations([body for body in network.driven_nodes if body in joined], 2):
        for path in networkx.all_simple_edge_paths(joined, start, end):
            on_path.update(number for step in path for number in joined.edges[step]["own"])
    assert set(np.flatnonzero(found.backbone)) == on_path


@pytest.mark.parametrize(("law", "more"), [("coulomb", {}), ("coulomb", {"spin_bottom": 0.3}), ("viscous", {}),
                                           ("coulomb-viscous", {})])  # fmt: skip
def test_a_torque_does_to_a_packing_what_it_does_to_the_lattice(law, more, tmp_path):
    scene, packing = pair((3, 3, 4), 3, law, **more)
    torque = 1.2 * solve(scene).power
    expected, found = solve(scene, torque=torque).findings, solve(packing, torque=torque)
    of_torque = {name: found.findings[name] for name in expected if name in found.findings}
    assert of_torque == pytest.approx({name: expected[name] for name in of_torque}, rel=1e-6, nan_ok=True)
    assert found.findings["yields"]
    found.save(tmp_path / "run")
    again = tb.load(tmp_path / "run").findings
    assert {name: again[name] for name in of_torque} == pytest.approx(of_torque, nan_ok=True)


def test_driven_spheres_that_touch_hold_a_torque_too_and_a_false_word_is_found(tmp_path):
    """Two driven discs and a free one that both touch: only contacts with the wall that rests hold the last body."""
    packing = tb.Packing(
        [[0, 0], [1, 0], [0.5, 0.75**0.5]], [[0, 1], [1, 2], [0, 2]], [0, 1, -1], [0.0, 1.0, 0.0],
        friction=[0.4, 0.3, 0.2], normal_force=10.0, radius=0.5,
    )  # fmt: skip
    packing.save(tmp_path / "three.npz")
    limit = 0.5 * 10.0 * (0.4 + 0.2)
    assert solve(packing, torque=1.0).findings["yield_torque"] == pytest.approx(limit)
    for torque, yields in ((0.999 * limit, False), (1.001 * limit, True)):
        done = bearings(
            "run", "--packing", "three.npz", "--torque", repr(torque), "--out", f"run-{yields}", cwd=tmp_path
        )
        assert f"so that the top moves in its direction: {'yes' if yields else 'no'}" in done.stdout
    assert verify(tmp_path / "run-True")["verified"]
    with h5py.File(tmp_path / "run-True" / "run.h5", "r+") as file:
        file.attrs["yield_torque_lower_bound"] = 2 * limit
        del file.attrs["sha256"]
    assert any("yield torque lower bound" in sentence for sentence in verify(tmp_path / "run-True")["contradictions"])


def test_a_torque_just_above_what_is_proven_to_be_held_is_verified(tmp_path):
    """Contacts between driven discs are summed; a share of 1e-13 is given up for that."""
    packing = tb.Packing.lattice("triangular", (3, 3), seed=1)
    held = solve(packing, torque=1.0).findings["yield_torque_lower_bound"]
    found = solve(packing, torque=held * (1 + 2e-14))
    assert np.isnan(found.findings["amplitude"])
    assert verify(found.save(tmp_path / "run"))["contradictions"] == []


def test_the_cut_start_the_threshold_and_the_histogram_are_those_of_the_lattice(tmp_path):
    scene, packing = pair((4, 4, 5), 1, spin_bottom=0.1)
    start = initial_spin(packing, "minimum-cut")[0]
    assert start == pytest.approx(initial_spin(scene, "minimum-cut")[0].reshape(-1, 3))
    threshold = 0.1 * np.sqrt(0.5)
    expected, found = (solve(system, slip_threshold=threshold) for system in (scene, packing))
    assert np.array_equal(np.concatenate([part.ravel() for part in expected.state]), found.state)
    counts = [next(iter(pooled([read_source(of.save(tmp_path / name))]).values())) for of, name in
              ((expected, "lattice"), (found, "packing"))]  # fmt: skip
    assert counts[0].slipping == counts[1].slipping > 0
    assert np.array_equal(counts[0].count, counts[1].count)
    assert verify(tmp_path / "packing")["verified"]
    both = pooled([read_source(tmp_path / name) for name in ("lattice", "packing")])[None]
    assert (both.samples, both.slipping) == (2, 2 * counts[0].slipping)


def test_a_callback_hears_and_stops_and_many_are_solved(thorough):
    packings, heard = [tb.Packing.lattice("bcc", (2, 2, 3), seed=seed) for seed in range(3)], []

    def enough(check):
        heard.append(check)
        return check.gap < 0.5

    stopped = solve(packings[0], "gradient-descent", callback=enough)
    assert stopped.status == "interrupted"
    assert heard[-1].gap < 0.5 <= min(check.gap for check in heard[:-1])
    for method in ("auto", "cundall-strack") if thorough else ("cundall-strack",):  # each starts a process
        options = {} if method == "auto" else {"iterations": 50, "start": "random"}
        for answer in tb.solve_many(packings, method, workers=1, **options):
            number = next(n for n, packing in enumerate(packings) if packing is answer.packing)
            assert np.array_equal(answer.spin, solve(packings[number], method, **options).spin)


@pytest.mark.parametrize("kind", ["fcc", "cubic"])
def test_a_minimum_is_heard_of_on_the_way_and_ends_where_it_is_told_to(kind, monkeypatch):
    """Looked at after every step, as large packings are; what a run that was cut short says is true of the minimum."""
    monkeypatch.setattr(packing_paths, "is_small", lambda system: False)
    packing, heard = tb.Packing.lattice(kind, (3, 3, 3), seed=2), []
    least = solve(packing, "interior-point", callback=lambda check: heard.append(check))
    assert (least.status, len(heard)) == ("certified", least.iterations + 1)
    assert heard[-1].gap <= 1e-8 < min(check.gap for check in heard[:-1])
    assert least.history["power"][-1] == least.power
    ends = {
        "step-limit": solve(packing, "interior-point", iterations=4),
        "time-limit": solve(packing, "interior-point", time_limit=1e-9),
        "interrupted": solve(packing, "interior-point", callback=lambda check: check.iteration >= 3),
    }
    assert [ends["step-limit"].iterations, ends["interrupted"].iterations] == [4, 3]
    for status, found in ends.items():
        assert found.status == status
        assert found.lower_bound <= least.power <= found.power
        assert found.gap > 1e-8
        assert (found.state[found.proven] == least.state[found.proven]).all()


def test_an_exact_method_of_packings_is_over_at_its_second_look():
    for packing, method in (
        (tb.Packing.lattice("triangular", (4, 4), seed=1), "planar-cut"),
        (tb.Packing.lattice("bcc", (2, 2, 3), seed=1, law="viscous"), "linear-solver"),
    ):
        heard = []
        found = solve(packing, callback=lambda check, heard=heard: heard.append((check.iteration, check.gap)))
        assert (found.method, found.status, found.iterations) == (method, "certified", 1)
        assert heard == [(0, 1.0), (1, found.gap)]


@pytest.mark.parametrize(("call", "sentence"), [
    (lambda p: solve(p, start="random"), "start is given, but method auto of a packing does not use it"),
    (lambda p: solve(p, "planar-cut"), "of this packing it must be interior-point"),
    (lambda p: solve(p, "operator-splitting"), "of a packing it can be auto, planar-cut"),
    (lambda p: solve(p, "cundall-strack", torque=1.0, duration=1.0), "with the law coulomb does not use it"),
    (lambda p: solve(p, torque="0:1:0.1"), "torque is '0:1:0.1'; it must be 0 or a number"),
    (lambda p: solve(p, "gradient-descent", start="minimum-cut"), "without odd loops"),
])  # fmt: skip
def test_what_cannot_be_is_one_sentence(call, sentence):
    with pytest.raises(InputError) as refused:
        call(tb.Packing.lattice("fcc", (2, 2, 2)))
    assert sentence in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_history_shows_every_replica():
    packings = [tb.Packing.lattice("bcc", (2, 2, 3), seed=seed) for seed in range(2)]
    found = [solve(p, "gradient-descent", iterations=100 * (n + 1)) for n, p in enumerate(packings)]
    together = Solution.joined([one.solution for one in found], Packing.together(packings))
    lines = draw_figure("history", together).axes[0].lines
    assert [line.get_xdata()[-1] for line in lines] == [100, 100, 200, 200]


def test_a_minimum_is_found_on_the_threads_that_are_given_and_on_no_gpu():
    packing = tb.Packing.lattice("cubic", (3, 3, 3))
    with pytest.raises(DeviceError, match="can only be found on the CPU; use --arch cpu"):
        tb.solve(packing, arch="vulkan")
    if runtime.available_threads() > 1:
        with pytest.raises(DeviceError, match="Taichi already runs in this process with cpu, f64, threads 1"):
            tb.solve(packing, threads=2)
