"""Scans keep every sample whatever fails: workers, samples, the scan itself; and a sample is what `run` makes of it."""

import multiprocessing
import os
import random
import signal
import threading
from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest

from taichi_bearings.errors import BearingsError, FileError, InputError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.runs.lattice_run import solve_job
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run import prepare
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans import engine as scan_engine
from taichi_bearings.scans.engine import LocalEngine, run_samples
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.sample import solve_samples, state_path
from taichi_bearings.scans.scan import estimate, refuse_unused, scan
from tests.scans import scan_faults
from tests.scans.scan_faults import Here, asking
from tests.stored_scans import bin_of

CLOCKS = {"seconds", "seconds_compile"}


def stripped(text):
    """A scan without what it keeps beside its table."""
    return [line for line in text.splitlines() if not line.startswith("keep_states")]


def assert_same_but_for_the_clock(a, b):
    first, second = read_scan(a), read_scan(b)
    assert list(first.table) == list(second.table)
    for name in first.table.keys() - CLOCKS:
        x, y = first.table[name], second.table[name]
        assert x.dtype == y.dtype
        assert np.array_equal(x, y, equal_nan=x.dtype == np.float64), name
    for name in ("edges", "count", "contacts"):
        assert np.array_equal(getattr(first.histograms, name), getattr(second.histograms, name)), name
    assert stripped(first.attributes["scan"]) == stripped(second.attributes["scan"])
    assert len(set(first.table["sample"])) == first.samples


MIXED = """
tolerance = 1e-6
[scan]
law = ["coulomb", "viscous"]
seed = { start = 4, stop = 9, step = 2 }
[[scan.zip]]
shape = [[5, 6], [3, 4, 4]]
spin_bottom = [0.0, 0.1]
"""


def test_a_sample_is_what_run_makes_of_it_to_the_last_bit(plan_of, tmp_path, needs_f64):
    plan = plan_of(MIXED)
    report = scan(plan, tmp_path / "scan", workers=2)
    assert report["reached"] == report["samples"] == report["done"] == 12
    stored = read_scan(tmp_path / "scan")
    names = "law seed shape spin_bottom power lower_bound gap status method slipping slipless seconds"
    assert " ".join(stored.table).startswith(names)
    for row, sample in enumerate(plan.samples):
        solution = solve_job(prepare(replace(sample.settings, threads=1)))
        summary = Result(sample.settings, solution).numbers
        for name, values in stored.table.items():
            if name in summary and name not in CLOCKS:
                found = summary[name]
                found = "x".join(map(str, found)) if name == "shape" else np.nan if found is None else found
                assert np.array_equal(values[row], found, equal_nan=isinstance(found, float)), (name, sample.label)
        power, state = solution.power_per_contact, solution.state
        edges = stored.histograms.edges
        first = round(20 * np.log10(edges[0]))
        expected = np.bincount(bin_of(power[(state == 1) & (power > 0)]) - first, minlength=len(edges) - 1)
        assert np.array_equal(stored.histograms.count[row], expected)
        assert stored.histograms.contacts[row].tolist() == [(state == code).sum() for code in (0, 1, 2, 4)]


@pytest.mark.parametrize("shape", [(6, 7), (5, 4, 5)])
def test_seeds_solved_together_are_the_same_to_the_last_bit(shape):
    about_x = {"direction": (1, 0, 0)} if len(shape) == 3 else {}
    settings = RunSettings(shape=shape, seed=3, **about_x)
    together = solve_job(prepare(replace(settings, replicas=5)))
    for number in range(5):
        alone = solve_job(prepare(replace(settings, seed=3 + number)))
        part = together.sample(number)
        assert part.scene.seeds == alone.scene.seeds
        assert (part.slip_threshold, part.status) == (alone.slip_threshold, alone.status)
        for name in ("spin", "power", "lower_bound", "gap", "largest_balance_residual", "states_proven"):
            assert np.array_equal(getattr(part, name), getattr(alone, name)), name
        for name in ("slip", "power_per_contact", "force", "friction", "state", "proven"):
            assert all(map(np.array_equal, getattr(part, name), getattr(alone, name))), name
        assert all(np.array_equal(part.findings[name], alone.findings[name]) for name in alone.findings)


