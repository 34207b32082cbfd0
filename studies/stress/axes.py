"""The axes of stress in one table, and the samples that they start from.

A *row* is a method, law, dimension, device and precision; an *axis* is a parameter that is taken to its extremes; a
*case* is a sample and how it is solved; a *cell* is one value of an axis on one row.

A *change* is a function `change(case, value, row)` that returns the case in which the parameter of an axis has this
value.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.options import options_of
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Scene
from taichi_bearings.scene.disorder import Draw
from taichi_bearings.scene.law import LAWS
from taichi_bearings.solvers.cundall_strack import stability_bound
from taichi_bearings.solvers.table import METHODS, CundallStrack, MethodOptions

SHAPES = {2: (4, 6), 3: (3, 3, 4)}  # of all samples but those of the axis of sizes, by dimension
SMALL_SHAPES = {2: (3, 5), 3: (2, 3, 4)}
ROWS: dict[str, type[MethodOptions]] = {"auto": MethodOptions, **METHODS}


@dataclass(frozen=True)
class Row:
    """One row of the report: what solves, and where.

    method : name of the method, or "auto".
    law : name of the contact law.
    dimension : 2 or 3.
    arch : device, such as "cpu" or "cuda".
    precision : "f64" or "f32".
    """

    method: str
    law: str
    dimension: int
    arch: str = "cpu"
    precision: str = "f64"

    def __str__(self) -> str:
        """Return the row in words, as reports name it."""
        device = "" if self.arch == "cpu" else f" {self.arch}"
        return f"{self.method} {self.law} {self.dimension}D{device} {self.precision}"


@dataclass(frozen=True)
class Case:
    """A sample and how it is solved, in one cell of the stress report.

    scene : the sample.
    options : options of the method, by name.
    settings : further arguments of :func:`taichi_bearings.solve`.
    unit : power of the sample over the power of `scaled`, if its units were changed.
    scaled : the scene before its units were changed; None if they were not.
    is_layered : True if all columns of spheres have equal contacts along the height, so that the exact minimum is found
        column by column (:func:`.truth.layered`).
    refusal : True if the only right answer is an error that refuses the input.
    """

    scene: Scene
    options: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    unit: float = 1.0
    scaled: Scene | None = None
    is_layered: bool = False
    refusal: bool = False

    @property
    def in_plain_units(self) -> Scene:
        """The scene in units in which its numbers are near 1: as it was before extreme factors changed its units, if
        they did. Its exact power times `unit` is the power of `scene`."""
        return self.scaled or self.scene


def column_name(value: Any) -> str:
    """Return the text that names a value of a parameter in reports."""
    return value if isinstance(value, str) else f"{value:g}"


Change = Callable[[Case, Any, Row], Case]  # returns a case from the unchanged one, for a value of an axis and a row


@dataclass(frozen=True)
class Axis:
    """A parameter that is taken to its extremes.

    name : name by which users choose the axis.
    title : label of the axis in figures.
    values : the values that are tried, which are the columns of the report.
    change : function that makes a case from the unchanged one, for a value.
    rows : function that returns True for rows on which the axis is tried.
    patience : factor of the time limit. If it is above 1, the quick form tries only the first values, as many as FIRST
        says.
    """

    name: str
    title: str
    values: tuple[Any, ...]
    change: Change
    rows: Callable[[Row], bool] = lambda row: True
    patience: float = 1.0

    @property
    def columns(self) -> list[str]:
        """The values as texts: numbers from the least to the greatest, then words in their own order."""
        numbers = sorted(value for value in self.values if not isinstance(value, str))
        return list(map(column_name, [*numbers, *(value for value in self.values if isinstance(value, str))]))


def drawn(row: Row, shape: Sequence[int], draw: Draw, seed: int = 7, **others: Any) -> Scene:
    """Return a scene with the law of a row of the report, all of whose coefficients (friction, viscosity or both) are
    drawn in the same way.

    row : method, law, dimension, device and precision; only the law is used.
    shape : numbers of spheres along the axes of the lattice.
    draw : function that returns an array of coefficients, from a generator of random numbers and a shape.
    seed : seed of the scene and of the generator.
    others : further arguments of a Scene.
    """
    rng = np.random.default_rng([seed, 1])
    others |= {"viscosity": draw} if len(LAWS[row.law].quantities) > 1 else {}
    return Scene.random(shape, seed, lambda _, sides: draw(rng, sides), row.law, **others)


def unchanged(row: Row, seed: int, quick: bool) -> Case | None:
    """Return the sample of a row of the report in which no parameter is extreme: a small lattice, with coefficients
    uniform in [0.1, 1]. It is driven about x + y or, if the method refuses that, about x alone; None if the method
    refuses both.

    row : method, law, dimension, device and precision.
    seed : seed of the sample.
    quick : True for a smaller lattice.
    """
    shape = (SMALL_SHAPES if quick else SHAPES)[row.dimension]
    for direction in ((1.0, 1.0, 0.0), (1.0, 0.0, 0.0)):
        scene = drawn(row, shape, _uniform, seed, direction=direction)
        if not ROWS[row.method].refusal(scene):
            return Case(scene)
    return None


def rows_of(methods: Sequence[str], laws: Sequence[str]) -> list[Row]:
    """Return all rows (method, law, dimension, device, precision) of these methods and laws, with all devices and
    precisions on which each method runs. A GPU that is emulated by the CPU is left out.
    """
    found = []
    for arch, precision in product(("cpu", *runtime.GPUS), runtime.PRECISIONS):
        if arch != "cpu" and all(device.is_software for device in runtime.usable(arch, precision)):
            continue
        for method, law, dimension in product(ROWS, LAWS, SHAPES):
            anywhere = ROWS[method].needs_taichi and not ROWS[method].cpu_only and method != "auto"
            if method in methods and law in laws and (anywhere or (arch, precision) == ("cpu", "f64")):
                found.append(Row(method, law, dimension, arch, precision))
    return found


def _uniform(rng: np.random.Generator, shape: Sequence[int]) -> np.ndarray:
    """Return coefficients, an array of this shape, that are drawn from a generator uniformly in [0.1, 1].

    rng : generator of random numbers.
    """
    return rng.uniform(0.1, 1.0, shape)


def _log_uniform(rng: np.random.Generator, shape: Sequence[int], value: float) -> np.ndarray:
    """Return coefficients, an array of this shape, that are drawn from a generator uniformly in their logarithm, over
    `value` decades around 1.

    rng : generator of random numbers.
    """
    return 10.0 ** (value * (rng.uniform(0, 1, shape) - 0.5))


def _tied(rng: np.random.Generator, shape: Sequence[int], value: str) -> np.ndarray:
    """Return coefficients (of `shape`) with few different values, so that minima tie.

    rng : generator of random numbers.
    value : name of the set of values, such as "1 or 2".
    """
    values = {"all equal": [1.0], "1 or 2": [1.0, 2.0], "1, 2 or 3": [1.0, 2.0, 3.0], "nearly": [1.0, 1 + 2**-50]}
    return rng.choice(values[value], shape)


def _with_coefficients(draw: Callable[..., np.ndarray]) -> Change:
    """Return a function that changes a case (a sample and how it is solved): it draws other coefficients on the
    same lattice.

    draw : function (generator, shape, value) that returns them.
    """

    def change(case: Case, value: Any, row: Row) -> Case:
        """Return the case with coefficients drawn anew.

        case : the unchanged case, whose lattice and direction are taken over.
        value : value of the axis, which is passed on to `draw`.
        row : row of the report; its law is that of the scene.
        """
        scene = case.scene
        shape, direction = scene.lattice.shape, scene.direction
        return replace(case, scene=drawn(row, shape, partial(draw, value=value), direction=direction))

    return change


def _absent(case: Case, value: str, row: Row) -> Case:
    """Return the case in which some contacts are absent: their coefficients are exactly zero.

    value : which coefficients are meant: "a tenth" or "a third" of all at random, "all", those of "a sphere" in the
        middle, or those between "a layer" in the middle and the one below.
    row : not used.
    """
    scene, lattice = case.scene, case.scene.lattice
    middle = tuple(n // 2 for n in lattice.shape)
    share = np.random.default_rng(11).uniform(0, 1, len(lattice.axis))
    upright = lattice.axis == lattice.height_axis
    is_absent = {
        "a tenth": share < 0.1, "a third": share < 1 / 3, "all": share < 1,
        "a sphere": (lattice.ends == np.ravel_multi_index(middle, lattice.shape)).any(axis=0),
        "a layer": upright & (lattice.ends[0] % lattice.shape[-1] == middle[-1] - 1),
    }[value]  # fmt: skip
    given = {name: getattr(scene, name) for name in ("coefficients", "viscosity") if getattr(scene, name)}
    changed: dict[str, Any] = {
        name: lattice.by_axis(np.where(is_absent, 0.0, lattice.flat(of))) for name, of in given.items()
    }
    return replace(case, scene=replace(scene, **changed))


def _in_units(force: int = 0, length: int = 0, time: int = 0) -> Callable[..., Case]:
    """Return a function that rescales a case (a sample and how it is solved) to other units, such that one parameter of
    its scene is multiplied by a given factor. In the new units the solution is the same.

    force, length, time : whole exponents: the units of force, length and time are divided by the factor raised to these
        powers, so that forces are multiplied by factor^force, lengths by factor^length and times by factor^time.
    """

    def change(case: Case, value: float, row: Row, name: str) -> Case:
        """Return the case in other units.

        case : the unchanged case.
        value : the factor; it is rounded to a power of two, by which all numbers are multiplied without rounding.
        row : row of the report; its method tells which options are rescaled.
        name : parameter of the scene that is multiplied by the factor, such as "radius".
        """
        factor = 2.0 ** round(np.log2(value))
        flow = factor ** (force + time - length)  # factor of viscosities and dampers
        scene, owned = case.scene, options_of(ROWS[row.method])
        changes: dict[str, Any] = {name: getattr(scene, name) * factor} if name in Scene.PARAMETERS else {}
        # coefficients of friction have no unit; those of a viscous law have that of a damper
        friction = factor if name == "coefficients" else 1.0
        first = friction if scene.law.has_friction else flow
        changes["coefficients"] = tuple(values * first for values in scene.coefficients)
        changes["viscosity"] = tuple(values * flow for values in scene.viscosity)
        scales = {"stiffness": factor ** (force - length), "damping": flow}
        scales["mass"] = factor ** (force + 2 * time - length)
        options = {key: owned[key].default * scale for key, scale in scales.items() if key in owned
                   and (key == "mass" or scene.law.has_friction)}  # fmt: skip
        power = factor ** (force + length - time)
        return replace(case, scene=replace(scene, **changes), options=options, unit=power, scaled=scene)

    return change


def _on_scene(changes: Callable[[Scene, Any], dict[str, Any]]) -> Change:
    """Return a function that changes parameters of the scene of a case.

    changes : function that returns the new parameters by name, from the scene and the value of the axis.
    """
    return lambda case, value, row: replace(case, scene=replace(case.scene, **changes(case.scene, value)))


def _nearly_equal(_: Scene, value: str) -> dict[str, Any]:
    """Return a spin of the bottom that is nearly, or exactly, the spin 1 of the top.

    value : 1 - omega_B / omega_T as a text, "an ulp" for the next double, or "equal".
    _ : the scene, not used.
    """
    bottom = {"equal": 1.0, "an ulp": np.nextafter(1.0, 0.0)}.get(value) or 1.0 - float(value)
    return {"spin_bottom": float(bottom)}


def _common_state(_: Scene, value: float) -> dict[str, Any]:
    """Return by name the imposed bearing states of bottom and top, (A_x, A_y, A_z, C) each; the spin at position x is A
    + C x, with alternating signs. The same large state is added to both; at the minimum it is added to all spins.

    value : size v of the large state (v, -v, v, v), 1/time; its A_y cancels C y at the second sphere along y.
    _ : the scene, not used.
    """
    top, bottom = (1.0, 0.5, 0.0, 0.5), (value, -value, value, value)
    return {"top": tuple(one + other for one, other in zip(top, bottom, strict=True)), "bottom": bottom}


def _pivot(_: Scene, value: float) -> dict[str, Any]:
    """Return by name the imposed bearing states of bottom and top, (A_x, A_y, A_z, C) each; the spin at position x is A
    + C x, with alternating signs. The bottom is at rest, and the spin of the top along x nearly vanishes at its second
    sphere along x.

    value : spin that is left over there, 1/time: the small sum A_x + C x, in which the two terms nearly cancel.
    _ : the scene, not used.
    """
    return {"top": (value - 1.0, 1.0, 0.0, 1.0), "bottom": (0.0,) * 4}


# by name, the shapes in 2D and 3D of lattices with periodic sides
RINGS = {"of 4": ((4, 6), (4, 2, 4)), "of 2": ((2, 6), (2, 2, 4)), "of 2, 9 decades": ((2, 6), (2, 2, 4)),
         "of 2, 18 decades": ((2, 6), (2, 2, 4))}  # fmt: skip


def _rings(case: Case, value: str, row: Row) -> Case:
    """Return the case on a lattice that is periodic in all directions but the height.

    case : the unchanged case, whose direction of driving is taken over.
    value : length of the closed sides and decades of the coefficients, in words (a key of RINGS).
    row : row of the report; its law and dimension are those of the scene.
    """
    decades = {"of 2, 9 decades": 9.0, "of 2, 18 decades": 18.0}.get(value)
    draw = partial(_log_uniform, value=decades) if decades else _uniform
    shape, closed = RINGS[value][row.dimension - 2], ("x", "y")[: row.dimension - 1]
    return replace(case, scene=drawn(row, shape, draw, direction=case.scene.direction, periodic=closed))


# by name, the shapes in 2D and 3D
SIDES = {
    "least": ((2, 3), (2, 2, 3)), "tall": ((2, 64), (2, 2, 64)), "flat": ((256, 3), (16, 16, 3)),
    "1e3": ((32, 32), (10, 10, 10)), "1e4": ((100, 100), (22, 22, 22)), "1e5": ((316, 316), (46, 46, 46)),
    "1e6": ((1000, 1000), (100, 100, 100)), "1e7": ((3162, 3162), (215, 215, 215)),
}  # fmt: skip


def _sides(case: Case, value: str, row: Row) -> Case:
    """Return the case on a lattice of another size. Its exact minimum is known, since all columns have equal contacts
    along the height; sideways contacts are random.

    value : name of the size, a key of SIDES, such as "flat".
    row : row of the report; its law and dimension, 2 or 3, are those of the scene.
    """

    def draw(rng: np.random.Generator, shape: Sequence[int]) -> np.ndarray:
        """Return uniform coefficients for the contacts along one axis, an array of this shape. Along the height each
        column gets those of the first column.

        rng : generator of random numbers.
        """
        values = _uniform(rng, shape)
        is_upward = shape[:-1] == sides[:-1]
        return np.broadcast_to(values[(0,) * (len(shape) - 1)], shape).copy() if is_upward else values

    sides = SIDES[value][row.dimension - 2]
    scene = drawn(row, sides, draw, direction=case.scene.direction)
    return replace(case, scene=scene, is_layered=True, settings={"start": "random"})


def _change_of_option(key: str) -> Change:
    """Return a function that changes a case (a sample and how it is solved): it sets an option of the method.

    key : name of the option.
    """
    return lambda case, value, row: replace(case, options={key: value})


def _has_options(*keys: str) -> Callable[[Row], bool]:
    """Return a function that says whether the method of a row of the report has all options with the names `keys`."""
    return lambda row: set(keys) <= options_of(ROWS[row.method]).keys()


def _has_spheres(row: Row) -> bool:
    """Return True if a row of the report is about spheres, in 3D."""
    return row.dimension == 3


def _has_friction(row: Row) -> bool:
    """Return True if the law of the row has static friction: a contact can bear a force without slip."""
    return LAWS[row.law].has_friction


def _stable_step(case: Case) -> float:
    """Return the largest stable time step of Cundall-Strack dynamics, with its default options, on the scene of a
    case.
    """
    return stability_bound(case.scene, case.scene.minimum_spin_axes, CundallStrack())


def _start(case: Case, value: str, row: Row) -> Case:
    """Return the case with other spins to start from, in the laboratory frame, 1/time: an array like the lattice, in 3D
    with a last axis of 3 components. Spins that are not finite must be refused.

    value : "huge", "tiny", "opposite" (staggered against the sense of the driving), "not staggered" (all alike),
        "NaN", "infinite", or else a start that the settings know by name, which is passed on.
    row : the method; only its dimension, 2 or 3, is used.
    """
    scene = case.scene
    shape = scene.lattice.shape if row.dimension == 2 else (*scene.lattice.shape, 3)
    # fixed, so that all rows start from the same spins
    rng = np.random.default_rng(5)
    parity = scene.lattice.parity if row.dimension == 2 else scene.lattice.parity[..., None]
    made: dict[str, Callable[[], np.ndarray]]
    made = {"huge": lambda: rng.uniform(-1e12, 1e12, shape), "opposite": lambda: -parity * np.ones(shape),
            "not staggered": lambda: np.ones(shape), "tiny": lambda: rng.uniform(-1e-300, 1e-300, shape),
            "NaN": lambda: np.full(shape, np.nan), "infinite": lambda: np.full(shape, np.inf)}  # fmt: skip
    start = made[value]() if value in made else value
    return replace(case, settings={"start": start}, refusal=value in ("NaN", "infinite"))


DECADES = (0, 3, 6, 9, 12, 15, 18)
SCALES = (1e-12, 1e-6, 1.0, 1e6, 1e12)
_FORCE, _LENGTH, _RATE = _in_units(force=1), _in_units(length=1), _in_units(time=-1)
AXES = {
    axis.name: axis
    for axis in (
        Axis("contrast", "decades of the coefficients", DECADES, _with_coefficients(_log_uniform)),
        Axis("two-strengths", "decades between two strengths", DECADES,
             _with_coefficients(lambda rng, shape, value: 10.0 ** (value * (rng.integers(0, 2, shape) - 0.5)))),
        Axis("ties", "coefficients", ("all equal", "1 or 2", "1, 2 or 3", "nearly"), _with_coefficients(_tied)),
        Axis("zeros", "contacts absent", ("a tenth", "a third", "a sphere", "a layer", "all"), _absent),
        Axis("friction-scale", "scale of the coefficients", SCALES, partial(_FORCE, name="coefficients")),
        Axis("force-scale", "scale of F_n", SCALES, partial(_FORCE, name="normal_force"), _has_friction),
        Axis("radius-scale", "scale of R", SCALES, partial(_LENGTH, name="radius")),
        Axis("spin-scale", "scale of omega_T", SCALES, partial(_RATE, name="spin_top")),
        Axis("viscosity", "scale of the viscosity", (1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12),
             _on_scene(lambda scene, value: {"viscosity": tuple(value * of_axis for of_axis in scene.viscosity)}),
             lambda row: row.law == "coulomb-viscous"),
        Axis("driving", "1 - omega_B / omega_T", ("2", "1e-1", "1e-4", "1e-8", "1e-12", "1e-15", "an ulp", "equal"),
             _on_scene(_nearly_equal)),
        Axis("direction", "y over x of the direction", (1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 0.0),
             _on_scene(lambda _, value: {"direction": (1.0, value, 0.0)}), _has_spheres),
        Axis("rate", "C of the top", (1e-12, 1e-6, 1e-3, 1.0, 1e3, 1e6, 1e12),
             _on_scene(lambda _, value: {"top": (1.0, 1.0, 0.0, value), "bottom": (0.0,) * 4}), _has_spheres),
        Axis("common-state", "state added to both planes", (0.0, 1.0, 1e3, 1e6, 1e9, 1e12), _on_scene(_common_state),
             _has_spheres),
        Axis("pivot", "part of A that cancels nothing", (0.1, 1e-4, 1e-8, 1e-12, 2.0**-52, 0.0), _on_scene(_pivot),
             _has_spheres),
        Axis("rings", "periodic sides", tuple(RINGS), _rings),
        Axis("sides", "spheres", tuple(SIDES), _sides, patience=5.0),
        Axis("stiffness", "K_t", tuple(10.0**k for k in range(1, 10)), _change_of_option("stiffness"),
             lambda row: _has_friction(row) and _has_options("stiffness")(row)),
        Axis("damping", "A_t", (0.0, *(10.0**k for k in range(-1, 8))), _change_of_option("damping"),
             lambda row: _has_friction(row) and _has_options("damping")(row)),
        Axis("time-step", "time step over the stability bound", (1e-2, 0.5, 0.9, 0.99, 1.0, 1.01, 1.1, 2.0, 10.0, 1e3),
             lambda case, value, row: replace(case, options={"time_step": value * _stable_step(case)}),
             _has_options("time_step")),
        Axis("start", "spins to start from", ("random", "zero", "minimum-cut", "tiny", "huge", "opposite",
             "not staggered", "NaN", "infinite"), _start),
        Axis("threads", "threads", (1, 2), lambda case, value, row: replace(case, settings={"threads": value}),
             lambda row: ROWS[row.method].needs_taichi),
        Axis("drift", "steps of 0.8 of the stability bound", (1e4, 1e6, 1e7),
             lambda case, value, row: replace(
                 case, settings={"duration": 0.8 * value * _stable_step(case), "iterations": 2**40}),
             _has_options("time_step"), 20.0),
    )
}  # fmt: skip
"""All axes of stress by name, in the order of the report."""


@dataclass(frozen=True)
class Cell:
    """A sample with one extreme value of a parameter, to be solved by one method, with one law, dimension, device and
    precision. `key`, `label` and `settings` are what the workers of scans need of a sample.

    axis : name of the parameter, a key of AXES.
    value : one of its values.
    row : method, law, dimension, device and precision.
    seed : seed of the sample.
    quick : True if the sample is a small one.
    most_seconds : time limit of the solve.
    """

    axis: str
    value: Any
    row: Row
    seed: int
    quick: bool
    most_seconds: float

    @property
    def column(self) -> str:
        """The text that names the value in reports."""
        return column_name(self.value)

    @property
    def key(self) -> str:
        """The text that names the cell in journals and progress reports."""
        kind = "quick" if self.quick else "full"
        return f"{self.axis} {self.column} {self.row} seed {self.seed} {kind} {self.most_seconds:g} s"

    label = key

    @property
    def settings(self) -> RunSettings:
        """Settings with device, precision and threads of the cell; the other ones are defaults."""
        threads = self.value if self.axis == "threads" else 1
        return RunSettings(arch=self.row.arch, precision=self.row.precision, threads=threads)

    @cached_property
    def case(self) -> Case:
        """The sample of the cell, and how it is solved."""
        base = unchanged(self.row, self.seed, self.quick)
        assert base is not None
        return AXES[self.axis].change(base, self.value, self.row)


QUICK = 25  # the quick form takes every 25th cell, so that it ends after about a minute
QUICK_CELLS = 100  # but at least about so many cells, or all, if the user chooses few axes
FIRST = {"sides": 3, "drift": 1}  # number of values that the quick form takes of axes that need patience


def cells_of(rows: Sequence[Row], axes: Sequence[str], seed: int, quick: bool, seconds: float) -> list[Cell]:
    """Return a cell for each row and each value of each axis that is tried on it. Rows whose method refuses the
    unchanged sample are left out.

    rows : combinations of method, law, dimension, device and precision.
    axes : names of the axes.
    seed : seed of the samples.
    quick : take smaller samples, and only the first values of axes that need patience. Of the cells only every QUICK-th
        is returned, or more of them, so that there are about QUICK_CELLS at least.
    seconds : time limit of a solve; it is multiplied by the patience of the axis, unless `quick`.
    """
    found = []
    for row in rows:
        if unchanged(row, seed, quick) is None:
            continue
        for axis in (AXES[name] for name in axes if AXES[name].rows(row)):
            limit = seconds * (1.0 if quick else axis.patience)
            values = axis.values[: FIRST.get(axis.name)] if quick else axis.values
            found += [Cell(axis.name, value, row, seed, quick, limit) for value in values]

    def order(cell: Cell) -> tuple[Any, ...]:
        """Return a key by which cells are sorted: long ones last, and those of one device and precision together, so
        that few workers have to start.

        cell : the cell.
        """
        row = cell.row
        return AXES[cell.axis].patience > 1, row.arch != "cpu", row.arch, row.precision != "f64", cell.axis == "threads"

    found.sort(key=order)
    return found[:: min(QUICK, max(1, len(found) // QUICK_CELLS))] if quick else found
