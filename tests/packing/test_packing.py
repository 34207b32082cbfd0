"""What comes in: each thing that is no packing is refused in one sentence; files give back what was put."""

import numpy as np
import pytest

import taichi_bearings as tb

ROW = {"center": [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], "contact": [[0, 1], [1, 2]], "driven": [0, -1, 1]}
ROW |= {"spin": [1.0, np.nan, 0.0], "friction": [0.5, 0.2]}

WRONG = [
    ({"center": [[0, 0], [1, np.nan], [2, 0]]}, "center of sphere 1"),
    ({"center": [[0, 0], [1, 0], [1, 0]]}, "spheres 1 and 2 have the same centre"),
    ({"center": [0, 1, 2]}, r"center has shape \(3,\)"),
    ({"center": np.zeros((0, 2))}, r"center has shape \(0, 2\)"),
    ({"center": [["a", "b"]]}, "centres are of type"),
    ({"contact": [[0, 1], [1, 3]]}, r"contact 1 is between \[1, 3\]"),
    ({"contact": [[0, 1], [-1, 2]]}, r"contact 1 is between \[-1, 2\]"),
    ({"contact": [[0, 1], [2, 2]]}, "contact 1 is of sphere 2 with itself"),
    ({"contact": [[0, 1], [0, 2]]}, "contact 1 does not touch"),
    ({"contact": [[0, 1], [1, 0]]}, "contacts 0 and 1 both join spheres 0 and 1"),
    ({"contact": [[0.0, 1.0], [1.0, 1.5]]}, "contact holds 1.5; it must hold whole numbers"),
    ({"contact": [[0.0, np.nan], [1.0, 2.0]]}, "contact holds nan"),
    ({"contact": [["0", "1"], ["1", "2"]]}, "contact is of type"),
    ({"contact": [[1, 2], [2, 3]]}, "contacts seem to count from 1"),
    ({"contact": [0, 1]}, r"contact has shape \(2,\)"),
    ({"contact": np.array([[0, 2**63], [1, 2]], dtype=np.uint64)}, "at most 9223372036854775807 is allowed"),
    ({"driven": [0, -2, 1]}, "driven of sphere 1 is -2"),
    ({"driven": [0, 7, 1]}, "driven of sphere 1 is 7"),
    ({"driven": [0, -1]}, r"driven has shape \(2,\)"),
    ({"spin": [np.inf, 0, 0]}, "spin of sphere 0"),
    ({"spin": np.zeros((3, 3))}, r"spin has shape \(3, 3\)"),
    ({"radius": [0.5, -0.5, 0.5]}, "radius of sphere 1 is -0.5"),
    ({"radius": 0.4}, "contact 0 does not touch"),
    ({"radius": [0.5, 0.5]}, r"radius has shape \(2,\)"),
    ({"normal": [[1.0, 0.0], [0.9, 0.0]]}, "normal of contact 1 has length 0.9"),
    ({"normal": [[1.0, 0.0]]}, r"normal has shape \(1, 2\)"),
    ({"friction": [0.5, -0.1]}, "friction of contact 1 is -0.1"),
    ({"friction": [0.5, np.nan]}, "friction of contact 1 is nan"),
    ({"friction": [0.5]}, r"friction has shape \(1,\)"),
    ({"viscosity": [0.5, 0.5], "law": "coulomb"}, "viscosity is given"),
    ({"normal_force": 0.0}, "normal_force of contact 0 is 0"),
    ({"normal_force": [1.0, np.nan]}, "normal_force of contact 1 is nan"),
    ({"law": "columb"}, "did you mean 'coulomb'"),
    ({"friction": None, "distribution": "uniform:2"}, "uniform is written"),
]


@pytest.mark.parametrize(("change", "words"), WRONG, ids=lambda value: value if isinstance(value, str) else "")
def test_what_is_no_packing_is_refused(change, words):
    with pytest.raises(tb.InputError, match=words) as told:
        tb.Packing(**ROW | change)
    assert "\n" not in str(told.value)


def test_arrays_are_copied_and_defaults_drawn_in_the_order_of_the_contacts():
    packing = tb.Packing(**ROW | {"friction": None, "seed": 7})
    assert np.array_equal(packing.friction, np.random.default_rng(7).uniform(0.1, 1.0, 2))
    assert np.array_equal(packing.normal, [[1, 0], [1, 0]])
    assert packing.spin[1] == 0  # ignored on free discs
    assert not packing.friction.flags.writeable


def test_a_ring_of_two_has_two_contacts():
    turned = {"center": [[0, 0], [1, 0], [1, 1]], "contact": [[0, 1], [1, 0], [1, 2]], "friction": [0.5, 0.2, 0.1]}
    packing = tb.Packing(**ROW | turned | {"normal": [[1, 0], [1, 0], [0, 1]]})
    assert packing.contacts == 3
    with pytest.raises(tb.InputError, match="both join spheres 0 and 1"):
        tb.Packing(**ROW | turned | {"normal": [[1, 0], [-1, 0], [0, 1]]})


@pytest.mark.parametrize("name", ["a.npz", "a.h5"])
@pytest.mark.parametrize("kind", ["honeycomb", "bcc"])
def test_files_give_back_what_was_put(tmp_path, name, kind):
    cells = (2, 3) if kind == "honeycomb" else (2, 3, 2)
    packing = tb.Packing.lattice(kind, cells, "x", law="coulomb-viscous", seed=3)
    again = tb.Packing.load(packing.save(tmp_path / name))
    for key, values in packing.arrays().items():
        assert np.array_equal(values, getattr(again, key)), key
    assert again.law is packing.law
    with pytest.raises(tb.BearingsError, match="cannot be written"):
        packing.save(tmp_path / name)


def test_strange_lattices_are_refused():
    for arguments, words in [
        (("cube", (2, 2, 2)), "did you mean 'cubic'"),
        (("bcc", (2, 2)), "3 whole numbers"),
        (("bcc", (2, 0, 2)), "3 whole numbers"),
        (("bcc", (2, 2.5, 2)), "whole numbers"),
        (("bcc", (1, 2, 2), ("x",)), "2 or more"),
        (("square", (2, 2), ("z",)), "names of axes"),
        (("cubic", (10**9, 10**9, 10**9)), "at most .* spheres in all"),
    ]:
        with pytest.raises(tb.InputError, match=words):
            tb.Packing.lattice(*arguments)
