"""The answer to a sample of a packing: spins and forces that were found, what is proven of them, which contacts slip.

Letters: N spheres, E contacts, A contacts of the *system* (those that take part in the motion and lie in parts of the
packing that touch a driven sphere), d tangents of a contact (1 for discs, 2 for spheres), C components of a spin,
u = R omega. The *unknowns* are the components of u of the free spheres of the system. A contact *bears* a force.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace

import numpy as np
from scipy import sparse

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.interrupts import GivenUp
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.proof.contact_state import SATURATED, decided
from taichi_bearings.proof.enclosed import LEAST_SPEED
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.proof.on_lattice import LEAST_SCALE, MOST_SCALE
from taichi_bearings.scene import Solution, Status
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.solution import DRIVEN, SLIPLESS, SLIPPING, UNDECIDED
from taichi_bearings.solvers.found import Found

# at exact minima: relative friction margin above which a contact is surely slipless; slip, in units of the fastest
# imposed surface, above which it surely slips
SURE_MARGIN, SURE_SLIP = 1e-6, 1e-11
MOST_TIES = 200  # motions between minima that are computed; with more of them every slipping contact is undecided
AT_REST = 1e-9  # slip, in units of the fastest imposed surface, up to which a contact may be slipless
MOVED = 1e-7  # relative slip above which a motion moves a contact


_last: tuple[Packing, ContactSystem] | None = None  # last packing that this process solved, and its system
OF_A_NETWORK = ("center", "contact", "driven", "spin", "radius", "normal")  # all that a contact system depends on


def system_of_sample(packing: Packing) -> ContactSystem:
    """Return the contact system of a packing: that of the last one if only coefficients differ, as between seeds."""
    from taichi_bearings.conic.shared import system_of  # and with it Taichi's kernels

    global _last
    known = _last
    if known is None or not _alike(known[0], packing):
        known = _last = None  # its memory is free before another one is found
        known = _last = packing, system_of(packing)
    return known[1]


def _alike(one: Packing, other: Packing) -> bool:
    """Return True if two packings have the same network, and the same contacts of it take part."""
    same = all(np.array_equal(getattr(one, name), getattr(other, name)) for name in OF_A_NETWORK)
    return same and np.array_equal(one.acting, other.acting)


def as_minima(
    system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found]
) -> tuple[Sequence[Found], Judgement]:
    """Return what was found, and what it proves; samples that have a state without slip get that.

    system : the contacts that take part.
    samples : samples of one network, of which the same contacts take part.
    found : spins and forces of each sample.
    """
    judgement = judgement_of(system, samples, found)
    if judgement.can_be_judged and judgement.slipless.any():
        slips = (judgement.network.slip.most > 0).reshape(len(samples), -1).any(axis=1)
        if (replaced := judgement.slipless & slips).any():
            pairs = zip(samples, found, replaced.tolist(), strict=True)
            found = [_without_slip(system, one, of) if rests else of for one, of, rests in pairs]
            judgement = judgement_of(system, samples, found)
    return found, judgement


def refuse_unjudged(judgement: Judgement) -> None:
    """Raise InputError for numbers that no arithmetic can judge."""
    if not judgement.can_be_judged:
        raise InputError(
            "the imposed spins or the coefficients are too small or too large for a proof; the largest radius * spin "
            f"must be from {LEAST_SPEED} to {MOST_SCALE} length/time, "
            f"the largest force from {LEAST_SCALE} to {MOST_SCALE}"
        )


def judged(
    system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found], moves: bool = False
) -> list[Solution]:
    """Return what was found of each sample as an answer, with all that is proven of it; its status is left open.

    system : the contacts that take part.
    samples : samples of one network, of which the same contacts take part; they are judged together.
    found : spins and forces of each sample.
    moves : True if the spins are those of a motion and are kept. Otherwise they are replaced by the slipless state
        where one is proven to exist.
    """
    of = system, samples, found
    found, judgement = (found, judgement_of(*of)) if moves else as_minima(*of)
    return answers(system, samples, found, judgement)


def answers(
    system: ContactSystem,
    samples: Sequence[Packing],
    found: Sequence[Found],
    judgement: Judgement,
    while_wanted: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> list[Solution]:
    """Return the answer of each sample; its status is left open.

    system : the contacts that take part.
    samples : samples of one network, of which the same contacts take part.
    found : spins and forces of each sample.
    judgement : what these prove.
    while_wanted : function that returns a context inside which the proof of contact states ends with GivenUp where it
        is no longer wanted; nothing is proven of the states then.
    """
    refuse_unjudged(judgement)
    values = {name: getattr(judgement, name) for name in JUDGED}

    def all_of(found: Sequence[Found], known: np.ndarray) -> list[Solution]:
        """Return all answers. known : (R, E), the states that are proven, UNDECIDED where nothing is."""
        rows = values | {"known": known}
        return [
            _answer(system, sample, of, {name: v[number : number + 1] for name, v in rows.items()})
            for number, (sample, of) in enumerate(zip(samples, found, strict=True))
        ]

    with suppress(GivenUp), while_wanted():
        return all_of(found, judgement.known)
    return all_of([replace(of, slips=None) for of in found], np.full(values["slip"].shape, UNDECIDED))


JUDGED = (
    "spin", "spin_rounding", "slip", "acts", "power", "objective", "lower_bound", "gap", "largest_torque",
    "proof", "driven_power",
)  # fmt: skip
"""What an answer takes from a judgement: arrays with one row for each sample."""


def _answer(system: ContactSystem, packing: Packing, found: Found, of: dict[str, np.ndarray]) -> Solution:
    """Return the answer of one sample.

    of : the rows of the sample, by the names in JUDGED, and `known`, the states that are proven.
    """
    law, slip = packing.law, of["slip"]
    force, friction = forces_of(system, np.nan_to_num(found.force, posinf=0.0, neginf=0.0))
    observed = np.where(of["acts"], _states(system, packing, found, slip[0], of["known"][0]), DRIVEN)
    state, proven = decided(observed, of["known"])
    return Solution(
        scene=packing,
        method=found.method,
        status=Status.STALLED,
        iterations=found.steps,
        spin=of["spin"],
        spin_rounding=of["spin_rounding"],
        slip=slip,
        power_per_contact=law.power(packing.material, slip),
        force=force[None],
        friction=friction[None],
        state=state,
        proven=proven,
        power=of["power"],
        objective=of["objective"],
        lower_bound=of["lower_bound"],
        gap=of["gap"],
        largest_balance_residual=of["largest_torque"],
        findings={
            "proof": of["proof"],
            "driven_power": of["driven_power"],
            "slipless_motions": np.array([system.motions], dtype=object),
        },
    )


def judgement_of(system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found]) -> Judgement:
    """Return what the spins and the forces that were found prove; numbers that are not finite count as 0.

    system : the contacts that take part.
    samples : samples of one network, of which the same contacts take part.
    found : spins and forces of each sample.
    """
    spins, friction = [], []
    for packing, of in zip(samples, found, strict=True):
        u = system.all_spins(of.spins) if of.everywhere is None else of.everywhere
        rest = np.append(np.zeros(system.unknowns) if of.rest is None else of.rest, 0.0)[system.moved]
        spins.append(packing.spins_of((np.nan_to_num(u, posinf=0.0, neginf=0.0), rest)))
        friction.append(forces_of(system, np.nan_to_num(of.force, posinf=0.0, neginf=0.0))[1])
    spin, rounding = (np.stack(parts) for parts in zip(*spins, strict=True))
    return Judgement(Packing.together(samples), spin, rounding, np.stack(friction))


def _without_slip(system: ContactSystem, packing: Packing, found: Found) -> Found:
    """Return the state in which no contact slips and none bears a force, to the rounding of sums of two doubles."""
    from taichi_bearings.conic.rolling import rolled  # and with it Taichi's kernels

    start = exactly(np.zeros(system.unknowns))
    spins, rest = rolled(system, packing, start, np.ones(len(system.numbers), dtype=bool))
    return replace(found, spins=spins, rest=rest, everywhere=None, force=np.zeros_like(system.offset), slips=None)


def forces_of(system: ContactSystem, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sizes (E contacts,) of contact forces, and the friction on the second sphere of each contact of a
    packing.

    The friction is a vector, (E, 3), or for discs its component along z x n, (E,), with the normal n.

    system : the A contacts that take part; others have no force.
    force : (d, A), components along the d tangents of each.
    """
    network = system.network
    size, vectors = np.zeros(network.contacts), system.on_contacts(force)
    size[system.contact] = np.linalg.norm(force, axis=0)
    return size, vectors[:, 0] if network.dimension == 2 else np.cross(vectors, network.normal)


