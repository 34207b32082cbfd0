"""Scans of packings out of files, and of lattices with other driven bodies than planes: single runs to the bit."""

import math
from dataclasses import fields
from functools import partial

import numpy as np
import pytest

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.errors import FileError, InputError
from taichi_bearings.files.scan_file import read_scan
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from taichi_bearings.scans.estimate import units_of
from taichi_bearings.scans.figure import Request, plot_scan
from taichi_bearings.scans.histogram import pooled, read_source
from taichi_bearings.scans.listing import entries
from taichi_bearings.scans.plan import read_plan
from taichi_bearings.scans.scan import estimate, scan
from taichi_bearings.scene.packing import Packing
from tests.scans.scan_faults import Here, asking
from tests.scans.test_scan import CLOCKS, assert_same_but_for_the_clock

DRAWN_OR_GIVEN = {"friction", "viscosity", "normal_force"}
LAWS_BY_SEEDS = """
packing = "bcc.npz"
viscosity = "uniform:0.5,1.0"
[scan]
law = ["coulomb", "viscous", "coulomb-viscous"]
seed = { start = 3, stop = 5 }
"""


def save(path, packing, *left_out):
    """Write a packing without what is to be drawn."""
    np.savez(path, **{name: values for name, values in packing.arrays().items() if name not in left_out})


@pytest.fixture
def bcc(tmp_path):
    save(tmp_path / "bcc.npz", Packing.lattice("bcc", (3, 2, 3)), *DRAWN_OR_GIVEN)
    return tmp_path / "bcc.npz"


def settings_of_run(sample):
    """What `bearings run` needs to be told for a sample alone."""
    settings = sample.settings
    unused = {} if settings.law == "coulomb-viscous" else {"viscosity": RunSettings().viscosity}
    return RunSettings(**{**settings.given, **unused, "threads": 1, "figures": "none"})


def assert_row_is_run(stored, row, found):
    """A row of a scan has the numbers of a single run, and its histogram the powers of its contacts."""
    for name, value in found.summary.items():
        if name not in {*CLOCKS, "run", "coefficients", "shape"} and name in stored.table:
            value = "; ".join(value) if name == "warnings" else math.nan if value is None else value
            kept = stored.table[name][row]
            assert kept == value or (isinstance(value, float) and math.isnan(value) and math.isnan(kept)), name
    assert stored.table.keys() >= found.summary.keys() - {"run", "coefficients", "shape", "warnings"}
    power, state = found.solution.power_per_contact, found.solution.state
    slipping = power[(state == ContactState.SLIPPING) & (power > 0)]
    edges = stored.histograms.edges
    assert np.array_equal(stored.histograms.count[row], np.histogram(slipping, edges)[0])
    assert stored.histograms.contacts[row, ContactState.SLIPPING] == (state == ContactState.SLIPPING).sum()


def test_a_packing_over_laws_and_seeds_is_its_runs_to_the_last_bit(plan_of, bcc, tmp_path, needs_f64):
    plan = plan_of(LAWS_BY_SEEDS)
    expected = estimate(plan, tmp_path / "scan")
    assert (expected["samples"], expected["seconds"]) == (6, None)
    assert expected["bytes"] > 1e8
    report = scan(asking(plan, analyse=True, keep_states=True), tmp_path / "scan", workers=2)
    assert (report["reached"], report["unanalysed"], report["workers"]) == (6, 0, 2)
    stored, counted, analysed = read_scan(tmp_path / "scan"), 0, set()
    assert " ".join(stored.table).startswith("law seed power lower_bound gap status method slipping slipless seconds")
    for row, sample in enumerate(plan.samples):
        found = run(settings_of_run(sample), tmp_path / f"run-{row}")
        assert_row_is_run(stored, row, found)
        state = tmp_path / "scan" / "states" / f"{sample.key}.h5"
        kept = read_run(state).solution
        for item in fields(kept):
            one, other = getattr(kept, item.name), getattr(found.solution, item.name)
            if isinstance(one, np.ndarray):
                assert np.array_equal(one, other), item.name
        whole = structure_of(found.solution).numbers.items()
        numbers = {name: value for name, value in whole if not isinstance(value, (list, dict))}  # as a table has them
        for name, value in numbers.items():
            assert np.array_equal(stored.table[name][row], np.nan if value is None else value, equal_nan=True), name
        analysed |= numbers.keys()
        counted = counted + found.histogram.slipping
    assert analysed <= stored.table.keys()
    assert verify(state)["verified"]
    source = read_source(tmp_path / "scan")
    assert pooled([source], 20, "mean", by="law").keys() == {"coulomb", "viscous", "coulomb-viscous"}
    assert sum(part.slipping for part in pooled([source], by="law").values()) == counted > 0
    state.write_bytes(state.read_bytes()[:5000])
    assert estimate(plan, tmp_path / "scan")["missing"] == 1


def test_a_scan_that_was_stopped_ends_as_if_it_had_not_been(plan_of, bcc, tmp_path):
    plan = plan_of(LAWS_BY_SEEDS)
    folder, whole = tmp_path / "stopped", tmp_path / "whole"
    scan(plan, whole, engine=Here())
    scan(plan, folder, engine=Here())
    journal, table = folder / "samples.jsonl", folder / "scan.h5"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:3], lines[3][:100]]))  # as a kill leaves it
    table.unlink()
    assert estimate(plan, folder)["missing"] == 3
    report = scan(read_plan(folder / "scan.toml"), folder, engine=Here())
    assert (report["solved_now"], report["reached"]) == (3, 6)
    assert_same_but_for_the_clock(folder, whole)


