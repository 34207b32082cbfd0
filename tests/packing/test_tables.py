"""Contacts found out of centres and radii, by trees or by all pairs; tables of spheres and contacts."""

import itertools
import json

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.scene.periods import nearest_images
from tests.cli.commands import bearings, refused
from tests.scenes import BIPARTITE, cells_of


def all_pairs(center, radius, tolerance, length):
    """Contacts by trying every image of every pair."""
    found = set()
    steps = [(0,) if not side else (-1, 0, 1) for side in length]
    for (i, j), step in itertools.product(itertools.combinations(range(len(center)), 2), itertools.product(*steps)):
        reach = radius[i] + radius[j]
        apart = np.linalg.norm(center[j] + np.multiply(step, length) - center[i])
        if abs(apart - reach) <= tolerance * reach:
            found.add((i, j, step))
    return found


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dimension", [2, 3])
def test_contacts_are_those_of_all_pairs_and_images(dimension, seed):
    ratio, width = (3.0, 12.5) if seed % 2 else (1.2, 5.0)
    packing = tb.Packing.random(70, dimension, ratio=ratio, width=width, seed=seed)
    length = [width] * (dimension - 1) + [0.0]
    center = packing.center + np.random.default_rng(seed).integers(-1, 2, packing.center.shape) * length  # anywhere
    found = tb.Packing.from_centers(center, packing.radius, 1e-6, periodic=length, seed=seed)
    inside = np.where(np.array(length) > 0, np.mod(center, np.where(length, length, 1)), center)
    pairs = all_pairs(inside, packing.radius, 1e-6, length)
    assert found.contacts == len(pairs) == packing.contacts
    assert sorted(map(tuple, found.contact.tolist())) == sorted(pair[:2] for pair in pairs)
    reach = packing.radius[found.contact].sum(axis=1)
    off = found.center[found.contact[:, 1]] - found.center[found.contact[:, 0]] - found.normal * reach[:, None]
    assert np.abs(off - np.round(off / width) * width)[:, :-1].max() < 1e-5
    whole = {"driven": packing.driven, "spin": packing.spin, "friction": [1.0] * packing.contacts}
    other = tb.Packing(**packing.arrays() | {"friction": [1.0] * packing.contacts})
    found = tb.Packing.from_centers(center, packing.radius, 1e-6, periodic=length, **whole)
    assert tb.solve(found).power == pytest.approx(tb.solve(other).power, rel=1e-8)


@pytest.mark.parametrize("kind", BIPARTITE)
def test_lattices_are_found_again_with_what_is_driven(kind):
    one = tb.Packing.lattice(kind, cells_of(kind))
    two = tb.Packing.from_centers(one.center, one.radius, spin_bottom=0.25, spin_top=-2.0, direction=(0, 3, 4))
    assert {tuple(sorted(c)) for c in one.contact.tolist()} == {tuple(c) for c in two.contact.tolist()}
    assert np.array_equal(one.driven, two.driven)
    spin = two.spin[two.driven == 1]
    assert np.allclose(spin, -2.0 if one.dimension == 2 else [0, -1.2, -1.6])


