"""The table of methods: the name of each, which scenes it solves, what it costs, and its options.

A method is named by a small frozen object that holds its options, such as ``CundallStrack(stiffness=1e6)``; `build`
loads what does the work. Nothing here loads Taichi or SciPy.
"""

import importlib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import inf, prod
from operator import attrgetter
from typing import TYPE_CHECKING, ClassVar, TypeVar

from taichi_bearings.errors import InputError
from taichi_bearings.options import (
    NOT_NEGATIVE,
    POSITIVE,
    TRUTH,
    Kind,
    OneOf,
    bounded,
    how,
    option,
    options_of,
    real,
    whole,
)
from taichi_bearings.scene.law import LAWS, Law
from taichi_bearings.words import meant, shown

if TYPE_CHECKING:
    from taichi_bearings.scene import Bearing, Scene
    from taichi_bearings.solvers.method import Method

MOST_FACTORISED = 120_000  # spheres of a cubic lattice up to which factorisations fit into any memory (about 48^3)
# least tolerances for which operator splitting is faster than the interior-point method: up to MOST_FACTORISED spheres,
# and beyond
SPLITTING_TOLERANCE, SPLITTING_TOLERANCE_BEYOND = 3e-5, 1e-6


def _laws(condition: Callable[[Law], bool] = lambda law: True) -> "staticmethod[[Law], bool]":
    """Return a function of a law that says whether a method solves it: True for friction, viscosity or both, if a
    condition holds; False for laws that users have defined.

    condition : function of the law; True if the method solves it.
    """
    return staticmethod(lambda law: law.is_sum and condition(law))


def _steps(law: Law) -> bool:
    """Return True if explicit steps, of gradient descent or of Cundall and Strack, solve a law: friction, viscosity or
    both, or a suitable one of a user.

    A suitable law has one coefficient and a force that grows with the slip and is 0 without slip, and defines
    `steepest`, the slope of its force.
    """
    is_steady = law.has_viscosity and not law.has_friction and type(law).steepest is not Law.steepest
    return law.is_sum or (is_steady and len(law.quantities) == 1)


def _why_not_stepped(law: Law, method: str) -> str:
    """Return in words why explicit steps do not solve a law of a user; empty if they do, or for other laws.

    law : the law.
    method : name of the method that makes the steps.
    """
    if _steps(law):
        return ""
    if len(law.quantities) > 1:
        return f"{method} takes laws of your own with one coefficient"
    if law.has_friction:
        return f'its {law.quantities[0].name} has the unit "1" of friction, which none of our methods takes'
    return f"{method} takes it if it defines `steepest`"


# bytes for each sphere of a lattice of 2 or 3 dimensions while its answer is judged: the answer, and enclosures (16 or
# 24 bytes a number) of the slips, forces and moments of 2 or 3 contacts a sphere; the peak that tracemalloc shows
JUDGED_BYTES = {2: 1000.0, 3: 1500.0}
SPLITTING_BYTES = 1200.0  # in 3D after operator splitting, which has given back its fields by then
# seconds for each sphere of a lattice to judge its answer, write it, and seal it with checksums
JUDGED_SECONDS = {2: 5e-6, 3: 1.5e-5}
SPLITTING_JUDGED_SECONDS = 6e-6  # in 3D after operator splitting, which proves no contact states
# bytes for each sphere in a method that factorises, in addition to the numbers of the factor: some 20 rows of the
# contacts along the path, the pattern of the factor and its tables
FACTORISING_BYTES = {2: 2800.0, 3: 4800.0}


def _factorising_bytes(shape: Sequence[int], periodic: Sequence[int]) -> float:
    """Return the most memory, bytes, of a method that factorises a Laplacian of the free spins of a lattice; infinity
    if the factor is too large to index.

    shape : shape of the lattice.
    periodic : numbers of the periodic axes.
    """
    from taichi_bearings.lattice import Lattice
    from taichi_bearings.numerics.cholesky.size import factor_numbers
    from taichi_bearings.numerics.cholesky.tuning import MOST_FACTOR_NUMBERS

    axes = (2,) if len(shape) == 2 else (0, 1)
    numbers = factor_numbers(Lattice(tuple(shape), periodic=tuple(periodic)), axes)
    return 8 * numbers + FACTORISING_BYTES[len(shape)] * prod(shape) if numbers < MOST_FACTOR_NUMBERS else inf


