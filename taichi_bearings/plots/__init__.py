"""Figures: arrays in, Figure out."""

from taichi_bearings.later import leave_out_descriptions

leave_out_descriptions()
