"""What the page of a run holds: numbers for people, and arrays as small as a picture needs them."""

from typing import Any

import numpy as np
from matplotlib import colormaps

from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.plots.bearing import SPIN_COLOURS
from taichi_bearings.plots.structure import colour_of_turn
from taichi_bearings.proof.contact_state import ContactState, count, critical
from taichi_bearings.runs.points_and_lines import Moments, PointsAndLines, moments_of_packing
from taichi_bearings.runs.solved import Run
from taichi_bearings.runs.structure_report import columns_of_packing
from taichi_bearings.scene.law import Law
from taichi_bearings.version import VERSION
from taichi_bearings.words import undecided_kinds

MOST_BYTES = 64e6  # of snapshots in a page: beyond, only some are shown
BOTTLENECKS = 200  # busiest contacts that are shown as such
CUT, PATH = 1, 2  # bits of `flags`
COLOUR_RANGE = (0.12, 0.95)  # of a map of colours that is seen on white
SLICES = 40  # steps of a slider along each axis of a packing
AROUND = 6  # neighbours that enclose a sphere of a cubic lattice
ALONE = ["an island", "touches no slipless contact"]
KEPT = {"slip": "f4", "power": "f4", "force": "f4", "coefficient": "f4", "viscosity": "f4", "normal_force": "f4"}
KEPT |= {"betweenness": "f4", "state": "u1"}
"""Columns of the contacts that a page holds where a run has them."""


def arrays_of(drawn: PointsAndLines | Run) -> dict[str, np.ndarray]:
    """What is drawn, by name: float32 has the six digits that the page shows. What a lattice repeats packs well:
    vectors are written one axis after the other, ends as differences."""
    if isinstance(drawn, Run):
        packing, moments = drawn.result.packing, moments_of_packing(drawn.result)
        center, radius, body = packing.center - packing.center[0], np.asarray(packing.radius), packing.driven
        ends, normal, columns = packing.contact, np.asarray(packing.normal), columns_of_packing(drawn.result)
    else:
        lattice, ends, moments = drawn.scene.lattice, drawn.ends, drawn.moments
        center, radius = np.indices(lattice.shape).reshape(lattice.dimension, -1).T, np.full(lattice.sites, 0.5)
        body = np.where(lattice.is_driven.ravel(), np.where(center[:, -1] == 0, 0, 1), -1)
        normal, columns = np.eye(lattice.dimension)[lattice.axis], (drawn.spheres, drawn.contacts)
    spheres, contacts = ({k: v.values for k, v in of.items()} for of in columns)
    found = {name: contacts[name].astype(kind) for name, kind in KEPT.items() if name in contacts}
    found |= {
        "center": center.T.astype(np.float32),
        "radius": radius.astype(np.float32),
        "body": body.astype(np.int32),
        "first": np.diff(ends[:, 0], prepend=0).astype(np.int32),
        "second": (ends[:, 1] - ends[:, 0]).astype(np.int32),
        "normal": normal.T.astype(np.float32),
        "spin": spheres["spin"].astype(np.float32),
        "domain": spheres["domain"].astype(np.int32),
        "domain_size": np.bincount(spheres["domain"]).astype(np.int32),
        "map_spin": _colours(SPIN_COLOURS, 0.0, 1.0),
        "map_power": _colours("plasma_r", *COLOUR_RANGE),
        "map_share": _colours("viridis_r", *COLOUR_RANGE),
    }
    if "above_cut" in spheres:
        found["above"] = spheres["above_cut"].astype(np.uint8)
        found["flags"] = (CUT * contacts["on_cut"] + PATH * contacts.get("on_path", 0)).astype(np.uint8)
    for name in {"betweenness", "sphere_betweenness"} & spheres.keys():
        found["sphere_betweenness"] = spheres[name].astype(np.float32)
    if isinstance(drawn, PointsAndLines):
        turn = colour_of_turn(drawn.domains.turn)[spheres["domain"], :3]
        found |= {"kind": spheres["domain_kind"], "path": drawn.path.astype(np.int32)}
        found["turn"] = np.round(255 * turn).astype(np.uint8)
    if moments is not None:
        chosen = _shown(moments)
        ways = {"snapshot_spin": moments.spin, "snapshot_slip": moments.slip}
        found |= {name: values[chosen].astype(np.float32) for name, values in ways.items()}
    return found


def _colours(name: str, first: float, last: float) -> np.ndarray:
    return np.round(255 * colormaps[name](np.linspace(first, last, 256))[:, :3]).astype(np.uint8)


def _shown(moments: Moments) -> np.ndarray:
    """The snapshots that are shown: all, or as many at even distances as a page can hold."""
    each = 4 * (moments.spin[0].size + moments.slip[0].size)
    most = max(2, int(MOST_BYTES / each))
    return np.unique(np.linspace(0, len(moments.time) - 1, min(most, len(moments.time))).round().astype(int))


