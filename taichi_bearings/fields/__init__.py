"""The numbers of a scene on the lattice, in one flat layout, on the device that runs."""

from taichi_bearings.fields.fields import CPU_BLOCK, Fields, FieldSpec, first_slots, make_layout, on_device, team_size

__all__ = ["CPU_BLOCK", "FieldSpec", "Fields", "first_slots", "make_layout", "on_device", "team_size"]
