"""Every number of the tables is what its sentence says: recomputed from stored arrays by the plain formulas beside."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import taichi_bearings as tb
from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.quantities import (
    ANALYSED,
    CHECK_ROWS,
    CONTACTS,
    FINDINGS,
    OF_SCANS,
    SAMPLES,
    SPHERES,
    STRUCTURE,
    Whole,
)
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import METHODS
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.packings import solve_packing
from taichi_bearings.solvers.stopping import StopRule
from tests.packing.twins import random_packing
from tests.properties import formulas
from tests.properties.answers import TOLERANCE, answer_of
from tests.properties.formulas import UNKNOWN, Laboratory, Number, OneOf, Range
from tests.properties.scenes import DISCS, cases, decades, scenes, seeds
from tests.properties.scenes import SPHERES as SHAPES

PROOF, TEXT, CLOCK, COURSE, SETTING = (
    "a proof: judged in exact numbers by tests/proof and tests/proof",
    "a text or a version",
    "seconds, or the number of steps, of this machine",
    "of the course to the answer, which is not stored: tests/solvers",
    "a setting, or what scans say of samples: tests/scans",
)
NOT_RECOMPUTED = {
    "SAMPLES": {
        "lower_bound": PROOF, "minimum_is_unique": PROOF, "method": TEXT, "version": TEXT, "seed": SETTING,
        "iterations": CLOCK, "seconds": CLOCK, "seconds_compile": CLOCK,
    },
    "SPHERES": {"spin": "what all else follows from"},
    "FINDINGS": {
        "proof": TEXT, "cut_is_unique": PROOF, "next_cut_over_minimum": PROOF,
        "step_error": COURSE, "accurate_time_step": COURSE, "elastic_share": COURSE, "rest_time": COURSE,
        "yields": PROOF, "yield_torque": PROOF, "yield_torque_lower_bound": PROOF, "amplitude": COURSE,
        "newton_steps": CLOCK,
    },
    "STRUCTURE": {"cut_is_unique": PROOF, "next_cut_over_cut": "all cuts are tried in tests/numerics"},
    "OF_SCANS": dict.fromkeys(("L", "stiffness", "damping", "warnings", "sample", "error"), SETTING),
    "CHECK_ROWS": dict.fromkeys(("iteration", "seconds"), CLOCK) | {"lower_bound": PROOF} | dict.fromkeys((
        "time", "potential", "slipping", "spring_energy", "injected_energy", "dissipated_energy",
        "largest_balance_residual",
    ), COURSE),
}  # fmt: skip
TABLES = {
    "SAMPLES": SAMPLES, "CONTACTS": CONTACTS, "SPHERES": SPHERES, "FINDINGS": FINDINGS, "STRUCTURE": ANALYSED,
    "OF_SCANS": OF_SCANS, "CHECK_ROWS": CHECK_ROWS,
}  # fmt: skip
OF_ROUNDING = ("largest_balance_residual", "largest_spread_in_a_domain")  # of exact answers nothing else is in them
SMALL = (*DISCS[:5], *SHAPES[:5])
KINDS = (
    ("square", (3, 4)), ("triangular", (3, 2)), ("honeycomb", (2, 2)), ("cubic", (2, 3, 3)), ("bcc", (2, 2, 2)),
    ("fcc", (1, 2, 2)), ("random", 2), ("random", 3), ("network", 2), ("network", 3),
)  # fmt: skip


@pytest.mark.parametrize("table", TABLES)
def test_every_row_has_a_formula_or_a_reason(table):
    formula, reason = getattr(formulas, table, {}).keys(), NOT_RECOMPUTED.get(table, {}).keys()
    assert formula | reason == TABLES[table].keys()
    assert not formula & reason


def test_numbers_that_only_lattices_have_say_so():
    """Of slips, which differ between the minima of a packing."""
    found = tb.solve(tb.Packing.lattice("square", (3, 3), seed=1))
    missing = {name for name, row in SAMPLES.items() if "slip speed" in row.text and row.of(found) is None}
    assert missing == {"largest_slipless_slip", "smallest_slipping_slip", "separation_decades"}
    assert all(SAMPLES[name].text.endswith(" (lattices only)") for name in missing)


def assert_is(name, said, expected):
    """said : what the table gives of one sample. expected : by a formula."""
    if expected is UNKNOWN:
        return
    if isinstance(expected, OneOf):
        assert said in expected.values, f"{name} is {said}, not one of {expected.values}"
    elif isinstance(expected, Range):
        assert expected.low <= said <= expected.high, f"{name} is {said}, not in {expected}"
    elif isinstance(expected, Number):
        assert said is not None, f"{name} is left out"
        missed = np.abs(np.asarray(said, float) - np.asarray(expected.value, float))
        assert (missed <= expected.error).all(), (
            f"{name} is {said}, not {expected.value}: off by {np.max(missed)}, of {np.max(expected.error)} by rounding"
        )
    elif expected is None or isinstance(expected, (bool, str, dict)):
        assert said == expected, f"{name} is {said}, not {expected}"
    else:
        np.testing.assert_array_equal(said, expected, err_msg=name)


def one_of(value):
    """The value of a single sample."""
    if isinstance(value, Whole):
        return list(value)
    return value[0] if isinstance(value, (list, np.ndarray)) and np.ndim(value) == 1 else value


def check(answer, tolerance=TOLERANCE, duration=None, inertia=None):
    """Every number of every sample of an answer."""
    for number in range(answer.scene.replicas):
        one = answer.sample(number)
        structure = structure_of(one)
        lab = Laboratory(one, structure, tolerance, duration, inertia)
        answered = Result(RunSettings(tolerance=tolerance, duration=duration), one)
        for name, formula in formulas.SAMPLES.items():
            assert_is(name, one_of(SAMPLES[name].of(answered)), formula(lab))
        for table, rows in ((formulas.CONTACTS, CONTACTS), (formulas.SPHERES, SPHERES)):
            for name, formula in table.items():
                values = rows[name].of(one)
                assert_is(f"{name} of each", 0.0 if values is None else values[0], formula(lab))
        for name in formulas.FINDINGS.keys() & one.findings.keys():
            assert_is(name, one.findings[name][0], formulas.FINDINGS[name](lab))
        for name in formulas.CHECK_ROWS.keys() & one.history.keys():
            assert_is(f"{name} at the end", one.history[name][-1, 0], formulas.CHECK_ROWS[name](lab))
        for section, rows in STRUCTURE.items():
            if section == "bottlenecks" and structure.bottlenecks is None:
                continue
            for row in rows:
                if row.name in formulas.STRUCTURE:
                    said = row.of(structure)
                    if row.name == "most_loaded":
                        said = [link["share"] for link in said]
                    assert_is(row.name, said, formulas.STRUCTURE[row.name](lab))


@cases(2.0)
@given(scenes(shapes=SMALL, replicas=(1, 1, 2), contrast=24, scale=9))
def test_numbers_of_minima(scene):
    check(answer_of(scene))


@st.composite
def states_of_planes(draw):
    """Scenes of planes in states with dilation, or closed along sides."""
    law, closed = draw(st.sampled_from(tuple(LAWS))), draw(st.sampled_from(((), ("x",), ("x", "y"), ("y",))))
    rng = np.random.default_rng(draw(seeds))
    if draw(st.booleans()):
        shape, closed = draw(st.sampled_from(((2, 2, 3), (4, 2, 4), (2, 4, 3)))), closed
    else:
        shape, closed = draw(st.sampled_from(((2, 3), (4, 4), (6, 5)))), closed[:1] if closed != ("y",) else ()
    given = {"periodic": closed, "law": law, "seed": int(rng.integers(2**31)), "radius": draw(decades(9))}
    given["distribution"] = f"power-law:{10.0 ** -draw(st.integers(0, 12))},1,-1"
    if len(shape) == 3 and not closed and draw(st.booleans()):
        state = rng.integers(-2, 3, 4) + rng.uniform(-1, 1, 4) * draw(st.booleans())
        given |= {"top": tuple(state), "bottom": tuple(rng.integers(-1, 2, 4).astype(float))}
    return Scene.random(shape, **given)


@cases()
@given(states_of_planes())
def test_numbers_of_planes_in_other_states_and_closed_sides(scene):
    check(answer_of(scene))


def test_a_domain_that_joins_both_planes_in_one_layer_is_locked_to_both():
    """One column slips nowhere, as the top has the spin of the bottom there."""
    ones = np.ones((1, 2, 3)), np.ones((2, 1, 3)), np.ones((2, 2, 2))
    check(answer_of(Scene(coefficients=ones, top=(1, 0, -1, 0), bottom=(1, 0, 1, 1), radius=1.0)))


@st.composite
def packings(draw):
    """Small packings of every kind."""
    (kind, cells), law = draw(st.sampled_from(KINDS)), draw(st.sampled_from(tuple(LAWS)))
    rng = np.random.default_rng(draw(seeds))
    if kind == "network":
        return random_packing(rng, cells, law, spheres=int(rng.integers(4, 16)))
    given = {"law": law, "seed": int(rng.integers(2**31)), "radius": draw(decades(9))}
    given |= {"spin_top": draw(decades(9)), "spin_bottom": draw(st.sampled_from((0.0, 0.3)))}
    given["distribution"] = f"power-law:{10.0 ** -draw(st.integers(0, 6))},1,-1"
    if kind == "random":
        return tb.Packing.random(int(rng.integers(10, 24)), cells, **given)
    return tb.Packing.lattice(kind, cells, **given)


@cases()
@given(packings())
def test_numbers_of_packings(packing):
    if packing.contacts and (packing.driven >= 0).any():
        check(solve_packing(packing, TOLERANCE))


@cases(0.5)
@given(
    scenes(shapes=SMALL[:4], contrast=3, scale=3), st.sampled_from(("rigid-limit", "cundall-strack")),
    st.floats(0.1, 10),
)  # fmt: skip
def test_numbers_of_a_short_dynamics(scene, name, inertia):
    kept = {"energy": True} if name == "cundall-strack" else {}
    options = METHODS[name](inertia=inertia, **kept)
    answer = solve(scene, options.build(), initial_spin(scene, "random"), StopRule(1e-14, 8))
    check(answer, 1e-14, inertia=inertia)


@pytest.mark.parametrize("law", LAWS)
def test_numbers_that_are_off_are_found(law):
    one = answer_of(Scene.random((3, 3, 4), law=law, seed=5))
    lab = Laboratory(one, structure_of(one), TOLERANCE)
    tables = (
        (formulas.SAMPLES, SAMPLES, Result(RunSettings(tolerance=TOLERANCE), one)),
        (formulas.STRUCTURE, ANALYSED, lab.structure),
    )
    found = 0
    for table, rows, of in tables:
        for name, formula in table.items():
            said, expected = rows[name].of(of), formula(lab)
            said = one_of(said) if rows is SAMPLES else said
            if (
                name not in OF_ROUNDING
                and isinstance(expected, (Number, int, float))
                and np.ndim(said) == 0
                and np.isfinite(said)
            ):
                found += 1
                with pytest.raises(AssertionError):
                    assert_is(name, said + 1e-6 * (abs(said) if abs(said) > 1e-9 else 1.0), expected)
    assert found > 25
