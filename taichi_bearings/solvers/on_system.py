"""The contacts of a packing as methods see them that find its minimum: one linear map from spins to slips.

Letters: R samples, N spheres, C components of a spin, E contacts, A contacts of the system (those that take part, in
parts of the packing that touch a driven sphere), d tangents of a contact; u = R omega, with the radius R.
"""

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import replace

import numpy as np

from taichi_bearings import runtime
from taichi_bearings.conic.iterate import LEAST_GAP
from taichi_bearings.conic.rolling import rolled
from taichi_bearings.conic.shared import system_of
from taichi_bearings.interrupts import GivenUp, look_up
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.proof.certificate import Forces
from taichi_bearings.scene import Progress, Solution
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers import nested_cuts
from taichi_bearings.solvers.answer import answered
from taichi_bearings.solvers.contacts import Ended, WithMinima
from taichi_bearings.solvers.packing_paths import MOST_STEPS, PackingPaths, viscous_spins
from taichi_bearings.solvers.packing_states import PackingReached
from taichi_bearings.solvers.part import Found, Part
from taichi_bearings.solvers.stopping import ended_as

ENOUGH_FRICTION = 1e3  # friction, in units of power over fastest imposed surface speed, of contacts that hardly slip
MOST_CAPS, LESS_POWER = 12, 0.5  # how often friction is cut off at most; factor by which that has to lower the power


