"""Memory for the numbers of spheres and contacts, row by row in one array, on the device that runs."""

from taichi_bearings.fields.fields import Fields, FieldSpec, block_size, first_slots, number_type, on_device, team_size

__all__ = ["FieldSpec", "Fields", "block_size", "first_slots", "number_type", "on_device", "team_size"]