material = partial(option, laws=attrgetter("has_friction"))  # an option that only laws with friction have


@dataclass(frozen=True, kw_only=True)
class MethodOptions:
    """A method and its options. What is known of the method are class variables; its options are the fields of
    subclasses.

    name : its name, for --method.
    implementation : "module:class" of what does the work; the class is called with the options.
    steps_packings : True if it also solves packings, from initial spins.
    minimises_packings : True if it also finds the minima of packings, without initial spins.
    is_dynamics : True if its iterations are steps in time.
    keeps_checkpoints : True if it can continue from a checkpoint.
    needs_taichi : True if it uses kernels or fields.
    cpu_only : True if it works on the CPU alone, in double precision whatever precision is asked for.
    alike_in_a_block : number of spheres of a sample below which several seeds are solved together; that is faster, and
        gives each seed the same bits as if it were solved alone.
    merit : why `auto` takes it where it may, in a few words.
    colour, marker : colour and marker of its curves in figures.
    solves : function that is True for the laws that it solves.
    """

    name: ClassVar[str]
    implementation: ClassVar[str]
    steps_packings: ClassVar[bool] = False
    minimises_packings: ClassVar[bool] = False
    is_dynamics: ClassVar[bool] = False
    keeps_checkpoints: ClassVar[bool] = False
    needs_taichi: ClassVar[bool] = True
    cpu_only: ClassVar[bool] = False
    alike_in_a_block: ClassVar[float] = 0
    merit: ClassVar[str] = "solves this law"
    colour: ClassVar[str] = "0.4"  # Okabe and Ito's palette, which the colour-blind can tell apart
    marker: ClassVar[str] = "h"
    solves: ClassVar["staticmethod[[Law], bool]"] = staticmethod(lambda law: True)

    def __post_init__(self) -> None:
        """Check each option and convert it to its type; raise InputError for a value that is not allowed."""
        for name, item in options_of(self).items():
            object.__setattr__(self, name, item.read(name, getattr(self, name)))

    def build(self) -> "Method":
        """Return the method with these options, ready for :func:`taichi_bearings.solvers.drive.solve`."""
        module, _, attribute = self.implementation.partition(":")
        with warnings.catch_warnings():  # SciPy adds filters of its own
            built: Method = getattr(importlib.import_module(module), attribute)(self)
        return built

    @classmethod
    def refusal(cls, scene: "Bearing") -> str:
        """Return why the method cannot solve a scene, as a sentence; empty if it can."""
        if cls.solves(scene.law):
            return ""
        laws = " or ".join(name for name, law in LAWS.items() if cls.solves(law))
        why = _why_not_stepped(scene.law, cls.name) if cls.solves is _steps else ""
        return f"method {cls.name!r} does not solve the law {scene.law.name!r}; it solves {laws}{why and f'; {why}'}"

    @classmethod
    def suits(cls, scene: "Scene", tolerance: float, on_gpu: bool) -> bool:
        """Return True if `--method auto` may take the method; it takes the first one of the table that it may.

        scene : what is to be solved.
        tolerance : relative gap that is asked for.
        on_gpu : True if the run has a GPU.
        """
        return not cls.is_dynamics and not (cls.cpu_only and on_gpu) and not cls.refusal(scene)

    @classmethod
    def seconds(cls, shape: Sequence[int], tolerance: float) -> float | None:
        """Return the seconds to solve one sample of a lattice on one core of a common server, right within a factor of
        three; None if that is not known.

        shape : shape of the lattice.
        tolerance : relative gap that is asked for.
        """
        return None

    @classmethod
    def step_seconds(cls, shape: Sequence[int]) -> float | None:
        """Return the seconds of a step, if all steps of the method on a lattice take the same time; else None.

        shape : shape of the lattice.
        """
        return None

    @classmethod
    def judged_seconds(cls, shape: Sequence[int]) -> float:
        """Return the seconds to judge the answer of one sample of a lattice, and to write it.

        shape : shape of the lattice.
        """
        return JUDGED_SECONDS[len(shape)] * prod(shape)

    @classmethod
    def bytes(cls, shape: Sequence[int], periodic: Sequence[int] = ()) -> float:
        """Return the most memory, bytes, that one sample takes until its answer is written, right within a factor of
        1.3.

        The memory of the interpreter itself comes on top. Judging the answer takes the most, unless a method overrides
        this because it needs more itself.

        shape : shape of the lattice.
        periodic : numbers of the periodic axes.
        """
        return JUDGED_BYTES[len(shape)] * prod(shape)


