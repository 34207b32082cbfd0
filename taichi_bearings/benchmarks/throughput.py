"""How fast a sweep and a time step are, beside the best NumPy for the same sweep, in one run on one machine."""

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.errors import BearingsError
from taichi_bearings.fields import Fields, make_layout
from taichi_bearings.interrupts import unheard_by_children
from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import weights
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import CundallStrack, GradientDescent
from taichi_bearings.solvers.gradient_descent import GradientDescentMethod

SHARPNESS = 1e12  # contacts with a smaller difference than its inverse do not slip
NUMPY = "NumPy sweep"
DIRECTIONS = {2: (1.0, 1.0, 0.0), 3: (1.0, 2.0, 3.0)}  # components -> axis of the driven spins
ROUNDS = 7  # each times every candidate once, so that a drift of the machine meets them alike; medians are reported


@dataclass(frozen=True)
class Throughput:
    """One row. seconds : median of one sweep or step. ratio : NumPy's sweep over this one, in the same process."""

    what: str
    components: int
    threads: int
    seconds: float
    contact_updates: float
    ratio: float | None


class NumpySweep:
    """The Coulomb subgradient sweep in vectorised NumPy, as fast as we could write it.

    Flat arrays in the layout of the kernels, so that every operation runs over one contiguous stretch; in place, with
    no temporaries; one square root and one division a contact, none where a contact has one component. (Written with
    slices of three-dimensional arrays it takes 1.2 to 1.6 times as long.)
    """

    def __init__(self, scene: Scene, components: int) -> None:
        axes = (0, 1, 2)[:components]
        self.layout = layout = Layout(1, scene.lattice.shape, block=1)
        self.kept = [tangential(axis, axes) for axis in range(3)]
        self.spin = list(layout.rows(scene.staggered_spin(initial_spin(scene, "random"), axes)))
        self.friction = list(layout.rows(layout.at_lower_sphere(scene.acting_coefficient)))
        weight = weights(scene.acting_coefficient, scene.lattice, axes)
        weight[..., scene.lattice.is_driven] = np.inf
        self.step = [1e-3 / w.ravel() for w in weight]
        most = layout.sites + layout.strides[0]
        self.force = [[np.empty(most) for _ in kept] for kept in self.kept]
        self.square, self.scratch, self.pull = np.empty(most), np.empty(most), np.empty(layout.sites)

    def repeat(self, sweeps: int) -> None:
        for _ in range(sweeps):
            self.sweep()

    def sweep(self) -> None:
        start, sites = self.layout.margin, self.layout.sites
        for axis, (kept, stride) in enumerate(zip(self.kept, self.layout.strides, strict=True)):
            count = sites + stride  # from one stride below the first site on, so that each contact is computed once
            below, above = slice(start - stride, start + sites), slice(start, start + count)
            forces = [buffer[:count] for buffer in self.force[axis]]
            for slot, force in zip(kept, forces, strict=True):
                np.subtract(self.spin[slot][above], self.spin[slot][below], out=force)
            friction = self.friction[axis][below]
            if len(kept) == 1:
                np.multiply(forces[0], SHARPNESS, out=forces[0])  # np.sign mispredicts its branches: 5 times as long
                np.maximum(forces[0], -1.0, out=forces[0])
                np.minimum(forces[0], 1.0, out=forces[0])
                np.multiply(forces[0], friction, out=forces[0])
                continue
            square, scratch = self.square[:count], self.scratch[:count]
            np.multiply(forces[0], forces[0], out=square)
            np.multiply(forces[1], forces[1], out=scratch)
            np.add(square, scratch, out=square)
            np.sqrt(square, out=square)
            np.maximum(square, 1e-300, out=square)
            np.divide(friction, square, out=square)
            for force in forces:
                np.multiply(force, square, out=force)
        for slot, step in enumerate(self.step):
            first = True
            for kept, stride, forces in zip(self.kept, self.layout.strides, self.force, strict=True):
                if slot not in kept:
                    continue
                force = forces[kept.index(slot)]
                if first:
                    np.subtract(force[stride : stride + sites], force[:sites], out=self.pull)
                    first = False
                else:
                    np.add(self.pull, force[stride : stride + sites], out=self.pull)
                    np.subtract(self.pull, force[:sites], out=self.pull)
            np.multiply(self.pull, step, out=self.pull)
            inside = self.spin[slot][start : start + sites]
            np.add(inside, self.pull, out=inside)


def measure(shape: tuple[int, ...], threads: int) -> list[Throughput]:
    """Rows for `threads` threads, measured in a process of their own."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with unheard_by_children():
        process = context.Process(target=_measure_and_send, args=(theirs, shape, threads), daemon=True)
        process.start()
    theirs.close()
    try:
        found: list[Throughput] = ours.recv()
    except EOFError:
        raise BearingsError(f"the measurement with {threads} threads ended without a result") from None
    finally:
        process.kill()
    return found


def _measure_and_send(pipe: Connection, shape: tuple[int, ...], threads: int) -> None:
    pipe.send(_measure_here(shape, threads))


def _measure_here(shape: tuple[int, ...], threads: int) -> list[Throughput]:
    runtime.start("cpu", "f64", threads)
    rows = []
    for components, direction in DIRECTIONS.items():
        scene = Scene.random(shape, direction=direction)
        seconds = _seconds(_candidates(scene, components))
        for name, value in seconds.items():
            of_numpy = name == NUMPY
            ratio = seconds[NUMPY] / value if "sweep" in name and not of_numpy else None
            updates = scene.lattice.contacts / value
            rows.append(Throughput(name, components, 1 if of_numpy else threads, value, updates, ratio))
    return rows


def _candidates(scene: Scene, components: int) -> dict[str, tuple[Callable[[int], None], int]]:
    """What makes a number of sweeps or steps, and how many."""
    plain = GradientDescentMethod(GradientDescent(momentum=False))
    fast, dynamics = GradientDescent().build(), CundallStrack().build()
    for method, start in ((plain, "random"), (fast, "random"), (dynamics, "linear")):
        spin = initial_spin(scene, start)
        method.begin(scene, spin, Fields(make_layout(1, scene.lattice.shape), method.plan(scene, spin)))
    plain.epoch_length = 2**40  # stay in the part of the epoch that does not average
    return {
        NUMPY: (NumpySweep(scene, components).repeat, 20),
        "sweep": (plain.advance, 400),
        "sweep with momentum": (fast.advance, 400),
        "Cundall-Strack step": (dynamics.advance, 200),
    }


def _seconds(candidates: dict[str, tuple[Callable[[int], None], int]]) -> dict[str, float]:
    """Median time of one sweep or step of each."""
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(ROUNDS):
        for name, (call, number) in candidates.items():
            began = time.perf_counter()
            call(number)
            times[name].append((time.perf_counter() - began) / number)
    return {name: float(np.median(measured)) for name, measured in times.items()}