def facts_of(drawn: PointsAndLines | Run) -> dict[str, Any]:
    """Numbers and words of the page, as JSON has them."""
    if isinstance(drawn, Run):
        return _facts_of_packing(drawn)
    solution, scene, moments = drawn.solution, drawn.scene, drawn.moments
    shares, gap = drawn.contacts["betweenness"].values, solution.gap[0]
    spins = drawn.spheres["spin"].values if moments is None else moments.spin[_shown(moments)]
    unit = scene.strength * scene.lattice.radius * abs(scene.imposed[0])
    natural = f" = {solution.power[0] / unit:.6g} Fₙ R ω_T" if scene.law.is_rate_independent and unit > 0 else ""
    bound = f"{_minimised(scene.law)}proven within {gap:.1e}" if np.isfinite(gap) else "without a proven bound"
    told = f"{solution.method}: {solution.status.value}; P = {solution.power[0]:.6g}{natural}, {bound}"
    undecided = int(count(solution.state, ContactState.UNDECIDED)[0])
    tied = int(solution.findings.get("tied_contacts", [0])[0])
    proven, kinds = bool(solution.states_proven[0]), undecided_kinds(undecided, int(critical(solution)[0]), tied)
    return {
        **_facts(scene.law, told, proven, kinds),
        **_shown_numbers(np.linalg.norm(spins, axis=-1), scene.fastest, shares, moments),
        "title": title_of(drawn),
        "shape": list(scene.lattice.shape),
        "origin": [0] * scene.lattice.dimension,
        "steps": [side - 1 for side in scene.lattice.shape],
        "enclosing": AROUND if scene.lattice.dimension == 3 else 0,
        "joined": "bottom and top",
        "pieces": ["joined to bottom and top", "joined to the bottom", "joined to the top", *ALONE],
        "sides": ["below the cut", "above the cut"],
        "spin_name": "|ω| / ω max",
        "jump_name": "R Δω",
        "jump_speed": scene.lattice.radius * scene.jump,
        "normal_force": scene.normal_force,
        "time": drawn.time,
    }


def _facts_of_packing(run: Run) -> dict[str, Any]:
    """The same of a packing."""
    result, packing, law = run.result, run.result.packing, run.result.packing.kind
    radius = np.asarray(packing.radius)
    median = float(np.sort(radius)[len(radius) // 2])
    moments, structure = moments_of_packing(result), PackingStructure.of(result)
    spins = result.spin[None] if moments is None else moments.spin[_shown(moments)]
    speed = np.linalg.norm(spins.reshape(len(spins), packing.spheres, -1), axis=2) * radius
    shares = structure.bottlenecks.share if structure.has_pairs else np.zeros(0)
    shares = shares if shares.any() else np.ones(1)
    fastest = float(np.linalg.norm(packing.imposed, axis=1).max(initial=0.0))
    bodies = np.unique(packing.driven[packing.driven >= 0])
    named = [f"driven body {body}" for body in bodies] if len(bodies) == 2 else ["one driven body"] * 2
    within = f"within {result.gap:.1e}"
    bound = _minimised(law) + ({"proven": f"proven {within}"}.get(result.proof, f"{within}, {result.proof}"))
    told = f"{result.method}: {result.status}; P = {result.power:.6g}, {bound}"
    what = "discs" if packing.dimension == 2 else "spheres"
    undecided = int((result.state == ContactState.UNDECIDED).sum())
    return {
        **_facts(law, told, False, undecided_kinds(undecided, result.critical, 0)),
        **_shown_numbers(speed / median, fastest / median, shares, moments),
        "title": f"{packing.spheres:,} {what}, {run.summary['contacts']:,} contacts, {law}",
        "shape": None,
        "origin": packing.center[0].tolist(),  # float32 has the digits of what lies around the first
        "steps": [SLICES] * packing.dimension,
        "enclosing": 0,
        "joined": "driven bodies",
        "pieces": ["joined to several driven bodies", *(f"joined to {name}" for name in named), *ALONE],
        "sides": [f"on the side of {name}" for name in named],
        "spin_name": "R |ω| / R ω max",
        "jump_name": "R ω max",
        "jump_speed": fastest,
        "normal_force": None,
        "time": result.time,
    }


def _facts(law: Law, told: str, proven: bool, kinds: list[str]) -> dict[str, Any]:
    """What the law and the states lead to. told : of method and power. kinds : of undecided contacts."""
    decided = "proven" if proven else f"decided by {'slip and friction' if law.holds else 'slip'}, not proven"
    keys = ("coefficient", "viscosity")[: len(law.quantities)]
    return {
        "version": VERSION,
        "subtitle": f"{told}; contact states {decided}",
        "proven": proven,
        "decided": decided,
        "open": ", ".join(kinds),
        "friction_limit": law.is_rate_independent and law.quantities[0].is_friction,
        "coefficients": [
            {"key": key, "name": f"{quantity.name} coefficient", "unit": quantity.unit}
            for quantity, key in zip(law.quantities, keys, strict=True)
        ],
    }


def _shown_numbers(speed: np.ndarray, largest: float, shares: np.ndarray, moments: Moments | None) -> dict[str, Any]:
    """Ends of scales, and the snapshots that are shown. speed, largest : of spins, or surface speeds of a sphere of
    median size, and the largest imposed one. shares : of the shortest paths, by contact."""
    found = {
        "spin_max": largest or 1.0,
        "beyond": bool((speed > (largest or 1.0) * (1 + 1e-9)).any()),
        "bottleneck_share": float(np.sort(shares)[-min(BOTTLENECKS, len(shares))]),
        "busiest_share": float(shares.max()),
    }
    if moments is None:
        return found | {"times": [], "left_out": "", "snapshot_threshold": 0.0}
    chosen = _shown(moments)
    some = "" if len(chosen) == len(moments.time) else f" shown, evenly chosen from {len(moments.time)}"
    times = {"times": moments.time[chosen].tolist(), "left_out": some}
    return found | times | {"snapshot_threshold": moments.threshold}


def _minimised(law: Law) -> str:
    return "" if law.minimises == "power" else f"its {law.minimises} "


def title_of(drawn: PointsAndLines) -> str:
    """Lattice, law and seed."""
    scene = drawn.scene
    source = f"seed {scene.seeds[0]}" if scene.drawn else "coefficients given"
    return f"{'×'.join(map(str, scene.lattice.shape))} {scene.law}{scene.closed}, {source}"
