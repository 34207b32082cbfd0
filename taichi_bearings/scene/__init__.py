"""What is solved, scenes and packings, and what comes out, solutions; in NumPy, without Taichi."""

from taichi_bearings.scene.bearing import Bearing
from taichi_bearings.scene.law import LAWS as LAWS
from taichi_bearings.scene.law import Law as Law
from taichi_bearings.scene.scene import Scene
from taichi_bearings.scene.solution import Energy, Progress, Snapshots, Solution, Status

__all__ = ["LAWS", "Bearing", "Energy", "Progress", "Scene", "Snapshots", "Solution", "Status"]
