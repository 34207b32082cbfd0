"""What a method has reached in samples of a packing, and which of their contacts slip.

Letters: N spheres, E contacts, A contacts of the *system* (those that take part in the motion and lie in parts of the
packing that touch a driven sphere), d tangents of a contact (1 for discs, 2 for spheres), C components of a spin,
u = R omega. The *unknowns* are the components of u of the free spheres of the system. A contact *bears* a force.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import sparse

from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.proof.contact_state import SATURATED
from taichi_bearings.proof.enclosed import LEAST_SPEED
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.proof.on_lattice import LEAST_SCALE, MOST_SCALE
from taichi_bearings.scene import Solution
from taichi_bearings.scene.packing import Packing
from taichi_bearings.scene.solution import DRIVEN, SLIPLESS, SLIPPING, UNDECIDED
from taichi_bearings.solvers.answer import Indicated, Reached
from taichi_bearings.solvers.part import Found

# at exact minima: relative friction margin above which a contact is surely slipless; slip, in units of the fastest
# imposed surface, above which it surely slips
SURE_MARGIN, SURE_SLIP = 1e-6, 1e-11
MOST_TIES = 200  # motions between minima that are computed; with more of them every slipping contact is undecided
AT_REST = 1e-9  # slip, in units of the fastest imposed surface, up to which a contact may be slipless
MOVED = 1e-7  # relative slip above which a motion moves a contact


class PackingReached(Reached):
    """What a method has reached in samples of a packing, and what it proves. The same contacts take part in all
    samples, which are judged together.

    system : the contacts that take part (can dissipate, in parts of the packing that touch a driven sphere).
    samples : each sample alone.
    found : spins and forces of each sample.
    scene : the packing with all these samples.
    judgement : what spins and forces prove.
    """

    scene: Packing
    judgement: Judgement

    def __init__(
        self, system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found], moves: bool = False
    ) -> None:
        """Judge what was found: compute what the spins and the forces prove. Unless `moves`, samples in which a state
        without slip is proven to exist get that state, and no forces.

        Raises InputError if the numbers are too large or too small for any proof.

        system : the contacts that take part.
        samples : each sample alone.
        found : spins and forces of each sample.
        moves : True if the spins are those of a motion, which are kept as they are.
        """
        self.system, self.samples = system, samples
        found, judgement = (
            (found, judgement_of(system, samples, found)) if moves else _as_minima(system, samples, found)
        )
        if judgement is None:
            raise InputError(
                "the imposed spins or the coefficients are too small or too large for a proof; the largest radius * "
                f"spin must be from {LEAST_SPEED} to {MOST_SCALE} length/time, "
                f"the largest force from {LEAST_SCALE} to {MOST_SCALE}"
            )
        self.found, self.judgement, self.scene = found, judgement, Packing.together(samples)
        self.spin, self.spin_rounding, self.friction = judgement.spin, judgement.spin_rounding, judgement.friction
        self.method, self.iterations = found[0].method, max(of.steps for of in found)
        self.findings = {
            "proof": judgement.proof,
            "driven_power": judgement.driven_power,
            "slipless_motions": np.full(len(found), system.motions, dtype=object),
        }

    def force(self, slip: np.ndarray) -> np.ndarray:
        """Return the sizes (R samples, E contacts) of the contact forces that were found.

        slip : not used.
        """
        return np.stack([forces_of(self.system, _finite(of.force))[0] for of in self.found])

    def indicated(self, slip: np.ndarray) -> Indicated:
        """Return the states before anything is proven: DRIVEN for contacts that take no part, UNDECIDED for all others.

        slip : not used.
        """
        state = np.where(self.judgement.acts, UNDECIDED, DRIVEN)
        if len(self.found) == 1:
            return Indicated(state)
        steps, methods = np.array([of.steps for of in self.found]), [of.method for of in self.found]
        return Indicated(state, own={"iterations": steps, "method": np.array(methods, dtype=object)})

    def known(self, has_ended: bool) -> np.ndarray | None:
        """Return the states (R samples, E contacts) that are proven of all minima, UNDECIDED where nothing is; None if
        no state is asked for.

        has_ended : not used.
        """
        return self.judgement.known if all(of.states_are_asked for of in self.found) else None

    def observed(self, answer: Solution, known: np.ndarray | None) -> np.ndarray:
        """Return the states (R samples, E contacts) that slips and friction margins (friction limit minus force) show.

        answer : the answer so far.
        known : (R, E), the states that are proven, UNDECIDED elsewhere; None if the proof of states was given up. Then
            states that the method has settled are not used either, since it takes long to find which contacts slip in
            some minima only.
        """
        found = self.found if known is not None else [replace(of, slips=None) for of in self.found]
        known = np.full(answer.state.shape, UNDECIDED) if known is None else known
        rows = zip(self.samples, found, answer.slip, known, strict=True)
        seen = np.stack([_states(self.system, sample, of, slip, row) for sample, of, slip, row in rows])
        return np.where(self.judgement.acts, seen, DRIVEN)


def _as_minima(
    system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found]
) -> tuple[Sequence[Found], Judgement | None]:
    """Return what was found, and what it proves (None for numbers that no arithmetic can judge). A sample in which a
    state without slip is proven to exist gets that state instead.

    system : the contacts that take part.
    samples : samples of one network, in which the same contacts take part.
    found : spins and forces of each sample.
    """
    judgement = judgement_of(system, samples, found)
    if judgement is not None and judgement.can_all_rest.any():
        slips = (judgement.network.slip.most > 0).reshape(len(samples), -1).any(axis=1)
        if (replaced := judgement.can_all_rest & slips).any():
            pairs = zip(samples, found, replaced.tolist(), strict=True)
            found = [_without_slip(system, one, of) if rests else of for one, of, rests in pairs]
            judgement = judgement_of(system, samples, found)
    return found, judgement


def judgement_of(system: ContactSystem, samples: Sequence[Packing], found: Sequence[Found]) -> Judgement | None:
    """Return what the spins and the forces that were found prove; None for numbers that no arithmetic can judge.
    Numbers that are not finite count as 0.

    system : the contacts that take part.
    samples : samples of one network, in which the same contacts take part.
    found : spins and forces of each sample.
    """
    spins, friction = [], []
    for packing, of in zip(samples, found, strict=True):
        u = system.all_spins(of.spins) if of.everywhere is None else of.everywhere
        rest = np.append(np.zeros(system.unknowns) if of.rest is None else of.rest, 0.0)[system.moved]
        spins.append(packing.spins_of((np.nan_to_num(u, posinf=0.0, neginf=0.0), rest)))
        friction.append(forces_of(system, _finite(of.force))[1])
    spin, rounding = (np.stack(parts) for parts in zip(*spins, strict=True))
    return Judgement.of(Packing.together(samples), spin, rounding, np.stack(friction))


def _finite(force: np.ndarray) -> np.ndarray:
    """Return forces, an array of any shape, with 0 in place of numbers that are not finite.

    force : the forces.
    """
    found: np.ndarray = np.nan_to_num(force, posinf=0.0, neginf=0.0)
    return found


def _without_slip(system: ContactSystem, packing: Packing, found: Found) -> Found:
    """Return the state in which no contact slips and none bears a force. Its spins roll exactly, but for the rounding
    of sums of two doubles.

    system : the contacts that take part.
    packing : one sample.
    found : spins and forces of a method, which are replaced.
    """
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
    """Return the contact states (E contacts,) that slips and friction margins show.

    * Without friction, a contact slips if its slip is more than rounding.
    * If the method has not settled the states, a contact slips if it is fast and its force is at the friction limit, is
      slipless if neither is so, and is undecided otherwise.
    * Settled states are taken where slip (above SURE_SLIP) or relative margin, 1 - force over friction limit (above
      SURE_MARGIN), confirms them. Others are undecided, and contacts whose slip is not the same at all minima.

    system : the contacts that take part.
    packing : one sample.
    found : spins and forces of the method.
    slip : (E,), slip speeds, length/time.
    known : (E,), proven states, UNDECIDED where nothing is proven. If every slipping contact is proven, no search for
        slips that differ between minima is made.
    """
    law = packing.law
    fastest = float(np.abs(packing.driven_speed).max(initial=0.0))
    held = law.holding_force(system.of_contacts(packing))
    if held is None or not held.any():
        return np.where(slip > 1e-12 * fastest, SLIPPING, SLIPLESS)  # smaller slips are rounding
    limit = np.asarray(law.holding_force(packing.material))[0]
    # by slip and force alone
    is_fast, at_limit = slip > AT_REST * fastest, forces_of(system, found.force)[0] >= SATURATED * limit
    state = np.where(is_fast & at_limit, SLIPPING, np.where(is_fast | (at_limit & (limit > 0)), UNDECIDED, SLIPLESS))
    if found.slips is None:
        return state
    # as the method has settled them
    margin = 1 - np.linalg.norm(found.force, axis=0) / np.where(held > 0, held, 1.0)
    slips = found.slips & (slip[system.contact] > SURE_SLIP * float(np.abs(system.offset).max()))
    settled = np.where(~found.slips & (margin > SURE_MARGIN), SLIPLESS, np.where(slips, SLIPPING, UNDECIDED))
    if found.open is not None:
        settled[found.open] = UNDECIDED
    unproven = known[system.contact] == UNDECIDED
    if not law.has_viscosity and (unproven & (settled == SLIPPING)).any():
        settled[tied(system, found.force, settled) if found.ties is None else found.ties] = UNDECIDED
    state[system.contact] = settled
    return state


def tied(system: ContactSystem, force: np.ndarray, state: np.ndarray) -> np.ndarray:
    """Return the mask (A,) of the slipping contacts whose slip is not the same at all minima.

    The force of a slipping contact is the same at all minima, so that its slips at two minima differ along this force
    alone. So a change of spins from one minimum to another lies in a kernel: it makes no slip across the force of any
    slipping contact, and none at all at slipless contacts. If the kernel has only the slipless motions of the whole
    network, all minima have the same slips.

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
    slipping, slipless = np.flatnonzero(state == SLIPPING), np.flatnonzero(state == SLIPLESS)
    rows = [system.operator[t * count + slipless] for t in range(d)]
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
    """Return True if one factorisation shows that all minima have the same slips. False shows nothing.

    A change of the spins from one minimum to another leaves slipless contacts slipless, and changes the slip of a
    slipping contact only along its force. The matrix that is factorised adds up the squares of all other slips: those
    of slipless contacts, and those of slipping contacts across their force. If it is regular, no change but zero makes
    all of them 0. Only packings in which some contact couples several spin components are tried; where each contact
    couples components one by one (normals along the axes) the result is False.

    system : the A contacts that take part, with two tangents each.
    along : (2, A), unit vectors along the contact forces, by tangent.
    state : (A,), states of the contacts, values of `ContactState`.
    """
    from taichi_bearings.conic.shared import surroundings_of  # and with it Taichi's kernels

    shared = surroundings_of(system)
    if shared.system.sign is not None:
        return False
    across = np.stack([-along[1], along[0]]) * (state == SLIPPING)
    rests = isotropic(along, (state == SLIPLESS).astype(float))
    return shared.matrix.is_regular(rests + across[:, None] * across[None, :])
