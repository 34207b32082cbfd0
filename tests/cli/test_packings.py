"""Packings from the command line: runs, what they hold, and what others make of them."""

import json

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.checksums import seal
from tests.cli.commands import bearings, refused
from tests.packing.twins import pair

CONTRACT = (
    "power", "lower_bound", "gap", "status", "method", "law", "shape", "seed", "iterations", "seconds",
    "seconds_compile", "contacts", "slipping", "slipless", "largest_balance_residual", "run", "version",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("packings")
    tb.Packing.lattice("bcc", (3, 3, 3), seed=3, spin_bottom=0.2).save(place / "bcc.npz")
    bare = tb.Packing.lattice("triangular", (4, 3), periodic="x")
    np.savez(place / "bare.npz", center=bare.center, contact=bare.contact, driven=bare.driven, spin=bare.spin,
             normal=bare.normal)  # fmt: skip
    for name in ("bcc", "bare"):
        done = bearings("run", "--packing", f"{name}.npz", "--seed", "5", "--out", name, "--json", cwd=place)
        assert done.returncode == 0, done.stderr
        is_idle = "seed is 5, but bcc.npz holds all coefficients, so nothing is drawn from it"
        assert (is_idle in " ".join(done.stderr.split())) == (name == "bcc")
        (place / f"{name}.json").write_text(done.stdout)
    return place


def test_a_run_says_what_is_promised_and_holds_the_arrays(folder):
    told = json.loads((folder / "bcc.json").read_text())
    assert set(CONTRACT) <= told.keys()
    assert told["shape"] is None
    assert told["status"] == "certified"
    expected = tb.solve(tb.Packing.load(folder / "bcc.npz"))
    assert told["power"] == expected.power
    assert told["lower_bound"] == expected.lower_bound
    with h5py.File(folder / "bcc" / "run.h5") as file:
        for name, values in expected.packing.arrays().items():
            assert np.array_equal(file[f"packing/{name}"], values), name
        assert np.array_equal(file["spin"], expected.spin)
        assert file["spin"].shape == (54, 3)
        for name, values in (
            ("slip", expected.slip), ("power", expected.power_per_contact), ("force", expected.force),
            ("state", expected.state), ("friction", expected.friction),
        ):  # fmt: skip
            assert np.array_equal(file[f"contact/{name}"], values), name
            assert {"units", "description"} <= file[f"contact/{name}"].attrs.keys()
        assert file.attrs["power"] == told["power"]
        assert 'packing = "run.h5"' in file.attrs["scene"]


def test_coefficients_are_drawn_as_promised(folder):
    found = tb.load(folder / "bare").packing
    assert np.array_equal(found.friction, np.random.default_rng(5).uniform(0.1, 1.0, found.contacts))
    words = ("--law", "coulomb-viscous", "--viscosity", "uniform:2,3", "--radius", 0.5, "--distribution", "constant:1")
    done = bearings("run", "--packing", "bare.npz", *words, "--seed", "7", "--out", "viscous", cwd=folder)
    assert done.returncode == 0, done.stderr
    found = tb.load(folder / "viscous").packing
    assert np.array_equal(found.viscosity, np.random.default_rng([7, 2]).uniform(2, 3, found.contacts))
    assert (found.friction == 1).all()


@pytest.mark.parametrize("name", ["bcc", "bare"])
def test_a_run_reads_back_to_the_bit_and_runs_again_from_its_directory(folder, tmp_path, name):
    first = tb.load(folder / name)
    assert first.save(tmp_path / "saved") == tmp_path / "saved"
    done = bearings("run", folder / name, "--out", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    for place in ("saved", "again"):
        second = tb.load(tmp_path / place)
        for key in ("spin", "slip", "force", "friction", "state", "power_per_contact"):
            assert np.array_equal(getattr(first, key), getattr(second, key)), (place, key)
        assert (first.power, first.lower_bound, first.proof) == (second.power, second.lower_bound, second.proof)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--packing", "bcc.npz", "--periodic", "x"), "a packing does not use it"),
        (("--packing", "bcc.npz", "--shape", "4,4,4"), "a packing does not use it"),
        (("--packing", "bcc.npz", "--distribution", "constant:1"), "bcc.npz holds friction"),
        (("--packing", "bcc.npz", "--radius", "2"), "bcc.npz holds radius"),
        (("--packing", "bcc.npz", "--viscosity", "constant:1"), "the law coulomb does not use it"),
        (("--packing", "none.npz"), "none.npz does not exist"),
        (("--packing", "bcc.npz", "--out", "bcc"), "already exists"),
    ],
)
def test_what_cannot_be_is_one_sentence(folder, words, expected):
    assert expected in refused("run", *words, cwd=folder)


