"""Collects what the page of a run holds: numbers for people, and arrays as small as a picture needs them."""

import numpy as np
from matplotlib import colormaps

from taichi_bearings.plain_files import Json
from taichi_bearings.plots.bearing import SPIN_COLOURS
from taichi_bearings.plots.spins import POWER_COLOURS
from taichi_bearings.plots.structure import colour_of_turn
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.points_and_lines import Moments, PointsAndLines
from taichi_bearings.scene.law import Law
from taichi_bearings.scene.scene import of_lattice
from taichi_bearings.version import VERSION
from taichi_bearings.words import other_contacts

MOST_BYTES = 64e6  # if the snapshots of a page took more, only some of them are shown
BOTTLENECKS = 200  # number of busiest contacts that are shown as such
CUT, PATH = 1, 2  # bits of the array `flags`: the contact is on the cut, on the path
COLOUR_RANGE = (0.12, 0.95)  # part of a colour map that can be seen on white
SLICES = 40  # steps of the slider that cuts a packing, along each axis
AROUND = 6  # neighbours that enclose a sphere of a cubic lattice: such spheres cannot be seen
ALONE = ["an island", "touches no slipless contact"]  # names of pieces of the slipless network that no body touches
KEPT = {"slip": "f4", "power": "f4", "force": "f4", "coefficient": "f4", "viscosity": "f4", "normal_force": "f4"}
KEPT |= {"betweenness": "f4", "state": "u1"}
"""Columns of the contacts that a page holds where a run has them, and the type of their numbers."""


def arrays_of(drawn: PointsAndLines) -> dict[str, np.ndarray]:
    """Return the arrays of the interactive page by name: places, radii, colours and columns of spheres and contacts.

    Numbers are float32, which has the six digits that the page shows. The arrays are arranged so that they compress
    well: vectors one axis after the other, ends of contacts as differences. On a lattice the distance of two neighbours
    is 1.

    drawn : spheres and contacts as points and lines, with their columns.
    """
    network = drawn.network
    center, radius, ends = network.center - network.center[0], network.radius, network.contact.T
    if drawn.is_lattice:
        center, radius = center / (2 * radius[0]), np.full(len(radius), 0.5)
    spheres, contacts = ({k: v.values for k, v in of.items()} for of in (drawn.spheres, drawn.contacts))
    found = {name: contacts[name].astype(kind) for name, kind in KEPT.items() if name in contacts}
    found |= {
        "center": center.T.astype(np.float32),
        "radius": radius.astype(np.float32),
        "body": network.body.astype(np.int32),
        "first": np.diff(ends[:, 0], prepend=0).astype(np.int32),
        "second": (ends[:, 1] - ends[:, 0]).astype(np.int32),
        "normal": network.normal.T.astype(np.float32),
        "spin": _shown_spins(drawn, spheres["spin"][None])[0].astype(np.float32),
        "map_spin": _colour_map(SPIN_COLOURS, 0.0, 1.0),
        "map_power": _colour_map(POWER_COLOURS, *COLOUR_RANGE),
        "map_share": _colour_map("plasma_r", *COLOUR_RANGE),
    }
    # what an analysis has found
    if drawn.drawn.is_known:
        label = spheres["domain"]
        found |= {"domain": label.astype(np.int32), "domain_size": np.bincount(label).astype(np.int32)}
        found["flags"] = (CUT * contacts.get("on_cut", 0) + PATH * contacts["on_path"]).astype(np.uint8)
        found["path"] = drawn.drawn.path.astype(np.int32)
    if "above_cut" in spheres:
        found["above"] = spheres["above_cut"].astype(np.uint8)
    if "betweenness" in spheres:
        found["sphere_betweenness"] = spheres["betweenness"].astype(np.float32)
    if (domains := drawn.drawn.domains) is not None:
        turn = colour_of_turn(domains.turn)[spheres["domain"], :3]
        found |= {"kind": spheres["domain_kind"], "turn": np.round(255 * turn).astype(np.uint8)}
    # spins and slips of the snapshots of a dynamics
    if (moments := drawn.moments) is not None:
        chosen = _shown_snapshots(moments)
        snapshots = {"snapshot_spin": _shown_spins(drawn, moments.spin), "snapshot_slip": moments.slip}
        found |= {name: values[chosen].astype(np.float32) for name, values in snapshots.items()}
    return found


