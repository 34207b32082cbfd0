"""The examples in the help of the front door print what they show."""

import doctest

import pytest

from taichi_bearings import api
from taichi_bearings.runs import result
from taichi_bearings.scene import packing, scene


@pytest.mark.parametrize(("module", "examples"), [(api, 12), (result, 3), (scene, 5), (packing, 15)])
def test_examples_of_the_front_door_print_what_they_show(module, examples, needs_f64):
    found = doctest.testmod(module)
    assert (found.failed, found.attempted >= examples) == (0, True)