def _states(system: ContactSystem, packing: Packing, found: Found, slip: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the contact states (E contacts,) that slips and friction margins show, for contacts without a proven
    state.

    A contact slips if it is fast and its friction is at the limit, is slipless if neither, and is undecided otherwise.
    Where the method has settled the states these are taken instead, if slip or margin (1 - force over friction limit)
    is clear (SURE_SLIP, SURE_MARGIN). Slips that are not the same at all minima leave a contact undecided.

    system : the contacts that take part.
    packing : one sample.
    found : spins and forces of the method.
    slip : (E,), slip speeds.
    known : (E,), proven states, UNDECIDED where nothing is proven.
    """
    law = packing.law
    fastest = float(np.abs(packing.driven_speed).max(initial=0.0))
    held = law.holding_force(system.of_contacts(packing))
    if held is None or not held.any():
        return np.where(slip > 1e-12 * fastest, SLIPPING, SLIPLESS)  # smaller slips are rounding
    limit = np.asarray(law.holding_force(packing.material))[0]
    fast, full = slip > AT_REST * fastest, forces_of(system, found.force)[0] >= SATURATED * limit
    state = np.where(fast & full, SLIPPING, np.where(fast | (full & (limit > 0)), UNDECIDED, SLIPLESS))
    if found.slips is None:
        return state
    margin = 1 - np.linalg.norm(found.force, axis=0) / np.where(held > 0, held, 1.0)
    slips = found.slips & (slip[system.contact] > SURE_SLIP * float(np.abs(system.offset).max()))
    own = np.where(~found.slips & (margin > SURE_MARGIN), SLIPLESS, np.where(slips, SLIPPING, UNDECIDED))
    if found.open is not None:
        own[found.open] = UNDECIDED
    unproven = known[system.contact] == UNDECIDED
    if not law.flows and (unproven & (own == SLIPPING)).any():
        own[tied(system, found.force, own) if found.ties is None else found.ties] = UNDECIDED
    state[system.contact] = own
    return state


def tied(system: ContactSystem, force: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return True (A,) for slipping contacts whose slip is not the same at all minima.

    The force of a slipping contact is the same at all minima, so that the slips of two minima differ along it alone. So
    the changes of spins between minima lie in a kernel: they make no slip across the force of a slipping contact, and
    none at all of a slipless contact. If only the slipless motions of the whole network are in that kernel, all minima
    have the same slips.

    system : the A contacts that take part.
    force : (d, A), forces at a minimum, along d tangents.
    state : (A,), states of the contacts.
    """
    d, count = force.shape
    # rows of the operator whose kernel has the changes of spins between minima
    size = np.linalg.norm(force, axis=0)
    along = force / np.where(size > 0, size, 1.0)
    found = np.zeros(count, dtype=bool)
    if d == 2 and system.sign is None and _is_only_one(system, along, state):
        return found
    across = np.stack([-along[1], along[0]]) if d == 2 else np.zeros((1, count))
    slipping, resting = np.flatnonzero(state == 1), np.flatnonzero(state == 0)
    rows = [system.operator[t * count + resting] for t in range(d)]
    if d == 2:
        parts = (sparse.diags_array(across[t, slipping]) @ system.operator[t * count + slipping] for t in range(d))
        rows.append(sum(parts))
    slips, moves = sparse.csr_array(sparse.vstack(rows)), np.any(system.moved >= 0, axis=1)
    motions = system.network.motions(slips, system.sphere, system.numbers, moves)
    if not motions.number:
        return found
    if motions.number > MOST_TIES:
        found[slipping] = True
        return found
    # a contact is tied if some motion of the kernel changes its slip along its force
    basis = motions.basis()
    moved = sum(np.abs(along[t, :, None] * (system.operator[t * count : (t + 1) * count] @ basis)) for t in range(d))
    found[slipping] = (moved > MOVED * np.abs(basis).max()).any(axis=1)[slipping]
    return found


def _is_only_one(system: ContactSystem, along: np.ndarray, state: np.ndarray) -> bool:
    """Return True if one factorisation proves that all minima have the same slips; for oblique normals.

    The matrix counts slips of slipless contacts, and slips of slipping contacts across their force. If it is regular,
    no change of the spins avoids both.

    system : the A contacts that take part.
    along : (2, A), directions of the forces.
    state : (A,), states of the contacts.
    """
    from taichi_bearings.conic.shared import surroundings_of  # and with it Taichi's kernels

    shared = surroundings_of(system)
    if shared.system.sign is not None:
        return False
    across = np.stack([-along[1], along[0]]) * (state == SLIPPING)
    rests = isotropic(along, (state == SLIPLESS).astype(float))
    return shared.matrix.is_regular(rests + across[:, None] * across[None, :])
