"""`bearings export --format`: solvers read the file alone, and find the least power that the run has proven."""

import h5py
import numpy as np
import pytest
from scipy import sparse

from taichi_bearings.api import load
from taichi_bearings.errors import InputError
from taichi_bearings.export.problems import export_problem
from tests.cli.commands import bearings

LAWS = {"viscous": {}, "coulomb-viscous": {"viscosity": "uniform:1,10"}}


def read_cbf(path):
    """Costs, matrix, constants and cones [(kind, size)] of a file whose unknowns are all free."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    numbers = {}
    while lines:
        name = lines.pop(0)
        if name in ("VER", "OBJSENSE"):
            numbers[name] = lines.pop(0)
            continue
        head = [int(word) for word in lines.pop(0).split()]
        numbers[name] = head, [line.split() for line in lines[: head[-1]]]
        del lines[: head[-1]]
    assert (numbers["VER"], numbers["OBJSENSE"]) == ("1", "MIN")
    (unknowns, _), domains = numbers["VAR"]
    assert domains == [["F", str(unknowns)]]
    (size, _), cones = numbers["CON"]
    entries = [(float(value), int(i), int(j)) for i, j, value in numbers["ACOORD"][1]]
    value, i, j = (np.array(column) for column in zip(*entries, strict=True))
    cost, constant = np.zeros(unknowns), np.zeros(size)
    for place, number in numbers["OBJACOORD"][1]:
        cost[int(place)] = float(number)
    for place, number in numbers["BCOORD"][1]:
        constant[int(place)] = float(number)
    matrix = sparse.csr_array((value, (i, j)), shape=(size, unknowns))
    return cost, matrix, constant, [(kind, int(number)) for kind, number in cones]


def least(cost, matrix, constant, cones, solver="clarabel"):
    """Of cost.x where matrix x + constant is in the cones, by Clarabel or SCS."""
    turned = []
    for kind, size in cones:
        turned.append(sparse.identity(size).tolil())
        if kind == "QR":  # 2 a b >= |c|^2 where (a + b, a - b, sqrt(2) c) is in a cone that is not rotated
            turned[-1][:2, :2] = np.array([[1, 1], [1, -1]]) / 2**0.5
    turn = sparse.block_diag(turned, format="csc")
    return SOLVERS[solver](cost, sparse.csc_matrix(-turn @ matrix), turn @ constant, cones)


def by_clarabel(cost, matrix, constant, cones):
    clarabel = pytest.importorskip("clarabel")
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    kinds = [clarabel.ZeroConeT(size) if kind == "L=" else clarabel.SecondOrderConeT(size) for kind, size in cones]
    found = clarabel.DefaultSolver(sparse.csc_matrix((len(cost),) * 2), cost, matrix, constant, kinds, settings).solve()
    assert "Solved" in str(found.status)
    return found.obj_val


def by_scs(cost, matrix, constant, cones):
    scs = pytest.importorskip("scs")
    sizes = [size for kind, size in cones if kind != "L="]
    kinds = {"z": sum(size for kind, size in cones if kind == "L="), "q": sizes}
    given = {"A": matrix, "b": constant, "c": cost}
    found = scs.SCS(given, kinds, eps_abs=1e-9, eps_rel=1e-9, max_iters=1_000_000, verbose=False).solve()
    assert found["info"]["status"] == "solved"
    return found["info"]["pobj"]


SOLVERS = {"clarabel": by_clarabel, "scs": by_scs}


def proven(run):
    """Bounds on what the run minimises."""
    result = load(run)
    return result.lower_bound, getattr(result, "potential", None) or result.power


def assert_is_least(value, run):
    below, above = proven(run)
    assert above - below <= 1e-7 * above
    assert value == pytest.approx(above, rel=1e-7)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", ["minimum", "discs", "ring"])
def test_cbf_of_lattices_has_the_proven_optimum(name, solver, request, tmp_path):
    run = request.getfixturevalue(name)
    report = export_problem(run, "cbf", tmp_path / "a.cbf")
    assert report["unknowns"] > 0
    assert_is_least(least(*read_cbf(tmp_path / "a.cbf"), solver), run)


def test_contacts_that_feel_no_driven_component_are_left_out(solved, tmp_path):
    run = solved(shape=(4, 5, 4), direction=(1.0, 0.0, 0.0), seed=6)
    export_problem(run, "cbf", tmp_path / "a.cbf")
    cost, matrix, constant, cones = read_cbf(tmp_path / "a.cbf")
    assert set(cones) == {("Q", 2)}
    assert (np.diff(matrix.tocsc().indptr) > 0).all()
    assert_is_least(least(cost, matrix, constant, cones), run)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("shape", [(4, 3, 5), (5, 6)], ids=str)
def test_cbf_has_viscosity_in_rotated_cones(law, shape, solved, tmp_path):
    run = solved(shape=shape, law=law, seed=4, **LAWS[law])
    export_problem(run, "cbf", tmp_path / "a.cbf")
    assert_is_least(least(*read_cbf(tmp_path / "a.cbf")), run)


def test_cbf_of_packings_has_the_proven_optimum(packed, tmp_path):
    export_problem(packed, "cbf", tmp_path / "a.cbf")
    assert_is_least(least(*read_cbf(tmp_path / "a.cbf")), packed)


def read_fclib(path):
    """V, q, s and mu of a mixed local problem without W and R, with spacedim numbers a contact."""
    with h5py.File(path) as file:
        root = file["fclib_local"]
        matrices = {}
        for name in "WVR":
            assert root[name]["nz"][0] == -1
            arrays = tuple(root[name][key][()] for key in ("x", "i", "p"))
            assert len(arrays[0]) == root[name]["nzmax"][0]
            matrices[name] = sparse.csc_array(arrays, shape=(root[name]["m"][0], root[name]["n"][0]))
        assert (matrices["W"].nnz, matrices["R"].nnz) == (0, 0)
        vectors = {name: root["vectors"][name][()] for name in ("q", "s", "mu")}
        return matrices["V"], vectors["q"], vectors["s"], vectors["mu"], int(root["spacedim"][0])


def most_by_forces(v, q, s, mu, dimension):
    """The most of -q.r over forces in their cones that balance; as normal forces are given, that is the least power."""
    size = v.shape[0]
    scale = np.ones(size)
    scale[::dimension] = mu
    matrix = sparse.vstack([v.T, sparse.diags_array(scale)])
    cones = [("L=", v.shape[1]), *[("Q", dimension)] * len(mu)]
    return -least(q, sparse.csr_array(matrix), np.concatenate([s, np.zeros(size)]), cones)


@pytest.mark.parametrize("name", ["minimum", "discs"])
def test_fclib_of_lattices_has_the_proven_optimum(name, request, tmp_path):
    assert_fclib_is_least(request.getfixturevalue(name), tmp_path)


def test_fclib_of_packings_has_the_proven_optimum(packed, tmp_path):
    assert_fclib_is_least(packed, tmp_path)


def assert_fclib_is_least(run, tmp_path):
    export_problem(run, "fclib", tmp_path / "a.hdf5")
    v, q, s, mu, dimension = read_fclib(tmp_path / "a.hdf5")
    assert v.shape == (dimension * len(mu), len(s))
    assert_is_least(most_by_forces(v, q, s, mu, dimension), run)


def test_what_cannot_be_said_is_refused(solved, minimum, tmp_path):
    viscous = solved(shape=(5, 6), law="viscous", seed=4)
    with pytest.raises(InputError, match="law is viscous; the format fclib has friction only"):
        export_problem(viscous, "fclib", tmp_path / "a.hdf5")
    with pytest.raises(InputError, match="replica is 1; the run has 1 replica"):
        export_problem(minimum, "cbf", tmp_path / "a.cbf", replica=1)
    turned = solved(shape=(4, 5), torque=500.0)
    with pytest.raises(InputError, match="the run is driven by a torque of 500"):
        export_problem(turned, "cbf", tmp_path / "a.cbf")
    assert not list(tmp_path.iterdir())


def test_the_command_writes_into_the_run_directory(minimum):
    done = bearings("export", minimum, "--format", "cbf")
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("problem.cbf: 150 unknown spins, 220 contacts\n")
    (minimum / "problem.cbf").unlink()
