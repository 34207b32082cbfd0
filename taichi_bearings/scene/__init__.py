"""What is solved and what comes out. NumPy only; nothing here knows Taichi."""

from taichi_bearings.scene.scene import LAWS, Scene
from taichi_bearings.scene.solution import Progress, Solution, Status

__all__ = ["LAWS", "Progress", "Scene", "Solution", "Status"]
