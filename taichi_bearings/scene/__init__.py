"""What is solved and what comes out. NumPy only; nothing here knows Taichi."""

from taichi_bearings.scene.scene import LAWS, Scene
from taichi_bearings.scene.solution import Energy, Progress, Snapshots, Solution, Status

__all__ = ["LAWS", "Energy", "Progress", "Scene", "Snapshots", "Solution", "Status"]
