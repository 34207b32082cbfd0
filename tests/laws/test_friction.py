"""The stored friction obeys the laws of mechanics in the laboratory frame and proves the lower bound by its work."""

import numpy as np
import pytest

from taichi_bearings.lattice.grid import friction_by_axis, laboratory_forces, staggered_forces
from taichi_bearings.lattice.incidence import contact_differences
from taichi_bearings.proof import certificate
from taichi_bearings.proof.certificate import (
    MOST_PROJECTIONS,
    certifying_forces,
    dual_value,
    largest_unbalanced_torque,
    lower_bound,
)
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.scenes import make_scene

RUNS = [
    ("planar-cut", "coulomb", (6, 7), 1e-10),
    ("interior-point", "coulomb", (6, 7), 1e-10),
    ("interior-point", "coulomb", (4, 5, 6), 1e-10),
    ("operator-splitting", "coulomb", (4, 5, 6), 1e-5),
    ("gradient-descent", "coulomb", (4, 5, 6), 1e-3),
    ("cundall-strack", "coulomb", (3, 2, 4), 1e-5),
    ("rigid-limit", "coulomb", (3, 4, 5), 1e-8),
    ("linear-solver", "viscous", (6, 7), 1e-10),
    ("linear-solver", "viscous", (4, 5, 6), 1e-10),
]


def solved(name, law, shape, tolerance):
    scene = make_scene(shape, law, seeds=(613,), spin_top=1.3, spin_bottom=0.2)
    return scene, solve(scene, METHODS[name]().build(), initial_spin(scene, "linear"), StopRule(tolerance))


def in_three_dimensions(scene, friction, spin):
    """Friction (*contacts, 3) an axis and spins (*N, 3) of a sample; in 2D from components along z x n, and z."""
    by_axis = friction_by_axis(friction[0], scene.lattice)
    if scene.lattice.dimension == 3:
        return by_axis, spin[0]
    along = [np.cross([0.0, 0.0, 1.0], np.eye(3)[axis]) for axis in range(2)]
    return [f[..., None] * t for f, t in zip(by_axis, along, strict=True)], spin[0][..., None] * [0.0, 0.0, 1.0]


@pytest.mark.parametrize(("name", "law", "shape", "tolerance"), RUNS)
def test_stored_friction_balances_torques_and_does_the_work_of_the_drive(name, law, shape, tolerance, needs_f64):
    scene, solution = solved(name, law, shape, tolerance)
    friction, spin = in_three_dimensions(scene, solution.friction, solution.spin)
    radius = scene.lattice.radius
    torque, dissipated = np.zeros((*shape, 3)), 0.0
    for axis, force in enumerate(friction):
        normal = np.eye(3)[axis]
        arm = np.cross(radius * normal, -force)  # on the lower sphere, r_ij x F; the upper one has -r_ij and -F
        for end in scene.lattice.along(axis):
            np.moveaxis(torque, -1, 0)[end] += np.moveaxis(arm, -1, 0)
        below, above = (np.moveaxis(np.moveaxis(spin, -1, 0)[end], 0, -1) for end in scene.lattice.along(axis))
        slip = -radius * np.cross(below + above, normal)  # paper Eq. 2
        dissipated -= float((force * slip).sum())
        length, limit = np.linalg.norm(force, axis=-1), scene.strength * scene.coefficients[axis][0]
        assert np.abs(force[..., axis]).max() == 0.0
        assert law == "viscous" or (length <= limit * (1 + 1e-14)).all()
    largest = max(np.abs(f).max() for f in friction)
    assert np.abs(torque[..., 1:-1, :]).max() < 1e-12 * radius * largest
    driven = torque * spin
    work = -float(driven[..., 0, :].sum() + driven[..., -1, :].sum())
    assert work == pytest.approx(dissipated, rel=1e-12)
    assert work == pytest.approx(solution.lower_bound[0], rel=1e-12 if tolerance < 1e-9 else 1e-2 * tolerance)
    assert solution.lower_bound[0] <= solution.power[0] * (1 + 1e-14)


