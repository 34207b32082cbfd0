"""The answer to a packing: spins of least dissipation, what is proven of them, and which contacts slip.

`solve_packing` chooses a method, has it find spins and forces (`Found`), and has them judged.

Letters: N spheres, E contacts, A contacts of the *system* (those that take part in the motion and lie in parts of the
packing that touch a driven sphere), d tangents of a contact (1 for discs, 2 for spheres), C components of a spin,
u = R omega. The *unknowns* are the components of u of the free spheres of the system. A contact *bears* a force.
"""

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np
from scipy import sparse

from taichi_bearings import runtime
from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.blas import one_thread
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.proof.contact_state import SATURATED, decided
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene import Bearing, Solution, Status
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.solution import DRIVEN, SLIPLESS, SLIPPING, UNDECIDED
from taichi_bearings.solvers import nested_cuts
from taichi_bearings.solvers.found import Found
from taichi_bearings.stages import stage
from taichi_bearings.words import shown

# at exact minima: relative friction margin above which a contact is surely slipless; slip, in units of the fastest
# imposed surface, above which it surely slips
SURE_MARGIN, SURE_SLIP = 1e-6, 1e-11
MOST_TIES = 200  # motions between minima that are computed; with more of them every slipping contact is undecided
ENOUGH_FRICTION = 1e3  # friction beyond which a contact hardly slips, in units of power over fastest driven surface
MOST_CAPS, LESS_POWER = 12, 0.5  # how often friction is cut off at most; factor by which that has to lower the power
AT_REST = 1e-9  # slip, in units of the fastest imposed surface, up to which a contact may be slipless
MOVED = 1e-7  # relative slip above which a motion moves a contact


def solve_packing(packing: Bearing, tolerance: float = 1e-8, method: str = "auto") -> Solution:
    """Return the state of least dissipation of every sample of a packing.

    Motions that make no contact slip are left at rest where nothing drives them. Small samples are solved side by side;
    the bits of each do not depend on the others.

    packing : a `taichi_bearings.Packing`.
    tolerance : proven relative gap at which the answer counts as certified.
    method : "auto", or the name of a method that solves this packing:

    * planar-cut, exact minimum cuts: friction of discs, and of spheres where each contact couples one spin component;
    * linear-solver, one linear system: viscous contacts alone;
    * interior-point, the central path: all laws with friction.

    Raises InputError for a wrong argument.
    """
    if not isinstance(packing, Packing):
        raise InputError(f"the packing is a {type(packing).__name__}; it must be a taichi_bearings.Packing")
    if not (isinstance(tolerance, (int, float)) and 0 < tolerance < 1):
        raise InputError(f"tolerance is {shown(tolerance)}; it must be above 0 and below 1")
    samples = [packing.sample(number) for number in range(packing.replicas)]
    found: dict[int, Solution] = {}
    for numbers in _alike_samples(samples):
        solved = _solved([samples[number] for number in numbers], tolerance, method)
        found |= dict(zip(numbers, solved, strict=True))
    return Solution.joined([found[number] for number in range(len(samples))], packing)


def _alike_samples(samples: Sequence[Packing]) -> list[list[int]]:
    """Return the numbers of the samples in groups, in each of which the same contacts take part."""
    found: dict[bytes, list[int]] = {}
    for number, sample in enumerate(samples):
        found.setdefault(sample.acting.tobytes(), []).append(number)
    return list(found.values())


def _solved(samples: Sequence[Packing], tolerance: float, method: str) -> list[Solution]:
    """Return the answers to samples in which the same contacts take part; each is given an equal share of the seconds.

    tolerance : relative gap at which an answer counts as certified.
    method : name of a method, or "auto".
    """
    begun = perf_counter()
    runtime.current()
    with one_thread():
        system = _system_of(samples[0])
        ends = _found(system, samples, method)
        with stage("proving"):
            answers = judged(system, samples, ends, tolerance)
        for number, (sample, found) in enumerate(zip(samples, answers, strict=True)):
            if found.method == "interior-point" and sample.law.is_rate_independent:
                answers[number] = _without_contrast(system, sample, found, tolerance)
    seconds = (perf_counter() - begun) / len(samples)
    return [replace(found, seconds=seconds) for found in answers]


def _without_contrast(system: ContactSystem, packing: Packing, found: Solution, tolerance: float) -> Solution:
    """Return the answer `found`, or a better one if it is not certified and some contacts have far more friction.

    A contact that can bear far more than the power over the fastest driven surface hardly slips. So its friction is cut
    off there, which makes the problem better conditioned; a lower bound for less friction is one for the whole. The
    spins of that solution are then corrected so that these contacts roll, to the rounding of sums of two doubles, and
    judged with the whole friction. This is repeated with the new power while it pays.

    system : the contacts that take part.
    packing : one sample.
    tolerance : relative gap at which an answer counts as certified.
    """
    from taichi_bearings.conic.rolling import rolled  # and with it Taichi's kernels

    held, fastest = system.of_contacts(packing)[0], float(np.abs(system.offset).max(initial=0.0))
    for _ in range(MOST_CAPS):
        most = ENOUGH_FRICTION * float(found.power[0]) / fastest
        capped = held > most
        if found.gap[0] <= tolerance or not capped.any() or not most > 0:
            break
        (end,) = _found(system, [packing], "interior-point", [(np.minimum(held, most),)])
        start = end.spins, np.zeros(system.unknowns) if end.rest is None else np.asarray(end.rest)
        spins, rounding = rolled(system, packing, start, capped)
        (other,) = judged(system, [packing], [replace(end, spins=spins, rest=rounding)], tolerance)
        if not (other.gap[0] < found.gap[0] or other.power[0] < LESS_POWER * found.power[0]):
            break
        found = replace(other, iterations=found.iterations + other.iterations)
    return found


