"""The sweep of gradient descent without our kernels, to compare with: in the best NumPy that we could write, and in
plain C that is compiled when it is measured.

A sweep computes the friction of all contacts from the spins, then changes each spin by a step times the sum of the
friction on it.
"""

import ctypes
import os
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

import numpy as np

from taichi_bearings.lattice.grid import tangential
from taichi_bearings.lattice.incidence import weights
from taichi_bearings.lattice.layout import Layout
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import initial_spin

SHARPNESS = 1e12  # contacts whose spin difference is less than 1 / SHARPNESS do not slip
LEAST_SQUARE = {8: 1e-300, 4: 1e-30}  # least value under a square root, to divide by it; by the bytes of a number
SOURCE = Path(__file__).parent / "others" / "sweep.c"
COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-w", "-shared", "-fPIC")


class Arrays:
    """Spins and coefficients of a scene of one sample as flat arrays, in the order in which the kernels have them:
    sphere after sphere, neighbours along the height next to each other, with zeros as margins before and after.
    `length` is the number of entries with both margins.

    dtype, layout : type of all numbers, and the order of the spheres in memory.
    kept : for each axis of the lattice, indices (into the first axis of `spin`) of the components that make its
        contacts slip.
    spin : (components, length), spins with signs that alternate between neighbours, 1/time.
    friction : (axes, length), friction coefficient of the contact of each sphere with its upper neighbour along an
        axis.
    step : (components, length), for each sphere the factor from the sum of the friction on it to the change of its
        spin in a sweep; 0 for driven spheres.
    """

    def __init__(self, scene: Scene, precision: str) -> None:
        """Make the arrays of a scene of one sample: random spins, coefficients of friction, and steps of a sweep.

        precision : "f64" or "f32", the type of all numbers.
        """
        axes, dtype = scene.minimum_spin_axes, np.dtype(np.float64 if precision == "f64" else np.float32)
        self.dtype, self.layout = dtype, Layout(1, scene.lattice.shape, block=1)
        self.kept = [tangential(axis, axes) for axis in range(scene.lattice.dimension)]
        spin = scene.staggered_spin(initial_spin(scene, "random"), axes)
        self.spin = self._rows(spin)
        self.friction = self._rows(self.layout.at_lower_sphere(scene.acting_coefficient))
        weight = weights(scene.acting_coefficient, scene.lattice, axes)
        weight[..., scene.lattice.is_driven] = np.inf
        self.step = self._rows(1e-3 / weight)

    def _rows(self, values: np.ndarray) -> np.ndarray:
        """Return values (rows, 1, *N spheres) as flat rows (rows, length), with zeros in the margins; a row belongs to
        a component or an axis.
        """
        margin, sites = self.layout.margin, self.layout.sites
        sides = ((0, 0), (margin, self.layout.length - margin - sites))
        return np.pad(values.reshape(len(values), -1), sides).astype(self.dtype)


class NumpySweep:
    """A sweep of gradient descent for Coulomb friction (all contact forces from the spins, then a step of each spin) in
    vectorised NumPy, as fast as we could write it.

    Every operation runs over one contiguous stretch, in place, with no temporaries. There is one square root and one
    division for each contact with two components, none for one with a single component. (Written with slices of
    three-dimensional arrays it takes 1.2 to 1.6 times as long.)
    """

    def __init__(self, arrays: Arrays) -> None:
        """Store the arrays and allocate the buffers of a sweep.

        arrays : state of one lattice; sweeps change its spins in place.
        """
        # kept : of each axis, the spin components whose change across a contact along this axis is a slip
        self.arrays, self.layout, self.kept = arrays, arrays.layout, arrays.kept
        most = self.layout.sites + self.layout.strides[0]
        # force[axis][i] : on all contacts along the axis, from the i-th of these components
        self.force = [[np.empty(most, arrays.dtype) for _ in components] for components in self.kept]
        self.square, self.scratch = np.empty((2, most), arrays.dtype)  # intermediate results
        self.pull = np.empty(self.layout.sites, arrays.dtype)  # sum of the forces on each sphere

    def repeat(self, sweeps: int) -> None:
        """Make `sweeps` sweeps."""
        for _ in range(sweeps):
            self._find_forces()
            self._move()

    def _find_forces(self) -> None:
        """Compute the friction of all contacts, one axis after another, into `force`. It has buffers for each axis: one
        for each of the spin components (`kept`) that make contacts along this axis slip.
        """
        start, sites = self.layout.margin, self.layout.sites
        for axis, (kept, stride) in enumerate(zip(self.kept, self.layout.strides, strict=True)):
            count = sites + stride  # contacts of all lower spheres, from one stride below the first site on
            below, above = slice(start - stride, start + sites), slice(start, start + count)
            forces = [buffer[:count] for buffer in self.force[axis]]
            for slot, force in zip(kept, forces, strict=True):
                np.subtract(self.arrays.spin[slot][above], self.arrays.spin[slot][below], out=force)
            friction = self.arrays.friction[axis][below]
            if len(kept) == 1:
                np.multiply(forces[0], SHARPNESS, out=forces[0])  # np.sign mispredicts its branches: 5 times as long
                np.maximum(forces[0], -1.0, out=forces[0])
                np.minimum(forces[0], 1.0, out=forces[0])
                np.multiply(forces[0], friction, out=forces[0])
                continue
            # two components: friction / |difference| times the difference
            square, scratch = self.square[:count], self.scratch[:count]
            np.multiply(forces[0], forces[0], out=square)
            np.multiply(forces[1], forces[1], out=scratch)
            np.add(square, scratch, out=square)
            np.maximum(square, LEAST_SQUARE[self.arrays.dtype.itemsize], out=square)
            np.sqrt(square, out=square)
            np.divide(friction, square, out=square)
            for force in forces:
                np.multiply(force, square, out=force)

    def _move(self) -> None:
        """Change each spin in place by its step times the sum of the friction on its sphere, component after component.

        A contact joins site i and site i + stride. Its friction counts with + on the first and with - on the second
        one, and only in the components `kept` that the contacts of this axis have.
        """
        start, sites = self.layout.margin, self.layout.sites
        for slot, (spin, step) in enumerate(zip(self.arrays.spin, self.arrays.step, strict=True)):
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
            np.multiply(self.pull, step[start : start + sites], out=self.pull)
            inside = spin[start : start + sites]
            np.add(inside, self.pull, out=inside)