def test_structure_and_states_are_kept_on_demand(plan_of, tmp_path, caplog):
    from taichi_bearings.analysis.structure import structure_of

    plan = plan_of("shape = [4, 4, 4]\n[scan]\nseed = [1, 2, 3]\n")
    scan(plan, tmp_path / "scan", engine=Here())
    assert "spans" not in read_scan(tmp_path / "scan").table
    states = tmp_path / "scan" / "states"
    report = scan(asking(plan, analyse=True, keep_states=True), tmp_path / "scan", engine=Here(True, states))
    assert report["solved_now"] == 3
    stored = read_scan(tmp_path / "scan")
    for row, sample in enumerate(plan.samples):
        state = read_run(tmp_path / "scan" / "states" / f"{sample.key}.h5")
        numbers = structure_of(state.solution).numbers
        for name in (
            "power_minimum_cut",
            "spans",
            "domains",
            "slipless_fraction",
            "reached_fraction",
            "disjoint_paths",
        ):
            assert stored.table[name][row] == numbers[name], name
    assert scan(asking(plan, analyse=True, keep_states=True), tmp_path / "scan")["solved_now"] == 0
    damaged = tmp_path / "scan" / "states" / f"{plan.samples[1].key}.h5"
    whole = damaged.read_bytes()
    with h5py.File(damaged, "r") as file:
        offset = file["contact/x/power"].id.get_offset()
    for content in (
        whole[:5000],
        whole[:5000] + 8 * b"?" + whole[5008:],
        whole[:offset] + 8 * b"?" + whole[offset + 8 :],
    ):
        caplog.clear()
        damaged.write_bytes(content)
        assert scan(plan, tmp_path / "scan", engine=Here(True, states))["solved_now"] == 1
        assert f"a kept state is taken for missing: {damaged} " in caplog.text
        read_run(damaged)
    assert scan(plan, tmp_path / "scan")["solved_now"] == 0


def test_what_a_scan_was_asked_for_once_is_done_ever_after(plan_of, tmp_path):
    """Resumed, extended and asked in the file alike; until it is called off."""
    three = plan_of("shape = [3, 3, 4]\n[scan]\nseed = { start = 0, stop = 3 }\n")
    four = plan_of("shape = [3, 3, 4]\n[scan]\nseed = { start = 0, stop = 4 }\n")
    folder = tmp_path / "scan"
    scan(three, folder, engine=Here())
    asked = plan_of("analyse = true\nkeep_states = true\nsample_timeout = 50\n" + three.text)
    assert estimate(asked, folder)["missing"] == 3
    assert scan(asked, folder)["solved_now"] == 3  # brought up
    assert (folder / "scan.toml").read_text() == asked.text
    assert scan(four, folder, engine=Here(True, folder / "states"))["solved_now"] == 1
    assert not np.isnan(read_scan(folder).table["power_minimum_cut"]).any()
    assert {file.stem for file in (folder / "states").iterdir()} == {sample.key for sample in four.samples}
    five = plan_of("shape = [3, 3, 4]\n[scan]\nseed = { start = 0, stop = 5 }\n")
    report = scan(asking(five, analyse=False, keep_states=False), folder, engine=Here())
    assert (report["lacking"], report["unanalysed"]) == (0, 1)
    assert np.isnan(read_scan(folder).table["power_minimum_cut"]).sum() == 1
    assert read_plan(folder / "scan.toml").options == {"analyse": False, "keep_states": False, "sample_timeout": 50}


def test_samples_that_fail_cost_nothing_but_themselves(plan_of, tmp_path, caplog):
    """One lacks memory, one ends its process, one hangs, one crashes, one fails but once."""
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 12 }\n")
    engine = LocalEngine(partial(scan_faults.solve, marks=tmp_path), 2, partial(scan_faults.allowed, seconds=0.3))
    report = scan(plan, tmp_path / "scan", engine=engine)
    assert (report["done"], report["failed"], report["missing"]) == (8, 4, 0)
    stored = read_scan(tmp_path / "scan")
    bad = [3, 5, 7, 8]
    assert stored.table["seed"][stored.failed].tolist() == bad
    reasons = dict(zip(stored.table["seed"].tolist(), stored.table["error"], strict=True))
    expected = ("MemoryError: no room", "exit code 42", "no result within 0.3 s", "SIGABRT")
    for seed, words in zip(bad, expected, strict=True):
        assert words in reasons[seed]
        assert f"sample seed = {seed} (" in caplog.text
    assert np.isnan(stored.table["power"][bad]).all()
    assert stored.histograms.count[bad].sum() == 0
    again = scan(plan, tmp_path / "scan", engine=Here())  # the fault is gone: only those are done again
    assert (again["solved_now"], again["failed"], again["reached"]) == (4, 0, 12)
    scan(plan, tmp_path / "undisturbed", engine=Here())
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