METHODS: dict[str, type[MethodOptions]] = {}
"""The methods by name, in the order in which `auto` tries them and tables list them."""
Row = TypeVar("Row", bound=type[MethodOptions])


def register(row: Row) -> Row:
    """Add a method to the table and return it, as a decorator does; raise InputError if its name is taken, or if
    another method has an option of the same name with values of another kind.

    row : class with the options of the method.
    """
    if row.name in METHODS or row.name == "auto":
        raise InputError(f"method is {row.name!r}, but a method of that name exists already; choose another name")
    for other in METHODS.values():
        theirs = options_of(other)
        for key, item in options_of(row).items():
            if key in theirs and item.kind.allowed != theirs[key].kind.allowed:
                raise InputError(
                    f"the option {key} of method {row.name!r} must be {item.kind.allowed}, but method {other.name!r} "
                    f"has an option {key} that must be {theirs[key].kind.allowed}; give yours another name"
                )
    METHODS[row.name] = row
    return row


@register
@dataclass(frozen=True, kw_only=True)
class PlanarCut(MethodOptions):
    """Find the minimum exactly, as minimum cuts of planar graphs: discs with Coulomb friction, and lattices of spheres
    whose planes are driven about x or y alone, where each plane of spheres is solved by itself.

    It has no options. Packings of discs with friction are solved too, and those of spheres in which each contact
    couples one spin component.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.PlanarCut(), threads=1).status
    'certified'
    """

    name = "planar-cut"
    implementation = "taichi_bearings.solvers.minimisers:PlanarCutMethod"
    minimises_packings = True
    needs_taichi = False
    alike_in_a_block = inf
    merit = "fastest, and exact"
    colour, marker = "#0072B2", "o"
    solves = _laws(attrgetter("is_rate_independent"))

    @classmethod
    def refusal(cls, scene: "Bearing") -> str:
        """Return why the method cannot solve a scene, such as imposed spins about two axes; empty if it can."""
        if reason := super().refusal(scene):
            return reason
        if len(scene.minimum_spin_axes) == 1:
            return ""
        return (
            f"method {cls.name} needs imposed spins about x or about y alone on a cubic lattice; "
            f"{scene.imposed_in_words}"
        )

    @classmethod
    def seconds(cls, shape: Sequence[int], tolerance: float) -> float | None:
        """Return the seconds to solve one lattice, fitted to measured times: about a power of the number of spheres.

        shape : shape of the lattice.
        tolerance : not used, as the minimum is exact.
        """
        return 1e-6 * prod(shape) if len(shape) == 2 else 2e-6 * prod(shape) ** 1.15


@register
@dataclass(frozen=True, kw_only=True)
class InteriorPoint(MethodOptions):
    """Follow the central path by the primal-dual interior-point method: a proven minimum to round-off in about twenty
    Newton steps.

    Parameters
    ----------
    settle : bool
        True to go on, once the gap is certified, until it is known of every contact whether it slips.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.InteriorPoint(settle=False), threads=1).status
    'certified'
    """

    name = "interior-point"
    keeps_checkpoints = True
    implementation = "taichi_bearings.solvers.minimisers:InteriorPointMethod"
    minimises_packings = True
    cpu_only = True
    alike_in_a_block = 5_000
    merit = "fastest that can prove which contacts slip"
    colour, marker = "#D55E00", "^"
    solves = _laws(attrgetter("has_friction"))

    settle: bool = how(
        True,
        TRUTH,
        "Once the gap is within the tolerance, continue until it is known of every contact whether it slips.",
        rare=True,
    )

    @classmethod
    def suits(cls, scene: "Scene", tolerance: float, on_gpu: bool) -> bool:
        """Return True if `--method auto` may take the method: where operator splitting is slower, and the factor fits.

        With more than MOST_FACTORISED spheres that depends on how much memory is free.

        scene : what is to be solved.
        tolerance : relative gap that is asked for.
        on_gpu : True if the run has a GPU.
        """
        if not super().suits(scene, tolerance, on_gpu):
            return False
        lattice = scene.lattice
        if lattice.sites <= MOST_FACTORISED:
            return tolerance < SPLITTING_TOLERANCE or scene.law.has_viscosity
        from taichi_bearings.memory import ESTIMATE_MARGIN, free_bytes

        needed = ESTIMATE_MARGIN * scene.replicas * cls.bytes(lattice.shape, lattice.periodic)
        return tolerance < SPLITTING_TOLERANCE_BEYOND and needed <= free_bytes()

    @classmethod
    def seconds(cls, shape: Sequence[int], tolerance: float) -> float | None:
        """Return the seconds to solve one lattice, fitted to measured times.

        shape : shape of the lattice.
        tolerance : not used, as a tighter one costs few steps more.
        """
        sites = prod(shape)
        found: float = 3e-6 * sites**1.3 if len(shape) == 2 else 1e-5 * sites + 9e-8 * sites**1.8
        return found

    @classmethod
    def bytes(cls, shape: Sequence[int], periodic: Sequence[int] = ()) -> float:
        """Return the memory, bytes, that one sample takes, which is that of the factorisation or of judging its answer,
        whichever is larger.

        shape : shape of the lattice.
        periodic : numbers of the periodic axes.
        """
        return max(_factorising_bytes(shape, periodic), super().bytes(shape))


