"""Lattices whose sides close on themselves: their seams are contacts like any other, also in rings of two spheres."""

from ast import literal_eval
from dataclasses import replace
from decimal import Decimal
from functools import cache

import h5py
import networkx
import numpy as np
import pytest

from taichi_bearings.errors import FileError
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.solution import SLIPLESS, SLIPPING, TIED, UNDECIDED
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.agreement.laboratory import laboratory_minimum
from tests.proof.honest import contradictions
from tests.proof.laboratory import Laboratory, by_axis
from tests.proof.samples import samples_of

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
BEARING = {"top": (1.0, 0.5, 0.0, 0.2), "bottom": (0.0, 0.3, 0.0, -0.1)}
ABOUT_X = {"direction": (1, 0, 0)}
BIMODAL = {"distribution": "bimodal:0.1,1.0,0.5"}
DAMPED = {"law": "coulomb-viscous", "viscosity": "uniform:0.5,5"}
SCENES = [
    ((2, 3), "x", {"spin_bottom": -0.3}),
    ((4, 5), "x", {}),
    ((4, 5), "x", {"law": "viscous"}),
    ((2, 2, 3), "x", {}),
    ((2, 2, 3), "xy", {"direction": (1, -2, 3), "spin_bottom": 0.25, "radius": 0.7, "normal_force": 3.0}),
    ((2, 2, 3), "xy", DAMPED),
    ((4, 3, 4), "x", {"law": "viscous", "direction": (1, 1, 1)}),
    ((4, 3, 4), "x", BEARING),
    ((4, 3, 4), "x", ABOUT_X),
    ((4, 4, 4), "xy", {}),
    ((4, 4, 4), "xy", BEARING | DAMPED),
    ((2, 4, 4), "xy", BEARING),
]
FREE = [
    ((4, 5), {}),
    ((4, 5), {"law": "viscous", "spin_bottom": -0.3}),
    ((3, 2, 4), {}),
    ((3, 2, 4), {"direction": (1, -2, 3), "spin_bottom": 0.25, "radius": 0.7, "normal_force": 3.0}),
    ((3, 2, 4), {"law": "viscous", "direction": (1, 1, 1)}),
    ((4, 5), {"law": "coulomb-viscous", "spin_bottom": -0.3, "viscosity": "uniform:5,60"}),
    ((3, 2, 4), {"law": "coulomb-viscous", "radius": 0.7, "normal_force": 3.0, "viscosity": "lognormal:3,2"}),
    ((2, 3, 4), {"law": "coulomb-viscous", "direction": (1, -2, 3), "spin_bottom": 0.999999}),
    ((2, 3, 4), {"spin_bottom": 0.999999999}),
    ((2, 3, 4), {"spin_top": 1e-9, "spin_bottom": -1e9, "direction": (1, 1e-7, 0)}),
]
ALIKE = [((2, 4, 4), "x", 11, [37, 11, 4, 0]), ((2, 4, 4), "xy", 18, [42, 8, 6, 0]),
         ((4, 3, 4), "x", 4, [52, 24, 0, 0]), ((4, 4, 4), "xy", 23, [74, 32, 6, 0])]  # fmt: skip
"""Friction of two values: seed, and the slipless, slipping, tied and unproven contacts, in 140 digits."""


def solved(scene):
    one = scene.lattice.dimension == 2 or (scene.top is None and scene.direction == ABOUT_X["direction"])
    cut = "planar-cut" if one else "interior-point"
    method = {"coulomb": cut, "viscous": "linear-solver", "coulomb-viscous": "interior-point"}[scene.law.name]
    return samples_of(solve(scene, METHODS[method]().build(), initial_spin(scene, "linear"), StopRule(1e-10)))


def scene_of(shape, sides, options, seed=5):
    return Scene.random(shape, seed=seed, periodic=tuple(sides), **options)


@cache
def _sample(text):
    return solved(scene_of(*literal_eval(text)))


def sample(shape, sides, options, seed=5):
    """That of several tests is solved once."""
    return _sample(repr((shape, sides, options, seed)))


def kinds(samples):
    """Numbers of slipless, slipping, tied and unproven contacts."""
    judgement = samples.judgement
    proven = judgement.states[0].known[judgement.acts[0]]
    return [int((proven == what).sum()) for what in (SLIPLESS, SLIPPING, TIED, UNDECIDED)]


