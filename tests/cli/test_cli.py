"""The command line as scripts use it: exit codes, one JSON object, files, and bad input in one sentence."""

import json
import os
import re
import signal

import h5py
import numpy as np
import pytest
from taichi_bearings_cli.main import COMMANDS, GROUPS

from taichi_bearings.runs.settings import settings_table
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.table import METHODS
from tests.cli.commands import bearings, refused

SMALL = ("--shape", "3,4,5", "--tolerance", "1e-3", "--figures", "none")


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "run"
    done = bearings("run", *SMALL, "--seed", 3, "--out", folder, "--json")
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


def test_help_answers_at_once():
    """In seconds of the processor, which others may keep busy."""
    resource, times = pytest.importorskip("resource"), []

    def spent():
        return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])

    for _ in range(3):
        began = spent()
        done = bearings("--help", env=dict(os.environ))  # started anew
        times.append(spent() - began)
    assert done.returncode == 0
    assert all(name in done.stdout for name in ("run", "histogram", "plot", "info"))
    assert min(times) < 0.5


@pytest.mark.parametrize(
    "command", ["run", "scan", "verify", "analyse", "histogram", "plot", "reproduce", "info", "benchmark"]
)
def test_every_command_has_help_with_an_example(command):
    done = bearings(command, "--help")
    assert done.returncode == 0
    assert "xample" in done.stdout or command == "benchmark"


def test_json_is_one_object_with_the_promised_keys(finished_run):
    folder, summary = finished_run
    promised = {
        "power", "lower_bound", "gap", "status", "method", "law", "shape", "seed", "iterations", "seconds",
        "seconds_compile", "contacts", "slipping", "slipless", "largest_balance_residual", "run", "version",
    }  # fmt: skip
    assert promised <= set(summary)
    assert summary["status"] == "certified"
    assert summary["gap"] <= 1e-3
    assert summary["lower_bound"] <= summary["power"]
    assert summary["run"] == str(folder)
    assert summary["slipping"] + summary["slipless"] + summary["undecided"] == summary["contacts"]


def test_the_run_file_has_the_promised_layout(finished_run):
    folder, summary = finished_run
    shapes = {"x": (2, 4, 5), "y": (3, 3, 5), "z": (3, 4, 4)}
    rng = np.random.default_rng(3)
    with h5py.File(folder / "run.h5") as file:
        total = 0.0
        for axis, shape in shapes.items():
            assert (file[f"coefficient/{axis}"][()] == rng.uniform(0.1, 1.0, shape)).all()
            for name in ("slip", "power", "force", "state"):
                assert file[f"contact/{axis}/{name}"].shape == shape
                assert file[f"contact/{axis}/{name}"].attrs["description"]
            mu_slip = 50 * file[f"coefficient/{axis}"][()] * file[f"contact/{axis}/slip"][()]
            driven = file[f"contact/{axis}/state"][()] == 3
            assert np.allclose(file[f"contact/{axis}/power"][()], np.where(driven, 0, mu_slip), rtol=1e-12)
            total += file[f"contact/{axis}/power"][()].sum()
        assert total == pytest.approx(summary["power"], rel=1e-12)
        assert file["spin"].shape == (3, 4, 5, 3)
        assert file["spin"].attrs["units"] == "1/time"
        lengths = {len(column) for column in file["history"].values()}
        assert len(lengths) == 1
        assert {"iteration", "seconds", "power", "lower_bound"} <= set(file["history"])
        for key in ("schema", "schema_version", "command", "scene", "power", "status", "numpy"):
            assert key in file.attrs


