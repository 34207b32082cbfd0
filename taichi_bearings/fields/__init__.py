"""The numbers of a scene on the lattice, in one flat layout, on the device that runs."""

from taichi_bearings.fields.fields import Fields, FieldSpec, block_size, first_slots, make_layout, on_device, team_size

__all__ = ["FieldSpec", "Fields", "block_size", "first_slots", "make_layout", "on_device", "team_size"]
