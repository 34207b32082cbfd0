"""Minima of packings: the method for each, and the samples whose minima are found together."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from taichi_bearings import runtime
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.options import options_of
from taichi_bearings.scene import Bearing, Solution
from taichi_bearings.solvers.drive import Checkpoints, Monitor, solve, uninterrupted
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.solvers.table import METHODS, InteriorPoint
from taichi_bearings.words import shown

MOST_IN_GROUP = 16  # samples whose minima are found together


def solve_packing(packing: Bearing, tolerance: float = 1e-8, method: str = "auto") -> Solution:
    """Return the state of least dissipation of every sample of a packing.

    Motions without slip are held at 0 where nothing drives them. Small samples are solved together; the bits of each
    result do not depend on the other samples.

    packing : a `taichi_bearings.Packing`.
    tolerance : proven relative gap at which the answer counts as certified.
    method : "auto", or the name of a method that solves this packing:

    * planar-cut, exact minimum cuts: friction of discs, and of spheres where each contact couples one spin component;
    * linear-solver, one linear system: viscous contacts alone;
    * interior-point, the central path: all laws with friction.

    Raises InputError for a wrong argument.
    """
    if not (isinstance(tolerance, (int, float)) and 0 < tolerance < 1):
        raise InputError(f"tolerance is {shown(tolerance)}; it must be above 0 and below 1")
    found = list[Solution]()
    for begin, end in groups_of_samples(packing):
        solved = uninterrupted(least_power(some_of(packing, begin, end), method, StopRule(tolerance)))
        found += [solved.sample(number) for number in range(end - begin)]
    return Solution.joined(found, packing)


def groups_of_samples(scene: Bearing) -> Iterator[tuple[int, int]]:
    """Yield pairs (first number, number after the last) of samples of a packing whose minima are found together.

    In these samples the same contacts take part. Only samples of small packings are taken together, at most
    MOST_IN_GROUP.

    scene : the packing with its samples.
    """
    most = MOST_IN_GROUP if scene.network.spheres < InteriorPoint.alike_in_a_block else 1
    acting = [scene.sample(number).acting.tobytes() for number in range(scene.replicas)]
    begin = 0
    for number in range(1, scene.replicas + 1):
        if number == scene.replicas or number - begin == most or acting[number] != acting[begin]:
            yield begin, number
            begin = number


def some_of(scene: Bearing, begin: int, end: int) -> Bearing:
    """Return a scene with the samples number `begin` to `end` - 1 of another."""
    return scene.sample(begin) if end == begin + 1 else scene.some(slice(begin, end))


def least_power(
    scene: Bearing,
    method: str,
    stop: StopRule,
    monitors: Sequence[Monitor] = (),
    checkpoints: Checkpoints | None = None,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> Solution:
    """Return the minima of all samples of a packing. The samples differ in coefficients alone, and a contact that is
    absent in one of them is absent in all.

    scene : the packing, with its samples.
    method : "auto", or the name of a method; InputError is raised if it does not solve this packing.
    stop : limits and tolerance at which to end.
    monitors : functions that are called with a report each time that the progress is read.
    checkpoints : where the state is saved, and from which to continue; None for none.
    options : values of options of methods by name; the method that is taken uses those that it has.
    """
    row = METHODS[method_of(scene, method)]
    own = row(**{name: options[name] for name in options_of(row) if name in options})
    return solve(scene, own.build(), scene.imposed_spins()[0][None], stop, monitors, None, None, checkpoints)


def method_of(scene: Bearing, method: str, looks_for_motions: bool = True) -> str:
    """Return the name of the method that solves a packing; raise InputError if the one that is asked for does not.

    scene : the packing, of which the first sample is looked at.
    method : name of the method, or "auto" for the quickest one.
    looks_for_motions : True to look first for motions of spheres that make no contact slip, and to hold these at 0,
        which takes a factorisation. False to take all spins as unknowns, which is quicker; then "interior-point" may be
        returned although exact cuts are possible.

    Exact cuts need a law with friction alone and contacts that each couple one spin component.
    """
    from taichi_bearings.conic.contact_system import ContactSystem
    from taichi_bearings.conic.shared import system_of  # and with it Taichi's kernels

    runtime.current()
    with one_thread():
        system = system_of(scene.sample(0)) if looks_for_motions else ContactSystem.before_motions(scene.sample(0))
    exact = scene.law.is_rate_independent and not (system.feels.sum(axis=1) > 1).any()
    able = ["planar-cut"] * exact + ["interior-point" if scene.law.has_friction else "linear-solver"]
    if method not in ("auto", *able):
        raise InputError(
            f"method is {shown(method)}; for the least power of this packing it must be {' or '.join(able)}"
        )
    return able[0] if method == "auto" else method