@register
@dataclass(frozen=True, kw_only=True)
class OperatorSplitting(MethodOptions):
    """Operator splitting with fast Poisson solves: rough answers of large scenes.

    It has no options of its own; the gap that ends it is the option `tolerance` of a run.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.OperatorSplitting(), tolerance=1e-3, threads=1).status
    'certified'
    """

    name = "operator-splitting"
    keeps_checkpoints = True
    implementation = "taichi_bearings.solvers.operator_splitting:OperatorSplittingMethod"
    merit = "fastest to this tolerance and size"
    colour, marker = "#009E73", "D"
    solves = _laws(attrgetter("is_rate_independent"))

    @classmethod
    def seconds(cls, shape: Sequence[int], tolerance: float) -> float | None:
        """Return the seconds to solve one lattice, fitted to measured times: number of iterations times seconds of one.

        shape : shape of the lattice.
        tolerance : relative gap that is asked for.
        """
        iterations = 300 * (1e-4 / tolerance) ** 0.55 * max(prod(shape) / 4096, 1) ** 0.25
        found: float | None = 0.02 + iterations * (2e-4 + 2.2e-8 * prod(shape))
        return found

    @classmethod
    def judged_seconds(cls, shape: Sequence[int]) -> float:
        """Return the seconds to judge the answer of one lattice, and to write it.

        shape : shape of the lattice.
        """
        return SPLITTING_JUDGED_SECONDS * prod(shape) if len(shape) == 3 else super().judged_seconds(shape)

    @classmethod
    def bytes(cls, shape: Sequence[int], periodic: Sequence[int] = ()) -> float:
        """Return the most memory, bytes, that one sample takes until its answer is written.

        shape : shape of the lattice.
        periodic : numbers of the periodic axes.
        """
        return SPLITTING_BYTES * prod(shape) if len(shape) == 3 else super().bytes(shape, periodic)


@register
@dataclass(frozen=True, kw_only=True)
class LinearSolver(MethodOptions):
    """Solve the linear equations of viscous contacts by sparse factorisations, exactly but for rounding.

    It has no options.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3, law="viscous"), tb.LinearSolver(), threads=1).status
    'certified'
    """

    name = "linear-solver"
    implementation = "taichi_bearings.solvers.minimisers:LinearSolverMethod"
    minimises_packings = True
    needs_taichi = False
    merit = "fastest, and exact but for rounding"
    colour, marker = "#CC79A7", "v"
    solves = _laws(lambda law: not law.has_friction)

    @classmethod
    def seconds(cls, shape: Sequence[int], tolerance: float) -> float | None:
        """Return the seconds to solve one lattice, fitted to measured times.

        shape : shape of the lattice.
        tolerance : not used, as the solution is exact to round-off.
        """
        return 0.003 + 4e-6 * prod(shape)


