"""Spheres and contacts as rows: against run.h5 read contact by contact, and the structure from the file or anew."""

import shutil
from itertools import pairwise, product

import h5py
import numpy as np
import pytest

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.runs.analysis import analyse
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import read_run


def contacts_one_by_one(shape, periodic):
    """Axis and lower sphere of each contact, in the order of the rows."""
    for axis in range(len(shape)):
        for lower in product(*(range(side - (a == axis and a not in periodic)) for a, side in enumerate(shape))):
            yield axis, lower


@pytest.mark.parametrize("name", ["minimum", "discs", "ring"])
def test_rows_are_those_of_the_file(name, request):
    folder = request.getfixturevalue(name)
    found = points_and_lines(read_run(folder), analyse=True)
    with h5py.File(folder / "run.h5") as file:
        shape = tuple(file.attrs["shape"])
        rows = list(contacts_one_by_one(shape, found.answer.scene.lattice.periodic))
        for key in ("slip", "power", "force", "state"):
            assert found.contacts[key].values.tolist() == [file[f"contact/{'xyz'[a]}/{key}"][at] for a, at in rows]
        assert found.contacts["coefficient"].values.tolist() == [file[f"coefficient/{'xyz'[a]}"][at] for a, at in rows]
        spin = file["spin"][()].reshape(-1, 3) if len(shape) == 3 else file["spin"][()].ravel()
        seen = found.spheres["spin"].values if len(shape) == 3 else found.spheres["spin"].values[:, 2]
        assert np.array_equal(seen, spin)
    for (low, high), (axis, at) in zip(found.network.contact.T, rows, strict=True):
        assert np.unravel_index(low, shape) == at
        assert np.unravel_index(high, shape) == tuple((i + (a == axis)) % shape[a] for a, i in enumerate(at))


def test_the_path_goes_along_slipless_contacts_from_bottom_to_top(minimum):
    found = points_and_lines(read_run(minimum), analyse=True)
    lattice, on_path = found.answer.scene.lattice, found.contacts["on_path"].values
    assert (found.contacts["state"].values[on_path] == 0).all()
    path = found.structure.network.path
    steps = {frozenset(pair) for pair in pairwise(path.tolist())}
    assert {frozenset(pair) for pair in found.network.contact.T[on_path].tolist()} == steps
    assert [np.unravel_index(end, lattice.shape)[-1] for end in path[[0, -1]]] == [0, lattice.shape[-1] - 1]


def test_states_are_said_to_be_proven_where_they_are(minimum, dynamics):
    assert points_and_lines(read_run(minimum), analyse=True).contacts["proven"].values.all()
    found = points_and_lines(read_run(dynamics), analyse=True).contacts
    assert (found["proven"].values == (found["state"].values == 3)).all()  # between driven spheres nothing is open


def test_states_of_packings_are_said_to_be_proven_contact_by_contact(packed):
    with h5py.File(packed / "run.h5") as file:
        stored = file["contact/proven"][()]
    proven = points_and_lines(read_run(packed), analyse=True).contacts["proven"].values
    assert proven.tolist() == stored.tolist()
    assert proven.any()


def columns(run):
    found = points_and_lines(read_run(run), analyse=True)
    return {**found.spheres, **found.contacts}, found.structure.network.path


def test_the_structure_goes_by_the_contact_states_whatever_was_analysed(minimum, tmp_path):
    run = shutil.copytree(minimum, tmp_path / "run")
    new, path = columns(run)
    analyse(run, figures=False, threshold=0.05)
    again, same_path = columns(run)
    assert all(np.array_equal(values.values, new[name].values) for name, values in again.items())
    assert path.tolist() == same_path.tolist()


def test_snapshots_have_the_slips_of_their_spins(dynamics):
    found = points_and_lines(read_run(dynamics), analyse=True)
    assert found.moments.time.tolist()[0] == 0
    assert found.moments.time.max() < found.time == pytest.approx(0.05, rel=1e-2)
    unit, radius = np.eye(3), found.answer.scene.lattice.radius
    for spin, slip, state in zip(found.moments.spin, found.moments.slip, found.moments.state, strict=True):
        low, high = spin[found.network.contact]
        velocity = np.cross(-radius * (low + high), unit[found.contacts["axis"].values])  # paper Eq. 2
        free = state != 3
        assert slip[free] == pytest.approx(np.linalg.norm(velocity, axis=1)[free], abs=1e-12)
        assert ((state == 1) == ((slip > found.moments.threshold) & free)).all()
    assert (found.moments.state[0] == 1).sum() > (found.contacts["state"].values == 1).sum()


def test_each_replica_has_its_own_rows(solved):
    run = solved(shape=(5, 5), seed=4, replicas=3)
    alone = points_and_lines(read_run(solved(shape=(5, 5), seed=6)), analyse=True)
    third = points_and_lines(read_run(run), 2, analyse=True)
    for name in ("slip", "on_cut", "betweenness"):
        assert third.contacts[name].values == pytest.approx(alone.contacts[name].values)
    assert third.spheres["domain_kind"].values.tolist() == alone.spheres["domain_kind"].values.tolist()
    with pytest.raises(InputError, match="replica is 3; the run has 3 replicas"):
        points_and_lines(read_run(run), 3)


@pytest.mark.parametrize("name", ["minimum", "discs", "ring", "three"])
def test_what_the_file_holds_of_the_structure_is_what_is_computed_anew(name, request, solved, tmp_path):
    source = solved(shape=(5, 5), seed=4, replicas=3) if name == "three" else request.getfixturevalue(name)
    hold_against_new(shutil.copytree(source, tmp_path / "run"), 2 if name == "three" else 0)


def test_what_the_file_of_a_packing_holds_of_its_structure_is_what_is_computed_anew(packed, tmp_path):
    hold_against_new(shutil.copytree(packed, tmp_path / "run"), 0)


def hold_against_new(run, replica):
    """A run that is not analysed has no columns of its structure; one that is has those that are computed anew."""
    bare = points_and_lines(read_run(run), replica)
    assert not bare.drawn.is_known
    assert not {"domain", "betweenness", "on_cut", "on_path", "above_cut"} & {*bare.spheres, *bare.contacts}
    assert not {"network", "interface", "rigid_domains", "bottlenecks"} & vars(bare.structure).keys()
    analyse(run, figures=False)
    held, new = (points_and_lines(read_run(run), replica, again) for again in (False, True))
    assert not {"network", "interface", "rigid_domains", "bottlenecks"} & vars(held.structure).keys()
    for found, like in ((held.spheres, new.spheres), (held.contacts, new.contacts)):
        assert list(found) == list(like)
        for key, column in like.items():
            assert found[key].values == pytest.approx(column.values, rel=1e-14), key
    assert held.drawn.path.tolist() == new.drawn.path.tolist()
    if new.drawn.domains is not None:
        assert held.drawn.domains.turn == pytest.approx(new.drawn.domains.turn, abs=1e-14)


def test_an_analysis_by_a_threshold_is_not_drawn_and_a_damaged_one_is_refused(minimum, tmp_path):
    run = shutil.copytree(minimum, tmp_path / "run")
    analyse(run, figures=False, threshold=0.05)
    assert not points_and_lines(read_run(run)).drawn.is_known
    analyse(run, figures=False)
    with h5py.File(run / "run.h5", "r+") as file:
        del file["analysis"].attrs["sha256"]
        file["analysis/domain"][0, 0, 0] = 1000
    with pytest.raises(FileError, match=r"the group analysis of .* is damaged .* domain must hold whole numbers"):
        points_and_lines(read_run(run))