def test_laboratory_friction_turns_back_into_the_same_staggered_forces():
    scene, generator = make_scene((3, 4, 5)), np.random.default_rng(19)
    for axes in ((0, 1), (1,), (0, 1, 2)):
        felt = scene.lattice.tangential_mask(axes)[:, None]
        force = np.where(felt, generator.normal(size=felt.shape), 0.0)
        back = staggered_forces(laboratory_forces(force, scene.lattice, axes), scene.lattice, axes)
        assert (force == back).all()


def test_any_forces_become_balanced_and_admissible_ones():
    scene, generator = make_scene((4, 3, 5), seeds=(5, 6)), np.random.default_rng(23)
    axes = scene.minimum_spin_axes
    felt = scene.lattice.tangential_mask(axes)[:, None]
    force = np.where(felt, 20 * generator.normal(size=(len(axes), 2, scene.lattice.all_contacts)) + 10, 0.0)
    bound = lower_bound(scene, force, axes)
    certifying = certifying_forces(scene, force, axes, bound)
    assert largest_unbalanced_torque(scene, certifying, axes).max() < 1e-12
    assert (dual_value(scene, certifying, axes) >= bound * (1 - 1e-3)).all()
    assert (bound > 0).all()
    for replica, seed in enumerate(scene.seeds):
        one = make_scene((4, 3, 5), seeds=(seed,))
        alone = certifying_forces(one, force[:, [replica]], axes, bound[[replica]])
        assert (alone[:, 0] == certifying[:, replica]).all()


@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
def test_forces_are_not_brought_into_balance_where_no_state_can_follow_or_none_is_asked_for(monkeypatch):
    """The bound that they prove is the same."""
    scene = make_scene((6, 6, 5), seeds=(1,))
    start = scene.staggered_spin(initial_spin(scene, "linear"), scene.minimum_spin_axes)
    force = scene.strength * scene.acting_coefficient * np.sign(contact_differences(start, scene.lattice, (0, 1))) / 2
    bound, made = lower_bound(scene, force, (0, 1)), []
    monkeypatch.setattr(certificate, "balance", lambda *words, of=certificate.balance: made.append(1) or of(*words))
    strongest = scene.strength * scene.acting_coefficient.max() * scene.lattice.radius * scene.jump
    # nor on large lattices, here of 180 spheres, where no state is asked for
    for share, asked, large, most in (
        (1.01, True, 180, 1),
        (0.99, True, 180, MOST_PROJECTIONS + 2),
        (0.99, False, 181, MOST_PROJECTIONS + 2),
        (0.99, False, 180, 1),
    ):
        made.clear()
        monkeypatch.setattr(certificate, "LONG_BALANCE", large)
        found = certifying_forces(scene, force, (0, 1), bound, np.array([share * strongest]), asked)
        assert dual_value(scene, found, (0, 1))[0] >= bound[0] * (1 - 1e-12)
        assert len(made) <= most
        assert (len(made) > 1) == (most > 1)
    exact = solve(scene, InteriorPoint().build(), initial_spin(scene, "linear"), StopRule(1e-9))
    assert bound[0] <= exact.power[0]


def test_what_is_open_proves_no_state_by_what_a_single_contact_can_dissipate():
    """By exact fractions of one contact: with friction w it slips by excess / w at most when it bears nothing."""
    scene = make_scene((4, 4, 4), seeds=(2,))
    fastest = scene.lattice.radius * scene.jump
    limit = (scene.strength * scene.acting_coefficient).max()
    for excess in (0.5 * limit * fastest, 2 * limit * fastest):
        assert certificate.can_prove_no_state(scene, np.array([excess])) == (excess / limit >= fastest)
    assert not certificate.can_prove_no_state(make_scene((4, 4, 4), "viscous", seeds=(2,)), np.array([1e9]))
