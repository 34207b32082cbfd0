"""Methods that reach the state of least dissipation, and the one loop that drives them."""

import importlib
from typing import Any

# name -> "module:class", imported on use so that listing the names does not load Taichi
METHODS = {
    "planar-cut": "taichi_bearings.solvers.planar_cut:PlanarCut",
    "interior-point": "taichi_bearings.solvers.interior_point:InteriorPoint",
    "operator-splitting": "taichi_bearings.solvers.operator_splitting:OperatorSplitting",
    "linear-solver": "taichi_bearings.solvers.linear_solver:LinearSolver",
    "gradient-descent": "taichi_bearings.solvers.gradient_descent:GradientDescent",
    "rigid-limit": "taichi_bearings.solvers.rigid_limit:RigidLimit",
    "cundall-strack": "taichi_bearings.solvers.cundall_strack:CundallStrack",
}


def method_class(name: str) -> Any:
    """The class of a method by its name in METHODS."""
    module, _, attribute = METHODS[name].partition(":")
    return getattr(importlib.import_module(module), attribute)