class OnSystem(WithMinima):
    """R samples of a packing for methods that find minima. The same contacts take part in all samples, and their slips
    are a linear map of the spins.

    scene : the packing with these R samples.
    samples : R packings, each sample alone.
    system : the A contacts that take part, with the matrix that maps spins to their slips. They are those that can
        dissipate, in parts of the packing that touch a driven sphere.
    spin_axes : numbers of the axes of the C spin components that are computed.
    """

    scene: Packing

    def __init__(self, packing: Packing) -> None:
        """Take the R samples of a packing, and build the system of their contacts from the first sample."""
        runtime.current()  # starts the default runtime if none runs
        self.scene, self.spin_axes = packing, packing.minimum_spin_axes
        self.samples = [packing.sample(number) for number in range(packing.replicas)]
        with one_thread():
            self.system = system_of(self.samples[0])
        # the spins and forces that were judged last, and what they prove
        self._judged: tuple[Sequence[Found], PackingReached] | None = None

    @property
    def is_still(self) -> bool:
        """True if nothing is driven, so that all spheres of the system are at rest."""
        return not self.system.unknowns or not self.system.offset.any()

    def at_rest(self, method: str = "linear-solver", steps: int = 0) -> Found:
        """Return spins and forces that are all 0.

        method : name of the method.
        steps : number of factorisations that it has made.
        """
        return Found(np.zeros(self.system.unknowns), np.zeros_like(self.system.offset), method, steps=steps)

    def paths(self, settle: bool, tolerance: float) -> Part:
        """Return the solver of the interior-point method: the central paths of all samples. A central path is a curve
        of spins and forces along which Newton steps lead to the minimum.

        settle : True to follow the paths until it is known which contacts slip.
        tolerance : relative gap, at a tenth of which the paths end if `settle` is False.
        """
        with one_thread():
            return PackingPaths(self, ends_at=LEAST_GAP if settle else max(tolerance / 10, LEAST_GAP))

    def cuts(self) -> Part:
        """Return the solver of the planar cut: it finds the spins of least power of each sample, one after the other,
        by minimum cuts of the graph of its contacts (nested_cuts.py).
        """

        def cut(number: int) -> Found:
            """Return the exact minimum of the power of one sample by minimum cuts: the spins u = radius * spin
            (unknowns,), length/time, as sums of two doubles (the second one is `rest`), and the contact forces (d
            tangents, A contacts).

            number : which sample, counted from 0.
            """
            (high, low), force = nested_cuts.least_power(self.system, self.samples[number])
            return Found(high, force, "planar-cut", rest=low, steps=1)

        return OneByOne(self, cut, "planar-cut")

    def linear_systems(self) -> Part:
        """Return the solver of the linear method: it finds the spins at which viscous forces balance, of one sample
        after the other.
        """
        return OneByOne(self, self.flowing, "linear-solver")

    def flowing(self, number: int) -> Found:
        """Return the spins and the forces of one sample, with its viscosity alone and without friction, at which all
        torques balance.

        number : number of the sample.
        """
        system, law = self.system, self.scene.law
        viscosity = law.viscosity(system.of_contacts(self.samples[number]))
        viscosity = np.zeros(len(system.numbers)) if viscosity is None else viscosity
        spins = viscous_spins(system, viscosity)
        return Found(spins, viscosity * system.differences(spins), "linear-solver", steps=1)

    def on_the_way(self, ends: Sequence[Found], iteration: int) -> Progress:
        """Return the progress of all samples before they are at their minima. No lower bound is proven yet; it is given
        as 0.

        ends : spins and forces of each sample now.
        iteration : number of iterations that were made.
        """
        staggered, force = self._stacked(ends)
        return Progress(
            iteration=iteration, staggered=staggered, spin_axes=self.spin_axes, force=force, resolution=0.0,
            objective=self.scene.objective(staggered, self.spin_axes), lower_bound=np.zeros(len(ends)),
            largest_balance_residual=self.scene.torques_left(force, self.spin_axes), settles_more=True,
        )  # fmt: skip

    def at_the_end(self, ends: Sequence[Found], iteration: int) -> Progress:
        """Return the progress of all samples at their minima, with the bounds that are proven.

        ends : spins and forces of each sample.
        iteration : number of iterations that were made.
        """
        staggered, force = self._stacked(ends)
        with one_thread():
            judgement = self.reached(ends).judgement
            return Progress(
                iteration=iteration, staggered=staggered, spin_axes=self.spin_axes, force=force, resolution=0.0,
                objective=judgement.objective, lower_bound=judgement.lower_bound,
                largest_balance_residual=judgement.largest_torque, exhausted=True,
            )  # fmt: skip

    def _stacked(self, ends: Sequence[Found]) -> tuple[np.ndarray, np.ndarray]:
        """Return u = radius * spin (C components, R samples, N spheres), length/time, and forces (d tangents, R, E
        contacts) of all samples.

        ends : spins and forces of each sample.
        """
        system = self.system
        spins = np.stack([system.all_spins(end.spins).T for end in ends], axis=1)
        force = np.zeros((len(system.offset), len(ends), system.network.contacts))
        for number, end in enumerate(ends):
            force[:, number, system.numbers] = end.force
        return np.nan_to_num(spins), np.nan_to_num(force)

    def reached(self, ends: Sequence[Found]) -> PackingReached:
        """Return what spins and forces of all samples prove of their minima. A sample that has a state without slip
        gets that state.

        Raises InputError if no arithmetic can judge the numbers.

        ends : spins and forces that were found of each sample. The result of the last call is returned again if they
            are the same objects.
        """
        known = self._judged
        if known is None or any(one is not other for one, other in zip(known[0], ends, strict=True)):
            known = self._judged = ends, PackingReached(self.system, self.samples, ends)
        return known[1]

    def proven_by(self, force: Forces) -> np.ndarray:
        """Return 0 for each sample, (R samples,): a bound is proven only at the end, from forces and spins.

        force : not used.
        """
        return np.zeros(self.scene.replicas)

    def answered(self, ended: Ended) -> Solution:
        """Return the answer to all samples of a run that ended, with what is proven of them. Answers of the
        interior-point method to friction alone are improved where its contrasts cost precision.

        ended : how the run ended, with the spins and forces that were reached.
        """
        with one_thread():
            whole = answered(self.reached(ended.found()), ended, ended.while_wanted)
            found = [whole.sample(number) for number in range(self.scene.replicas)]
            for number, one in enumerate(found):
                if one.method == "interior-point" and one.scene.law.is_rate_independent:
                    one = self._without_contrast(number, one, ended)
                found[number] = replace(one, status=ended_as(ended.status, one, ended.stop, is_dynamics=False))
        return Solution.joined(found, self.scene)

    def _without_contrast(self, number: int, found: Solution, ended: Ended) -> Solution:
        """Return the answer `found`; or a better one, if `found` is not certified and some contacts have far more
        friction than others.

        A contact that can bear far more than the power over the speed of the fastest driven surface hardly slips. Its
        friction is cut off there, which makes the problem better conditioned; a lower bound with less friction is also
        one with all of it. The spins of that solution are corrected so that these contacts roll, up to the rounding of
        sums of two doubles, and judged with the whole friction. This is repeated with the new power while it pays.

        number : number of the sample.
        found : answer to the sample so far.
        ended : how the run ended.
        """
        system, sample, tolerance = self.system, self.samples[number], ended.stop.tolerance
        held, fastest = system.of_contacts(sample)[0], float(np.abs(system.offset).max(initial=0.0))
        with suppress(GivenUp), ended.while_wanted():
            for _ in range(MOST_CAPS):
                most = ENOUGH_FRICTION * float(found.power[0]) / fastest
                capped = held > most
                if found.gap[0] <= tolerance or not capped.any() or not most > 0:
                    break
                # minimum with less friction; strong contacts are made to roll; all is judged with the whole friction
                paths = PackingPaths(self, {number: (np.minimum(held, most),)})
                paths.advance(MOST_STEPS)
                (end,) = paths.found()
                start = end.spins, np.zeros(system.unknowns) if end.rest is None else end.rest
                spins, rounding = rolled(system, sample, start, capped)
                reached = PackingReached(system, [sample], [replace(end, spins=spins, rest=rounding)])
                other = answered(reached, ended, nullcontext)
                if not (other.gap[0] < found.gap[0] or other.power[0] < LESS_POWER * found.power[0]):
                    break
                found = replace(other, iterations=found.iterations + other.iterations)
        return found


