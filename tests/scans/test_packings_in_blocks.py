"""Seeds of one packing are solved side by side in a scan, and their rows are those of each sample alone, bit by bit."""

from itertools import chain

import numpy as np
import pytest

from taichi_bearings.conic import shared
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.runs import packing_run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.scans.engine import LocalEngine
from taichi_bearings.scans.estimate import units_of
from taichi_bearings.scans.sample import solve_samples, state_path
from taichi_bearings.scans.scan import scan
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers import on_system
from tests.scans.scan_faults import Here, die_of_several
from tests.scans.test_scan import CLOCKS, assert_same_but_for_the_clock
from tests.scans.test_scan_of_packings import save

SEEDS = 'packing = "network.npz"\n[scan]\nseed = [0, 1, 2, 5, 9]\n'


def network(tmp_path, kind="bcc", cells=(2, 3, 3), **others):
    save(tmp_path / "network.npz", Packing.lattice(kind, cells, **others), "friction", "viscosity", "normal_force")


def without_clocks(record):
    return record | {"scalars": {name: v for name, v in record["scalars"].items() if name not in CLOCKS}}


def one_by_one(samples, *others):
    """Records of samples, each of a call of its own that knows nothing of the network."""
    found = []
    for sample in samples:
        shared.last.forget()
        found += solve_samples([sample], *others)
    return [without_clocks(record) for record in found]


@pytest.fixture
def solved(monkeypatch):
    """Numbers of the samples that were solved at a time."""
    sizes, solve = [], packing_run.least_power

    def counting(packing, *others, **more):
        sizes.append(packing.replicas)
        return solve(packing, *others, **more)

    monkeypatch.setattr(packing_run, "least_power", counting)
    return sizes


KINDS = {
    "bcc": lambda: ("bcc", (2, 3, 3), ""),
    "cubic": lambda: ("cubic", (4, 4, 4), "slip_threshold = 1e-3\n"),
    "triangular": lambda: ("triangular", (5, 5), ""),
    "both": lambda: ("fcc", (2, 2, 2), 'law = "coulomb-viscous"\nviscosity = "uniform:0.5,1.0"\n'),
    "viscous": lambda: ("bcc", (2, 2, 3), 'law = "viscous"\n'),
}


@pytest.mark.parametrize("kind", KINDS)
def test_records_of_a_block_are_those_of_each_sample_alone(kind, plan_of, tmp_path, solved):
    kind, cells, text = KINDS[kind]()
    network(tmp_path, kind, cells)
    samples = plan_of(text + SEEDS).samples
    beside = solve_samples(samples, True, tmp_path / "beside")
    assert solved == [5]
    assert [without_clocks(record) for record in beside] == one_by_one(samples, True, tmp_path / "alone")
    for sample in samples:
        one, other = (read_run(state_path(tmp_path / name, sample.key)) for name in ("beside", "alone"))
        assert one.asked.seed == other.asked.seed == sample.settings.seed
        assert np.array_equal(one.solution.spin, other.solution.spin)
        assert np.array_equal(one.scene.friction, other.scene.friction)


def test_tables_of_spheres_and_lattices_with_other_bodies_go_in_blocks_too(plan_of, tmp_path, solved):
    (tmp_path / "discs.csv").write_text(
        "x,y,radius\n" + "".join(f"{i + j / 2},{j * 0.75**0.5:.12f},0.5\n" for j in range(4) for i in range(4))
    )
    for text in ('packing = "discs.csv"\n', 'shape = [5, 5, 3]\ndriven = "shaft:1"\n'):
        samples = plan_of(text + "[scan]\nseed = [3, 4, 8]\n").samples
        beside = [without_clocks(record) for record in solve_samples(samples)]
        assert solved.pop() == 3
        assert beside == one_by_one(samples)
        assert all(record["scalars"]["status"] == "certified" for record in beside)
        solved.clear()


def test_units_are_blocks_shared_by_the_workers(plan_of, tmp_path):
    network(tmp_path)
    text = 'packing = "network.npz"\n{}[scan]\nseed = {{ start = 0, stop = 40 }}\n'

    def sizes(more, workers):
        return [len(unit) for unit in units_of(plan_of(text.format(more)).samples, False, workers)]

    assert sizes("", 1) == [14, 14, 12]
    assert sizes("", 4) == [10] * 4
    assert sizes('method = "cundall-strack"\nduration = 0.1\n', 1) == [1] * 40
    network(tmp_path, "cubic", (17, 17, 18))
    assert sizes("", 1) == [1] * 40


def test_a_sample_that_fails_fails_alone(plan_of, tmp_path, monkeypatch):
    network(tmp_path)
    samples, answered = plan_of(SEEDS).samples, on_system.answered
    expected = one_by_one(samples)

    def failing(reached, *others):
        if any(packing.seed == 5 for packing in reached.samples):
            raise ArithmeticError("no luck")
        return answered(reached, *others)

    monkeypatch.setattr(on_system, "answered", failing)
    found = [without_clocks(record) for record in solve_samples(samples)]
    assert found[:3] + found[4:] == expected[:3] + expected[4:]
    assert found[3]["scalars"] == {"status": "failed", "error": "ArithmeticError: no luck"}


def test_a_file_of_as_many_samples_as_a_block_is_refused_as_alone(plan_of, tmp_path):
    packing = Packing.lattice("bcc", (2, 2, 2), law="coulomb-viscous")
    arrays = {name: values for name, values in packing.arrays().items() if name not in ("friction", "viscosity")}
    np.savez(tmp_path / "network.npz", **arrays, viscosity=np.ones((5, packing.contacts)))
    found = solve_samples(plan_of('law = "coulomb-viscous"\n' + SEEDS).samples)
    assert {record["scalars"]["error"] for record in found} == {
        f"replicas is 1, but {tmp_path / 'network.npz'} holds 5 samples; leave replicas out or give that number"
    }


def test_a_file_that_is_gone_is_said_of_each_sample(plan_of, tmp_path):
    network(tmp_path)
    samples = plan_of(SEEDS).samples
    (tmp_path / "network.npz").unlink()
    found = solve_samples(samples)
    assert ["does not exist" in record["scalars"]["error"] for record in found] == [True] * 5


def test_a_killed_block_loses_nothing_that_was_written_down(plan_of, tmp_path):
    network(tmp_path)
    folder, plan = tmp_path / "scan", plan_of(SEEDS)
    scan(plan_of(SEEDS.replace("5, 9", "5")), folder, engine=Here())
    before = (folder / "samples.jsonl").read_bytes()
    more = plan_of(SEEDS.replace("9", "9, 10, 12"))
    report = scan(more, folder, engine=LocalEngine(die_of_several, 1))
    assert (report["solved_now"], report["failed"], report["missing"]) == (3, 0, 0)
    assert (folder / "samples.jsonl").read_bytes().startswith(before)
    scan(more, tmp_path / "whole", engine=Here())
    assert_same_but_for_the_clock(folder, tmp_path / "whole")
    assert read_scan(folder).table["seed"].tolist() == list(chain([0, 1, 2, 5], [9, 10, 12]))
    assert {sample.key for sample in plan.samples} < {sample.key for sample in more.samples}
