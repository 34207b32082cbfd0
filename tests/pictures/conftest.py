"""Runs that pictures are made of, each solved once."""

import pytest

from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings


@pytest.fixture(scope="session")
def solved(taichi_runtime, needs_f64, tmp_path_factory):
    """A function that solves a scene and gives its run directory, each scene once."""
    done = {}

    def solve(**settings):
        key = repr(sorted(settings.items()))
        if key not in done:
            done[key] = tmp_path_factory.mktemp("runs") / "run"
            run(RunSettings(threads=1, figures="none", **settings), done[key])
        return done[key]

    return solve


@pytest.fixture(scope="session")
def minimum(solved):
    """A certified minimum in 3D with proven states, whose slipless contacts join bottom and top."""
    return solved(shape=(5, 5, 5), seed=7, spin_bottom=0.1)


@pytest.fixture(scope="session")
def ring(solved):
    """A certified minimum whose sides are closed, one of them a ring of two spheres."""
    return solved(shape=(2, 4, 5), periodic="x,y", seed=3, spin_bottom=0.1)


@pytest.fixture(scope="session", params=[(2, 4, 5), (4, 4, 5), (6, 5)], ids=str)
def periodic(solved, request):
    """A dynamics with snapshots on a lattice whose sides are closed, one of them a ring of two spheres, and many
    slipless contacts across them."""
    sides = "x" if len(request.param) == 2 else "x,y"
    return solved(
        shape=request.param,
        periodic=sides,
        method="cundall-strack",
        seed=3,
        spin_bottom=0.1,
        duration=2,
        snapshots="0,1,2",
    )


@pytest.fixture(scope="session")
def dynamics(solved):
    """A dynamics in 3D with snapshots at its beginning, on its way and at its end."""
    return solved(
        shape=(3, 4, 5), method="cundall-strack", initial="random", seed=5, duration=0.05, snapshots="0,0.001,0.01,0.05"
    )


@pytest.fixture(scope="session")
def discs(solved):
    """A certified minimum in 2D."""
    return solved(shape=(7, 6), seed=2)