class OneByOne(Part):
    """Solves the R samples of a packing exactly, one after the other. The only iteration solves all of them.

    contacts : contacts of the samples.
    solve : function that returns the minimum of the sample with a given number.
    ends : spins and forces of each of the R samples; all 0 before it is solved.
    solved : how many samples are solved.
    iteration : 0 before all samples are solved, then 1.
    """

    def __init__(self, contacts: OnSystem, solve: Callable[[int], Found], method: str) -> None:
        """Begin with all samples at rest.

        contacts : contacts of the samples.
        solve : function that returns the minimum of the sample with a given number.
        method : name of the method.
        """
        self.contacts, self.solve, self.iteration, self.solved = contacts, solve, 0, 0
        self.ends = [contacts.at_rest() if contacts.is_still else contacts.at_rest(method) for _ in contacts.samples]

    def advance(self, steps: int) -> None:
        """Solve one after another all samples that are not solved yet, and store their minima in `ends`.

        If nothing is driven, all spins are 0 at the minimum, as `ends` has them from the start.

        steps : not used, as a direct solver makes no steps.
        """
        with one_thread():
            while self.solved < len(self.ends):
                look_up()  # raises GivenUp if the user or the time limit has ended the run
                if not self.contacts.is_still:
                    self.ends[self.solved] = self.solve(self.solved)
                self.solved += 1
        self.iteration = 1

    def progress(self) -> Progress:
        """Return spins and forces of all samples, with their bounds once all samples are solved."""
        return (self.contacts.at_the_end if self.iteration else self.contacts.on_the_way)(self.ends, self.iteration)

    def found(self) -> list[Found]:
        """Return the spins and forces of each sample."""
        return self.ends
