"""The error that a time step of Gear's method is said to make, against what a step of 1/16 gives."""

from dataclasses import replace

import numpy as np
import pytest

from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack
from taichi_bearings.solvers.gear import ACCURATE_ERROR, SAMPLE_MODES, Modes, laplacian_spectrum
from taichi_bearings.solvers.on_strides import sticking_modes
from tests.scenes import make_scene
from tests.solvers.test_gear import laplacian, without_vertical

COURSE = np.unique(np.round(np.geomspace(1, 2000, 40)).astype(int))  # steps after which spins are compared


def course(scene, start, options, parts=1):
    """Spins (times, C, R, *N) after COURSE steps, each of as many `parts` of the options' length; the method."""
    method, spins = options.build(), []
    method.begin(scene, start)
    for steps in np.diff(np.concatenate([[0], COURSE])):
        method.advance(int(steps) * parts)
        spins.append(scene.impose_driving(method.fields.read("gear_0"), method.spin_axes))
    return np.array(spins), method


def said_of(method):
    """Error and advice for the whole course."""
    method.iteration = int(COURSE[-1])
    found = method.findings(method.progress())
    return found["step_error"][0], found["accurate_time_step"][0]


def measured(scene, options):
    """Root mean square and largest difference to a course of 1/16 of the step, over the largest spin; the method."""
    start = without_vertical(initial_spin(scene, "random"))
    spins, method = course(scene, start, options)
    finer, _ = course(scene, start, replace(options, time_step=method.time_step / 16), 16)
    difference = np.abs(spins - finer)[..., ~scene.lattice.is_driven] / max(np.abs(start).max(), 1.0)
    mean = np.sqrt(np.square(difference).reshape(len(COURSE), -1).mean(axis=1)).max()
    return mean, difference.max(), method


MATERIALS = [(2, 1e5, 1e3), (2, 1e3, 0.5), (2, 1e3, 50.0), (2, 1e5, 10.0), (4, 1e3, 0.5)]


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize("shape", [(8, 7), (4, 5, 6)], ids=str)
@pytest.mark.parametrize(("order", "stiffness", "damping"), MATERIALS)
def test_the_error_is_about_that_of_a_course_without_slip(order, stiffness, damping, shape):
    """Spins drawn evenly up to the largest have 0.58 of it root mean square, and damping leaves less: 0.2 to 0.8."""
    options = CundallStrack(gear_order=order, stiffness=stiffness, damping=damping)
    mean, largest, method = measured(make_scene(shape, normal_force=1e7), options)
    said, _ = said_of(method)
    assert 0.15 * said < mean < said
    assert largest < 2.5 * said


@pytest.mark.usefixtures("needs_f64")
@pytest.mark.parametrize(("order", "stiffness", "damping"), MATERIALS[:4])
def test_contacts_that_slip_make_less_of_it(order, stiffness, damping):
    options = CundallStrack(
        gear_order=order, stiffness=stiffness, damping=damping, slipping_spring="relax"
    )  # with "reset" a contact that barely slips may go either way, whatever the step
    mean, _, method = measured(make_scene((8, 7)), options)
    assert mean < said_of(method)[0]


@pytest.mark.usefixtures("needs_f64")
def test_the_error_of_viscous_contacts():
    mean, _, method = measured(make_scene((8, 7), "viscous"), CundallStrack())
    said, _ = said_of(method)
    assert 0.05 * said < mean < said


@pytest.mark.usefixtures("needs_f64")
def test_the_step_that_is_advised_is_accurate():
    scene, options = make_scene((8, 7), normal_force=1e7), CundallStrack(stiffness=1e3, damping=0.5)
    mean, _, method = measured(scene, options)
    assert mean > ACCURATE_ERROR
    _, advised = said_of(method)
    mean, _, method = measured(scene, replace(options, time_step=advised))
    assert mean < ACCURATE_ERROR
    assert said_of(method)[1] == advised


def test_without_damping_the_error_grows_with_the_time():
    modes = Modes(np.zeros(1), np.full(1, 100.0), 0.0, 50.0, np.inf)
    few, many, all_of_it = (modes.error(5, 0.02, steps) for steps in (100, 1000, 10**9))
    assert many == pytest.approx(10 * few, rel=0.3)
    assert all_of_it == pytest.approx(1, rel=0.01)
    assert modes.error(5, 0.02, 0) == 0
    advised = modes.accurate_step(5, 0.02, 10**5)
    assert advised < 0.02
    assert modes.error(5, advised, round(10**5 * 0.02 / advised)) <= ACCURATE_ERROR


@pytest.mark.parametrize("shape", [(8, 7), (3, 4, 5), (40, 9)], ids=str)
def test_the_spectrum_is_that_of_the_lattice(shape):
    scene = make_scene(shape)
    axes, exact = scene.minimum_spin_axes, []
    for component in axes:
        matrix, free = laplacian(scene, component, weighted=False)
        exact.append(np.linalg.eigvalsh(matrix[free][:, free]))
    shares = (np.arange(SAMPLE_MODES) + 0.5) / SAMPLE_MODES
    found = laplacian_spectrum(scene.lattice, axes)
    assert found == pytest.approx(np.quantile(np.concatenate(exact), shares), abs=1e-9)


@pytest.mark.parametrize("axes", [(0, 1, 2), (2,)])
def test_layers_that_turn_about_the_height_make_no_error(axes):
    options = CundallStrack()
    modes = sticking_modes(make_scene((3, 4, 5)), axes, options, 1.0, 3e-5)
    assert np.isfinite(modes.errors(2, 2e-5)).all()
