"""Packings: any bearing that users bring, with its state of least dissipation and what is proven of it.

Letters: N spheres, in D = 2 (discs) or 3 dimensions; E contacts; C components of a spin, 1 for discs, else 3; R radius
of a sphere, omega its spin, and u = R omega, which methods solve for.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from taichi_bearings.packing.answer import solve_packing
    from taichi_bearings.scene.packing import Packing

__all__ = ["Packing", "solve_packing"]
MODULES = {
    "Packing": "scene.packing", "solve_packing": "packing.answer",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    """Return a name of this package, loaded when it is first used, as runs of lattices need none of them."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    found = getattr(importlib.import_module(f"taichi_bearings.{MODULES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
