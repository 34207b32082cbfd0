"""Redundant arrays held against each other: what is mixed up is refused with its remedy, what is right is taken."""

import numpy as np
import pytest

import taichi_bearings as tb


def bcc(**others):
    return tb.Packing.lattice("bcc", (3, 3, 4), seed=1, **others)


def mixed_up(packing, kind):
    """The arrays of a packing, wrong in one way, and words of the sentence that refuses them."""
    arrays, rng = packing.arrays(), np.random.default_rng(0)
    order = rng.permutation(packing.contacts)
    if kind == "normals":
        return arrays | {"normal": arrays["normal"][order]}, "contact"
    if kind == "contacts":
        return arrays | {"contact": arrays["contact"][order]}, "contact"
    if kind == "units":
        return arrays | {"center": arrays["center"] * 1000}, "in different units: distances are 1e"
    if kind == "diameters":
        return arrays | {"radius": arrays["radius"] * 2}, "radii look like diameters"
    if kind == "signs":
        return arrays | {"normal": -arrays["normal"]}, "normals seem to point from the second sphere to the first"
    if kind == "one":
        far = {"center": np.vstack([arrays["center"], arrays["center"].max(axis=0) + 50])}
        far |= {"driven": np.append(arrays["driven"], -1), "radius": np.append(arrays["radius"], 0.5)}
        far["spin"] = np.concatenate([arrays["spin"], np.zeros_like(arrays["spin"][:1])])
        return arrays | far | {"contact": arrays["contact"] + 1}, "contacts seem to count from 1"
    if kind == "one normal":
        normal = arrays["normal"].copy()
        normal[7] = np.roll(normal[7], 1) * [1, -1, 1][: packing.dimension]
        return arrays | {"normal": normal}, "contact 7 does not fit"
    raise KeyError(kind)


KINDS = ("normals", "contacts", "units", "diameters", "signs", "one", "one normal")
PACKINGS = {
    "bcc": bcc(),
    "periodic": bcc(periodic=("x", "y")),
    "discs": tb.Packing.lattice("honeycomb", (3, 4), ("x",), seed=2),
    "fcc": tb.Packing.lattice("fcc", (3, 2, 3), ("x", "y"), seed=2),
    "random": tb.Packing.random(120, ratio=2.5, seed=4),
    "filling": tb.Packing.space_filling(1, 1, 0.02),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", PACKINGS)
def test_arrays_that_contradict_each_other_are_refused_with_the_likely_remedy(name, kind):
    arrays, words = mixed_up(PACKINGS[name], kind)
    with pytest.raises(tb.InputError, match=words) as told:
        tb.Packing(**arrays)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", PACKINGS)
def test_what_fits_is_taken_to_the_bit_wherever_it_is_counted_from(name):
    packing = PACKINGS[name]
    rng = np.random.default_rng(1)
    order, flip = rng.permutation(packing.contacts), rng.random(packing.contacts) < 0.5
    number = rng.permutation(packing.spheres)
    place = np.argsort(number)
    arrays = packing.arrays()
    contact, normal = number[arrays["contact"]][order], arrays["normal"][order]
    contact[flip], normal[flip] = contact[flip, ::-1], -normal[flip]
    spheres = {key: arrays[key][place] for key in ("center", "driven", "spin", "radius")}
    again = tb.Packing(contact=contact, normal=normal, friction=arrays["friction"][order], **spheres)
    assert np.array_equal(again.normal, normal)
    if packing.spheres < 100:
        assert tb.solve(again).power == pytest.approx(tb.solve(packing).power, rel=1e-9)


@pytest.mark.parametrize("form", ["%.17g", "%g", "%.5f", "%.4f", "%.3f"])
def test_printed_normals_are_those_of_the_centres(form):
    packing = tb.Packing.random(60, seed=1)
    arrays = packing.arrays()
    printed = np.array([[float(form % value) for value in row] for row in arrays["normal"]])
    again = tb.Packing(**arrays | {"normal": printed})
    vector = packing.center[packing.contact[:, 1]] - packing.center[packing.contact[:, 0]]
    direct = np.linalg.norm(vector, axis=1) < 1.01 * packing.radius[packing.contact].sum(axis=1)
    assert direct.sum() > 100
    assert np.abs(again.normal - packing.normal)[direct].max() < 1e-14
    assert np.abs(again.normal - packing.normal).max() <= 1.1 * (10.0 ** -int(form[2]) if "f" in form else 1e-6)


def test_a_normal_that_is_no_unit_vector_even_as_printed_is_refused():
    arrays = bcc().arrays()
    with pytest.raises(tb.InputError, match=r"normal of contact 0 has length 1.002; the length must be 1"):
        tb.Packing(**arrays | {"normal": arrays["normal"] * 1.002})


@pytest.mark.parametrize(("apart", "words"), [(0.81, ""), (0.79, "overlap by 21%"), (0.7, "overlap by 30%")])
def test_soft_spheres_may_overlap_and_too_much_is_told_as_that(apart, words):
    row = {"center": [[0, 0, 0], [apart, 0, 0], [2 * apart, 0, 0]], "contact": [[0, 1], [1, 2]], "driven": [0, -1, 1]}
    row["spin"] = [[0, 0, 0], [0, 0, 0], [0, 1.0, 0]]
    if not words:
        assert tb.solve(tb.Packing(**row)).status == "certified"
        return
    with pytest.raises(tb.InputError, match=f"contact 0 is pressed too far: .*{words} of that, and at most 20% is"):
        tb.Packing(**row)


def test_a_schematic_network_is_taken_as_it_is_and_says_so_in_its_file(tmp_path):
    center = [[0, 0], [3, 0], [9, 0]]
    of = {"center": center, "contact": [[0, 1], [1, 2]], "driven": [0, -1, 1], "spin": [1.0, 0, 0]}
    of |= {"normal": [[0.0, 1.0], [1.0, 0.0]], "friction": [0.3, 0.2]}
    with pytest.raises(tb.InputError, match="contact 0 does not fit: spheres 0 and 1 are 3 apart"):
        tb.Packing(**of)
    packing = tb.Packing(**of, schematic=True)
    assert tb.Packing.load(packing.save(tmp_path / "a.npz")).schematic
    found = tb.solve(packing)
    assert found.power == pytest.approx(0.2 * 50 * 0.5)  # the weaker contact of the chain takes all of the slip
    assert tb.load(found.save(tmp_path / "run")).packing.schematic


def test_contacts_that_bear_nothing_do_not_act(caplog):
    """The same as friction 0; negative forces pull, and are told."""
    arrays = tb.Packing.lattice("cubic", (3, 3, 3), seed=1).arrays()
    force, friction = np.ones(54), arrays["friction"].copy()
    force[[5, 9]], friction[[5, 9]] = [0.0, -0.3], 0.0
    of = {**arrays, "normal_force": force}
    found, same = (
        tb.solve(tb.Packing(**of)),
        tb.solve(tb.Packing(**arrays | {"normal_force": 1.0, "friction": friction})),
    )
    assert "1 of 54 normal forces are negative" in caplog.text
    assert found.power == same.power
    assert np.array_equal(found.state, same.state)
