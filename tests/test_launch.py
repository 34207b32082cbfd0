"""Kernels that are prepared once."""

import numpy as np
import pytest

from taichi_bearings import launch
from taichi_bearings.compiler import ti
from taichi_bearings.kernels.elimination import LANES, NUMBERS, VECTORS
from taichi_bearings.launch import prepared
from taichi_bearings.memory import aligned_zeros

pytestmark = pytest.mark.usefixtures("taichi_runtime")


@ti.kernel
def add(values: NUMBERS, vectors: VECTORS, first: int, count: int):
    for i in range(count):
        vectors[i] = vectors[i] + values[first + i]


def test_a_prepared_kernel_does_what_it_does_anew_each_time():
    values, vectors = np.arange(7.0), aligned_zeros(3 * LANES, LANES).reshape(3, LANES)
    start = prepared(add, values, vectors, 2, 3)
    assert not vectors.any()  # nothing has run yet
    assert not launch._warn_of_slow_starts.cache_info().currsize  # both compilers are known
    start()
    assert (vectors == np.array([2.0, 3.0, 4.0])[:, None]).all()
    values[:] = -1.0
    start()
    assert (vectors == np.array([1.0, 2.0, 3.0])[:, None]).all()


def test_two_of_a_kernel_keep_their_own_arguments():
    found = [aligned_zeros(3 * LANES, LANES).reshape(3, LANES) for _ in range(2)]
    starts = [prepared(add, np.arange(7.0), vectors, first, 3 - first) for first, vectors in enumerate(found)]
    for start in starts:
        start()
    assert [vectors[:, -1].tolist() for vectors in found] == [[0.0, 1.0, 2.0], [1.0, 2.0, 0.0]]
