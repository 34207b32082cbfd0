"""Dumps of LAMMPS: numbers by hand, a packing there and back, and files of strangers."""

import numpy as np
import pytest

import taichi_bearings as tb

ATOMS = """ITEM: TIMESTEP
100
ITEM: NUMBER OF ATOMS
1
ITEM: BOX BOUNDS pp ff ff
0 4
0 2
0 2
ITEM: ATOMS id type x y z diameter omegax omegay omegaz
1 1 9 9 9 1 0 0 0
ITEM: TIMESTEP
200
ITEM: NUMBER OF ATOMS
3
ITEM: BOX BOUNDS pp ff ff
0.0 4.0
0.0000000000000000e+00 2
0 2
ITEM: ATOMS id type x y z diameter omegax omegay omegaz
30 2 3.5 1 1 1.0 0 0 7
10 1 0.5 1 1 1 1 2 3
20 1 0.5 1.75 1 0.5 0 0 0
"""
CONTACTS = """ITEM: TIMESTEP
200
ITEM: NUMBER OF ENTRIES
3
ITEM: BOX BOUNDS pp ff ff
0 4
0 2
0 2
ITEM: ENTRIES index c_pair[1] c_pair[2] c_fn
1 10 20 2.5
2 10 30 0.5
3 30 20 0
"""
COLUMNS = ("c_pair[1]", "c_pair[2]", "c_fn")


def read(folder, atoms=ATOMS, contacts=CONTACTS, **others):
    (folder / "atoms").write_bytes(atoms if isinstance(atoms, bytes) else atoms.encode())
    (folder / "contacts").write_bytes(contacts if isinstance(contacts, bytes) else contacts.encode())
    return tb.Packing.from_lammps(folder / "atoms", folder / "contacts", COLUMNS, **{"driven_types": {2: 0}} | others)


def test_numbers_of_a_dump_are_those_worked_out_by_hand(tmp_path):
    found = read(tmp_path)
    assert found.center.tolist() == [[0.5, 1, 1], [0.5, 1.75, 1], [3.5, 1, 1]]  # by id
    assert found.radius.tolist() == [0.5, 0.25, 0.5]
    assert found.contact.tolist() == [[0, 1], [0, 2]]  # the third one bears no force
    assert found.normal.tolist() == [[0, 1, 0], [-1, 0, 0]]  # the second across the periodic side
    assert found.normal_force.tolist() == [2.5, 0.5]
    assert found.driven.tolist() == [-1, -1, 0]
    assert found.spin[2].tolist() == [0, 0, 7]
    named = read(
        tmp_path, driven_types=None, driven={10: 1, 20: 0}, spin={0: (0, 0, 1), 1: (1, 0, 0)}, friction=[0.1, 0.2]
    )
    assert named.driven.tolist() == [1, 0, -1]
    assert named.spin[:2].tolist() == [[1, 0, 0], [0, 0, 1]]
    assert named.friction.tolist() == [0.1, 0.2]


def as_dumps(packing, side, rng):
    """Text of a packing with periodic lateral sides, atoms in any order, places as they are."""
    flat = packing.dimension == 2
    pad = lambda values: np.column_stack([values, np.zeros(len(values))]) if flat else values  # noqa: E731
    center, box = pad(packing.center), [f"0 {side!r}"] * (packing.dimension - 1) + ["-1 99"] * (4 - packing.dimension)
    flags = " ".join(["pp"] * (packing.dimension - 1) + ["ff", "pp"])[:8]
    spin = np.column_stack([np.zeros((packing.spheres, 2)), packing.spin]) if flat else packing.spin
    head = (
        "ITEM: TIMESTEP\n{}\nITEM: NUMBER OF {}\n{}\n" + f"ITEM: BOX BOUNDS {flags}\n" + "\n".join(box) + "\nITEM: {}"
    )
    rows = [
        " ".join(map(repr, [int(i) + 1, int(packing.driven[i]) + 2, *center[i].tolist(), float(packing.radius[i])]))
        + " " + " ".join(map(repr, spin[i].tolist()))
        for i in rng.permutation(packing.spheres)
    ]  # fmt: skip
    atoms = head.format(7, "ATOMS", len(rows), "ATOMS id type x y z radius omegax omegay omegaz\n")
    pairs = [f"{i + 1} {j + 1} {f!r}" for (i, j), f in zip(packing.contact, packing.normal_force.tolist(), strict=True)]
    contacts = head.format(7, "ENTRIES", len(pairs), "ENTRIES c_pair[1] c_pair[2] c_fn\n")
    return atoms + "\n".join(rows) + "\n", contacts + "\n".join(pairs) + "\n"


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_packing_is_the_same_there_and_back(tmp_path, dimension):
    rng = np.random.default_rng(8)
    packing = tb.Packing.random(90, dimension, width=7.0, seed=5, spin_bottom=0.25)
    again = read(
        tmp_path,
        *as_dumps(packing, 7.0, rng),
        driven_types={2: 0, 3: 1},
        dimension=dimension,
        friction=packing.friction,
    )
    for name, values in packing.arrays().items():
        assert np.asarray(getattr(again, name)) == pytest.approx(values, abs=1e-15, rel=1e-15), name
    assert tb.solve(again).power == pytest.approx(tb.solve(packing).power, rel=1e-9)


