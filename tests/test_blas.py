import numpy as np
import pytest

from taichi_bearings import blas


def test_the_number_of_threads_is_one_inside_and_as_before_afterwards():
    functions = blas._thread_functions()
    if functions is None:
        pytest.skip("NumPy does not use OpenBLAS here")
    get, put = functions
    original = get()
    put(2)
    outside = get()
    with blas.one_thread():
        assert get() == 1
    assert get() == outside
    put(original)


def test_an_error_inside_restores_the_number_too(monkeypatch):
    threads = [3]
    monkeypatch.setattr(blas, "_thread_functions", lambda: (lambda: threads[-1], threads.append))

    def fail():
        with blas.one_thread():
            assert threads[-1] == 1
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert threads == [3, 1, 3]


def test_another_library_is_left_alone(monkeypatch):
    monkeypatch.setattr(blas, "_thread_functions", lambda: None)
    with blas.one_thread():
        assert (np.ones((2, 2)) @ np.ones((2, 2)) == 2).all()