@pytest.mark.parametrize("size", [0.0, 0.1])
@pytest.mark.parametrize(
    ("shape", "sides", "options"), [*SCENES, *((shape, "", options) for shape, options in FREE)], ids=str
)
def test_bounds_are_those_of_the_laboratory(shape, sides, options, size):
    """In 80 digits, contact by contact: at a minimum, and of spins and friction far from one."""
    samples, rng = sample(shape, sides, options), np.random.default_rng(3)
    spin = samples.spin + size * (samples.spin_top - samples.spin_bottom) * rng.standard_normal(samples.spin.shape)
    ends = (slice(None),) * samples.dimension + ([0, -1],)
    spin[ends] = samples.spin[ends]
    friction = tuple(f * rng.uniform(1 - size, 1 + size, f.shape) for f in samples.friction)
    samples = replace(samples, spin=spin, friction=friction)
    judgement, truth = samples.judgement, Laboratory(samples)
    objective, bound = truth.objective(), truth.lower_bound()
    assert Decimal(judgement.lower_bound[0]) <= max(bound, Decimal(0)) <= objective <= Decimal(judgement.upper_bound[0])
    assert float(Decimal(judgement.upper_bound[0]) / objective - 1) < 2e-15
    assert judgement.lower_bound[0] == pytest.approx(max(float(bound), 0.0), rel=1e-13 if size else 4e-15)
    assert judgement.objective[0] == pytest.approx(float(objective), rel=1e-13 if size else 3e-16)
    assert (judgement.gap[0] < 1e-13) == (size == 0)


def assert_states_of_cone_programme(scene, samples):
    """Of the laboratory frame with all components, whose slips are those in the middle of all minima."""
    judgement, truth = samples.judgement, laboratory_minimum(scene)
    least = truth.objective * (1 if scene.law.has_friction else 2)
    assert judgement.lower_bound[0] == pytest.approx(least, rel=1e-8)
    small = 1e-5 * samples.radius * samples.jump_size
    proven = by_axis(samples, judgement.states[0].known)
    for (site, axis), slip in truth.slip.items():
        if not samples.coefficient[axis][(0, *site)]:  # an absent contact
            continue
        assert slip < small or proven[axis][site] != SLIPLESS
        assert slip > small or proven[axis][site] not in (SLIPPING, TIED)


@pytest.mark.parametrize(("shape", "sides", "options", "seed"), [
    *((*scene, 5) for scene in SCENES), *((shape, sides, BIMODAL, seed) for shape, sides, seed, _ in ALIKE),
], ids=str)  # fmt: skip
def test_power_and_states_are_those_of_a_cone_programme(shape, sides, options, seed):
    samples = sample(shape, sides, options, seed)
    assert_states_of_cone_programme(scene_of(shape, sides, options, seed), samples)
    assert samples.law == "coulomb-viscous" or kinds(samples)[-1] == 0


@pytest.mark.parametrize(("shape", "sides", "seed", "expected"), ALIKE, ids=str)
def test_contacts_that_tie_are_proven_as_on_free_lattices(shape, sides, seed, expected):
    samples = sample(shape, sides, BIMODAL, seed)
    assert kinds(samples) == expected
    assert samples.judgement.states[0].unique == (expected[2] == 0)


@pytest.mark.parametrize(("shape", "sides", "share"), [
    ((3, 3, 4), "", 0.1), ((4, 3, 4), "x", 0.1), ((2, 4, 4), "xy", 0.2), ((4, 4, 4), "xy", 0.3),
], ids=str)  # fmt: skip
def test_where_contacts_are_missing_the_others_are_judged_as_ever(shape, sides, share):
    whole, rng, proven = Scene.random(shape, seed=5, periodic=tuple(sides)), np.random.default_rng(7), []
    for _ in range(4):
        left = tuple(np.where(rng.random(c.shape) < share, 0.0, c) for c in whole.coefficients)
        scene = replace(whole, coefficients=left)
        samples = solved(scene)
        assert_states_of_cone_programme(scene, samples)
        proven.append(kinds(samples)[-1] == 0)
    assert sum(proven) >= 3


