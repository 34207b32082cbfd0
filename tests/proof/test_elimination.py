"""Elimination along a nested dissection: the order, the factor, and what of a matrix rounding can hide."""

from fractions import Fraction

import networkx
import numpy as np
import pytest
from scipy import sparse

from taichi_bearings import dissection
from taichi_bearings.dissection import dissected, restricted
from taichi_bearings.proof import rounded_elimination as elimination
from taichi_bearings.proof.curvature import Floor, _largest_of_products, proven_floor
from taichi_bearings.proof.rounded_elimination import Elimination, Samples


def neighbours(shape: tuple[int, ...]) -> tuple[sparse.csc_array, np.ndarray]:
    """How many neighbours the nodes of a lattice have, and -1 between them; and where they are."""
    node = np.arange(np.prod(shape)).reshape(shape)
    ends = [(node.take(range(n - 1), a).ravel(), node.take(range(1, n), a).ravel()) for a, n in enumerate(shape)]
    low, high = (np.concatenate(end) for end in zip(*ends, strict=True))
    joined = sparse.coo_array((-np.ones(len(low)), (low, high)), shape=(node.size,) * 2)
    joined = (joined + joined.T).tocsc()
    return joined - sparse.diags_array(joined.sum(axis=0)), np.indices(shape).reshape(len(shape), -1).astype(float)


def scattered(seed: int, count: int = 120) -> tuple[sparse.csc_array, np.ndarray]:
    """A matrix of several pieces without any order, with eigenvalues of 0.1 and more."""
    rng = np.random.default_rng(seed)
    rows = sparse.random_array((2 * count, count), density=2.5 / count, rng=rng, data_sampler=rng.standard_normal)
    return (rows.T @ rows + 0.1 * sparse.eye_array(count)).tocsc(), rng.random((3, count))


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(elimination, "REGION_UNKNOWNS", 4)
    monkeypatch.setattr(elimination, "WHOLE_UNKNOWNS", 4)


def test_the_same_graph_is_divided_once_and_any_other_for_itself(monkeypatch):
    """As many divisions as different graphs, places and leaves, and the parts are those of a division of their own."""
    divided = list[int]()
    own = dissection._divided
    monkeypatch.setattr(dissection, "_divided", lambda *given: divided.append(1) or own(*given))
    monkeypatch.setattr(dissection, "_kept", {})
    (one, place), (other, beside) = scattered(1), scattered(2)
    asked = [(one, place, 4), (other, place, 4), (one, beside, 4), (one, place, 8), (one, place, 4, 60)]
    asked.append((one.copy(), place.copy(), 4))
    found = [dissected(*given) for given in asked * 2]
    assert len(divided) == 5
    for given, parts in zip(asked * 2, found, strict=True):
        for part, expected in zip(parts, own(*given), strict=True):
            assert np.array_equal(part.nodes, expected.nodes)
            assert part.children == expected.children


@pytest.mark.parametrize("seed", range(5))
def test_what_is_dissected_is_joined_only_through_the_parts_above(seed):
    matrix, place = scattered(seed)
    parts = dissected(matrix, place, 4)
    assert sorted(np.concatenate([part.nodes for part in parts])) == list(range(len(place[0])))
    owner, parent = np.empty(len(place[0]), dtype=int), {}
    for number, part in enumerate(parts):
        owner[part.nodes] = number
        assert all(child < number for child in part.children)
        assert len(part.nodes) <= 4 or part.children
        parent |= dict.fromkeys(part.children, number)
    above = [{n} for n in range(len(parts))]
    for number in reversed(range(len(parts))):
        above[number] |= above[parent[number]] if number in parent else set()
    for a, b in zip(*matrix.nonzero(), strict=True):
        assert owner[a] in above[owner[b]] or owner[b] in above[owner[a]]