class CSweep:
    """A sweep of gradient descent for Coulomb friction in C, in which each contact is computed twice, once for each of
    its ends. Sweeps are made in pairs, which read one array of spins and write the other.
    """

    def __init__(self, arrays: Arrays, folder: Path) -> None:
        """Compile the sweep for some arrays, and make a second array of spins. The type of numbers, and the spin
        components that make the contacts of each axis slip, are constants of the compiled code.

        arrays : spins, which the sweeps change, friction and steps.
        folder : where the machine code is written.

        Raises OSError if it cannot be compiled or loaded.
        """
        self.arrays, layout = arrays, arrays.layout
        self.other = arrays.spin.copy()
        real = "double" if arrays.dtype.itemsize == 8 else "float"
        counts = ",".join(str(len(kept)) for kept in arrays.kept)
        pairs = [(*kept, 0)[:2] for kept in arrays.kept]  # sweep.c reads two components for each axis
        slots = ",".join(f"{{{first},{second}}}" for first, second in pairs)
        options = {
            "REAL": real, "DIMENSION": len(arrays.kept), "COMPONENTS": len(arrays.spin),
            "COUNT": f"{{{counts}}}", "KEPT": f"{{{slots}}}",
        }  # fmt: skip
        library = ctypes.CDLL(str(compiled(tuple(f"-D{name}={value}" for name, value in options.items()), folder)))
        self._sweeps, self._stride = library.sweeps, np.array(layout.strides, np.int64)

    def repeat(self, sweeps: int) -> None:
        """Make `sweeps` sweeps, or one more if the number is odd."""
        layout, rows = self.arrays.layout, (self.arrays.spin, self.other, self.arrays.friction, self.arrays.step)
        numbers = (2 * -(-sweeps // 2), layout.margin, layout.sites, layout.length)
        pointers = [ctypes.c_void_p(values.ctypes.data) for values in (self._stride, *rows)]
        self._sweeps(*(ctypes.c_long(number) for number in numbers), *pointers)


def find_compiler() -> str | None:
    """Return the path of this machine's C compiler: the one that CC names, or else one of COMPILERS; None if there is
    none.
    """
    named = [os.environ["CC"]] if os.environ.get("CC") else []
    return next((found for name in (*named, *COMPILERS) if (found := shutil.which(name))), None)


@lru_cache
def compiled(options: tuple[str, ...], folder: Path) -> Path:
    """Return the path of sweep.c, compiled to a shared library. Raises OSError if it cannot be compiled.

    options : options of the compiler, which fix sizes and types.
    folder : where the library is written.
    """
    compiler = find_compiler()
    if compiler is None:
        raise FileNotFoundError("no C compiler was found; install gcc or clang, or name one in the variable CC")
    library = folder / f"sweep-{abs(hash(options))}.so"
    command = [compiler, *FLAGS, *options, str(SOURCE), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{compiler} failed: {done.stderr.strip()[:200]}")
    return library
