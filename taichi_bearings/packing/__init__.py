"""Any bearing that users bring: its state of least dissipation, what is proven of it.

Shapes: N spheres (of discs D = 2, else 3), E contacts, C = 3 components of a spin, of discs 1; u = R omega.
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
    """What packings are and what solves them, loaded when it is first used: runs of lattices need none of it."""
    if name not in MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    import importlib

    found = getattr(importlib.import_module(f"taichi_bearings.{MODULES[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