def test_workers_that_never_work_end_the_scan_in_one_sentence(plan_of, monkeypatch):
    monkeypatch.setattr(scan_engine, "HOPELESS", 3)
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 500 }\n")
    units = [(sample,) for sample in plan.samples]
    engine = LocalEngine(scan_faults.die, 2)
    with pytest.raises(BearingsError, match="in a row ended without a result"):
        list(run_samples(units, engine))
    engine.close()


def test_bad_scenes_are_refused_before_anything_is_written(plan_of, tmp_path):
    np.savez(tmp_path / "c.npz", x=np.ones((31, 32, 32)))
    for text in (
        "shape = [[5, 5], [5, 5, 2]]",
        'distribution = ["uniform:0.1,1", "cauchy:1"]',
        "direction = [[1, 0, 0], [0, 0, 0]]",
        'coefficients = ["c.npz"]',
    ):
        with pytest.raises(BearingsError):
            scan(plan_of(f"[scan]\n{text}\n"), tmp_path / "scan")
        assert not (tmp_path / "scan").exists()


@pytest.mark.parametrize("driven", ["planes", "walls"])
def test_seeds_are_refused_where_a_file_has_all_coefficients(driven, plan_of, tmp_path):
    np.savez(tmp_path / "given.npz", x=np.ones((3, 5)), y=np.ones((4, 4)))
    given = f'coefficients = "given.npz"\ndriven = "{driven}"\n'
    seeds = "[scan]\nseed = [0, 1]\n"
    for call in (estimate, partial(scan, engine=Here())):
        with pytest.raises(InputError, match=r"seed is scanned, but .*given\.npz holds all coefficients, so nothing"):
            call(plan_of(given + seeds), tmp_path / "never")
    assert not (tmp_path / "never").exists()
    drawn = plan_of(f'{given}method = "gradient-descent"\ninitial = "random"\n{seeds}')
    assert estimate(drawn, tmp_path / "never")["missing"] == 2


def test_killed_workers_lose_nothing(plan_of, tmp_path):
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 40 }\n")
    engine = LocalEngine(partial(scan_faults.dawdle, seconds=0.01), 2)
    draw, kills = random.Random(7), []

    def kill_now_and_then(progress):
        alive = [process.pid for process in multiprocessing.active_children() if process.name == "bearings-worker"]
        if alive and progress.running and len(kills) < 3 and draw.random() < 0.5:
            kills.append(draw.choice(alive))
            os.kill(kills[-1], signal.SIGKILL)

    scan(plan, tmp_path / "scan", engine=engine, monitor=kill_now_and_then)
    assert len(kills) == 3
    report = scan(plan, tmp_path / "scan", engine=Here())
    assert report["reached"] == 40
    scan(plan, tmp_path / "undisturbed", engine=Here())
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


def test_a_scan_grows_but_does_not_forget(plan_of, tmp_path):
    small = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 10 }\n")
    large = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 15 }\n")
    scan(small, tmp_path / "scan", engine=Here())
    assert scan(large, tmp_path / "scan", engine=Here())["solved_now"] == 5
    with pytest.raises(FileError, match="5 samples that this scan does not ask for"):
        scan(small, tmp_path / "scan", engine=Here())
    assert read_scan(tmp_path / "scan").samples == 15


def test_a_damaged_journal_line_costs_that_sample_alone(plan_of, tmp_path, caplog):
    plan = plan_of("shape = [5, 5]\n[scan]\nseed = { start = 0, stop = 10 }\n")
    scan(plan, tmp_path / "scan", engine=Here())
    scan(plan, tmp_path / "undisturbed", engine=Here())
    journal = tmp_path / "scan" / "samples.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:4], lines[4].replace(b"power", b"pover"), *lines[5:-1], lines[-1][:60]]))
    (tmp_path / "scan" / "scan.h5").write_bytes(b"damaged")
    assert scan(plan, tmp_path / "scan", engine=Here())["solved_now"] == 2
    assert "line 5" in caplog.text
    caplog.clear()
    assert scan(plan, tmp_path / "scan", engine=Here())["solved_now"] == 0
    assert not caplog.records
    assert_same_but_for_the_clock(tmp_path / "scan", tmp_path / "undisturbed")


