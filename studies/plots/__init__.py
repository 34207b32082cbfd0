"""Figures of the studies: arrays in, Figure out."""
