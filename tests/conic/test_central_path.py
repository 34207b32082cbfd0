"""Steps along the central path where a factorisation takes far longer than a solution, as in large samples."""

import numpy as np
import pytest

import taichi_bearings.conic.central_path as central_path
from taichi_bearings.conic.central_path import Path
from taichi_bearings.conic.cones import inner, length
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.iterate import Iterate
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.lattice import Lattice
from taichi_bearings.numerics.cholesky import Engine, dissect

pytestmark = pytest.mark.usefixtures("taichi_runtime")
AXES = 0, 1
LAYERS = np.repeat(np.tile(np.arange(1, 7) / 7, 64), 2)  # spins of 8 x 8 x 8 spheres in proportion to the height


def followed(seed: int, engine: Engine, begin=Iterate.start) -> tuple[int, Iterate, float]:
    """Return the number of steps until the relative gap of a lattice of 8 x 8 x 8 spheres is below 1e-9, the point
    there, and its power.

    seed : of the coefficients.
    engine : the way to factorise, which decides how many correctors a step has.
    begin : function that returns the point where the path begins.
    """
    lattice = Lattice((8, 8, 8))
    system = lattice_system(lattice, AXES, np.ones(2))
    matrix, friction = NewtonMatrix(system, dissect(lattice, AXES), engine=engine), np.random.default_rng(seed)
    friction = friction.uniform(0.1, 1.9, system.offset.shape[1])
    path = Path(matrix)
    path.put(0, begin(system, np.zeros(system.unknowns), friction, 1 / 7))
    steps = 0
    while steps == 0 or path.gap(0) > 1e-9:
        assert path.step()[0]
        steps += 1
    point = path.iterate(0)
    return steps, point, float(friction @ length(point.difference))


def test_further_correctors_save_factorisations_and_lead_to_the_same_minimum() -> None:
    all_steps, all_fewer = 0, 0
    for seed in (1, 2, 3):
        steps, _, power = followed(seed, Engine.LAUNCH)
        fewer, point, same = followed(seed, Engine.CALLS)
        assert same == pytest.approx(power, rel=1e-8)
        # the point is inside all cones, and its forces balance
        assert (length(point.dual) < point.friction).all()
        assert (length(point.difference) < point.bound).all()
        assert np.abs(point.system.torques(point.dual)).max() < 1e-8
        all_steps, all_fewer = all_steps + steps, all_fewer + fewer
    assert all_fewer < all_steps


def test_a_step_is_never_shorter_than_its_correctors_make_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the steps between the one before and the corrected one the furthest is taken."""
    furthest, seen = Path._furthest, []

    def kept(path: Path, step: central_path._Step, further: central_path._Step) -> central_path._Step:
        """Return what the program takes, and keep how far all three go."""
        found = furthest(path, step, further)
        seen.append((found.reach[0], further.reach[0]))
        return found

    monkeypatch.setattr(Path, "_furthest", kept)
    followed(1, Engine.CALLS)
    assert all(found >= of for found, of in seen)
    assert any(found > of for found, of in seen)


def start_near_path(friction: np.ndarray, spins: np.ndarray, lattice: Lattice) -> Iterate:
    """Return the start near the path of a lattice between planes whose spins differ by 1, with slips of 1 / 7."""
    return Iterate.near_path(lattice_system(lattice, AXES, np.ones(2)), spins, friction, 1 / 7)


def test_starts_near_the_path_have_one_product_and_save_steps() -> None:
    lattice, rng = Lattice((8, 8, 8)), np.random.default_rng(5)
    system = lattice_system(lattice, AXES, np.ones(2))
    point = start_near_path(rng.uniform(0.1, 1.9, system.offset.shape[1]), LAYERS, lattice)
    assert (length(point.dual) < point.friction).all()
    assert (length(point.difference) < point.bound).all()
    products = point.friction * point.bound + inner(point.difference, point.dual)
    assert products == pytest.approx(np.full(len(products), products.mean()), rel=1e-12)
    plain, near = (
        sum(followed(seed, Engine.LAUNCH, lambda system, _, *rest, begin=begin: begin(system, LAYERS, *rest))[0]
            for seed in range(4))
        for begin in (Iterate.start, Iterate.near_path)
    )  # fmt: skip
    assert near < plain


def test_starts_have_no_forces_where_they_would_take_long_to_balance() -> None:
    lattice, rng = Lattice((8, 8, 8)), np.random.default_rng(6)
    system = lattice_system(lattice, AXES, np.ones(2))
    even, apart = rng.uniform(0.1, 1.9, system.offset.shape[1]), 10 ** rng.uniform(-6, 6, system.offset.shape[1])
    wild = rng.uniform(-1, 1, system.unknowns)
    assert start_near_path(even, LAYERS, lattice).dual.any()
    assert not start_near_path(apart, LAYERS, lattice).dual.any()
    assert not start_near_path(even, wild, lattice).dual.any()


@pytest.mark.parametrize(("side", "correctors"), [(6, 1), (12, 2), (16, 3)])
def test_correctors_are_as_many_as_factorisations_are_long(side: int, correctors: int) -> None:
    lattice = Lattice((side, side, side))
    system = lattice_system(lattice, AXES, np.ones(2))
    matrix, contacts = NewtonMatrix(system, dissect(lattice, AXES), engine=Engine.LAUNCH), system.offset.shape[1]
    rng, spins = np.random.default_rng(7), np.zeros(system.unknowns)
    even, apart = (
        Iterate.start(system, spins, of(contacts), 1.0) for of in (rng.random, lambda n: rng.random(n) ** 40)
    )
    assert Path(matrix)._correctors_for(even) == correctors
    assert Path(matrix)._correctors_for(apart) == 3