@register
@dataclass(frozen=True, kw_only=True)
class GradientDescent(MethodOptions):
    """The paper's first method, with step lengths that provably converge.

    Parameters
    ----------
    momentum : bool
        True for momentum and smoothed friction, which is faster; False for the paper's plain method.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.GradientDescent(), tolerance=1e-2, threads=1).status
    'certified'
    """

    name = "gradient-descent"
    keeps_checkpoints = True
    implementation = "taichi_bearings.solvers.gradient_descent:GradientDescentMethod"
    steps_packings = True
    colour, marker = "#E69F00", "P"
    solves = staticmethod(_steps)

    @classmethod
    def step_seconds(cls, shape: Sequence[int]) -> float | None:
        """Return the seconds of a sweep over a lattice of this shape, fitted to measured times."""
        return 5e-6 + 2e-8 * prod(shape)

    momentum: bool = how(
        True,
        TRUTH,
        "Use momentum and smoothed friction, which is faster than the paper's plain method.",
        rare=True,
    )


def _rest_tolerance(default: float) -> float:
    """Return the option `rest_tolerance`, the change of the power below which a dynamics counts as being at rest.

    default : value of the option if it is not given.
    """
    found: float = how(
        default,
        POSITIVE,
        "Relative change of the power, in a step or between checks, below which the motion counts as at rest.",
        unset=True,
        rare=True,
    )
    return found


def _error_tolerance() -> float:
    """Return the option `error_tolerance`, the error of a time step whose length a method chooses itself."""
    help = "Root mean square error of the spins in a step, relative to the largest spin, by which the step is chosen."
    found: float = how(1e-3, POSITIVE, help, unset=True, rare=True)
    return found


@dataclass(frozen=True, kw_only=True)
class Motion(MethodOptions):
    """The options that all dynamics have: mass and moment of inertia of the spheres, and the time step."""

    is_dynamics = keeps_checkpoints = True

    mass: float = option(1.0, POSITIVE, "Mass of a sphere (or disc).", unit="mass", rare=True)
    inertia: float | None = option(
        None,
        POSITIVE,
        "Moment of inertia of a sphere of mass m and radius R. Default: 2 m R^2/5, for discs m R^2/2.",
        unit="mass*length^2",
        rare=True,
    )
    time_step: float | None = how(
        None,
        POSITIVE,
        "Fixed time step. Default: with cundall-strack 0.8 of the computed stability limit; with other dynamics it is "
        "chosen by its error.",
        unit="time",
    )


@register
@dataclass(frozen=True, kw_only=True)
class RigidLimit(Motion):
    """Dynamics without springs, in implicit steps of any length.

    At rest once the power falls by less than rest_tolerance in a step and the proven gap is below 1e-9.

    Parameters
    ----------
    mass : float
        Mass of a sphere; in packings that of one with the mean radius.
    inertia : float or None
        Moment of inertia, mass * length^2. Default: m R^2 / 2 of a disc, 2 m R^2 / 5 of a sphere.
    time_step : float or None
        Fixed length of the steps, time. Default: each is chosen by its error.
    error_tolerance : float
        Root mean square error of the spins in a step, relative to the largest spin, where steps are chosen by it.
    rest_tolerance : float
        Relative change of the power in a step below which the motion counts as at rest.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.RigidLimit(mass=2.0), threads=1).status
    'certified'
    """

    name = "rigid-limit"
    implementation = "taichi_bearings.solvers.rigid_limit:RigidLimitMethod"
    steps_packings = True
    cpu_only = True
    colour, marker = "#56B4E9", "<"
    solves = _laws()

    @classmethod
    def bytes(cls, shape: Sequence[int], periodic: Sequence[int] = ()) -> float:
        """Return the memory, bytes, that one sample takes, which is that of the factorisation or of judging its answer,
        whichever is larger.

        shape : shape of the lattice.
        periodic : numbers of the periodic axes.
        """
        return max(_factorising_bytes(shape, periodic), super().bytes(shape))

    error_tolerance: float = _error_tolerance()
    rest_tolerance: float = _rest_tolerance(1e-12)


