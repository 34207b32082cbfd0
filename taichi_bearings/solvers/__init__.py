"""Methods that find the state of least dissipation, and the loop that runs them."""

from taichi_bearings.solvers.table import (
    METHODS,
    CundallStrack,
    GradientDescent,
    InteriorPoint,
    LinearSolver,
    MethodOptions,
    OperatorSplitting,
    PlanarCut,
    RigidLimit,
    register,
)

__all__ = [
    "METHODS", "CundallStrack", "GradientDescent", "InteriorPoint", "LinearSolver",
    "MethodOptions", "OperatorSplitting", "PlanarCut", "RigidLimit", "register",
]  # fmt: skip