def test_others_draw_it_and_say_where_they_cannot(folder, tmp_path):
    for words in (("plot", "spins"), ("plot", "power"), ("plot", "network")):
        done = bearings(*words, folder / "bcc", "--out", tmp_path / f"{words[1]}.png")
        assert done.returncode == 0, done.stderr
        assert (tmp_path / f"{words[1]}.png").stat().st_size > 5000
    done = bearings("list", folder, "--json")
    runs = {entry["path"].split("/")[-1]: entry for entry in json.loads(done.stdout)["entries"]}
    assert runs["bcc"]["spheres"] == 54
    assert runs["bcc"]["status"] == "certified"
    assert "holds no snapshots to film" in refused("movie", folder / "bcc")


def test_paraview_gets_every_sphere_and_contact_and_images_over_periodic_sides(folder, tmp_path):
    done = bearings("export", folder / "bare", "--out", tmp_path / "a.vtkhdf", "--json")
    told, packing = json.loads(done.stdout), tb.load(folder / "bare").packing
    assert (told["points"], told["lines"]) == (packing.spheres, packing.contacts)
    assert told["images"] > 0
    with h5py.File(tmp_path / "a.vtkhdf") as file:
        points, ends = file["VTKHDF/Points"][()], file["VTKHDF/Lines/Connectivity"][()].reshape(-1, 2)
        step = points[ends[:, 1]] - points[ends[:, 0]]
        assert np.allclose(step[:, :2], packing.normal, atol=1e-9)  # of discs of diameter 1, images in their places
        assert len(file["VTKHDF/PointData/spin"]) == len(points)
        assert np.array_equal(file["VTKHDF/CellData/slip"], tb.load(folder / "bare").slip)


def test_its_structure_is_told_and_stored(tmp_path):
    scene, packing = pair((6, 6, 6), 1, spin_bottom=0.2)
    found, expected = tb.solve(packing), tb.analyse(tb.solve(scene, threads=1)).report
    found.save(tmp_path / "run")
    report = json.loads(bearings("analyse", tmp_path / "run", "--no-figures", "--json").stdout)
    for name in ("power", "power_minimum_cut", "power_over_cut", "slipless_fraction", "reached_fraction"):
        assert report[name] == pytest.approx(expected[name], rel=1e-9), name
    for name in ("states", "cut_is_unique", "cut_contacts", "components", "spans", "shortest_path", "disjoint_paths"):
        assert report[name] == expected[name], name
    shares = [[link["share"] for link in of["most_loaded"]] for of in (report, expected)]
    assert shares[0] == pytest.approx(shares[1])
    told = bearings("analyse", tmp_path / "run").stdout
    assert told.startswith("216 spheres, coulomb")
    assert f"{'yes' if expected['spans'] else 'no'}  whether slipless contacts join bottom and top" in told
    with h5py.File(tmp_path / "run" / "run.h5") as file:
        assert np.array_equal(file["analysis/on_cut"], tb.analyse(found).interface.contacts)
        assert file["analysis/betweenness"][:].max() == pytest.approx(report["busiest_link_share"] or 0)
    assert tb.load(tmp_path / "run").power == found.power  # the file is whole with its new group