def contacts_of_one_component(samples):
    """(axis, lower sphere, node of it, node of the upper one, coefficient); the driven spheres are two nodes."""
    node = {
        site: {0: "bottom", samples.shape[-1] - 1: "top"}.get(site[-1], site) for site in np.ndindex(*samples.shape)
    }
    jump = dict(zip(samples.components, samples.scene.top_spin(samples.components), strict=True))
    about = next(k for k in samples.components if k != samples.dimension - 1 and jump[k].any())
    for axis, coefficient in enumerate(samples.coefficient):
        for lower in np.ndindex(*coefficient.shape[1:]) if about != axis else ():
            upper = tuple((x + (k == axis)) % n for k, (x, n) in enumerate(zip(lower, samples.shape, strict=True)))
            yield axis, lower, node[lower], node[upper], int(coefficient[(0, *lower)])


def least_cut(contacts, *never_cut):
    """Its weight, where none may lead from the first to the second of some pairs."""
    graph = networkx.DiGraph()
    for *_, a, b, weight in contacts:
        for pair in ((a, b), (b, a)):  # in a ring of two there are two contacts between them
            graph.add_edge(*pair, capacity=weight + graph.get_edge_data(*pair, {"capacity": 0})["capacity"])
    for pair in never_cut:
        graph.add_edge(*pair, capacity=np.inf)
    try:
        return networkx.minimum_cut_value(graph, "bottom", "top")
    except networkx.NetworkXUnbounded:
        return np.inf


@pytest.mark.parametrize("values", ["1,2", "1,3"])
@pytest.mark.parametrize(("shape", "sides", "options"), [
    ((4, 5), "x", {}), ((2, 6), "x", {}), ((4, 3, 4), "x", ABOUT_X), ((3, 2, 4), "y", ABOUT_X),
], ids=str)  # fmt: skip
def test_states_are_those_of_all_lightest_cuts(shape, sides, options, values, thorough):
    """Exactly, in whole numbers: what some cut goes through and another does not is tied, and nothing else."""
    for seed in range(8 if thorough else 2):
        samples = sample(shape, sides, options | {"distribution": f"bimodal:{values},0.5"}, seed)
        judgement, contacts = samples.judgement, list(contacts_of_one_component(samples))
        least = least_cut(contacts)
        unit = samples.normal_force * samples.radius * samples.jump_size
        assert judgement.lower_bound[0] <= unit * least * (1 + 1e-15)
        assert judgement.lower_bound[0] == pytest.approx(unit * least, rel=1e-14)
        for axis, lower, a, b, _ in contacts:
            slips = least in (least_cut(contacts, ("bottom", x), (y, "top")) for x, y in ((a, b), (b, a)))
            rests = least == least_cut(contacts, (a, b), (b, a))
            expected = TIED if slips and rests else SLIPPING if slips else SLIPLESS
            assert by_axis(samples, judgement.states[0].known)[axis][lower] == expected


PERIODIC = {
    "discs": {"shape": (4, 5), "periodic": ("x",)},
    "rings of two": {"shape": (2, 2, 3), "periodic": ("x", "y"), "top": (1.0, 0.5, 0.0, 0.2)},
    "samples": {"shape": (4, 3, 4), "periodic": ("x",), "law": "coulomb-viscous", "replicas": 2},
}


@pytest.mark.parametrize("name", PERIODIC)
def test_a_run_says_which_sides_are_closed(name, tmp_path):
    assert contradictions(PERIODIC[name] | {"seed": 5}, tmp_path) == []
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        del file.attrs["sha256"]
        file["coefficient/x"][..., -1, 1] *= 1 + 1e-15  # that of the seam
    assert any(
        "the coefficient in the file differs from what seed 5 gives" in said
        for said in verify(tmp_path)["contradictions"]
    )


@pytest.mark.parametrize(("said", "words"), [
    ("[]", r"has float64 of shape \(4, 3, 4\)"), ('["y"]', "has 3 spheres; the number must be even"),
    ('["x", "x"]', "among x, y, each once"), ('["z"]', "names of axes"), ("1", "names of axes"),
    ('[["x"]]', "names of axes"),
])  # fmt: skip
def test_sides_that_cannot_be_closed_are_refused(said, words, tmp_path):
    assert contradictions({"shape": (4, 3, 4), "periodic": ("x",), "seed": 5}, tmp_path) == []
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        scene = file.attrs["scene"].replace('periodic = ["x"]', f"periodic = {said}")
        file.attrs["scene"] = scene
    with pytest.raises(FileError, match=words):
        verify(tmp_path)
