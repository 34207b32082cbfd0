"""Fields and their compiled kernels are kept for the next scene."""

from taichi_bearings.fields import borrow
from taichi_bearings.fields.workspace import make_layout


def test_the_fields_used_last_serve_the_next_scene():
    layout, spec = make_layout(1, (5, 4)), (("tried_here_only", 1),)
    with borrow(layout, spec) as first, borrow(layout, spec) as second:
        assert first is not second
    for _ in range(2):
        with borrow(layout, spec) as again:
            assert again is first  # given back after the second
