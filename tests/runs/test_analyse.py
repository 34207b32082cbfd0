"""The analysis of stored runs: against plain graph algorithms on run.h5, and where the answer is known by hand."""

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.errors import FileError
from taichi_bearings.quantities import COLUMNS
from taichi_bearings.runs.analysis import analyse
from taichi_bearings.runs.figures import FIGURES
from taichi_bearings.runs.run import run
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.runs.settings import DRIVING_KEYS, RunSettings
from taichi_bearings.scans.stored_scans import OF_A_SPANNING_NETWORK


@pytest.fixture(scope="module")
def solved(taichi_runtime, precision, tmp_path_factory):
    """A function that solves a scene and gives its run directory, each scene once."""
    if precision != "f64":
        pytest.skip("stored runs are double precision")
    done = {}

    def solve(**settings):
        key = repr(sorted(settings.items()))
        if key not in done:
            done[key] = tmp_path_factory.mktemp("runs") / "run"
            run(RunSettings(threads=1, figures="none", **settings), done[key])
        return done[key]

    return solve


def coefficients(tmp_path, **arrays):
    path = tmp_path / "coefficients.npz"
    np.savez(path, **arrays)
    return str(path)


def analysed(folder, **options):
    return analyse(folder, figures=False, **options)


def test_in_2d_the_minimum_is_the_cut_and_has_two_domains(solved):
    report = analysed(solved(shape=(6, 7), seed=0))
    assert report["power_over_cut"] == pytest.approx(1, abs=1e-12)
    assert report["slipping_contacts_are_the_cut"]
    assert report["domains"] == 2
    assert report["domains_locked_to"] == {"bottom": 1, "top": 1, "both": 0, "mixed": 0, "partly": 0, "neither": 0}
    assert not report["spans"]
    assert report["disjoint_paths"] == 0
    for name in OF_A_SPANNING_NETWORK:  # does not apply, and is not 0
        assert report[name] is None


def test_a_weak_row_is_the_cut_and_equal_rows_are_not_unique(solved, tmp_path):
    weak = {"x": np.full((3, 6), 0.7), "y": np.full((4, 5), 0.9)}
    weak["y"][:, 3] = 0.2
    report = analysed(solved(shape=(4, 6), coefficients=coefficients(tmp_path, **weak)))
    assert report["power_minimum_cut"] == pytest.approx(4 * 0.2 * 50 * 0.5, rel=1e-12)
    assert (report["cut_contacts"], report["cut_is_unique"], report["slipping"]) == (4, True, 4)
    assert report["free_spheres_locked_to"] == {
        "bottom": 12,
        "top": 4,
        "both": 0,
        "mixed": 0,
        "partly": 0,
        "neither": 0,
    }
    assert report["next_cut_over_cut"] == pytest.approx((3 * 0.2 + 0.9 + 0.7) / 0.8)  # a step of one disc at the edge
    equal = analysed(solved(shape=(4, 6), distribution="constant:0.5"))
    assert not equal["cut_is_unique"]
    assert equal["power_minimum_cut"] == pytest.approx(4 * 0.5 * 50 * 0.5, rel=1e-12)


def test_driven_about_x_the_planes_part_but_contacts_along_x_join_them(solved):
    """Spins about x alone: contacts along x never slip, so a path changes planes where their cuts differ in height."""
    report = analysed(solved(shape=(5, 4, 6), direction=(1, 0, 0), seed=1))
    assert report["power_over_cut"] == pytest.approx(1, abs=1e-12)
    assert report["spans"]
    assert report["domains"] == 2
    assert report["planes_crossed"][0] > 1