def test_folders_that_cannot_serve_are_named(plan_of, tmp_path):
    plan = plan_of("shape = [5, 5]\n")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FileError, match="file cannot be written"):
        scan(plan, tmp_path / "file")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "precious.txt").write_text("mine")
    with pytest.raises(FileError, match="not the folder of a scan"):
        scan(plan, tmp_path / "folder")
    assert [file.name for file in (tmp_path / "folder").iterdir()] == ["precious.txt"]
    if os.geteuid():  # root may write anywhere
        (tmp_path / "closed").mkdir(mode=0o500)
        with pytest.raises(FileError, match="closed cannot be written"):
            scan(plan, tmp_path / "closed")


def test_samples_of_two_precisions_get_workers_of_their_own(plan_of, tmp_path):
    plan = plan_of(
        'shape = [3, 3, 3]\ntolerance = 1e-2\nmethod = "gradient-descent"\n[scan]\n'
        'precision = ["f64", "f32"]\nseed = [1, 2]\n'
    )
    assert scan(plan, tmp_path / "scan", workers=1)["reached"] == 4
    power = read_scan(tmp_path / "scan").table["power"]
    assert (power[:2] != power[2:]).all()
    assert np.allclose(power[:2], power[2:], rtol=2e-2)


def test_what_no_sample_uses_is_refused_before_anything_is_computed(plan_of, tmp_path, caplog):
    minima = plan_of("shape = [4, 4]\nmass = 2.0\n[scan]\nstiffness = [1e4, 1e5]\nradius = [0.5, 1.0]\n")
    (tmp_path / "before").mkdir()
    (tmp_path / "before" / "scan.toml").touch()
    refuse_unused(minima, tmp_path / "before")
    assert [record.message.split(" ")[1] for record in caplog.records] == ["mass", "stiffness"]
    with pytest.raises(InputError, match=r"mass is 2\.0, but planar-cut with the law coulomb does not use it"):
        scan(minima, tmp_path / "scan", engine=Here())
    assert not (tmp_path / "scan").exists()
    viscous = plan_of('shape = [4, 4]\nlaw = "viscous"\nnormal_force = 2.0\n')
    with pytest.raises(InputError, match=r"it needs --law coulomb or coulomb-viscous"):
        scan(viscous, tmp_path / "scan", engine=Here())
    both = 'shape = [4, 4]\nmass = 2.0\nnormal_force = 2.0\n[[scan.zip]]\nmethod = ["auto", "rigid-limit"]\n'
    refuse_unused(plan_of(both + 'law = ["viscous", "coulomb"]\n'), tmp_path / "scan")
    report = scan(plan_of(both), tmp_path / "scan", engine=Here())
    assert report["reached"] == 2


def test_a_scan_runs_in_a_thread_too(plan_of, tmp_path):
    plan, reports = plan_of("shape = [5, 5]\n"), []
    thread = threading.Thread(target=lambda: reports.append(scan(plan, tmp_path / "scan")))
    thread.start()
    thread.join()
    assert reports[0]["reached"] == 1


def test_numbers_that_are_lists_where_they_are_known_are_no_columns(plan_of):
    samples = plan_of('shape = [3, 3, 4]\n[scan]\ndistribution = ["uniform:0.1,1.0", "lognormal:1,6"]\n').samples
    records = [record["scalars"] for sample in samples for record in solve_samples([sample], analyse=True)]
    assert {record["spans"] for record in records} == {True, False}
    assert all("shortest_path" in record for record in records)
    assert not any({"planes_crossed", "driving_torque"} & set(record) for record in records)


def test_kept_states_of_lattices_need_no_file_of_the_scan(plan_of, tmp_path):
    rng = np.random.default_rng(0)
    given, spin = {"x": rng.uniform(0.1, 1, (3, 5)), "y": rng.uniform(0.1, 1, (4, 4))}, rng.uniform(-1, 1, (4, 5))
    np.savez(tmp_path / "given.npz", **given)
    np.savez(tmp_path / "spin.npz", spin=spin)
    words = 'coefficients = "given.npz"\ninitial = "spin.npz"\nmethod = "gradient-descent"\niterations = 3\n'
    (sample,) = plan_of(words + "[scan]\nspin_top = [2.0]\n").samples
    (record,) = solve_samples([sample], states=tmp_path / "states")
    for name in ("given.npz", "spin.npz"):
        (tmp_path / name).unlink()
    moved = (tmp_path / "states").rename(tmp_path / "moved")
    state = read_run(state_path(moved, sample.key))
    assert state.power == record["scalars"]["power"]
    assert np.array_equal(state.start(), spin[None])
    for axis, values in zip("xy", state.scene.coefficients, strict=True):
        assert np.array_equal(np.squeeze(values), given[axis])
    assert state.asked.spin_top == 2.0
    assert state.asked.threads == sample.settings.threads
