"""Frustrated bearings on square and cubic lattices and packings, solved on CPU and GPU, with proven error bounds.

    import taichi_bearings as tb

    scene = tb.Scene.random((10, 10, 10), seed=3, spin_bottom=0.1)  # or tb.Scene(coefficients=(x, y, z))
    best = tb.solve(scene, tolerance=1e-9)
    course = tb.solve(scene, tb.CundallStrack(stiffness=1e6), start="random", duration=10)
    net = tb.analyse(best)

Scene : a lattice to solve; Packing : any network of spheres.
solve, solve_many : give the state of least power as a :class:`Result`. load : reads a Result from a file.
analyse : finds rigid domains, slipless networks and cuts of a Result.
"""

from typing import TYPE_CHECKING, Any

from taichi_bearings.errors import BearingsError, DeviceError, FileError, InputError
from taichi_bearings.version import VERSION

if TYPE_CHECKING:
    from taichi_bearings.api import Packing, Result, Scene, analyse, load, solve, solve_many
    from taichi_bearings.solvers import (
        CundallStrack,
        GradientDescent,
        InteriorPoint,
        LinearSolver,
        OperatorSplitting,
        PlanarCut,
        RigidLimit,
    )

__version__ = VERSION
__all__ = [
    "BearingsError", "CundallStrack", "DeviceError", "FileError", "GradientDescent", 
    "InputError", "InteriorPoint", "LinearSolver", "OperatorSplitting", "Packing", "PlanarCut",
    "Result", "RigidLimit", "Scene", "__version__", "analyse", "load", "solve", "solve_many",
]  # fmt: skip
OF_API = ("Packing", "Result", "Scene", "analyse", "load", "solve", "solve_many")


def __getattr__(name: str) -> Any:
    """Return a public name, loaded when it is first used: importing the package takes no time."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib
    import warnings

    of_api = name in OF_API
    with warnings.catch_warnings():  # SciPy adds filters of its own
        found = getattr(importlib.import_module(f"{__name__}.{'api' if of_api else 'solvers'}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
