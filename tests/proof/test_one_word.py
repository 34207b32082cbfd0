"""One word for each contact: its state, and whether that is proven, in answers, files and sums."""

from functools import partial
from itertools import product

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.proof.contact_state import ContactState, decided
from taichi_bearings.runs.verify import verify

pytestmark = pytest.mark.usefixtures("needs_f64", "taichi_runtime")
solve = partial(tb.solve, threads=1)
SLIPLESS, SLIPPING, UNDECIDED, DRIVEN, TIED = range(5)


def word(told, known, describes_motion, has_ended):
    """State and whether it is proven, of one contact, sentence by sentence."""
    if told == DRIVEN:
        return DRIVEN, True
    told = UNDECIDED if told == TIED else told  # nobody but a proof says so
    if not describes_motion:
        return (told, False) if known == UNDECIDED else (known, True)
    if has_ended and {known, told} == {SLIPLESS, SLIPPING}:
        return UNDECIDED, False
    if has_ended and told == UNDECIDED and known in (SLIPLESS, SLIPPING):  # at the minimum it is what it must be
        return known, True
    return told, told == known and known != UNDECIDED


@pytest.mark.parametrize(("describes_motion", "has_ended"), [(False, False), (True, False), (True, True)])
def test_every_contact_has_the_word_that_is_written_in_the_handbook(describes_motion, has_ended):
    told, known = np.array(list(product(range(5), (SLIPLESS, SLIPPING, UNDECIDED, TIED)))).T[:, None]
    state, proven = decided(told, known, describes_motion, has_ended)
    expected = [word(*pair, describes_motion, has_ended) for pair in zip(told[0], known[0], strict=True)]
    assert list(zip(state[0].tolist(), proven[0].tolist(), strict=True)) == expected


def flat(values):
    return np.concatenate([np.ravel(part) for part in values]) if isinstance(values, tuple) else np.ravel(values)


BIMODAL = "bimodal:0.1,1.0,0.5"
ANSWERS = {
    "ties": lambda: solve(tb.Scene.random((5, 5, 5), seed=3, distribution=BIMODAL)),
    "discs": lambda: solve(tb.Scene.random((6, 5), seed=1, distribution="constant:0.5")),
    "dynamics": lambda: solve(tb.Scene.random((4, 5), seed=1), tb.CundallStrack(), duration=1e-3),
    "packing": lambda: solve(tb.Packing.lattice("bcc", (2, 2, 2), seed=1)),
    "square packing": lambda: solve(tb.Packing.lattice("square", (5, 5), seed=0, distribution="constant:0.5")),
    "absent": lambda: solve(with_gaps()),
    "packing with gaps": lambda: solve(with_idle_contacts()),
}


def with_gaps():
    """A lattice a fifth of whose contacts are absent."""
    scene, rng = tb.Scene.random((4, 4, 5), seed=2), np.random.default_rng(2)
    return tb.Scene(tuple(np.where(rng.random(of.shape) < 0.2, 0.0, of) for of in scene.coefficients))


def with_idle_contacts():
    """A packing some of whose contacts bear no normal force."""
    packing = tb.Packing.lattice("bcc", (2, 2, 2), seed=1)
    force = np.where(np.arange(packing.contacts) % 5 == 0, 0.0, 50.0)
    return tb.Packing(**packing.arrays() | {"normal_force": force})


@pytest.mark.parametrize("name", ANSWERS)
def test_counts_add_up_and_are_those_of_the_arrays(name, tmp_path):
    found = ANSWERS[name]()
    state, proven = flat(found.state), flat(found.proven)
    words = {"slipless": SLIPLESS, "slipping": SLIPPING, "undecided": UNDECIDED, "tied": TIED}
    for word, code in words.items():
        assert getattr(found, word) == (state == code).sum()
    assert found.contacts == sum(getattr(found, word) for word in words) == (state != DRIVEN).sum()
    assert proven.dtype == bool
    assert proven[state == DRIVEN].all()
    assert proven[state == TIED].all()
    assert not proven[state == UNDECIDED].any()
    assert found.unproven == (~proven).sum()
    assert found.states_proven == (found.unproven == 0)
    path = found.save(tmp_path / "run") / "run.h5"
    with h5py.File(path) as file:
        first = "contact" if isinstance(found.state, np.ndarray) else "contact/x"
        assert file.attrs["schema_version"] == 2
        assert set(np.unique(file[f"{first}/proven"])) <= {0, 1}
        assert "slip_bound" not in file[first]
        assert file.attrs["contacts"] == found.contacts
    again = tb.load(path)
    assert np.array_equal(flat(again.state), state)
    assert np.array_equal(flat(again.proven), proven)
    assert verify(path)["contradictions"] == []


def test_in_2d_ties_are_proven_whatever_the_method():
    scene = tb.Scene.random((6, 5), seed=1, distribution="constant:0.5")
    for method in ("planar-cut", "interior-point"):
        found = solve(scene, method)
        sideways, upward = found.state
        assert (upward == TIED).all()
        assert np.isin(sideways, (SLIPLESS, DRIVEN)).all()
        assert found.states_proven
        assert found.minimum_is_unique is False


CODES = {  # of a file of layout 1, state and what was proven -> what they are now
    (0, 0): (0, 1), (1, 1): (1, 1), (2, 0): (0, 1), (2, 4): (4, 1), (2, 2): (2, 0), (0, 2): (0, 0), (1, 2): (1, 0),
    (3, 3): (3, 1),
}  # fmt: skip


def test_files_of_layout_1_are_read_and_their_codes_translated(tmp_path):
    """Critical contacts had the state 2; they are slipless where that was proven, and undecided elsewhere."""
    found = solve(tb.Scene.random((5, 5, 5), seed=3, distribution=BIMODAL))
    path = found.save(tmp_path / "run") / "run.h5"
    rng, expected = np.random.default_rng(0), []
    with h5py.File(path, "r+") as file:
        file.attrs["schema_version"] = 1
        for group in (file, *(file[name] for name in file)):
            group.attrs.pop("sha256", None)
        for axis in "xyz":
            state, proven = file[f"contact/{axis}/state"], file[f"contact/{axis}/proven"]
            free = [pair for pair in CODES if pair[0] != DRIVEN]
            drawn = rng.integers(len(free), size=state.shape)
            old = np.where((state[()] == DRIVEN)[..., None], DRIVEN, np.array(free)[drawn]).reshape(-1, 2)
            state[...], proven[...] = old[:, 0].reshape(state.shape), old[:, 1].reshape(state.shape)
            expected += [CODES[tuple(pair)] for pair in old.tolist()]
    again = tb.load(path)
    assert flat(again.state).tolist() == [state for state, _ in expected]
    assert flat(again.proven).tolist() == [bool(proven) for _, proven in expected]
    assert ContactState.TIED in flat(again.state)
