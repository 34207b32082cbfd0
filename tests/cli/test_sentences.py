"""What the commands say where something is not what it seems: one sentence that names it and the command that fits."""

import json
import os
import sys

import h5py
import numpy as np
import pytest

from taichi_bearings.devices import find
from tests.cli import commands
from tests.cli.commands import bearings
from tests.scenes import KNOWN_LAWS

SCAN = "shape = [4, 5]\n[scan]\nseed = [1, 2]\n"
RUN = ("run", "--shape", "4,5", "--figures", "none")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """With a run `run`, a scan `scan` of the file `many.toml`, and a scene `one.toml`."""
    place = tmp_path_factory.mktemp("both")
    (place / "many.toml").write_text(SCAN)
    (place / "one.toml").write_text("shape = [4, 5]\n")
    assert bearings(*RUN, "--out", "run", cwd=place).returncode == 0
    assert bearings("scan", "many.toml", "--out", "scan", cwd=place).returncode == 0
    return place


@pytest.fixture
def refused(tmp_path):
    """The sentence with which a command refuses its words, before anything is written."""

    def sentence(*words, cwd=tmp_path):
        before = sorted(cwd.rglob("*"))
        said = commands.refused(*words, cwd=cwd)
        assert sorted(cwd.rglob("*")) == before
        return said

    return sentence


def draw(*sides, samples=()):
    rng = np.random.default_rng(1)
    shapes = [[n - (a == axis) for a, n in enumerate(sides)] for axis in range(len(sides))]
    return {axis: rng.uniform(0.1, 1.0, (*samples, *shape)) for axis, shape in zip("xyz", shapes, strict=False)}


@pytest.mark.parametrize(
    "command", ["analyse", "verify", "view", "export", "movie", "plot spins", "run", "run --resume"]
)
@pytest.mark.parametrize("given", ["scan", "scan/scan.h5"])
def test_a_scan_where_a_run_is_wanted(folder, refused, command, given):
    assert refused(*command.split(), given, cwd=folder).startswith(
        f"bearings: {given} is a scan, not a run; `bearings scan scan` goes on with it, `bearings plot scan scan` and"
    )


@pytest.mark.parametrize(
    "words", [("scan", "run"), ("scan", "run/run.h5"), ("plot", "scan", "run", "--x", "L", "--y", "power")]
)
def test_a_run_where_a_scan_is_wanted(folder, refused, words):
    sentence = refused(*words, cwd=folder)
    assert (
        "run is a run, not a scan; `bearings run run` solves it again, `bearings plot spins run` draws it" in sentence
    )


def test_a_table_of_a_scan_is_not_a_scan_to_solve(folder, refused):
    assert "`bearings scan scan` continues a scan there" in refused("scan", "scan/scan.h5", cwd=folder)


def test_the_root_of_the_file_system_is_no_place_for_a_run(refused):
    for force in ((), ("--force",)):
        words = ("run", "--shape", "4,5", "--out", os.sep, *force)
        assert "is the root of the file system; choose another --out" in refused(*words)


@pytest.mark.parametrize("command", ["analyse", "verify"])
def test_what_is_there_but_no_file_of_a_run_is_told_apart_from_what_is_missing(refused, tmp_path, command):
    assert refused(command, "nowhere").endswith("nowhere is not a run: there is no file or folder nowhere")
    (tmp_path / "folder" / "run.h5").mkdir(parents=True)
    assert refused(command, "folder").endswith("folder/run.h5 is not a file".replace("/", os.sep))
    with h5py.File(tmp_path / "bare.h5", "w") as file:
        file.attrs.update(schema="taichi_bearings.run", schema_version=1)
    assert "bare.h5 lacks the attribute '" in refused(command, "bare.h5")


def test_parts_of_no_scan_are_not_merged(refused):
    assert "there is no nowhere; --part and --merge need the folder of a scan" in refused("scan", "nowhere", "--merge")