def test_structure_before_anything_is_solved(folder):
    told = json.loads(bearings("info", folder / "bcc.npz", "--json").stdout)  # two corners dangle at one contact
    assert told["bipartite"]
    assert told["all_motions"] == 6
    assert told["bearing_state"] == "yes"
    told = json.loads(bearings("info", folder / "bare.npz", "--json").stdout)
    assert not told["bipartite"]
    assert told["smallest_odd_loop"] == 3
    assert told["all_motions"] == 0
    assert "idle_contacts" not in told


def test_contacts_without_normal_force_are_named_before_a_run_leaves_them_out(tmp_path):
    """Three discs in a row: without the second contact the middle one rolls on the first, whatever the third does."""
    row = {"center": [[0, 0], [1, 0], [2, 0]], "contact": [[0, 1], [1, 2]], "driven": [0, -1, 1], "spin": [1.0, 0, 0.5]}
    np.savez(tmp_path / "row.npz", **row, friction=[0.5, 0.5], normal_force=[50.0, 0.0])
    assert json.loads(bearings("info", tmp_path / "row.npz", "--json").stdout)["idle_contacts"] == 1
    done = bearings("info", tmp_path / "row.npz").stdout
    assert "contacts without normal force, counted here too" in done
    found = tb.solve(tb.Packing.load(tmp_path / "row.npz"), threads=1)
    assert (found.contacts, found.power) == (1, 0.0)


@pytest.mark.parametrize("options", [(), ("--method", "cundall-strack", "--duration", "0.02", "--snapshots", "0,0.02")])
def test_replicas_are_the_bits_of_single_runs(folder, tmp_path, needs_f64, options):
    """With a leading axis in every array; a run of several runs again from its directory."""
    words = ("run", "--packing", folder / "bare.npz", "--seed", "5", "--replicas", "2", "--initial", "random", *options)
    words = tuple(word for word in words if options or word not in ("--initial", "random"))
    done = bearings(*words, "--out", tmp_path / "both", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    both = tb.load(tmp_path / "both")
    with h5py.File(tmp_path / "both" / "run.h5") as file:
        assert all(item.shape[0] == 2 for item in (file["spin"], *file["packing"].values(), *file["contact"].values()))
    for seed, found in zip((5, 6), both, strict=True):
        packing = tb.Packing.load(folder / "bare.npz", seed=seed)
        method = {"method": "cundall-strack", "start": "random", "duration": 0.02, "snapshots": [0, 0.02]}
        single = tb.solve(packing, **(method if options else {}))
        for name in ("spin", "slip", "force", "friction", "power_per_contact", "state", "proven"):
            np.testing.assert_array_equal(getattr(found, name), getattr(single, name), err_msg=name)
        assert np.array_equal(found.packing.friction, packing.friction)
        assert {name: told[name][seed - 5] for name in ("seed", "power", "lower_bound", "gap", "status")} == {
            "seed": seed, "power": single.power, "lower_bound": single.lower_bound, "gap": single.gap,
            "status": single.status,
        }  # fmt: skip
        if options:
            assert np.array_equal(found.snapshots.spin, single.snapshots.spin)
            assert np.array_equal(found.history["power"], single.history["power"])
    again = bearings("run", tmp_path / "both", "--out", tmp_path / "again", "--json")
    assert json.loads(again.stdout)["power"] == told["power"]
    verdict = json.loads(bearings("verify", tmp_path / "both", "--json").stdout)
    assert verdict["verified"]
    assert (verdict["power"], verdict["lower_bound"], verdict["seed"]) == (told["power"], told["lower_bound"], [5, 6])
    with h5py.File(tmp_path / "both" / "run.h5", "r+") as file:
        file["contact/slip"][1, 3] *= 2
        file["contact/slip"][1, 3] += 1
        seal(file)
    verdict = json.loads(bearings("verify", tmp_path / "both", "--json").stdout)
    assert verdict["contradictions"]
    assert all(sentence.startswith("sample 1: ") for sentence in verdict["contradictions"])
