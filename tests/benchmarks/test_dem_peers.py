"""The other codes run our scene: they come to rest at the certified minimum. Skipped where they are not installed."""

import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import InteriorPoint
from taichi_bearings.solvers.drive import solve
from taichi_bearings.solvers.stopping import StopRule
from tests.benchmarks.dem_peers import FRICTION, PEER_STEP, Lammps, Yade, power_at_rest
from tests.scenes import make_scene

PEERS = (Lammps("hooke", 1), Lammps("granular", 1), Yade(1))


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_rests_at_the_minimum(peer):
    if not peer.is_installed:
        pytest.skip(f"{peer.name} is not installed here: {peer.how_to_install}")
    scene = make_scene((3, 3, 3), seeds=(0,), distribution=f"constant:{FRICTION}")
    spin = initial_spin(scene, "random")
    minimum = solve(scene, InteriorPoint().build(), spin, StopRule(1e-10)).power[0]
    assert power_at_rest(peer, scene, spin, duration=0.3) == pytest.approx(minimum, rel=1e-4)
    assert power_at_rest(peer, scene, spin, duration=PEER_STEP) > 1.02 * minimum  # it was not there from the start