def test_missing_arrays_are_named(refused, tmp_path):
    arrays = draw(3, 4, 5)
    np.savez(tmp_path / "flat.npz", x=arrays["x"], y=arrays["y"])
    np.savez(tmp_path / "tall.npz", y=arrays["y"], z=arrays["z"])
    np.savez(tmp_path / "dry.npz", **arrays)
    assert refused("run", "--coefficients", "flat.npz").endswith("flat.npz lacks the array z")
    assert refused("run", "--shape", "3,4,5", "--coefficients", "flat.npz").endswith("flat.npz lacks the array z")
    assert refused("run", "--coefficients", "tall.npz").endswith("tall.npz lacks the array x")
    np.savetxt(tmp_path / "table.csv", arrays["x"][0], delimiter=",")
    said = refused("run", "--coefficients", "table.csv")
    assert said.endswith("table.csv is a text file; arrays are read from npy, npz or HDF5 files")
    words = ("run", "--coefficients", "dry.npz", "--law", "coulomb-viscous")
    assert refused(*words).endswith("dry.npz lacks the arrays x_viscosity, y_viscosity, z_viscosity")


def test_coefficients_bring_their_shape_and_stand_in_the_report_instead_of_the_seed(refused, tmp_path):
    np.savez(tmp_path / "one.npz", **draw(4, 6))
    np.savez(tmp_path / "two.npz", **draw(4, 6, samples=(2,)))
    around = draw(4, 6)
    np.savez(tmp_path / "around.npz", x=np.concatenate([around["x"], around["x"][:1]]), y=around["y"])
    said = bearings("run", "--coefficients", "around.npz", "--figures", "none", "--out", "c", cwd=tmp_path).stdout
    assert "coefficients from around.npz; the shapes of its arrays make x periodic\n  P = " in said
    words = ("run", "--coefficients", "one.npz", "--seed", "7", "--figures", "none")
    done = bearings(*words, "--out", "a", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("4x6 coulomb")
    assert "coefficients from one.npz\n  P = " in done.stdout
    assert "seed" not in done.stdout + bearings("verify", "a", cwd=tmp_path).stdout
    assert "coefficients given" in bearings("list", ".", cwd=tmp_path).stdout
    done = bearings(*words, "--driven", "walls", "--out", "walls", cwd=tmp_path)
    assert "coefficients from one.npz\n  P = " in done.stdout
    assert json.loads((tmp_path / "walls" / "summary.json").read_text())["coefficients"] == "one.npz"
    done = bearings("run", "--coefficients", "two.npz", "--replicas", "2", "--out", "b", cwd=tmp_path)
    assert "sample 0: P = " in done.stdout
    assert "sample 1: P = " in done.stdout
    for name, words, expected in (
        ("one.npz", ("--shape", "4,5"), "shape is 4x5, but the coefficients in one.npz are of 4x6 spheres"),
        ("one.npz", ("--shape", "4,6,3"), "shape is 4x6x3, but the coefficients in one.npz are of 4x6 spheres"),
        ("two.npz", (), "replicas is 1, but two.npz holds 2 samples; it must be 2"),
        (
            "one.npz",
            ("--distribution", "constant:1"),
            "the coefficients are those of one.npz; leave one",
        ),
    ):
        assert expected in refused("run", "--coefficients", name, *words)


def test_a_scan_over_files_of_coefficients_takes_the_shape_of_each(tmp_path):
    for name, height in (("low", 4), ("high", 7)):
        np.savez(tmp_path / f"{name}.npz", **draw(3, height))
    (tmp_path / "scan.toml").write_text('[scan]\ncoefficients = ["low.npz", "high.npz"]\n')
    done = bearings("scan", "scan.toml", "--out", "s", "--workers", "1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    table = (tmp_path / "s" / "scan.csv").read_text()
    assert "3x4" in table
    assert "3x7" in table


@pytest.mark.parametrize("dry", [(), ("--dry-run",)])
def test_an_impossible_grid_is_refused_before_anything_is_computed(refused, tmp_path, dry):
    file = tmp_path / "scan.toml"
    file.write_text('shape = [4, 5]\nmethod = "planar-cut"\n[scan]\nlaw = ["coulomb", "viscous"]\nseed = [1, 2]\n')
    words = "method 'planar-cut' does not solve the law 'viscous'; it solves coulomb"
    assert words in refused("scan", "scan.toml", "--out", "s", *dry)
    file.write_text('shape = [4, 4, 5]\nmethod = "planar-cut"\n[scan]\ndirection = [[1, 0, 0], [1, 1, 0]]\n')
    assert "needs imposed spins about x or about y alone" in refused("scan", "scan.toml", "--out", "s", *dry)


def test_a_direction_has_no_meaning_in_two_dimensions(refused, tmp_path):
    words = ("--shape", "4,5", "--direction", "1,0,0")
    assert "direction is (1.0, 0.0, 0.0), but spins of discs point along z" in refused("run", *words)
    (tmp_path / "scan.toml").write_text("shape = [4, 5]\n[scan]\ndirection = [[1, 0, 0], [0, 1, 0]]\n")
    assert "spins of discs point along z" in refused("scan", "scan.toml", "--out", "s")


@pytest.mark.skipif(bool(find("cuda")), reason="there is a CUDA device here")
@pytest.mark.parametrize("method", ["planar-cut", "gradient-descent"])
def test_an_absent_device_is_refused_also_by_methods_that_need_none(refused, tmp_path, method):
    law = "coulomb" if method == "planar-cut" else "viscous"
    words = ("--shape", "4,5", "--method", method, "--law", law, "--arch", "cuda")
    assert "arch is 'cuda' but no CUDA device was found here" in refused("run", *words)
    (tmp_path / "scan.toml").write_text(f'shape = [4, 5]\nlaw = "{law}"\nmethod = "{method}"\narch = "cuda"\n')
    assert "arch is 'cuda' but no CUDA device was found here" in refused("scan", "scan.toml", "--out", "s")


@pytest.mark.parametrize("law", KNOWN_LAWS)
def test_no_power_has_its_reason(tmp_path, law):
    """Each of the three, and only where it is the reason."""
    cut = draw(4, 6)
    cut["y"][:, 2] = 0
    np.savez(tmp_path / "cut.npz", **cut, x_viscosity=cut["x"], y_viscosity=cut["y"])
    for number, (words, reason) in enumerate(
        (
            (("--shape", "3,3,4", "--spin-bottom", "1"), "top and bottom are driven alike"),
            (("--shape", "3,3,4", "--direction", "0,0,1"), "the imposed spins point along the height"),
            (("--coefficients", "cut.npz"), "contacts are absent"),
            (("--shape", "4,6"), None),
        )
    ):
        done = bearings("run", *words, "--law", law, "--figures", "none", "--out", f"r{number}", "--json", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        summary = json.loads(done.stdout)
        assert (summary["power"] < 1e-20) == (reason is not None)
        assert [reason in sentence for sentence in summary["warnings"]] == [True] * (reason is not None)
        assert done.stderr.count("the least power is 0") == (reason is not None)


if sys.platform != "win32":
    from tests.cli.terminal import on_terminal

    STANDS = (  # a program that never comes further than to prepare its first step
        "import time\nfrom taichi_bearings.solvers.{0} import {1}\nfrom taichi_bearings_cli.__main__ import main\n"
        "def begin(*_):\n    while True:\n        time.sleep(0.01)\n{1}.begin = begin\nmain()\n"
    )

    def interrupted(*words, method):
        """What a run says that is interrupted before its first step. method : module and class of the method."""
        program = ("-c", STANDS.format(*method))
        session = on_terminal("run", *words, columns=300, stop="preparing", program=program)
        assert (session.returncode, session.stdout) == (130, ""), session.raw
        return session.frames[-1][1]

    def test_ctrl_c_before_the_first_result_says_that_nothing_is_kept(tmp_path):
        said = interrupted("--shape", "6,6,6", "--out", tmp_path / "r", method=("minimisers", "Minimiser"))
        assert said == "bearings: interrupted before a first result was reached; nothing is kept"
        assert list(tmp_path.iterdir()) == []

    def test_ctrl_c_before_the_first_result_of_a_run_with_checkpoints_names_the_command_that_goes_on(tmp_path):
        words = ("--method", "cundall-strack", "--shape", "4,4", "--duration", "1e-3", "--checkpoint-every", "60")
        said = interrupted(*words, "--out", tmp_path / "r", method=("cundall_strack", "CundallStrackMethod"))
        assert f"`bearings run --resume {tmp_path / 'r'}` goes on from the last checkpoint" in said
        assert bearings("run", "--resume", tmp_path / "r").returncode == 0


def test_a_run_under_a_torque_says_what_its_power_belongs_to(tmp_path):
    words = ("run", "--shape", "4,5", "--figures", "none")
    said = "P and the slipping contacts are those of a top that turns with its imposed spin"
    assert said in bearings(*words, "--torque", "1", "--out", "a", cwd=tmp_path).stdout
    assert said not in bearings(*words, "--out", "b", cwd=tmp_path).stdout
