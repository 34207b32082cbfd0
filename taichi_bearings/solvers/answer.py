"""The answer of a solve, made for any scene by one function: spins and forces that a method has reached are judged, and
every contact gets its state.

What differs between scenes and methods is asked of what was reached (`Reached`): lattice_states.py answers for
lattices, packing_states.py for minima of packings, and on_lists.py for packings that are stepped.

Shapes: R samples, E contacts, N spheres. A state is *proven* if it is that of the contact at every minimum.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace

import numpy as np

from taichi_bearings.interrupts import GivenUp
from taichi_bearings.proof.contact_state import ContactState, decided
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.solvers.contacts import Ended
from taichi_bearings.solvers.stopping import ended_as


@dataclass(frozen=True)
class Indicated:
    """What slips and forces indicate of the contacts of R samples, before any state is proven.

    state : (R samples, E contacts), values of `ContactState`; DRIVEN for contacts that take no part (absent, or between
        two driven spheres).
    slip_threshold : slip speed, length/time, up to which a contact counts as slipless.
    own : further numbers of each sample, arrays (R,) by name, such as its number of iterations.
    """

    state: np.ndarray
    slip_threshold: float = 0.0
    own: Mapping[str, np.ndarray] = field(default_factory=dict)


class Reached(ABC):
    """Spins and forces that a method has reached in the R samples of a scene, in the form from which the answer is
    made.

    scene : the scene with its R samples.
    method, iterations : name of the method, and how many iterations it has made, the largest number of all samples.
    spin, spin_rounding : spins, and what their rounding leaves out, (R, *N spheres, 3), of discs (R, *N), 1/time.
    friction : force on the second (upper) sphere of each contact, (R, E contacts, 3) or (R, E) for discs, from which
        the lower bound follows.
    judgement : what spins and friction prove; None if no arithmetic can judge the numbers.
    findings : other results of the method, by name.
    """

    scene: Bearing
    method: str
    iterations: int
    spin: np.ndarray
    spin_rounding: np.ndarray
    friction: np.ndarray
    judgement: Judgement | None
    findings: Mapping[str, np.ndarray]

    def numbers(self) -> dict[str, np.ndarray]:
        """Return by name the numbers of the answer that are proven: `slip` (R samples, E contacts), slip speeds,
        length/time, and (R,) each `power`, `objective` (what is minimised), `lower_bound`, energy/time, `gap`,
        relative, and `largest_balance_residual`, the largest torque left on a free sphere.
        """
        return {name: getattr(self.judgement, of) for name, of in JUDGED.items()}

    @abstractmethod
    def force(self, slip: np.ndarray) -> np.ndarray:
        """Return the sizes (R samples, E contacts) of the contact forces.

        slip : (R, E), slip speeds, length/time; some scenes compute the forces from them.
        """

    @abstractmethod
    def indicated(self, slip: np.ndarray) -> Indicated:
        """Return what slips and forces indicate of the state of each contact, before anything is proven.

        slip : (R samples, E contacts), slip speeds, length/time.
        """

    @abstractmethod
    def known(self, has_ended: bool) -> np.ndarray | None:
        """Return the states (R samples, E contacts) that are proven of all minima, UNDECIDED where nothing is; None if
        no proof is tried.

        has_ended : True if a dynamics is proven to have come to a minimum.
        """

    @abstractmethod
    def observed(self, answer: Solution, known: np.ndarray | None) -> np.ndarray:
        """Return the state of each contact (slipping, slipless, ...), (R samples, E contacts), that its slip and its
        force in the answer show. The caller combines it with what is proven.

        answer : the answer so far. Its `state` has what `indicated` returned before anything was proven.
        known : (R, E), the states that are proven, UNDECIDED where nothing is; None if no proof was tried, or if it was
            given up. An implementation may use it to spare work on contacts whose state is proven.
        """


JUDGED = {
    "slip": "slip", "power": "power", "objective": "objective", "lower_bound": "lower_bound", "gap": "gap",
    "largest_balance_residual": "largest_torque",
}  # fmt: skip
"""Fields of an answer that are reported as they are proven, with the names that a judgement has for them."""


def answered(reached: Reached, ended: Ended, while_wanted: Callable[[], AbstractContextManager[None]]) -> Solution:
    """Return the answer to all samples of a scene: their numbers, the states of their contacts, and how the run ended.

    reached : spins and forces that the method has reached.
    ended : how its run ended.
    while_wanted : function that returns a context inside which the proof of contact states ends with GivenUp where it
        is no longer wanted; nothing is proven of the states then.
    """
    answer = _with_numbers(reached)
    is_dynamics, threshold = ended.options.is_dynamics, ended.slip_threshold
    status = ended_as(ended.status, answer, ended.stop, is_dynamics)
    # a motion without viscosity has states of its own, whatever those of the minima are
    moves = is_dynamics and not reached.scene.law.has_viscosity
    has_ended = moves and threshold is None and status is Status.CERTIFIED

    def with_states(known: np.ndarray | None) -> Solution:
        """Return the answer with its status and with the states of its contacts: those that `decided` chooses from the
        proven states and from those that slips and forces show.

        known : (R samples, E contacts), the states that are proven, or None.
        """
        undecided = np.full(answer.state.shape, ContactState.UNDECIDED)
        seen, proven = reached.observed(answer, known), undecided if known is None else known
        state, is_proven = decided(seen, proven, moves or threshold is not None, has_ended)
        return replace(answer, status=status, state=state, proven=is_proven)

    with suppress(GivenUp), while_wanted():
        return with_states(reached.known(has_ended))
    return with_states(None)


def _with_numbers(reached: Reached) -> Solution:
    """Return the answer with all that is proven of its numbers; of its contacts no state is proven yet.

    reached : spins and forces that the method has reached, and what they prove.
    """
    scene, numbers = reached.scene, reached.numbers()
    slip = numbers["slip"]
    indicated = reached.indicated(slip)
    return Solution(
        scene=scene,
        method=reached.method,
        status=Status.STALLED,
        iterations=reached.iterations,
        spin=reached.spin,
        spin_rounding=reached.spin_rounding,
        slip=slip,
        power_per_contact=scene.law.power(scene.material, slip),
        force=reached.force(slip),
        friction=reached.friction,
        state=indicated.state,
        proven=indicated.state == ContactState.DRIVEN,
        power=numbers["power"],
        objective=numbers["objective"],
        lower_bound=numbers["lower_bound"],
        gap=numbers["gap"],
        largest_balance_residual=numbers["largest_balance_residual"],
        slip_threshold=indicated.slip_threshold,
        findings=reached.findings,
        own=indicated.own,
    )


def with_forces_of(answer: Solution, other: Solution) -> Solution:
    """Return `answer` with the contact forces of `other` if those prove the greater lower bound; else `answer` itself.
    Both are answers to the same single sample.

    Spins and contact states stay as they are in `answer`. Bound, gap and leftover torque are computed anew from the
    forces that were taken, and no contact state counts as proven any more.
    """
    if not other.lower_bound[0] > answer.lower_bound[0]:
        return answer
    judgement = Judgement.of(answer.scene, answer.spin, answer.spin_rounding, other.friction)
    if judgement is None:
        return answer
    return replace(
        answer,
        friction=other.friction,
        force=other.force,
        proven=answer.state == ContactState.DRIVEN,
        largest_balance_residual=judgement.largest_torque,
        lower_bound=judgement.lower_bound,
        gap=judgement.gap,
    )