def _shown_spins(drawn: PointsAndLines, spins: np.ndarray) -> np.ndarray:
    """Return spins as the page shows them, in the shape of `spins`: for a lattice of spheres without rotations of whole
    layers about the height, which no contact resists; else unchanged.

    drawn : the sample that is shown.
    spins : (snapshots S, spheres N, 3), 1/time.
    """
    if drawn.network.dimension == 2:
        return spins
    shape = drawn.structure.spin.shape
    return drawn.structure.scene.driving.shown(spins.reshape(len(spins), *shape)).reshape(spins.shape)


def _colour_map(name: str, first: float, last: float) -> np.ndarray:
    """Return 256 colours (256, 3), red, green and blue as bytes, evenly taken from a part of a colour map.

    name : name of the colour map of matplotlib.
    first, last : where the part begins and ends in the map, from 0 to 1.
    """
    return np.round(255 * colormaps[name](np.linspace(first, last, 256))[:, :3]).astype(np.uint8)


def _shown_snapshots(moments: Moments) -> np.ndarray:
    """Return the numbers (n,) of the n snapshots that the page shows: all, or as many as fit into MOST_BYTES, evenly
    chosen.

    moments : the snapshots of a dynamics: times, with the spins and slips at each.
    """
    bytes_each = 4 * (moments.spin[0].size + moments.slip[0].size)  # float32
    most = max(2, int(MOST_BYTES / bytes_each))
    return np.unique(np.linspace(0, len(moments.time) - 1, min(most, len(moments.time))).round().astype(int))


def facts_of(drawn: PointsAndLines) -> Json:
    """Return the numbers and words that the page shows, by name, in types that JSON has.

    drawn : spheres and contacts as points and lines, with their columns, their structure, and the answer they belong
        to."""
    structure, states, law = drawn.structure, drawn.contacts["state"].values, drawn.structure.scene.law
    # facts of lattices or of packings alone, largest imposed spin, power in its natural unit, and proven bound in words
    specific, fastest, natural, bound = (_of_lattice if drawn.is_lattice else _of_packing)(drawn)
    proven = bool(drawn.contacts["proven"].values[states != ContactState.DRIVEN].all())
    decided = "proven" if proven else f"decided by {'slip and friction' if law.has_friction else 'slip'}, not proven"
    answer = f"{drawn.answer.method}: {drawn.answer.status.value}; P = {structure.power:.6g}{natural}, {bound}"
    tied, undecided = (structure.contacts_in(kind) for kind in (ContactState.TIED, ContactState.UNDECIDED))
    keys = ("coefficient", "viscosity")[: len(law.quantities)]
    return {
        **specific,
        **_ends_of_scales(drawn, fastest),
        **_snapshots(drawn.moments),
        "version": VERSION,
        "subtitle": f"{answer}; contact states {decided}",
        "open": ", ".join(other_contacts(tied, undecided)),
        "proven": proven,
        "analysed": drawn.drawn.is_known,
        "decided": decided,
        "friction_limit": law.is_rate_independent and law.quantities[0].is_friction,
        "coefficients": [
            {"key": key, "name": f"{quantity.name} coefficient", "unit": quantity.unit}
            for quantity, key in zip(law.quantities, keys, strict=True)
        ],
        "time": drawn.time,
    }


def _of_lattice(drawn: PointsAndLines) -> tuple[Json, float, str, str]:
    """Return four things that the page says of a lattice: facts by name; the largest imposed spin, 1/time; the power in
    its natural unit, in words; and the proven bound in words.

    drawn : spheres and contacts as points and lines, with the answer they belong to.
    """
    scene, gap = of_lattice(drawn.answer.scene), float(drawn.answer.gap[0])
    lattice, unit = scene.lattice, scene.strength * scene.lattice.radius * abs(scene.imposed[0])
    natural = f" = {drawn.structure.power / unit:.6g} Fₙ R ω_T" if scene.law.is_rate_independent and unit > 0 else ""
    bound = f"{_name_of_minimum(scene.law)}proven within {gap:.1e}" if np.isfinite(gap) else "without a proven bound"
    facts = {
        "title": f"{'×'.join(map(str, lattice.shape))} {scene.law}{scene.periodic_in_words}, {scene.source}",
        "shape": list(lattice.shape),
        "origin": [0] * lattice.dimension,
        "steps": [side - 1 for side in lattice.shape],
        "enclosing": AROUND if lattice.dimension == 3 else 0,
        "joined": "bottom and top",
        "pieces": ["joined to bottom and top", "joined to the bottom", "joined to the top", *ALONE],
        "sides": ["below the cut", "above the cut"],
        "spin_name": "|ω| / ω max",
        "jump_name": "R Δω",
        "jump_speed": lattice.radius * scene.jump,
        "normal_force": scene.normal_force,
    }
    return facts, scene.fastest, natural, bound


