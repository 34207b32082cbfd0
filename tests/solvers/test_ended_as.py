"""How a run ended follows from what is proven of its answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from taichi_bearings.scene import Status
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import GradientDescent, InteriorPoint, OperatorSplitting
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule, ended_as
from tests.scenes import make_scene

CUT_SHORT = (Status.STEP_LIMIT, Status.TIME_LIMIT, Status.INTERRUPTED)


def answer(**values):
    """What two samples prove; by default of all spins."""
    return SimpleNamespace(**{name: np.array(of) for name, of in ({"is_restricted": [False] * 2} | values).items()})


@pytest.mark.parametrize("status", list(Status))
@pytest.mark.parametrize("duration", [np.inf, 3.0])
def test_what_is_proven_is_certified_unless_it_is_cut_short(status, duration):
    proven = answer(gap=[0.0, 1e-9], lower_bound=[0.0, 1.0])
    stays = duration == 3.0 and status in CUT_SHORT
    found = ended_as(status, proven, StopRule(tolerance=1e-8, duration=duration), is_dynamics=duration == 3.0)
    assert found is (status if stays else Status.CERTIFIED)


@pytest.mark.parametrize("status", list(Status))
@pytest.mark.parametrize("duration", [np.inf, 3.0])
def test_what_is_proven_of_slow_spins_alone_is_restricted_unless_a_motion_reached_its_end(status, duration):
    proven = answer(gap=[0.0, 1e-9], lower_bound=[0.0, 1.0], is_restricted=[False, True])
    found = ended_as(status, proven, StopRule(tolerance=1e-8, duration=duration), is_dynamics=duration == 3.0)
    if status in (Status.STATIONARY, Status.FINISHED) or (duration == 3.0 and status in CUT_SHORT):
        assert found is status
    else:
        assert found is (Status.FINISHED if duration == 3.0 else Status.RESTRICTED)
    assert not Status.RESTRICTED.reached


@pytest.mark.parametrize("status", list(Status))
@pytest.mark.parametrize(("least", "is_dynamics"), [(0.0, True), (0.0, False), (1.0, True)])
def test_what_is_not_proven_is_not_certified(status, least, is_dynamics):
    """A sample that is off is enough; a motion whose least power is 0 has come to rest."""
    open_ = answer(gap=[0.0, 1e-7], lower_bound=[1.0, least], is_restricted=[True, False])
    expected = status
    if status is Status.CERTIFIED:
        expected = Status.STATIONARY if is_dynamics and least == 0 else Status.STALLED
    assert ended_as(status, open_, StopRule(tolerance=1e-8), is_dynamics) is expected


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("method", [OperatorSplitting(), GradientDescent(), InteriorPoint()])
@pytest.mark.parametrize("iterations", [4, 60])
def test_a_lattice_is_certified_just_where_its_gap_is_the_tolerance_or_less(method, iterations):
    scene = make_scene((4, 3, 5), seeds=[2])

    def found(tolerance):
        stop = StopRule(tolerance=float(tolerance), iterations=iterations)
        return solve(scene, method.build(), initial_spin(scene, "linear"), stop)

    gap = found(1e-15).gap[0]
    for tolerance in (np.nextafter(gap, 0), gap, np.nextafter(gap, 1), 2 * gap, gap / 2):
        if 0 < tolerance < 1:
            answer = found(tolerance)
            assert (answer.status is Status.CERTIFIED) == (answer.gap[0] <= tolerance)