_last: tuple[Packing, ContactSystem] | None = None  # last packing that this process solved, and its system
OF_A_NETWORK = ("center", "contact", "driven", "spin", "radius", "normal")  # all that a contact system depends on


def _system_of(packing: Packing) -> ContactSystem:
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


def _found(
    system: ContactSystem,
    samples: Sequence[Packing],
    method: str,
    resisting: Sequence[tuple[np.ndarray, ...]] | None = None,
) -> list[Found]:
    """Return the spins and forces that a method finds for each sample.

    system : the contacts that all samples share, A of them.
    method : name of a method, or "auto".
    resisting : for each sample the coefficients of the law, (A,) arrays, if these are not those of the samples.
    """
    law = samples[0].law
    exact = law.is_rate_independent and not (system.feels.sum(axis=1) > 1).any()
    able = ["planar-cut"] * exact + ["interior-point" if law.holds else "linear-solver"]
    if method not in ("auto", *able):
        raise InputError(f"method is {shown(method)}, but this packing is solved by {' or '.join(able)}")
    if not system.unknowns or not system.offset.any():  # nothing is driven: all at rest
        still = Found(np.zeros(system.unknowns), np.zeros_like(system.offset), "linear-solver")
        return [still for _ in samples]
    if exact and method != "interior-point":
        cuts = [nested_cuts.least_power(system, sample) for sample in samples]
        return [Found(high, force, "planar-cut", rest=low) for (high, low), force in cuts]
    from taichi_bearings.solvers.packing_path import Strengths, followed, viscous_spins  # and with it Taichi's kernels

    found: dict[int, Found] = {}
    ways: dict[int, Strengths] = {}
    # units in which spins and forces are about 1; contacts without friction need a linear system alone
    fastest = float(np.abs(system.offset).max())
    speed = float(np.exp2(np.round(np.log2(fastest))))  # dividing by it rounds nothing
    for number, of in enumerate(resisting or [system.of_contacts(sample) for sample in samples]):
        none = np.zeros(len(system.numbers))
        held, viscosity = (none if v is None else v for v in (law.holding_force(of), law.viscosity(of)))
        if held.any():
            force = float(np.exp2(np.round(np.log2(max(held.max(), viscosity.max() * fastest)))))
            ways[number] = Strengths(held / force, viscosity * speed / force, speed * force, force)
        else:
            spins = viscous_spins(system, viscosity)
            found[number] = Found(spins, viscosity * system.differences(spins), "linear-solver", steps=1)
    followed_ways = followed(system, speed, list(ways.values())) if ways else []
    found |= dict(zip(ways, followed_ways, strict=True))
    return [found[number] for number in range(len(samples))]


def judged(
    system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found], tolerance: float, moves: bool = False
) -> list[Solution]:
    """Return what was found of each sample as an answer, with all that is proven of it.

    system : the contacts that take part.
    samples : samples of one network, of which the same contacts take part; they are judged together.
    found : spins and forces of each sample.
    tolerance : relative gap at which an answer is certified.
    moves : True if the spins are those of a motion and are kept. Otherwise they are replaced by the slipless state
        where one is proven to exist.
    """
    judgement = judgement_of(system, samples, found)
    if judgement.can_be_judged and not moves and judgement.slipless.any():
        slips = (judgement.network.slip.most > 0).reshape(len(samples), -1).any(axis=1)
        if (replaced := judgement.slipless & slips).any():
            pairs = zip(samples, found, replaced.tolist(), strict=True)
            found = [_without_slip(system, one, of) if rests else of for one, of, rests in pairs]
            judgement = judgement_of(system, samples, found)
    if not judgement.can_be_judged:
        raise InputError(
            "the imposed spins are too small or too large for a proof; the largest must be above 1e-100 length/time"
        )
    values = {name: getattr(judgement, name) for name in JUDGED}
    return [
        _answer(system, sample, of, {name: v[number : number + 1] for name, v in values.items()}, tolerance)
        for number, (sample, of) in enumerate(zip(samples, found, strict=True))
    ]


JUDGED = (
    "spin", "spin_rounding", "slip", "acts", "known", "power", "objective", "lower_bound", "gap", "largest_torque",
    "proof", "driven_power",
)  # fmt: skip
"""What an answer takes from a judgement: arrays with one row for each sample."""


def _answer(
    system: ContactSystem, packing: Packing, found: Found, of: dict[str, np.ndarray], tolerance: float
) -> Solution:
    """Return the answer of one sample. of : the rows of the sample, by the names in JUDGED."""
    law, slip = packing.law, of["slip"]
    force, friction = forces_of(system, np.nan_to_num(found.force, posinf=0.0, neginf=0.0))
    observed = np.where(of["acts"], _states(system, packing, found, slip[0], of["known"][0]), DRIVEN)
    state, proven = decided(observed, of["known"])
    return Solution(
        scene=packing,
        method=found.method,
        status=Status.CERTIFIED if of["gap"][0] <= tolerance else Status.STALLED,
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

    slip : (E,), slip speeds. known : (E,), proven states, UNDECIDED where nothing is proven.

    A contact slips if it is fast and its friction is at the limit, is slipless if neither, and is undecided otherwise.
    Where the method has settled the states these are taken instead, if slip or margin (1 - force over friction limit)
    is clear (SURE_SLIP, SURE_MARGIN). Slips that are not the same at all minima leave a contact undecided.

    system : the contacts that take part.
    packing : one sample.
    found : spins and forces of the method.
    judgement : what these prove.
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