def test_a_large_sphere_among_many_small_ones_costs_no_more_than_they_do():
    """A disc of radius 100 with 627 of radius 0.5 around it in a ring that touches it."""
    angle = 2 * np.pi * np.arange(627) / 628.5
    center = np.vstack([[0, 0], 100.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    radius = np.append(100.0, np.full(627, 0.5))
    driven = np.full(628, -1)
    driven[:2] = 0, 1
    found = tb.Packing.from_centers(center, radius, 0.002, driven=driven)
    assert (found.contact[:, 0] == 0).sum() == 627
    assert found.contacts >= 627


WRONG = [
    ({"radius": 1.0}, "overlap by 0.5 of that, more than the tolerance 0.001; radii look like diameters"),
    (
        {"radius": 0.3},
        "no two spheres touch within the tolerance 0.001 .*check that radii and centres have the same unit",
    ),
    ({"tolerance": 0.2}, "tolerance is 0.2; it must be from 0 to 0.05"),
    ({"radius": [0.5, 0.5]}, "radius has shape"),
    ({"periodic": (3, 3)}, "it must be 3 lengths"),
    ({"periodic": (1.0, 3, 0)}, "each length must exceed the largest diameter, 1"),
    ({"periodic": (3, 3, 4)}, "z is periodic, so there is no bottom"),
    ({"driven": [5] + [-1] * 35}, "driven of sphere 0 is 5; without an array `spin` it must be -1"),
]


@pytest.mark.parametrize(("change", "words"), WRONG, ids=range(len(WRONG)))
def test_what_is_not_found_is_one_sentence(change, words):
    center = tb.Packing.lattice("cubic", (3, 3, 4)).center
    with pytest.raises(tb.InputError, match=words) as told:
        tb.Packing.from_centers(**{"center": center} | change)
    assert "\n" not in str(told.value)


def test_nearest_images_in_tilted_boxes_are_those_of_many_images():
    rng = np.random.default_rng(4)
    for _ in range(40):
        periods = np.diag(rng.uniform(1, 30, 3)) + np.tril(rng.uniform(-40, 40, (3, 3)), -1)
        vector = rng.uniform(-60, 60, (50, 3))
        found, _ = nearest_images(vector, periods, np.zeros(50))
        steps = np.array(list(itertools.product(range(-9, 10), repeat=3)))
        near = vector - np.round(vector @ np.linalg.inv(periods)) @ periods
        least = np.linalg.norm(near[:, None] + (steps @ periods)[None], axis=2).min(axis=1)
        assert (np.linalg.norm(found, axis=1) <= least * (1 + 1e-9)).all()
        whole = (vector - found) @ np.linalg.inv(periods)
        assert np.abs(whole - np.round(whole)).max() < 1e-6


BODY = (0, -1, -1, -1, 1)
SPHERES = "id,x,y,r,driven\n" + "".join(f"{i + 10},{i},0,0.5,{BODY[i]}\n" for i in range(5))
CONTACTS = "i,j,fn,mu\n" + "".join(f"{i + 10},{i + 11},1.0,0.{i + 2}\n" for i in range(4))
TORN = [
    (SPHERES[:-1], CONTACTS, r"line 6, the last one, has no line break"),
    (SPHERES, CONTACTS[:-2], r"line 5, the last one, has no line break"),
    (SPHERES.replace("12,2,0", "12,2;0"), CONTACTS, r"line 4 of .* has 4 cells; it must have 5, as many as the header"),
    (SPHERES.replace("12,2,0", "12,two,0"), CONTACTS, r"line 4 of .* has 'two' for x; it must be a number"),
    (SPHERES.replace("12,2,0", "12,nan,0"), CONTACTS, r"line 4 of .* has 'nan' for x; it must be finite"),
    (SPHERES.replace("12,2,0", "11,2,0"), CONTACTS, r"has the id 11 twice"),
    (SPHERES.replace("r,", "rad,"), CONTACTS, r"line 1 of .* names an unknown column 'rad'"),
    (SPHERES.replace(",y", ",r"), CONTACTS, r"must have a column y"),
    (SPHERES.partition("\n")[2], CONTACTS, r"line 1 of .* names an unknown column '10'"),
    ("", CONTACTS, r"has no header such as x,y"),
    (SPHERES, CONTACTS.replace("13,14", "13,15"), r"row 4 of .* has a contact of sphere 15"),
    (SPHERES, CONTACTS.replace("13,14", "12,14"), r"contact 3 does not touch: spheres 2 and 4 are 2 apart"),
    (
        SPHERES.replace(",", ";").replace(";0;0.5", ";0,1;0.5"),
        CONTACTS,
        r"line 2 of .* has '0,1' for y.*decimal points",
    ),
]


@pytest.mark.parametrize(("spheres", "contacts", "words"), TORN, ids=range(len(TORN)))
def test_a_table_that_is_torn_is_refused_with_its_line(tmp_path, spheres, contacts, words):
    for name, text in (("spheres.csv", spheres), ("contacts.csv", contacts)):
        (tmp_path / name).write_text(text)
    with pytest.raises(tb.InputError, match=words) as told:
        tb.Packing.load(tmp_path / "spheres.csv", tmp_path / "contacts.csv")
    assert "\n" not in str(told.value)


def test_tables_are_solved_from_the_command_line(tmp_path):
    """Discs in a row: the weakest contact takes the difference of the driven spins, which turn against each other."""
    (tmp_path / "spheres.csv").write_text(SPHERES)
    (tmp_path / "contacts.csv").write_text(CONTACTS)
    words = ("run", "--packing", "spheres.csv", "--figures", "none", "--json", "--spin-bottom", "0.25", "--out")
    done = bearings(*words, "a", "--contacts", "contacts.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["power"] == pytest.approx(0.2 * 1.0 * 0.5 * (1.0 - 0.25))
    again = tb.load(tmp_path / "a")
    assert again.packing.friction.tolist() == [0.2, 0.3, 0.4, 0.5]
    (tmp_path / "lone.csv").write_text(SPHERES + "20,0,9,0.5,-1\n")
    done = bearings("run", "--packing", "lone.csv", "--figures", "none", "--json", "--out", "b", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    weakest = np.random.default_rng(0).uniform(0.1, 1.0, 4).min()
    assert told["power"] == pytest.approx(weakest * 50 * 0.5)
    assert any(
        "4 contacts found between 6 spheres, where gap or overlap is at most 0.001 of the sum of two radii; "
        "1 sphere touches nothing" in w
        for w in told["warnings"]
    )
    for others, sentence in [
        (
            ("--touching", "0.01", "--contacts", "contacts.csv"),
            "touching is 0.01, but contacts are those of contacts.csv",
        ),
        (("--radius", "0.6"), "radius is 0.6, but spheres.csv holds radius"),
        (("--shape", "3,3"), "but a packing does not use it"),
    ]:
        assert sentence in " ".join(refused("run", "--packing", "spheres.csv", *others, cwd=tmp_path).split())
    assert "only a packing that is a table" in refused("run", "--shape", "3,3", "--touching", "0.01", cwd=tmp_path)


def test_a_table_of_another_name_is_told_what_it_must_be(tmp_path):
    (tmp_path / "spheres.txt").write_text(SPHERES.replace(",", " "))
    said = refused("run", "--packing", "spheres.txt", cwd=tmp_path)
    assert "spheres.txt is a text file, but its name does not end in .csv; a table of centres is a .csv file" in said
    assert "whose first line names its columns, such as x,y,z,radius" in said


def test_spheres_that_touch_nothing_are_told(caplog):
    center = [[0.0, 0], [1, 0], [0, 1], [9, 0.5], [9, 3]]
    tb.Packing.from_centers(center, driven=[0, -1, 1, -1, -1])
    assert "2 contacts found between 5 spheres, where gap or overlap is at most 0.001 " in caplog.text
    assert "; 2 spheres touch nothing" in caplog.text
