"""Descent sweeps against plain loops in the laboratory frame."""

import numpy as np
import pytest

from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers import GradientDescent
from tests.kernels.twins import descent_sweep
from tests.scenes import axis_of, make_scene

CASES = [
    ((4, 5), (1, 1, 0), ""),
    ((3, 4, 5), (1, 1, 0), ""),
    ((3, 4, 5), (1, 2, 3), ""),
    ((4, 3, 4), (0, 1, 0), ""),
    ((2, 3, 20), (1, 1, 0), ""),
    ((4, 5), (1, 1, 0), "x"),
    ((3, 2, 5), (1, 1, 0), "y"),
    ((4, 2, 20), (1, 2, 3), "xy"),
]


def three_components(scene: Scene, spin):
    """Laboratory spins of the first replica as (*N, 3)."""
    if scene.lattice.dimension == 3:
        return spin[0].copy()
    return np.stack([np.zeros(scene.lattice.shape)] * 2 + [spin[0]], axis=-1)


@pytest.mark.parametrize(
    ("shape", "direction", "periodic", "law", "momentum"),
    [(*case, law, i % 2 == 1) for i, case in enumerate(CASES) for n, law in enumerate(LAWS) if not (i and (i + n) % 3)],
)
def test_sweeps_equal_plain_loops(shape, direction, periodic, law, momentum, precision):
    driving = {"direction": direction, "spin_bottom": -0.2, "periodic": tuple(periodic)}
    scene = make_scene(shape, law, viscosity="uniform:20,100", **driving)
    accuracy = 1e-13 if precision == "f64" else 1e-5
    method = GradientDescent(momentum=momentum).build()
    start = scene.laboratory_spin(
        scene.staggered_spin(initial_spin(scene, "random"), scene.minimum_spin_axes), scene.minimum_spin_axes
    )
    method.begin(scene, start)
    fields = method.fields
    step, sharpness = method._step_and_sharpness()
    width = 1 / sharpness if sharpness else 0.0
    box = np.sort([s * axis_of(scene) for s in (scene.spin_bottom, scene.spin_top)], axis=0)
    parity = scene.lattice.parity
    clipped = scene.clip_to_box(scene.staggered_spin(start, method.spin_axes), method.spin_axes)
    omega = three_components(scene, scene.laboratory_spin(clipped, method.spin_axes))
    ahead, coefficient, beside = omega.copy(), scene.lattice.by_axis(scene.coefficient[0]), ()
    if law == "coulomb-viscous":
        viscosity = scene.lattice.radius / scene.normal_force * scene.viscosities[0]
        beside = (scene.lattice.by_axis(viscosity), width if momentum else 2 * step)
    for sweep in range(4):
        moved, _ = descent_sweep(ahead, coefficient, law, step, width, box, parity, *beside)
        beta = sweep / (sweep + 3) if momentum else 0.0
        ahead, omega = moved + beta * (moved - omega), moved
    method.advance(4)
    name = "spin" if momentum else "point"
    found = three_components(
        scene, scene.laboratory_spin(scene.impose_driving(fields.read(name), method.spin_axes), method.spin_axes)
    )
    assert np.abs(found - omega).max() <= accuracy


@pytest.mark.parametrize(("shape", "direction", "periodic"), CASES[::2] + CASES[-1:])
def test_averages_equal_plain_loops(shape, direction, periodic, precision):
    """From random spins: contacts near rest would turn rounding of the spins into forces, in any precision."""
    scene = make_scene(shape, direction=direction, periodic=tuple(periodic))
    accuracy = 1e-13 if precision == "f64" else 1e-5
    method = GradientDescent(momentum=False).build()
    start = scene.laboratory_spin(
        scene.staggered_spin(initial_spin(scene, "random"), scene.minimum_spin_axes), scene.minimum_spin_axes
    )
    method.begin(scene, start)
    method.iteration = method.epoch_length // 2  # from here on the method averages
    step, sharpness = method._step_and_sharpness()
    box = np.sort([s * axis_of(scene) for s in (scene.spin_bottom, scene.spin_top)], axis=0)
    clipped = scene.clip_to_box(scene.staggered_spin(start, method.spin_axes), method.spin_axes)
    omega = three_components(scene, scene.laboratory_spin(clipped, method.spin_axes))
    coefficient = scene.lattice.by_axis(scene.coefficient[0])
    spin_sum, force_sum = np.zeros_like(omega), {}
    for _ in range(6):
        spin_sum += omega
        omega, forces = descent_sweep(omega, coefficient, "coulomb", step, 1 / sharpness, box, scene.lattice.parity)
        for contact, force in forces.items():
            force_sum[contact] = force_sum.get(contact, 0) + force * scene.lattice.parity[contact[0]]
    method.advance(6)
    progress = method.progress()
    found = three_components(scene, scene.laboratory_spin(progress.staggered, method.spin_axes))
    free = ~scene.lattice.is_driven
    assert np.abs(found - spin_sum / 6)[free].max() <= accuracy
    sizes = scene.lattice.by_axis(np.linalg.norm(progress.force[:, 0], axis=0) / scene.normal_force)
    for (site, axis), total in force_sum.items():
        assert sizes[axis][site] == pytest.approx(np.linalg.norm(total) / 6, abs=accuracy)