def test_connected_pieces_up_to_a_size_are_not_divided():
    """Of sizes that networkx knows; each larger piece is divided as if it were alone."""
    matrix, place = scattered(3, 200)
    pieces = [np.sort(list(piece)) for piece in networkx.connected_components(networkx.from_scipy_sparse_array(matrix))]
    size = sorted(map(len, pieces))[-1]
    assert size > 20
    parts = dissected(matrix, place, 4, size)
    assert sorted(part.nodes.tolist() for part in parts) == sorted(piece.tolist() for piece in pieces)
    assert not any(part.children for part in parts)
    largest = next(piece for piece in pieces if len(piece) == size)
    whole = [part.nodes.tolist() for part in dissected(matrix, place, 4, size - 1)]
    alone = dissected(matrix[largest][:, largest].tocsc(), place[:, largest], 4)
    assert all(largest[part.nodes].tolist() in whole for part in alone)
    assert len(whole) == len(pieces) - 1 + len(alone)


@pytest.mark.parametrize("seed", range(5))
def test_the_parts_of_some_nodes_of_a_divided_graph_are_a_division(seed):
    """Some nodes are left out, and some stand for several; what parts keep apart is joined through parts above."""
    matrix, place = scattered(seed)
    node = np.sort(np.random.default_rng(seed).integers(0, 90, 110))
    joined, of = matrix[node][:, node].tocsc(), restricted(dissected(matrix, place, 4), node, 6)
    assert sorted(np.concatenate([part.nodes for part in of])) == list(range(len(node)))
    assert all(len(part.nodes) for part in of)
    size = [len(part.nodes) for part in of]
    for number, part in enumerate(of):
        size[number] += sum(size[child] for child in part.children)
        assert size[number] > 6 or not part.children
    whole = joined.toarray() + 0.1 * np.eye(len(node))  # copies of one node are alike
    elimination, right = Elimination.of(sparse.csc_array(whole), place[:, node], of), np.arange(float(len(node)))
    np.testing.assert_allclose(elimination.factorised().solve(right), np.linalg.solve(whole, right), atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_the_nodes_between_two_halves_are_as_many_as_edges_without_a_common_node(seed):
    """König's theorem; some edges are given twice, and some nodes have none."""
    rng = np.random.default_rng(seed)
    low, high = rng.integers(0, 25, 60), rng.integers(30, 55, 60)
    low, high = np.append(low, low[:7]), np.append(high, high[:7])
    cover = dissection._least_cover(low, high, 60)
    graph = networkx.Graph()  # old ones look for pandas where edges are given here
    graph.add_edges_from(zip(low.tolist(), high.tolist(), strict=True))
    assert (cover[low] | cover[high]).all()
    assert cover.sum() == len(networkx.max_weight_matching(graph, maxcardinality=True))


@pytest.mark.parametrize("seed", range(5))
def test_the_factor_is_that_of_the_shifted_matrix(seed):
    matrix, place = scattered(seed)
    elimination, shifted = Elimination.of(matrix, place), matrix.toarray() - 0.05 * np.eye(len(place[0]))
    factor = elimination.factorised(0.05)
    whole = np.zeros(shifted.shape)
    for front, columns in factor.columns:
        whole[front.places, front.first : front.first + front.own] = np.concatenate(columns)
    ordered = shifted[np.ix_(factor.order, factor.order)]
    np.testing.assert_allclose(np.tril(whole), np.linalg.cholesky(ordered), atol=1e-13)
    right = np.random.default_rng(seed).standard_normal(len(shifted))
    np.testing.assert_allclose(factor.solve(right), np.linalg.solve(shifted, right), rtol=1e-10, atol=1e-12)
    exact = whole.astype(np.longdouble)  # but for 1e-19
    missed = np.linalg.norm((exact @ exact.T - ordered).astype(float), 2)
    root = np.sqrt(((whole != 0).sum(axis=1) + 1) * 2.0**-53)[:, None]  # Higham's bound
    allowed = np.linalg.norm((root * abs(whole)) @ (root * abs(whole)).T, 2)
    assert 1e-17 < missed < allowed < elimination.distance_from_positive(0.05) < 50 * allowed


@pytest.mark.parametrize("in_units", [False, True])
def test_floors_of_samples_are_below_their_least_eigenvalues(in_units):
    """Matrices of four samples in one elimination, one of them singular: each has the floor that it has alone. One in
    units of unknowns, over the square of the largest unit, is a floor for all."""
    rows, of = [], []
    for seed in range(4):
        count = 20 + 7 * seed
        dense = np.random.default_rng(seed).standard_normal((2 * count, count)) / np.sqrt(2 * count)
        dense[:, 3] = dense[:, 4] if seed == 2 else dense[:, 3]
        rows.append(sparse.csr_array(dense))
        of += [seed] * count
    whole = sparse.csr_array(sparse.block_diag(rows, format="csr"))
    place = np.random.default_rng(9).random((3, len(of)))

    def floors(part, samples, at):
        doubt = sparse.csr_array((1e-16 * abs(part.data), part.indices, part.indptr), shape=part.shape)
        elimination = Elimination.of((part.T @ part).tocsc(), at, None, samples)
        if not in_units:
            return proven_floor(part, doubt, elimination)
        floor = Floor.of(part, doubt, elimination)
        return floor.tau / elimination.samples.largest(floor.unit) ** 2

    together = floors(whole, Samples(np.array(of), 4), place)
    for seed, part in enumerate(rows):
        alone = floors(part, None, place[:, np.array(of) == seed])
        least = np.linalg.eigvalsh((part.T @ part).toarray())[0]
        assert together[seed] == pytest.approx(alone[0], rel=1e-6)
        assert (together[seed] == 0) == (seed == 2)
        assert together[seed] <= max(least, 0.0)
        assert seed == 2 or not in_units or together[seed] > least / 50


def pivots(matrix: list[list[Fraction]]) -> list[Fraction]:
    """The pivots of an elimination in fractions."""
    found = []
    for k in range(len(matrix)):
        found.append(matrix[k][k])
        for i in range(k + 1, len(matrix)):
            factor = matrix[i][k] / matrix[k][k]
            matrix[i] = [a - factor * b for a, b in zip(matrix[i], matrix[k], strict=True)]
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_floor_in_units_holds_in_fractions_and_softens_only_what_is_soft(seed):
    """Two unknowns that hardly differ in what they do, beside others: their difference is held by 1e-8 of the rest."""
    rng, count = np.random.default_rng(seed), 9
    dense = rng.standard_normal((2 * count, count)) * (rng.random((2 * count, count)) < 0.5)
    dense[:, 1] = dense[:, 0] + 1e-4 * rng.standard_normal(2 * count)
    dense /= np.linalg.norm(dense, axis=0)
    rows = sparse.csr_array(dense)
    doubt = sparse.csr_array((1e-16 * abs(rows.data), rows.indices, rows.indptr), shape=rows.shape)
    floor = Floor.of(rows, doubt, Elimination.of((rows.T @ rows).tocsc(), rng.random((3, count))))
    exact = [[Fraction(x) for x in row] for row in dense.tolist()]
    less = [Fraction(float(floor.tau[0])) / Fraction(unit) ** 2 for unit in floor.unit.tolist()]
    left = [[sum(row[i] * row[j] for row in exact) - (less[i] if i == j else 0) for j in range(count)]
            for i in range(count)]  # fmt: skip
    assert min(pivots(left)) > 0
    assert (np.log2(floor.unit) % 1 == 0).all()
    held, least = floor.tau[0] / floor.unit**2, np.linalg.eigvalsh(dense.T @ dense)[0]
    assert least / 100 < held[:2].max() < 100 * least < 1e-5
    assert held[2:].min() > 1e-3
    doubled = Elimination.of((rows.T @ rows).tocsc(), rng.random((3, count))).in_units(floor.unit).lower
    ordered = dense.T @ dense * np.outer(floor.unit, floor.unit)
    np.testing.assert_allclose(np.linalg.eigvalsh(doubled.toarray()), np.linalg.eigvalsh(ordered), rtol=1e-6)


def test_what_is_drawn_has_the_inverse_as_covariance():
    matrix, place = scattered(1, 30)
    factor = Elimination.of(matrix, place).factorised()
    drawn = factor.drawn(np.eye(30))  # columns add up to the covariance
    np.testing.assert_allclose(drawn @ drawn.T, np.linalg.inv(matrix.toarray()), atol=1e-12)


def test_a_matrix_that_is_not_positive_is_refused():
    matrix, place = scattered(0)
    elimination, least = Elimination.of(matrix, place), np.linalg.eigvalsh(matrix.toarray())[0]
    assert elimination.factorised(0.999 * least) is not None
    assert elimination.factorised(1.001 * least) is None
    assert elimination.distance_from_positive(1.001 * least) == np.inf
    matrix[3, 3] = np.nan
    assert not Elimination.of(matrix, place).distance_from_positive(0.0) < np.inf


def test_what_rounding_hides_is_within_its_bound():
    """Matrices ((a, b), (b, c)) with b^2 > a c: not positive, by at most (b^2 - a c) / (a + c) but for its square."""
    rng, passed, two = np.random.default_rng(0), 0, Elimination.of(sparse.csc_array(np.ones((2, 2))), np.zeros((1, 2)))
    for a, c in rng.uniform(0.5, 2.0, (5000, 2)):
        b = np.nextafter(np.sqrt(a * c), 2.0)
        two.lower.data[:] = a, b, c
        (distance,) = two.distance_from_positive(0.0)
        lacking = float((Fraction(b) ** 2 - Fraction(a) * Fraction(c)) / (Fraction(a) + Fraction(c)))
        if lacking > 0 and distance < np.inf:
            passed += 1
            assert 0.99 * lacking < distance < 2e-14
    assert passed > 20


def test_parts_that_nothing_joins_need_no_separator():
    star = 50.0 * np.eye(40)
    star[0, 1:] = star[1:, 0] = 1.0
    elimination = Elimination.of(sparse.csc_array(star), np.random.default_rng(0).random((3, 40)))
    assert 0 in [front.own for front in elimination.fronts]
    np.testing.assert_allclose(elimination.factorised().solve(star @ np.arange(40.0)), np.arange(40.0), atol=1e-12)


@pytest.mark.parametrize("fault", ["twice", "lost", "in two"])
def test_an_order_that_leaves_something_out_is_refused(monkeypatch, fault):
    """So that nothing depends on who has found it."""

    def spoiled(*arguments):
        parts = dissected(*arguments)
        if fault == "twice":
            parts[0] = dissection.Part(np.append(parts[0].nodes[1:], parts[-1].nodes[0]), parts[0].children)
        elif fault == "lost":
            parts[-1] = dissection.Part(parts[-1].nodes, [])
        else:
            parts[-1] = dissection.Part(parts[-1].nodes, [*parts[-1].children, 0])
        return parts

    monkeypatch.setattr(elimination, "dissected", spoiled)
    with pytest.raises(RuntimeError, match="internal check failed"):
        Elimination.of(*neighbours((4, 4, 4)))


@pytest.mark.parametrize("seed", range(4))
def test_differences_of_products_are_within_their_bound_and_near_it_where_doubts_lie_apart(seed):
    """Doubts that are large in a row of small entries count with these, not with the largest entries of all."""
    rng = np.random.default_rng([11, seed])
    rows = rng.standard_normal((40, 12)) * np.append(np.full(38, 1e3), [1.0, 1.0])[:, None]
    doubt = 1e-9 * np.abs(rng.standard_normal(rows.shape)) * np.append(np.zeros(38), [1.0, 1.0])[:, None]
    sizes = sparse.csr_array(np.abs(rows) + doubt)
    bound = _largest_of_products(sizes, sparse.csr_array(doubt), 6, Samples.one(12))[0]
    norms = []
    for _ in range(50):
        other = rows + doubt * rng.choice([-1, 1], doubt.shape)
        norms.append(np.linalg.norm((other - rows).T @ other + rows.T @ (other - rows), 2))
    assert max(norms) <= bound
    assert bound < 20 * max(norms)
    assert bound < 1e-2 * 2 * np.linalg.norm(sizes.toarray(), 2) * np.linalg.norm(doubt, 2)