def test_the_version_is_the_one_that_solved_the_run(solved, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(solved(shape=(6, 7), seed=0), folder)
    with h5py.File(folder / "run.h5", "a") as file:
        del file.attrs["sha256"]
        file.attrs["version"] = "0.0.7"
    found = read_run(folder)
    assert (found.version, found.summary["version"], analysed(folder)["version"]) == ("0.0.7",) * 3


def test_without_frustration_nothing_slips(solved):
    report = analysed(solved(shape=(4, 4, 5), spin_bottom=1.0))
    assert report["power_over_cut"] is None
    assert report["slipping"] == 0
    assert (report["spans"], report["spanning_fraction"], report["domains"]) == (True, 1.0, 1)
    assert report["disjoint_paths"] == 16


def test_a_viscous_state_has_no_network(solved):
    report = analysed(solved(shape=(4, 4, 5), law="viscous"))
    assert report["power_over_cut"] < 1
    assert (report["slipless"], report["spans"], report["components"]) == (0, False, 0)
    assert report["domains"] == 2 * 1 + 4 * 4 * 3  # each driven plane, each free sphere
    assert "mean_saturation" not in report


def test_contacts_that_are_not_decided_join_nothing(solved):
    solution = read_run(solved(shape=(4, 5, 7), seed=0)).solution
    undecided = replace(solution, state=np.where(solution.state == 0, 2, solution.state).astype(np.uint8))
    found = structure_of(undecided).numbers
    assert found["undecided"] > 0
    assert found["slipless"] == found["components"] == 0


def test_dynamics_whose_third_component_has_not_died_out_are_judged_by_the_two_that_matter(solved):
    folder = solved(shape=(3, 3, 4), method="cundall-strack", initial="random", tolerance=1e-6, seed=2)
    exact = solved(shape=(3, 3, 4), seed=2)
    found, expected = analysed(folder), analysed(exact)
    assert found["domains"] == expected["domains"]
    assert found["power_over_cut"] == pytest.approx(expected["power_over_cut"], rel=1e-5)


@pytest.mark.parametrize("driving", [{"spin_bottom": 1.0}, {"direction": (0.0, 0.0, 1.0)}], ids=str)
def test_a_sample_that_slips_nowhere_is_one_bearing(solved, driving, tmp_path):
    report = analyse(solved(shape=(3, 3, 4), **driving), out=tmp_path / "figures")
    assert (report["power"], report["slipping"], report["domains"], report["driving_torque"]) == (0, 0, 1, [0])
    assert report["power_over_cut"] is None
    assert len(report["files"]) == 1 + len(FIGURES)


def test_thresholds_go_from_one_domain_to_the_certified_view(solved):
    folder = solved(shape=(10, 10, 10), seed=0)
    report = analysed(folder)
    rows = [analysed(folder, threshold=0.5 * 10.0**-decades) for decades in range(2, 11)]
    assert np.all(np.diff([row["slipless"] for row in rows]) <= 0)
    assert np.all(np.diff([row["domains"] for row in rows]) >= 0)
    for key in ("slipless", "domains", "reached_fraction"):
        assert rows[-1][key] == report[key]
    everything = analysed(folder, threshold=10.0)
    assert (everything["slipping"], everything["domains"], everything["states"]) == (0, 1, "threshold")
    assert (report["minimum_is_unique"], everything["minimum_is_unique"]) == (True, None)
    analysed(folder)  # leave the run as it was


@pytest.mark.parametrize(("seed", "certified", "coarse"), [(0, True, True), (2, False, True)])
def test_a_coarse_threshold_can_join_planes_that_the_minimum_parts(solved, seed, certified, coarse):
    folder = solved(shape=(10, 10, 10), seed=seed)
    assert analysed(folder, threshold=1e-2 * 0.5)["spans"] == coarse
    report = analysed(folder)
    assert (report["spans"], report["states"]) == (certified, "proven")
    assert (report["disjoint_paths"] > 0) == certified


def test_that_the_minimum_is_the_only_one_is_said_only_of_proven_states(solved):
    tied = solved(shape=(6, 6), distribution="constant:0.5", method="gradient-descent", initial="minimum-cut")
    report = analysed(tied)
    assert (report["states"], report["undecided"], report["cut_is_unique"]) == ("decided", 0, False)
    assert report["minimum_is_unique"] is None  # the descent stands at one of many minima
    folder = solved(shape=(4, 5, 7), seed=0)
    assert analysed(folder)["minimum_is_unique"] is True
    assert analysed(folder, threshold=0.01)["minimum_is_unique"] is None


def test_the_group_holds_the_structure_and_the_rest_of_the_file_stays(solved):
    folder = solved(shape=(10, 10, 10), seed=0)
    before = contents(folder / "run.h5", without="analysis")
    report = analysed(folder)
    assert contents(folder / "run.h5", without="analysis") == before
    with h5py.File(folder / "run.h5") as file:
        group = file["analysis"]
        assert all(isinstance(item, h5py.Group) or {"units", "description"} <= set(item.attrs) for item in every(group))
        assert group.attrs["power_over_cut"] == report["power_over_cut"]
        assert group["domain"].shape == (10, 10, 10)
        assert len(group["domains/spheres"]) == report["domains"] == group["domain"][()].max() + 1
        path = group["path"][()]
        assert len(path) == report["shortest_path"] + 1
        assert (path[0, 2], path[-1, 2]) == (0, 9)
        for here, there in pairwise(path):
            axis = int(np.abs(there - here).argmax())
            assert file[f"contact/{'xyz'[axis]}/state"][tuple(np.minimum(here, there))] == 0
        cut = sum(int(group[f"minimum_cut/{axis}"][()].sum()) for axis in "xyz")
        assert cut == report["cut_contacts"]
        paths = group["betweenness/z"][()][..., 0].sum()
        assert paths == pytest.approx(1.0)
    size = (folder / "run.h5").stat().st_size
    analysed(folder)
    assert (folder / "run.h5").stat().st_size == size


def contents(path, without):
    """Every data set and attribute of a file as bytes, lists of texts as they are."""
    with h5py.File(path) as file:
        found = {key: np.asarray(value) for key, value in file.attrs.items()}
        found = {key: value.tolist() if value.dtype == object else value.tobytes() for key, value in found.items()}
        for key in file:
            if key != without:
                found |= {i.name: i[()].tobytes() for i in every(file[key]) if isinstance(i, h5py.Dataset)}
                found |= {
                    f"{i.name} {k}": np.asarray(v).tobytes() for i in every(file[key]) for k, v in i.attrs.items()
                }
    return found


def every(item):
    if isinstance(item, h5py.Dataset):
        return [item]
    return [item, *(part for key in item for part in every(item[key]))]


def test_several_samples_are_lists_and_stacked_arrays(solved):
    folder = solved(shape=(4, 4, 5), seed=5, replicas=3)
    report = analysed(folder)
    assert report["seed"] == [5, 6, 7]
    for number, seed in enumerate(report["seed"]):
        alone = analysed(solved(shape=(4, 4, 5), seed=seed))
        for key in ("power_minimum_cut", "domains", "spans", "reached_fraction", "self_stress_states"):
            assert report[key][number] == pytest.approx(alone[key], rel=1e-12)
    with h5py.File(folder / "run.h5") as file:
        group = file["analysis"]
        assert group["domain"].shape == (3, 4, 4, 5)
        spheres = group["domains/spheres"][()]
        assert spheres.shape == (3, max(report["domains"]))
        assert [int(row[row > 0].sum()) for row in spheres] == [80, 80, 80]
        assert group.attrs["domains"].tolist() == report["domains"]


def test_figures_and_files_beside_the_run(solved, tmp_path):
    folder = solved(shape=(4, 5, 7), seed=0)
    before = (folder / "run.h5").read_bytes()
    report = analyse(folder, out=tmp_path / "beside")
    assert (folder / "run.h5").read_bytes() == before
    names = {path.name for path in (tmp_path / "beside").iterdir()}
    assert names == {"analysis.h5", *(f"{name}.png" for name in FIGURES)}
    assert {Path(file).name for file in report["files"]} == names
    with pytest.raises(FileError, match="already exists"):
        analyse(folder, out=tmp_path / "beside")
    analyse(folder, out=tmp_path / "beside", force=True, figures=False)


@pytest.mark.parametrize("settings", [{"shape": (4, 5)}, {"shape": (4, 4, 3), "driven": "shaft:1"}], ids=str)
def test_numbers_of_an_analysis_are_rows_of_the_tables(solved, settings):
    said_beside = {*DRIVING_KEYS, "threshold", "states", "run", "files"}
    assert analysed(solved(**settings)).keys() <= COLUMNS.keys() | said_beside