def test_a_run_can_be_run_again_from_what_it_stored(finished_run, tmp_path):
    folder, summary = finished_run
    for source in (folder, folder / "run.h5", folder / "scene.toml"):
        out = tmp_path / f"again-{source.name}"
        done = bearings("run", source, "--out", out, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["power"] == summary["power"]


def test_coefficients_and_spins_from_a_file_travel_with_the_run(finished_run, tmp_path):
    folder, summary = finished_run
    files = ("--coefficients", folder / "run.h5", "--initial", folder / "run.h5")
    first = bearings("run", *SMALL, *files, "--out", tmp_path / "a", "--json")
    assert first.returncode == 0, first.stderr
    os.rename(tmp_path / "a", tmp_path / "moved")
    second = bearings("run", tmp_path / "moved", "--out", tmp_path / "b", "--json")
    assert second.returncode == 0, second.stderr
    assert json.loads(second.stdout)["power"] == json.loads(first.stdout)["power"]
    assert json.loads(first.stdout)["power"] == pytest.approx(summary["power"], rel=1e-3)


def test_options_win_over_the_file_and_both_mean_the_same(tmp_path):
    (tmp_path / "scene.toml").write_text('shape = [4, 5]\nlaw = "viscous"\nseed = 9\ntolerance = 1e-6\n')
    done = bearings("run", tmp_path / "scene.toml", "--seed", 5, "--out", tmp_path / "a", "--json")
    words = ["--shape", "4x5", "--law", "viscous", "--seed", "5", "--tolerance", "1e-6"]
    other = bearings("run", *words, "--out", tmp_path / "b", "--json")
    assert json.loads(done.stdout)["power"] == json.loads(other.stdout)["power"]
    assert json.loads(done.stdout)["seed"] == 5


def test_replicas_give_lists_and_a_replica_axis(tmp_path):
    words = ["--shape", "4,5", "--replicas", "3", "--seed", "2", "--tolerance", "1e-3"]
    done = bearings("run", *words, "--out", tmp_path / "r", "--json")
    summary = json.loads(done.stdout)
    assert summary["seed"] == [2, 3, 4]
    assert len(summary["power"]) == 3
    with h5py.File(tmp_path / "r" / "run.h5") as file:
        assert file["spin"].shape == (3, 4, 5)
        assert file["contact/x/slip"].shape == (3, 3, 5)
        assert all(len(column) == 3 for column in file["history"].values())
    assert summary["status"] == ["certified"] * 3
    assert bearings("histogram", tmp_path / "r", "--out", tmp_path / "h").returncode == 0
    assert bearings("plot", "spins", tmp_path / "r", "--replica", 2).returncode == 0


def test_the_histogram_counts_every_slipping_contact_once(finished_run, tmp_path):
    folder, summary = finished_run
    twin = tmp_path / "twin.h5"
    twin.write_bytes((folder / "run.h5").read_bytes())
    assert "twice" in bearings("histogram", folder, folder / "run.h5", "--out", tmp_path).stderr
    done = bearings("histogram", folder, twin, "--bins-per-decade", 7, "--out", tmp_path, "--json")
    report = json.loads(done.stdout)
    assert report["slipping"] == 2 * summary["slipping"]
    lines = (tmp_path / "power_histogram.csv").read_text().splitlines()
    assert lines[2].startswith("power_low,power_high,count,standard_error")
    rows = np.array([[float(word) for word in line.split(",")] for line in lines[3:]])
    assert rows[:, 2].sum() == report["slipping"]
    assert (rows[1:, 0] == rows[:-1, 1]).all()
    with h5py.File(tmp_path / "power_histogram.h5") as file:
        assert file["count"][()].sum() == report["slipping"]
    assert "already exists" in refused("histogram", folder, "--out", tmp_path)


@pytest.mark.parametrize("words", [("histogram", "r"), ("analyse", "r"), ("reproduce",), ("benchmark", "speed")])
def test_a_folder_of_results_is_not_called_like_a_file(words, tmp_path):
    sentence = refused(*words, "--out", tmp_path / "x.csv")
    assert "x.csv" in sentence
    assert "give a name without .csv" in sentence
    assert not list(tmp_path.iterdir())


def test_a_block_of_seeds_is_summarised_for_people(tmp_path):
    done = bearings("run", "--shape", "6,7", "--replicas", 12, "--out", tmp_path / "r")
    assert done.returncode == 0, done.stderr
    assert "seed 9:" in done.stdout
    assert "2 more seeds" in done.stdout


def test_the_gap_between_slipping_and_slipless_contacts_is_told(tmp_path):
    done = bearings("run", "--shape", "5,5,5", "--out", tmp_path / "r", "--json")
    summary = json.loads(done.stdout)
    assert summary["method"] == "interior-point"
    assert summary["states_proven"] is True
    assert summary["largest_slipless_slip"] == 0
    assert summary["separation_decades"] > 10
    assert summary["undecided"] == 0
    told = bearings("run", "--shape", "5,5,5", "--out", tmp_path / "s").stdout
    assert "; all states proven" in told


def test_not_reaching_the_tolerance_is_exit_code_1_with_a_result(tmp_path):
    done = bearings(
        "run", "--shape", "4,5", "--method", "gradient-descent", "--tolerance", "1e-12", "--iterations", 50,
        "--out", tmp_path / "r", "--json",
    )  # fmt: skip
    assert done.returncode == 1
    assert json.loads(done.stdout)["status"] == "step-limit"
    assert (tmp_path / "r" / "run.h5").exists()


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize("what", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_saves_what_was_reached(tmp_path, what):
    from tests.cli.terminal import on_terminal

    words = ("--shape", "16,16,16", "--method", "gradient-descent", "--tolerance", "1e-13", "--iterations", 100000000)
    session = on_terminal("run", *words, "--out", tmp_path / "r", "--json", stop="iterations", by=what)
    assert session.returncode == 130, session.raw
    assert b"Traceback" not in session.raw
    assert json.loads(session.stdout)["status"] == "interrupted"
    assert (tmp_path / "r" / "run.h5").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


BAD = {
    "option of other methods": (("--stiffness", "2e5"), "with the law coulomb does not use it; it needs --method cund"),
    "option of another dynamics": (
        ("--method", "rigid-limit", "--static-ratio", "1.2"),
        "static_ratio is 1.2, but rigid-limit with the law coulomb does not use it",
    ),
    "option of other laws": (("--law", "viscous", "--normal-force", "2"), "it needs --law coulomb or coulomb-viscous"),
    "height of 2": (("--shape", "5,5,2"), "must be 3 or more"),
    "tolerance of 0": (("--tolerance", "0"), "above 0"),
    "negative seed": (("--seed", "-1"), "0 or more"),
    "null direction": (("--direction", "0,0,0"), "not all zero"),
    "unknown distribution": (("--distribution", "cauchy:1"), "allowed are"),
    "missing coefficients": (("--coefficients", "nowhere.npz"), "does not exist"),
    "too large a step": (("--method", "cundall-strack", "--time-step", "1"), "stable only for time steps up to"),
    "huge seed": (("--seed", "99999999999999999999999"), "below 2^62"),
    "too many replicas": (("--replicas", "100000000"), "of memory"),
    "replicas beyond 32 bits": (("--replicas", "100000000000"), "it must be a whole number from 1 to 2,147,483,648"),
    "missing scene": (("none.toml",), "does not exist"),
    "scene without a name": (("",), "scene file scene.toml does not exist"),
    "arrays as a scene": (("arrays.npz",), "is not a text in UTF-8; --coefficients or --packing reads arrays"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_exit_code_2(name, tmp_path):
    words, expected = BAD[name]
    shape = () if "--shape" in words else ("--shape", "3,3,4")
    if "arrays.npz" in words:
        np.savez(tmp_path / "arrays.npz", x=np.full((3, 5), 0.3))
    before = list(tmp_path.iterdir())
    assert expected in refused("run", *shape, *words, "--out", tmp_path / "r", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == before


def test_bad_files_are_named(tmp_path):
    def said_of(text):
        (tmp_path / "scene.toml").write_text(text)
        return refused("run", tmp_path / "scene.toml", cwd=tmp_path)

    assert "did you mean 'shape'" in said_of("shpe = [3, 3, 3]\n")
    assert "not valid TOML" in said_of("shape = [3, 3, 3\n")
    assert "shape is 'three'" in said_of('shape = "three"\n')
    assert "seed is 'True'" in said_of("seed = true\n")
    assert said_of("law = ['coulomb']\n").endswith(
        "law is ['coulomb']; it must be one of coulomb, viscous, coulomb-viscous"
    )
    np.savez(tmp_path / "mu.npz", x=np.ones((2, 3, 3)), y=np.ones((3, 2, 3)), z=-np.ones((3, 3, 2)))
    cube = "shape = [3, 3, 3]\ncoefficients = 'mu.npz'\n"
    assert "coefficient -1.0 at [0, 0, 0] along z" in said_of(cube)
    assert "shape is 3x4x3, but the coefficients" in said_of(cube.replace("3, 3, 3", "3, 4, 3"))
    (tmp_path / "mu.npz").write_bytes((tmp_path / "mu.npz").read_bytes()[:300])
    assert "truncated" in said_of(cube)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mu.npz", "scene.toml"]


def test_a_dynamics_is_not_at_rest_before_it_has_begun(tmp_path):
    """Springs that have not loaded yet look stationary; the certificate knows better. Powers scale with the spins."""
    powers = []
    for name, top in (("a", "1e-4"), ("b", "1")):
        words = ("--shape", "4,4", "--method", "cundall-strack", "--spin-top", top, "--tolerance", "1e-4")
        done = bearings("run", *words, "--iterations", 3_000_000, "--out", tmp_path / name, "--json")
        assert done.returncode == 0, done.stderr
        powers.append(json.loads(done.stdout)["power"] / float(top))
    assert powers[0] == pytest.approx(powers[1], rel=2e-4)


def test_equal_coefficients_are_resolved(tmp_path):
    done = bearings("run", "--shape", "4,4,5", "--distribution", "constant:0.5", "--out", tmp_path / "r", "--json")
    summary = json.loads(done.stdout)
    assert summary["power"] == pytest.approx(200, rel=1e-6)
    assert (summary["undecided"], summary["tied"], summary["unproven"]) == (64, 0, summary["contacts"])
    assert summary["states_proven"] is False  # any layer of 16 contacts between bottom and top may slip
    assert summary["minimum_is_unique"] is None


def test_nothing_is_overwritten_unless_asked(finished_run, tmp_path):
    folder, _ = finished_run
    before = (folder / "run.h5").read_bytes()
    assert "already exists" in refused("run", *SMALL, "--out", folder)
    assert (folder / "run.h5").read_bytes() == before
    (tmp_path / "precious.txt").write_text("mine")
    assert "not a run directory" in refused("run", *SMALL, "--out", tmp_path, "--force")
    assert (tmp_path / "precious.txt").read_text() == "mine"
    assert "cannot be written" in refused("run", *SMALL, "--out", "/dev/null/run")
    first = bearings("run", *SMALL, "--out", tmp_path / "r", "--json")
    second = bearings("run", *SMALL, "--seed", 8, "--out", tmp_path / "r", "--force", "--json")
    assert second.returncode == 0, second.stderr
    assert json.loads(first.stdout)["power"] != json.loads(second.stdout)["power"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["precious.txt", "r"]


def test_damaged_runs_are_refused(finished_run, tmp_path):
    damaged = tmp_path / "run.h5"
    damaged.write_bytes((finished_run[0] / "run.h5").read_bytes()[:5000])
    for words in (
        ("histogram", damaged),
        ("plot", "spins", damaged),
        ("plot", "spins", tmp_path / "none"),
        ("run", damaged),
    ):
        refused(*words, cwd=tmp_path)


def test_a_time_step_too_long_for_the_course_is_said_with_a_number(tmp_path):
    words = ("--shape", "4,5", "--method", "cundall-strack", "--initial", "random", "--duration", "2")
    soft = bearings("run", *words, "--stiffness", "1e3", "--damping", "0.5", "--out", tmp_path / "soft")
    assert soft.returncode == 0, soft.stderr
    assert "warning: the time step makes spins wrong by about 2." in soft.stderr
    summary = json.loads((tmp_path / "soft" / "summary.json").read_text())
    step = str(summary["accurate_time_step"])
    assert f"--time-step {float(step):.2g} keeps" in soft.stderr
    short = ("--stiffness", "1e3", "--damping", "0.5", "--time-step", step, "--out", tmp_path / "short", "--json")
    short = json.loads(bearings("run", *words, *short).stdout)
    assert short["step_error"] <= 1e-2 < summary["step_error"]
    assert short["accurate_time_step"] == float(step)


def test_help_leaves_out_what_few_need_and_all_help_has_it():
    short, full = (bearings("run", word).stdout for word in ("--help", "--help-all"))
    for name, item in settings_table().items():
        told = f"--{name.replace('_', '-')}"
        assert f"{told} " in full or f"{told}\n" in full, name
        assert (re.search(rf"{told}\b(?!-)", short) is None) == item.rare, name
    assert [short.index(title) for title in ("What is solved:", "How:", "Files and output:")] == sorted(
        short.index(title) for title in ("What is solved:", "How:", "Files and output:")
    )


def test_the_list_of_commands_has_each_once():
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(COMMANDS)


@pytest.mark.parametrize(("word", "option"), [("--friction", "--distribution"), ("--size", "--shape")])
def test_an_option_under_another_name_is_refused_with_the_name_it_has_here(word, option, tmp_path):
    assert f"Did you mean '{option}'?" in refused("run", word, "1", cwd=tmp_path)
    (tmp_path / "scene.toml").write_text(f"{word.strip('-')} = 1\n")
    assert f"did you mean '{option.strip('-')}'?" in refused("run", "scene.toml", cwd=tmp_path)


def test_the_help_says_which_laws_a_method_refuses():
    shown = " ".join(bearings("run", "--help").stdout.split()).replace("- ", "-")  # lines end at hyphens, too
    for name, row in METHODS.items():
        laws = [law.name for law in LAWS.values() if row.solves(law)]
        assert (f"{name}: law {' or '.join(laws)}" in shown) == (len(laws) < len(LAWS)), name


def test_every_number_of_a_summary_and_an_analysis_is_listed_with_unit_and_meaning(finished_run):
    folder, summary = finished_run
    listed = json.loads(bearings("info", "--quantities", "--json").stdout)
    known = {name: row for rows in listed.values() for name, row in rows.items()}
    beside = {
        "run",
        "settings",
        "versions",
        "arch",
        "precision",
        "threads",
        "coefficients",
    }  # of the run, not the answer
    assert set(summary) - beside <= set(known)
    analysed = json.loads(bearings("analyse", folder, "--no-figures", "--json").stdout)
    assert set(analysed) - {"files", "run", "threshold", "states"} <= set(known)
    assert known["yield_torque"] == {"unit": "force*length", "meaning": "torque above which the top is proven to move"}
    shown = bearings("info", "--quantities").stdout
    assert re.search(r"^  smallest_slipping_slip +length/time +smallest slip speed of a contact", shown, re.MULTILINE)
    assert "leave out PACKING" in refused("info", "--quantities", "some.npz")
