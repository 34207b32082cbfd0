"""What an answer is not is said with the right number, and not where there is nothing to say."""

import pytest
from taichi_bearings_studies.stress.truth import SLIPPING

import taichi_bearings as tb
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.caveats import caveats
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.verify import verify
from tests.stress.minima import least_of_all

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")


@pytest.fixture
def solved(tmp_path):
    def solve(**settings):
        made = RunSettings(threads=1, figures="none", **({"shape": (4, 5)} | settings))
        return run(made, tmp_path / "run", force=True)

    return solve


def words_of(found, word):
    """The warnings of a run with this word."""
    assert found.summary["warnings"] == caveats(found.solution, found.asked)
    return [sentence for sentence in found.summary["warnings"] if word in sentence]


def test_a_proven_answer_needs_no_words(solved):
    assert solved().summary["warnings"] == []
    assert solved(shape=(3, 3, 4)).summary["warnings"] == []


def test_what_remains_after_a_limit(solved):
    found = solved(method="gradient-descent", iterations=50)
    gap = found.summary["gap"]
    assert gap > 1e-3
    assert words_of(found, "the limit of") == [
        f"the limit of iterations came with a proven gap of {gap:.1e}; the tolerance is 1e-08"
    ]
    two = solved(method="gradient-descent", iterations=50, replicas=2)
    assert f"{max(two.summary['gap']):.1e} in 2 of 2 samples" in two.summary["warnings"][0]
    found = solved(method="rigid-limit", duration=5.0, iterations=3)
    assert f"at the simulated time {found.summary['time']:.6g} of 5" in words_of(found, "the limit of")[0]
    found = solved(method="rigid-limit", iterations=3)
    assert f"torques of {found.summary['largest_balance_residual']:.1e} were" in words_of(found, "the limit of")[0]


def test_weak_contacts_whose_states_are_all_proven_are_not_warned_of():
    """Driven about an axis that all but lies along x, many contacts hardly dissipate, and all the same are proven."""
    found = tb.solve(tb.Scene.random((3, 3, 4), seed=2, direction=(1.0, 1e-15, 0.0)), threads=1)
    assert found.states_proven
    assert found.warnings == []


def test_contacts_between_driven_discs_that_slip_are_not_said_to_roll():
    """Two driven discs turn alike, so they slip on each other; the free disc beside them rolls on one."""
    row = tb.Packing([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2]], [0, 1, -1], [1.0, 1.0, 0.0], friction=[0.5, 0.5])
    found = tb.solve(row, threads=1)
    assert (found.power, found.driven_power) == (0.0, 50 * 0.5 * 1.0)
    (sentence,) = found.warnings
    assert sentence.endswith("no contact slips but those between driven spheres")


def test_undecided_contacts_of_a_film_have_no_friction_limit():
    """A film resists every slip; without a proof one only knows that a contact slips in the answer."""
    found = tb.solve(tb.Packing.lattice("fcc", (2, 2, 2), seed=3, law="viscous"), "gradient-descent", iterations=2)
    assert found.undecided > 0
    (sentence,) = (words for words in found.warnings if "undecided" in words)
    assert sentence.endswith(f": {found.undecided} slipping, but perhaps not at every minimum")


def test_undecided_contacts_are_counted(solved):
    found = solved(method="gradient-descent", iterations=50)
    number = found.summary["undecided"]
    assert number > 0
    (sentence,) = words_of(found, "undecided")
    assert sentence.startswith(f"{number} of 25 contacts undecided: ")
    slips = found.solution.slip[found.solution.state == ContactState.UNDECIDED]
    fast = int((slips > found.summary["slip_threshold"]).sum())
    assert (f": {fast} slipping faster than" in sentence) == (fast > 0)
    assert (f"{number - fast} at the friction limit" in sentence) == (number > fast)


@pytest.mark.parametrize(
    "settings",
    [
        {"shape": (2, 2, 8), "seed": 641052, "distribution": "bimodal:1,1e12,0.8"},
        {"shape": (3, 3, 5), "seed": 529164, "distribution": "bimodal:1,1e6,0.8", "direction": (1.0, 1e-8, 0.0)},
    ],
)
def test_what_rounding_makes_of_slips_is_not_named(solved, settings):
    """Weak contacts bend strong ones by less than doubles hold: 2 and 7 contacts seem to slip and do not at all."""
    found = solved(method="interior-point", tolerance=1e-10, **settings)
    true, state = least_of_all(found.solution.scene), found.solution.state[0]
    slips = found.solution.scene.lattice.flat(true.state) == SLIPPING
    assert not ((state == ContactState.SLIPPING) & ~slips).any()
    assert not found.solution.states_proven.any()
    assert words_of(found, "only proven states are named")
    assert verify(found.path)["contradictions"] == []


def test_ties_are_counted(solved):
    found = solved(distribution="constant:1")
    (sentence,) = words_of(found, "tie")
    assert f" {found.summary['tied']} contacts slip at some of them and not at others" in sentence
    assert found.summary["tied"] > 0


def test_springs_that_take_up_the_motion_of_the_planes(solved):
    """At first they take up all of it; in the end they bear what the contacts bear."""
    dynamics = {"method": "cundall-strack", "stiffness": 1e3}
    start = solved(**dynamics, damping=1e-3, mass=1e9, duration=1e-3, initial="zero")
    assert start.summary["elastic_share"] == pytest.approx(1.0, rel=1e-3)
    assert "a stiffness 1e+02 times as large" in words_of(start, "springs")[0]
    end = solved(shape=(2, 3), method="cundall-strack", stiffness=100.0, damping=10.0, duration=20.0)
    strongest = end.solution.force.max()  # at rest: the dampers are idle
    assert end.summary["elastic_share"] == pytest.approx(strongest / 100.0 / (0.5 * 20.0), rel=1e-3)
    assert f"up to {end.summary['elastic_share']:.1e} of the distance" in words_of(end, "springs")[0]
    assert words_of(solved(method="cundall-strack", duration=2.0), "springs") == []
    assert "elastic_share" not in solved(law="viscous", method="cundall-strack", duration=0.1).summary


def test_answers_in_python_have_their_warnings_too():
    scene = tb.Scene.random((4, 5), distribution="constant:1")
    answer = tb.solve(scene, threads=1)
    assert any("tie exactly" in sentence for sentence in answer.warnings)
    assert tb.solve(tb.Scene.random((4, 5)), threads=1).warnings == []


def test_packings_have_the_warnings_that_lattices_have(solved):
    found = solved(shape=(4, 4, 4), driven="walls", method="cundall-strack", iterations=3)
    assert f"torques of {found.summary['largest_balance_residual']:.1e} were" in words_of(found, "the limit of")[0]
    found = solved(shape=(4, 4, 4), driven="walls", method="gradient-descent", iterations=3)
    assert f"with a proven gap of {found.summary['gap']:.1e}" in words_of(found, "the limit of")[0]
    assert solved(shape=(4, 4, 4), driven="walls").summary["warnings"] == []
