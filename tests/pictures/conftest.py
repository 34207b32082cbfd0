"""Runs that pictures are made of, each solved once."""

import numpy as np
import pytest

from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene.packing import Packing


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


def strip(count=24, seed=2):
    """Discs of unequal radii, each of which touches the two before it, on one side of them and then on the other; the
    first two are driven, and the last two."""
    radius = np.random.default_rng(seed).uniform(0.3, 1.5, count)
    place = [0j, complex(radius[0] + radius[1])]
    for disc in range(2, count):
        first, apart = place[-2], place[-1] - place[-2]
        ends = radius[disc - 2 : disc] + radius[disc]
        along = (abs(apart) ** 2 + ends[0] ** 2 - ends[1] ** 2) / (2 * abs(apart))
        up = (-1) ** disc * np.sqrt(ends[0] ** 2 - along**2)
        place.append(first + apart / abs(apart) * complex(along, up))
    driven = np.full(count, -1)
    driven[:2], driven[-2:] = 0, 1
    contact = [(disc - back, disc) for disc in range(1, count) for back in (2, 1) if disc >= back]
    spin = np.where(driven == 1, 1.0, -0.2)
    return Packing(np.column_stack([np.real(place), 1e4 + np.imag(place)]), contact, driven, spin, radius, seed=seed)


PACKINGS = {
    "bcc": lambda: Packing.lattice("bcc", (3, 3, 4), seed=1),
    "strip": strip,
    "periodic": lambda: Packing.lattice("triangular", (5, 4), periodic="x", seed=2),
}


@pytest.fixture(scope="session", params=list(PACKINGS))
def packed(needs_f64, tmp_path_factory, request):
    """The run of a packing."""
    folder = tmp_path_factory.mktemp("packings")
    PACKINGS[request.param]().save(folder / "packing.npz")
    settings = RunSettings(packing=str(folder / "packing.npz"), threads=1, figures="none")
    return run(settings, folder / "run").path