@register
@dataclass(frozen=True, kw_only=True)
class CundallStrack(Motion):
    """The paper's second method: springs and dampers of Cundall and Strack, the paper's values as defaults, in explicit
    steps by Gear's method.

    At rest once, over three checks in a row, the power changes by less than rest_tolerance, no contact changes between
    sticking and slipping, and the torque on each free sphere is below 1000 rest_tolerance times the typical one of
    friction.

    Parameters
    ----------
    mass : float
        Mass of a sphere; in packings that of one with the mean radius.
    inertia : float or None
        Moment of inertia, mass * length^2. Default: m R^2 / 2 of a disc, 2 m R^2 / 5 of a sphere.
    time_step : float or None
        Fixed length of the steps, time. Default: 0.8 of the computed stability limit.
    stiffness : float
        Tangential stiffness K_t of a contact, force / length.
    damping : float
        Tangential damping A_t of a contact, force * time / length.
    slipping_spring : str
        What a spring does while its contact slips: "reset", it carries the friction alone at once, as in the paper;
        "relax", it approaches that through its damper, so that results converge for short time steps.
    rest_tolerance : float
        Relative change of the power below which the motion counts as at rest.
    static_ratio : float
        Ratio of static to kinetic friction, 1 or more.
    gear_order : int
        Number of time derivatives that Gear's predictor keeps, 2 to 5.
    energy : bool
        True to record the energy balance; a time step takes a third longer.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> tb.solve(tb.Scene.random((4, 5), seed=3), tb.CundallStrack(stiffness=1e6), threads=1).status
    'certified'
    """

    name = "cundall-strack"
    implementation = "taichi_bearings.solvers.cundall_strack:CundallStrackMethod"
    steps_packings = True
    colour, marker = "#8C6BB1", ">"
    solves = staticmethod(_steps)

    @classmethod
    def step_seconds(cls, shape: Sequence[int]) -> float | None:
        """Return the seconds of a time step of a lattice of this shape, fitted to measured times."""
        return 5e-6 + 2.5e-8 * prod(shape)

    stiffness: float = material(
        1e5, POSITIVE, "Tangential stiffness K_t of the spring at each contact.", unit="force/length"
    )
    damping: float = material(
        1e3, NOT_NEGATIVE, "Tangential damping A_t of the spring at each contact.", unit="force*time/length"
    )
    slipping_spring: str = material(
        "reset",
        OneOf("reset", "relax"),
        "What a spring does while its contact slips. reset: it carries the friction alone at once, as in the "
        "paper. relax: it approaches that through its damper, so that results converge for short time steps.",
        rare=True,
    )
    rest_tolerance: float = _rest_tolerance(1e-9)
    static_ratio: float = material(
        1.0, Kind(bounded(real, 1), "1 or more", "NUMBER"), "Ratio mu_s/mu_k of static to kinetic friction.", rare=True
    )
    gear_order: int = how(
        2, whole(2, 5), "Order of Gear's integrator: number of time derivatives of a spin that it keeps.", rare=True
    )
    energy: bool = how(
        False,
        TRUTH,
        "Record how much energy is put in, stored and dissipated; a time step takes a third longer.",
        rare=True,
    )

    def after_slip(self, span: float) -> tuple[float, float]:
        """Return two numbers a, length/force, and b, a pure number, from which the elongation of a slipping spring
        after a step follows:

            elongation = a * force + b * elongation before the step.

        a is in length/force. With the option `reset` a = 1 / K, b = 0 (paper Eq. 9, with a unit vector). With `relax`
        the elongation obeys A d(elongation)/dt = force - K elongation, solved by implicit Euler. K is the stiffness, A
        the damping.

        span : length of the step, time.
        """
        if self.slipping_spring == "reset":
            return 1 / self.stiffness, 0.0
        resistance = self.stiffness * span + self.damping
        return span / resistance, self.damping / resistance


def fastest(scene: "Scene", tolerance: float, on_gpu: bool) -> type[MethodOptions]:
    """Return the fastest method that certifies a scene, for which `auto` stands; raise InputError if there is none.

    tolerance : relative gap that is asked for.
    on_gpu : True if the run has a GPU.
    """
    for row in METHODS.values():
        if row.suits(scene, tolerance, on_gpu):
            return row
    law, why = scene.law, _why_not_stepped(scene.law, "gradient-descent")
    why = f"{why}; name one of your own by --method" if why else "name one of your own by --method"
    raise InputError(f"law is {law.name!r}; auto knows no method for this law: {why}")


def row_of_packing(method: str) -> type[MethodOptions] | None:
    """Return the options class of a method that computes packings step by step from initial spins. Return None for a
    method that finds their minima directly, and for "auto".

    method : name of the method, or "auto".

    Raises InputError for a method that does not solve packings.
    """
    row = METHODS.get(method)
    able = [name for name, built in METHODS.items() if built.steps_packings or built.minimises_packings]
    if method not in ("auto", *able):
        allowed = ["auto", *able]
        raise InputError(
            f"method is {shown(method)}; of a packing it can be {', '.join(allowed)}{meant(method, allowed)}"
        )
    return row if row is not None and row.steps_packings else None