WRONG = [
    (ATOMS.replace("pp ff ff", "xy xz yz pp ff ff"), CONTACTS, "at line 16 a row of 3 numbers is expected"),
    (
        ATOMS.replace("pp ff ff", "pp ff"),
        CONTACTS,
        'at line 15 the line "ITEM: BOX BOUNDS" must end with three boundary flags',
    ),
    (
        ATOMS.replace("ATOMS\n3", "ATOMS\n4"),
        CONTACTS,
        "no timestep is complete in both .* at line 23, where row 4 of 4 is expected",
    ),
    (
        ATOMS.replace("ATOMS\n3", "ATOMS\n2"),
        CONTACTS,
        'at line 22 the line "ITEM: TIMESTEP" must follow the 2 rows that the header announces',
    ),
    (ATOMS.replace("ATOMS\n3", "ATOMS\n99999999999999"), CONTACTS, "line 14 must be a whole number"),
    (ATOMS.replace("10 1 0.5", "10 1 zero"), CONTACTS, "at line 21 a row of 9 numbers is expected"),
    (ATOMS.replace("10 1 0.5", "1_0 1 0.5"), CONTACTS, "at line 21 a row of 9 numbers is expected"),
    (
        ATOMS.replace("10 1 0.5", "10.5 1 0.5"),
        CONTACTS,
        "at line 21 a row of 9 numbers is expected, with whole ones for ids and types",
    ),
    (ATOMS.replace("10 1 0.5", "20 1 0.5"), CONTACTS, "line 22 of .* has atom 20 a second time"),
    (
        ATOMS.replace("10 1 0.5", "10 1 nan"),
        CONTACTS,
        "line 21 of .* has the value nan for atom 10; numbers must be finite",
    ),
    (ATOMS.replace("0.5 1 1 1 1", "0.5 1 1 0 1"), CONTACTS, "line 21 of .*: the radius of atom 10 is 0; it must be"),
    (ATOMS.replace("diameter", "mass"), CONTACTS, "must have exactly one column diameter"),
    (ATOMS.replace("0.0 4.0", "4.0 0.0"), CONTACTS, "each must have a lower and a larger upper bound"),
    (
        ATOMS.replace("0.0 4.0", "0.0 2.0"),
        CONTACTS.replace("0 4", "0 2"),
        "atoms 10 and 30 touch both directly and across a periodic side",
    ),
    (
        ATOMS,
        CONTACTS.replace("200", "300"),
        "no timestep is complete in both .*contacts has no timestep 200",
    ),
    (ATOMS, CONTACTS.replace("2 10 30", "2 10 31"), "line 11 of .* has a contact of atom 31"),
    (
        ATOMS,
        CONTACTS.replace("3 30 20 0", "3 30 20 1"),
        "line 12 of .*: atoms 30 and 20 are 1.25 apart and their radii add up to 0.75",
    ),
    (
        ATOMS,
        CONTACTS.replace("3 30 20 0", "3 10 20 1"),
        "line 12 of .*: the contact of atoms 10 and 20 is there a second time",
    ),
    (ATOMS, CONTACTS.replace("c_fn", "fn"), "must have exactly one column c_fn; its columns are index c_pair"),
    ("", CONTACTS, "atoms is no LAMMPS dump"),
]


@pytest.mark.parametrize(("atoms", "contacts", "words"), WRONG, ids=range(len(WRONG)))
def test_what_is_no_dump_is_one_sentence_with_its_line(tmp_path, atoms, contacts, words):
    with pytest.raises(tb.InputError, match=words) as told:
        read(tmp_path, atoms, contacts)
    assert "\n" not in str(told.value)


def test_spins_must_be_in_the_dump_or_given(tmp_path):
    atoms = ATOMS.replace(" omegax omegay omegaz", " a b c")
    assert atoms != ATOMS
    with pytest.raises(tb.InputError, match=r"no column omegax; give spin, .* spin=\{0: \(0, 0, 0\), 1: \(1, 1, 0\)\}"):
        read(tmp_path, atoms)
    assert read(tmp_path, atoms, spin={0: (0, 0, 7)}).spin.tolist() == [[0, 0, 0], [0, 0, 0], [0, 0, 7]]


def test_what_is_asked_for_must_be_there(tmp_path):
    for others, words in [
        ({"step": 100, "driven_types": {1: 0}}, "timestep 100 must be complete in both .* it is missing or cut off"),
        ({"step": 150}, "timestep 150 must be complete in both .* it is missing or cut off"),
        ({"driven_types": {3: 0}}, "driven names 3, but the dump has no atom or type of that number"),
        ({"driven": {10: 0}}, "either driven .* or driven_types"),
        ({"spin": {1: (0, 0, 1)}}, "spin lacks body 0"),
        ({"spin": {0: 0, 1: 1}}, "spin of body 0 is 0; it must be three numbers"),
        ({"dimension": 4}, "dimension is 4"),
    ]:
        with pytest.raises(tb.InputError, match=words):
            read(tmp_path, **others)
