"""Taichi kernels: one statement of the contact physics, walked over the flat layout. No options, files or loops in time
beyond fused steps."""
