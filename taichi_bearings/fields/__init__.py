"""Taichi fields on the lattice, in one flat layout; allocated on demand, reused between scenes, freed at the end."""

from taichi_bearings.fields.workspace import Workspace, borrow, release_all
from taichi_bearings.lattice.layout import Layout

__all__ = ["Layout", "Workspace", "borrow", "release_all"]
