"""Files that prove what they claim are verified; with one number changed where it matters, they are not."""

import json
import shutil
from contextlib import suppress

import h5py
import numpy as np
import pytest

from taichi_bearings.checksums import seal
from taichi_bearings.errors import FileError
from taichi_bearings.runs.lattice_run import build_scene
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
KEPT = {
    "spheres": {"shape": (4, 3, 5), "seed": 12, "spin_bottom": 0.1},
    "discs": {"shape": (6, 7), "seed": 5},
    "dampers": {"shape": (3, 4, 4), "seed": 2, "law": "viscous"},
    "samples": {"shape": (3, 3, 4), "seed": 3, "replicas": 2},
    "descent": {"shape": (4, 4, 4), "method": "gradient-descent", "tolerance": 1e-3},
    "given": {"shape": (3, 3, 4), "distribution": "constant:1"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    there = tmp_path_factory.mktemp("verify")
    for name, settings in KEPT.items():
        run(RunSettings(threads=1, figures="none", **settings), there / name)
        with h5py.File(there / name / "run.h5", "r+") as file:
            del file.attrs["sha256"]  # the numbers themselves must contradict each other
    return there


@pytest.mark.parametrize("name", KEPT)
def test_a_run_proves_what_it_claims(folder, name):
    report = verify(folder / name)
    assert report["contradictions"] == []
    assert report["verified"]
    gaps = np.atleast_1d(report["gap"])
    assert (gaps >= 0).all()
    assert (gaps < (1e-3 if name == "descent" else 1e-8)).all()
    if name in ("spheres", "discs"):
        assert report["states_proven"]["unproven"] == 0
        assert report["minimum_is_unique"] is True


@pytest.fixture
def changed(folder, tmp_path):
    """A function that gives a copy of one of the files, changed by a function of it."""

    def change_one(name, change):
        with h5py.File(shutil.copy(folder / name / "run.h5", tmp_path), "r+") as file:
            change(file)
        return tmp_path / "run.h5"

    return change_one


def says(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def of_scene(old, new):
    def change(file):
        assert old in file.attrs["scene"]
        file.attrs["scene"] = file.attrs["scene"].replace(old, new)

    return change


def turn_one_driven_sphere(file):
    file["spin_rounding"][2, 1, -1, 0] += 1e-18


def adds(name, entry, amount):
    """Return a function that adds an amount to one entry of an array of a file."""

    def change(file):
        values = file[name][()]
        values[entry] += amount
        file[name][...] = values

    return change


FORGED = [
    ("spheres", turn_one_driven_sphere),
    ("spheres", adds("contact/x/force", (1, 1, 2), 1e-6)),
    ("discs", adds("contact/y/force", (2, 3), -1e-9)),
    ("dampers", adds("contact/z/force", (0, 0, 1), 1e-9)),
    ("descent", adds("contact/y/force", (0, 1, 1), 1e-6)),
    ("samples", adds("contact/y/force", (1, 0, 1, 1), 1e-6)),
    ("spheres", adds("contact/x/friction", (1, 1, 0, 1), 1e-6)),  # between driven spheres
    ("discs", adds("contact/x/friction", (2, 6), 1e-9)),
    ("discs", says("cut_is_unique", False)),
    *(("descent", says(name, value)) for name, value in (  # more than a descent knows
        ("states_proven", True), ("minimum_is_unique", True), ("gap", 1e-12), ("lower_bound", 1e9),
    )),
    *(("spheres", says(name, value)) for name, value in (
        ("gap", np.nan), ("power_normalised", 1.0), ("contacts", 7), ("minimum_is_unique", False),
        ("smallest_slipping_slip", 1e-3), ("largest_slipless_slip", 1e-3), ("status", "stalled"),
        ("slipping", 3), ("slipless", 3), ("undecided", 1), ("unproven", 1), ("power", 1.0), ("power", 1e9),
        ("lower_bound", 1.0), ("lower_bound", 1e9), ("gap", -1.0), ("gap", 0.1), ("seed", 13),
    )),
    *(("spheres", of_scene(old, new)) for old, new in (
        ("normal_force = 50.0", "normal_force = 1.0"), ("spin_bottom = 0.1", "spin_bottom = 0.7"),
        ("radius = 0.5", "radius = 5.0"), ('law = "coulomb"', 'law = "viscous"'),
        ("shape = [4, 3, 5]", "shape = [9, 9, 9]"),
        ("seed = 12", "seed = 99"), ("replicas = 1", "replicas = 5"), ("tolerance = 1e-08", "tolerance = 1e-300"),
        ("direction = [1.0, 1.0, 0.0]", "direction = [1.0, 1.0001, 0.0]"), ("uniform:0.1,1.0", "uniform:0.1,1.1"),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change"), FORGED, ids=range(len(FORGED)))
def test_what_a_run_did_not_prove_is_found(changed, name, change):
    report = verify(changed(name, change))
    assert not report["verified"]
    assert len(report["contradictions"]) >= 1


@pytest.mark.parametrize(
    ("name", "key", "value"), [("spheres", "power", 1.0), ("discs", "gap", None), ("samples", "seed", 3)]
)
def test_a_summary_that_differs_from_the_file_is_found(folder, tmp_path, name, key, value):
    run = shutil.copytree(folder / name, tmp_path / name)
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(summary | {key: value}))
    (sentence,) = verify(run)["contradictions"]
    assert sentence.startswith(f"the {key} is {value} in summary.json and ")
    (run / "summary.json").write_text("[]")
    assert verify(run)["contradictions"] == ["summary.json does not hold a JSON object"]
    (run / "summary.json").unlink()
    assert verify(run)["verified"]


@pytest.mark.parametrize("name", ["spheres", "discs", "dampers"])
@pytest.mark.parametrize(("key", "towards"), [("lower_bound", np.inf), ("gap", -np.inf), ("power", -np.inf)])
def test_nothing_is_said_to_be_better_than_it_is_proven_to_be(changed, name, key, towards):
    """Not by the last digit: nothing tells whether the least power is between the bounds by more than that."""

    def say_a_little_more(file):
        file.attrs[key] = np.nextafter(file.attrs[key], towards)

    def say_a_little_less(file):
        file.attrs[key] = np.nextafter(file.attrs[key], -towards)

    found = verify(changed(name, say_a_little_more))["contradictions"]
    assert any(f"the {key.replace('_', ' ')} is said" in sentence for sentence in found)
    assert verify(changed(name, say_a_little_less))["verified"]


@pytest.mark.parametrize("field", ["contact/x/slip", "contact/y/friction", "spin", "contact/z/power"])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_that_are_not_finite_are_damage_in_one_sentence(changed, field, number):
    with pytest.raises(FileError, match="is damaged: it must hold finite numbers"):
        verify(changed("spheres", lambda file: file[field].__setitem__(..., number)))


def one_more(file, name, at):
    values = file[name][()]
    values[at] = 0 if values[at] else 1
    file[name][...] = values


@pytest.mark.parametrize(
    "change",
    [
        lambda file: one_more(file, "contact/x/state", (1, 1, 2)),
        lambda file: one_more(file, "contact/y/proven", (1, 1, 2)),
        lambda file: file["spin"].__setitem__((1, 1, 2, 0), np.nextafter(file["spin"][1, 1, 2, 0], 9.0) + 1e-9),
        lambda file: file["coefficient/x"].__setitem__((1, 1, 2), 0.3),
        lambda file: file["contact/x/slip"].__setitem__((1, 1, 2), 0.3),
        lambda file: file["contact/z/power"].__setitem__((1, 1, 2), 0.3),
        lambda file: file["contact/z/friction"].__setitem__((1, 1, 2, 0), 40.0),
    ],
    ids=range(7),
)
@pytest.mark.parametrize("sealed", [True, False])
def test_an_edited_array_is_found_with_checksums_and_without(folder, tmp_path, change, sealed):
    path = tmp_path / "run.h5"
    shutil.copy(folder / "spheres" / "run.h5", path)
    with h5py.File(path, "r+") as file:
        if sealed:
            seal(file)
        change(file)
    report = verify(path)
    assert len(report["contradictions"]) >= 1 + sealed
    assert report["unchanged"] is (False if sealed else None)


@pytest.mark.parametrize("tolerance", ["inf", "1e9", "0.0", "nan", "true", '"small"'])
def test_a_tolerance_that_certifies_anything_is_none(changed, tolerance):
    with suppress(FileError):
        assert not verify(changed("descent", of_scene("tolerance = 0.001", f"tolerance = {tolerance}")))["verified"]


@pytest.mark.parametrize("damage", ["contact/z/friction", "spin", "coefficient/x"])
def test_a_file_without_what_is_needed_is_refused_in_one_sentence(changed, damage):
    with pytest.raises(FileError, match=r"lacks|cannot be read"):
        verify(changed("spheres", lambda file: file.__delitem__(damage)))


def test_files_that_are_none_and_two_powers_of_one_sample_are_refused(changed, tmp_path):
    with pytest.raises(FileError, match="for each of the 1 samples"):
        verify(changed("spheres", says("power", [404.0, 1.0])))
    (tmp_path / "run.h5").write_bytes(b"no HDF5 file")
    with pytest.raises(FileError, match="cannot be read"):
        verify(tmp_path / "run.h5")


def test_a_file_without_motion_is_not_verified(changed):
    def stop(file):
        file["spin"][...] = file["spin_rounding"][...] = 0.0

    report = verify(changed("spheres", stop))
    assert not report["verified"]
    assert report["power"] is None
    assert report["gap"] is None


def test_without_a_jump_not_anything_is_certified(tmp_path):
    run(RunSettings(shape=(4, 5), spin_top=0.5, spin_bottom=0.5, threads=1, figures="none"), tmp_path / "run")
    assert verify(tmp_path / "run")["verified"]
    with h5py.File(tmp_path / "run" / "run.h5", "r+") as file:
        file["spin"][1, 2] += 0.1
    assert not verify(tmp_path / "run")["verified"]


def test_a_sample_beside_that_of_its_seed_is_not_the_seeds(tmp_path):
    """Both runs prove what they say of their coefficients; these are those of the seed to the bit, or are not."""
    run(RunSettings(shape=(4, 5), seed=3, threads=1, figures="none"), tmp_path / "run")
    scene = build_scene(RunSettings(shape=(4, 5), seed=3))
    x, y = scene.lattice.by_axis(scene.coefficient[0] * (1 + 2.0**-52))
    np.savez(tmp_path / "moved.npz", x=x, y=y)
    other = run(
        RunSettings(shape=(4, 5), seed=3, coefficients=str(tmp_path / "moved.npz"), threads=1), tmp_path / "moved"
    )
    assert verify(tmp_path / "moved")["verified"]
    with h5py.File(tmp_path / "moved" / "run.h5", "r+") as file:
        del file.attrs["sha256"]
        file.attrs["coefficients"] = ""
        file.attrs["scene"] = file.attrs["scene"].replace('coefficients = "run.h5"\n', "")
    assert verify(tmp_path / "moved/run.h5")["contradictions"] == [
        "the coefficient in the file differs from what seed 3 gives"
    ]
    assert other.solution.power[0] == pytest.approx(verify(tmp_path / "run")["power"], rel=1e-15)


def test_a_run_whose_coefficients_another_machine_has_rounded_is_verified(tmp_path):
    settings = RunSettings(shape=(20, 20), seed=3, distribution="lognormal:0.4,0.8", figures="none")
    run(settings, tmp_path / "run")
    for factor, verified in ((1 + 2.0**-52, True), (1 + 1e-12, False)):
        with h5py.File(tmp_path / "run" / "run.h5", "r+") as file:
            file.attrs.pop("sha256", None)
            file["coefficient/x"][3, 4] *= factor
        said = verify(tmp_path / "run")["contradictions"]
        assert ("the coefficient in the file differs from what seed 3 gives" in said) != verified


def test_viscous_contacts_that_are_proven_to_slip_are_not_said_to_rest(changed):
    def say_that_they_rest(file):
        slips = file["contact/z/state"][()] == 1
        file["contact/z/state"][...] = np.where(slips, 0, file["contact/z/state"][()])
        for name in ("slipping", "slipless"):
            file.attrs[name] += (1 if name == "slipless" else -1) * int(slips.sum())
        slip = {axis: file[f"contact/{axis}/slip"][()] for axis in "xyz"}
        file.attrs["slip_threshold"] = file.attrs["largest_slipless_slip"] = slip["z"].max()
        file.attrs["separation_decades"] = ""

    found = verify(changed("dampers", say_that_they_rest))["contradictions"]
    assert any("states proven" in sentence for sentence in found)


@pytest.mark.parametrize("name", KEPT)
def test_whether_states_are_proven_is_said_as_it_is(changed, name):
    """Of every law: with and without a threshold, the one word and the other."""

    def say_the_other(file):
        said = file.attrs["states_proven"]
        assert name not in ("spheres", "discs", "dampers") or said
        file.attrs["states_proven"] = ~said

    assert any("proven" in found for found in verify(changed(name, say_the_other))["contradictions"])