def test_another_content_of_the_file_makes_other_samples(plan_of, bcc, tmp_path, caplog):
    text = 'packing = "bcc.npz"\n[scan]\nseed = [0, 1]\n'
    before = plan_of(text)
    scan(before, tmp_path / "scan", engine=Here())
    save(bcc, Packing.lattice("bcc", (2, 2, 3)), *DRAWN_OR_GIVEN)
    after = plan_of(text)
    assert not {sample.key for sample in before.samples} & {sample.key for sample in after.samples}
    with pytest.raises(FileError, match="2 samples that this scan does not ask for"):
        scan(after, tmp_path / "scan", engine=Here())
    report = scan(before, tmp_path / "late", engine=Here())  # the file has changed since the plan was made
    assert report["failed"] == 2
    assert "bcc.npz has changed since the scan began" in report["failures"][0]["error"]
    assert "tried again" not in caplog.text


def test_keys_of_scans_of_lattices_stay(plan_of):
    """As they were before packings were scanned: stored scans go on."""
    plan = plan_of("spin_bottom = 0.5\n[scan]\nshape = [[4, 4], [3, 3, 4]]\nseed = [0, 7]\n")
    kept = ["95c48ffef6932d74", "e0f1a2e4499400c8", "89fceed8dfd88e7b", "9fad00d3cec1f67c"]
    assert [sample.key for sample in plan.samples] == kept


def test_driven_bodies_of_a_lattice_are_scanned(plan_of, tmp_path):
    text = 'analyse = true\nshape = [7, 7, 3]\n[scan]\ndriven = ["walls", "shaft:1"]\nseed = [4, 5]\n'
    plan = plan_of(text)
    assert [len(unit) for unit in units_of(plan.samples)] == [2, 2]
    scan(plan, tmp_path / "scan", engine=Here(analyse=True))
    stored = read_scan(tmp_path / "scan")
    for row, sample in enumerate(plan.samples):
        found = run(settings_of_run(sample), tmp_path / f"run-{row}")
        assert_row_is_run(stored, row, found)
    assert set(stored.table["shape"]) == {"7x7x3"}
    assert stored.table["spans"].dtype == bool
    request = Request(y="power", x="driven", by=(), where=())
    figure, table = plot_scan(tmp_path / "scan", request, tmp_path / "figure.png")
    assert figure.is_file()
    assert "shaft:1" in table.read_text()
    words = [entry.words() for entry in entries(tmp_path) if entry.kind == "scan"]
    assert words == ["7x7x3, over driven x seed: 4 of 4 samples; 4 certified"]


def test_a_dynamics_of_a_packing_is_scanned_beside_the_minimum(plan_of, bcc, tmp_path):
    text = """
    packing = "bcc.npz"
    duration = 0.002
    initial = "random"
    tolerance = 0.1
    [scan]
    method = ["auto", "cundall-strack"]
    seed = [1]
    """
    plan = plan_of(text)
    scan(plan, tmp_path / "scan", engine=Here())
    table = read_scan(tmp_path / "scan").table
    assert table["method_found"].tolist() == ["interior-point", "cundall-strack"]
    assert table["power"][0] <= table["power"][1]
    found = run(settings_of_run(plan.samples[1]), tmp_path / "run")
    assert_row_is_run(read_scan(tmp_path / "scan"), 1, found)


def test_what_cannot_be_is_refused_before_anything_is_solved(plan_of, bcc, tmp_path):
    whole = Packing.lattice("square", (4, 4))
    save(tmp_path / "whole.npz", whole)
    save(tmp_path / "two.npz", Packing.lattice("square", (4, 4), law="coulomb-viscous"))
    refused = {
        'packing = "whole.npz"\n[scan]\nseed = [0, 1]': "seed is scanned, but .*whole.npz holds all coefficients",
        'packing = "whole.npz"\ndistribution = "constant:1"': "distribution is 'constant:1', but .* holds friction",
        'packing = "bcc.npz"\n[scan]\nspin_bottom = [0.0, 1.0]': "spin_bottom is 1.0, but a packing does not use it",
        'shape = [5, 5]\n[scan]\ndriven = ["walls", "rods"]': "driven is 'rods'",
        'shape = [5, 5]\ndriven = "walls"\nmethod = "operator-splitting"': "method is .*of a packing it can be",
    }
    for text, sentence in refused.items():
        for call in (estimate, partial(scan, engine=Here())):
            with pytest.raises(InputError, match=sentence):
                call(plan_of(text), tmp_path / "never")
    assert not (tmp_path / "never").exists()
    with pytest.raises(FileError, match=r"none\.npz does not exist"):
        plan_of('[scan]\npacking = ["bcc.npz", "none.npz"]\n')
    laws = plan_of('[scan]\npacking = ["whole.npz", "two.npz", "bcc.npz"]\n')
    assert [sample.settings.law for sample in laws.samples] == ["coulomb", "coulomb-viscous", "coulomb"]
