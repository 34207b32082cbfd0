"""The least power in the laboratory frame, with all components of all spins, as a cone programme for Clarabel.

Nothing is shared with the package but the scene: no staggered spins, no reduction to the components that a minimum
needs, no jump. `draw_scene` draws scenes in 2D and 3D, of all laws, between spins and bearing states, with and without
periodic sides, with ties and contrasts; `falsehoods` compares bounds, power and contact states.
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene
from taichi_bearings.scene.law import LAWS
from tests.clarabel_twin import least
from tests.kernels.twins import is_driven, neighbours

TOLERANCE, SHARPER = 1e-11, 1e-13  # of Clarabel
AGREEMENT = 1e-8  # of the power
CLEAR_SLIP = 1e-3  # of the largest jump, by which the slip at a proven contact and that of the programme may differ
SHAPES = ((3, 4), (4, 6), (2, 9), (6, 4), (2, 2, 3), (3, 3, 4), (2, 3, 5), (4, 3, 3), (3, 4, 4))
DISTRIBUTIONS = ("uniform:0.1,1.0", "lognormal:1.0,1.0", "bimodal:0.1,1.0,0.5", "bimodal:1,2,0.5", "constant:0.5",
                 "bimodal:1,1e3,0.3")  # fmt: skip


@dataclass(frozen=True)
class Minimum:
    """objective : least power by friction, half of it by viscosity. slip : by contact, (lower site, axis) -> speed."""

    objective: float
    slip: dict
    solved: bool


def imposed_spin(scene, site, k):
    """Component k of the spin of a driven sphere, as one sees it."""
    sign = (-1) ** sum(site)
    state = scene.bottom if site[-1] == 0 else scene.top
    if state is None:
        size = scene.spin_bottom if site[-1] == 0 else scene.spin_top
        direction = np.array([0, 0, 1.0] if scene.lattice.dimension == 2 else scene.direction)
        return sign * size * direction[k] / np.linalg.norm(direction)
    if len(state) == 1:
        return sign * state[0] * (k == 2)
    at = 2 * scene.lattice.radius * site[k] if scene.lattice.dimension == 3 else 0.0
    return sign * (state[k] + state[3] * at)


def laboratory_minimum(scene, tolerance=TOLERANCE):
    """Slips v = (w_i + w_j) x (R n), but for their sign; friction mu F_n |v| and viscosity eta |v|^2 / 2."""
    shape, radius = scene.lattice.shape, scene.lattice.radius
    components = (2,) if len(shape) == 2 else (0, 1, 2)
    free = [site for site in np.ndindex(*shape) if not is_driven(site, shape)]
    column = {(site, k): len(components) * n + slot for n, site in enumerate(free) for slot, k in enumerate(components)}
    spins, contacts, slips, known = len(column), [], [], []
    seam = (
        (site, (*site[:axis], 0, *site[axis + 1 :]), axis)
        for axis in map("xyz".index, scene.periodic)
        for site in np.ndindex(*shape)
        if site[axis] == shape[axis] - 1
    )
    for lower, upper, axis in (*neighbours(shape), *seam):
        if is_driven(lower, shape) and is_driven(upper, shape):
            continue
        contacts.append((lower, axis))
        matrix, fixed = np.zeros((3, spins)), np.zeros(3)
        for site in (lower, upper):
            for k in components:
                turned = np.cross(np.eye(3)[k], radius * np.eye(3)[axis])
                if is_driven(site, shape):
                    fixed += turned * imposed_spin(scene, site, k)
                else:
                    matrix[:, column[site, k]] += turned
        slips.append(matrix)
        known.append(fixed)
    holds = scene.law.has_friction
    friction = [scene.normal_force * scene.coefficients[axis][site] if holds else 0.0 for site, axis in contacts]
    viscous = scene.viscosity or (() if holds else scene.coefficients)
    eta = np.array([viscous[axis][site] if viscous else 0.0 for site, axis in contacts])
    found = least(np.vstack(slips), np.array(known), np.array(friction), eta, tolerance)
    slip = dict(zip(contacts, found.slip, strict=True))
    return Minimum(found.objective, slip, found.status in ("Solved", "AlmostSolved"))


def draw_scene(seed, number):
    rng = np.random.default_rng([seed, number])
    shape = SHAPES[rng.integers(len(SHAPES))]
    law = LAWS[rng.choice(("coulomb", "coulomb-viscous", "viscous"), p=(0.6, 0.25, 0.15))]
    given = {"law": law, "distribution": str(rng.choice(DISTRIBUTIONS))}
    parts = [0.0, 1.0, -1.0, 0.5, float(rng.uniform(-2, 2)), 1.0 + float(10 ** -rng.uniform(1, 4))]
    if rng.random() < 0.7:
        size = 1 if len(shape) == 2 else 4
        for plane in ("top", "bottom"):
            given[plane] = tuple(float(part) for part in rng.choice(parts, size))
    else:
        given |= {"spin_top": 1.0, "spin_bottom": float(rng.choice(parts))}
        if len(shape) == 3:
            given["direction"] = tuple(float(part) for part in rng.choice(parts[1:], 3))
    even = [name for name, side in zip("xy", shape[:-1], strict=False) if side % 2 == 0]
    given["periodic"] = tuple(name for name in even if rng.random() < 0.5)
    given |= {"radius": float(rng.choice([0.5, 2.0]))}
    given |= {"normal_force": float(rng.choice([1.0, 50.0]))} if law.has_friction else {}
    return Scene.random(shape, seed=int(rng.integers(2**31)), **given)


def falsehoods(scene, best, truth):
    """What the answer says and the programme refutes, and how many states were compared."""
    least = truth.objective * (
        1 if scene.law.has_friction else 2
    )  # viscous contacts alone dissipate twice their potential
    clear = CLEAR_SLIP * scene.lattice.radius * (scene.jump or scene.fastest or 1.0)
    fastest = scene.lattice.radius * scene.fastest
    unit = scene.strength * max(float(values.max()) for values in scene.coefficients) * fastest
    room = AGREEMENT * abs(least) + 1e-10 * unit * (1 if scene.law.has_friction else fastest) + 10 * TOLERANCE
    found, compared = [], 0
    objective = best.potential if scene.law.name == "coulomb-viscous" else best.power
    if best.lower_bound > least + room:
        found.append(f"bound {best.lower_bound!r} above {least!r}")
    if objective < least - room:
        found.append(f"objective {objective!r} below {least!r}")
    for (site, axis), speed in truth.slip.items() if best.states_proven else ():
        state, own = best.state[axis][site], best.slip[axis][site]
        if state != ContactState.DRIVEN:
            compared += 1
            rests = state == ContactState.SLIPLESS  # at every minimum, also where several have other slips elsewhere
            if (rests and speed > clear) or (abs(own - speed) > clear and best.minimum_is_unique):
                found.append(f"contact {site} along {axis}: state {state}, slip {own:.3g} instead of {speed:.3g}")
    return found, compared