def _of_packing(drawn: PointsAndLines) -> tuple[Json, float, str, str]:
    """Return four things that the page says of a packing: facts by name; the largest imposed surface speed over the
    median radius, 1/time; a text that only lattices have, here ""; and the proven bound in words.

    drawn : spheres and contacts as points and lines, with the answer they belong to.
    """
    network, law = drawn.network, drawn.structure.scene.law
    within, proof = f"within {drawn.answer.gap[0]:.1e}", drawn.answer.findings["proof"][0]
    fastest, bodies = drawn.structure.fastest, network.bodies
    named = [f"driven body {number}" for number in bodies] if len(bodies) == 2 else ["one driven body"] * 2
    bound = _name_of_minimum(law) + (f"proven {within}" if proof == "proven" else f"{within}, {proof}")
    what = "discs" if network.dimension == 2 else "spheres"
    facts = {
        "title": f"{network.spheres:,} {what}, {drawn.structure.movable:,} contacts, {law}",
        "shape": None,
        "origin": network.center[0].tolist(),  # float32 resolves distances from the first sphere, not large coordinates
        "steps": [SLICES] * network.dimension,
        "enclosing": 0,
        "joined": "driven bodies",
        "pieces": ["joined to several driven bodies", *(f"joined to {name}" for name in named), *ALONE],
        "sides": [f"on the side of {name}" for name in named],
        "spin_name": "R |ω| / R ω max",
        "jump_name": "R ω max",
        "jump_speed": fastest,
        "normal_force": None,
    }
    return facts, fastest / _median(network.radius), "", bound


def _name_of_minimum(law: Law) -> str:
    """Return words for what the stationary state of a law minimises, "its potential "; empty if that is the power.

    law : the contact law.
    """
    return "" if law.minimises == "power" else f"its {law.minimises} "


def _median(radius: np.ndarray) -> float:
    """Return the median radius; of an even number of radii the upper one of the two in the middle.

    radius : (spheres,), radii, length.
    """
    return float(np.sort(radius)[len(radius) // 2])


def _ends_of_scales(drawn: PointsAndLines, fastest: float) -> Json:
    """Return the ends of the colour scales, by name: `spin_max`, the end of the scale of spins, 1/time; `beyond`, True
    if a drawn spin exceeds it; `busiest_share`, the largest betweenness of a contact (share of the shortest paths from
    bottom to top that run through it); and `bottleneck_share`, the least of the BOTTLENECKS largest betweennesses. The
    last two are 0 where no betweenness is known.

    drawn : the spheres and contacts that are shown.
    fastest : the largest imposed spin, of a sphere of median size, 1/time.
    """
    moments, end = drawn.moments, drawn.spheres["spin"].values[None]
    spins = _shown_spins(drawn, end if moments is None else moments.spin[_shown_snapshots(moments)])
    speed = np.linalg.norm(spins, axis=-1) * (drawn.network.radius / _median(drawn.network.radius))
    shares = drawn.contacts["betweenness"].values if "betweenness" in drawn.contacts else np.zeros(1)
    return {
        "spin_max": fastest or 1.0,
        "beyond": bool((speed > (fastest or 1.0) * (1 + 1e-9)).any()),
        "bottleneck_share": float(np.sort(shares)[-min(BOTTLENECKS, len(shares))]),
        "busiest_share": float(shares.max()),
    }


def _snapshots(moments: Moments | None) -> Json:
    """Return by name the times of the snapshots that the page shows, words on those left out, and the slip speed up to
    which contacts count as slipless in them.

    moments : the snapshots; None if there are none.
    """
    if moments is None:
        return {"times": [], "left_out": "", "snapshot_threshold": 0.0}
    chosen = _shown_snapshots(moments)
    some = "" if len(chosen) == len(moments.time) else f" shown, evenly chosen from {len(moments.time)}"
    return {"times": moments.time[chosen].tolist(), "left_out": some, "snapshot_threshold": moments.threshold}
