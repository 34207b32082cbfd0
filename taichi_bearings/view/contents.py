"""What the page of a run holds: numbers for people, and arrays as small as a picture needs them."""

from typing import Any

import numpy as np
from matplotlib import colormaps

from taichi_bearings.plots.domains import colour_of_turn
from taichi_bearings.plots.lattice import SPIN_COLOURS
from taichi_bearings.proof.contact_state import ContactState, count, critical
from taichi_bearings.runs.points_and_lines import Moments, PointsAndLines
from taichi_bearings.version import VERSION
from taichi_bearings.words import undecided_kinds

MOST_BYTES = 64e6  # of snapshots in a page: beyond, only some are shown
BOTTLENECKS = 200  # busiest contacts that are shown as such
CUT, PATH = 1, 2  # bits of `flags`
COLOUR_RANGE = (0.12, 0.95)  # of a map of colours that is seen on white


def arrays_of(drawn: PointsAndLines) -> dict[str, np.ndarray]:
    """What is drawn, by name: float32 has the six digits that the page shows."""
    spheres, contacts = ({k: v.values for k, v in c.items()} for c in (drawn.spheres, drawn.contacts))
    turn = colour_of_turn(drawn.domains.turn)[spheres["domain"], :3]
    names = ("slip", "power", "force", "betweenness", *drawn.scene.named_coefficients)
    found = {name: contacts[name].astype(np.float32) for name in names}
    found |= {
        "spin": spheres["spin"].astype(np.float32),
        "domain": spheres["domain"].astype(np.int32),
        "domain_size": drawn.domains.spheres.astype(np.int32),
        "path": drawn.path.astype(np.int32),
        "sphere_betweenness": spheres["betweenness"].astype(np.float32),
        "state": contacts["state"].astype(np.uint8),
        "flags": (CUT * contacts["on_cut"] + PATH * contacts["on_path"]).astype(np.uint8),
        "kind": spheres["domain_kind"],
        "above": spheres["above_cut"].astype(np.uint8),
        "turn": np.round(255 * turn).astype(np.uint8),
        "map_spin": _colours(SPIN_COLOURS, 0.0, 1.0),
        "map_power": _colours("plasma_r", *COLOUR_RANGE),
        "map_share": _colours("viridis_r", *COLOUR_RANGE),
    }
    if drawn.moments is not None:
        chosen = _shown(drawn.moments)
        found["snapshot_spin"] = drawn.moments.spin[chosen].astype(np.float32)
        found["snapshot_slip"] = drawn.moments.slip[chosen].astype(np.float32)
    return found


def _colours(name: str, first: float, last: float) -> np.ndarray:
    return np.round(255 * colormaps[name](np.linspace(first, last, 256))[:, :3]).astype(np.uint8)


def _shown(moments: Moments) -> np.ndarray:
    """The snapshots that are shown: all, or as many at even distances as a page can hold."""
    each = 4 * (moments.spin[0].size + moments.slip[0].size)
    most = max(2, int(MOST_BYTES / each))
    return np.unique(np.linspace(0, len(moments.time) - 1, min(most, len(moments.time))).round().astype(int))


def facts_of(drawn: PointsAndLines) -> dict[str, Any]:
    """Numbers and words of the page, as JSON has them."""
    solution, scene, moments = drawn.solution, drawn.scene, drawn.moments
    shares = drawn.contacts["betweenness"].values
    largest = scene.fastest or 1.0
    chosen = np.array([], dtype=int) if moments is None else _shown(moments)
    spins = drawn.spheres["spin"].values if moments is None else moments.spin[chosen]
    return {
        "title": title_of(drawn),
        "subtitle": _subtitle(drawn),
        "version": VERSION,
        "shape": list(scene.lattice.shape),
        "periodic": list(scene.lattice.periodic),
        "proven": bool(solution.states_proven[0]),
        "open": ", ".join(
            undecided_kinds(
                int(count(solution.state, ContactState.UNDECIDED)[0]),
                int(critical(solution)[0]),
                int(solution.findings.get("tied_contacts", [0])[0]),
            )
        ),
        "spin_max": largest,
        "beyond": bool((np.linalg.norm(spins, axis=-1) > largest * (1 + 1e-9)).any()),
        "jump_speed": scene.lattice.radius * scene.jump,
        "decided": _decided(drawn),
        "normal_force": scene.normal_force,
        "friction_limit": scene.law.is_rate_independent and scene.law.quantities[0].is_friction,
        "coefficients": [
            {"key": key, "name": f"{quantity.name} coefficient", "unit": quantity.unit}
            for quantity, key in zip(scene.law.quantities, scene.named_coefficients, strict=True)
        ],
        "bottleneck_share": float(np.sort(shares)[-min(BOTTLENECKS, len(shares))]),
        "busiest_share": float(shares.max()),
        "time": drawn.time,
        "times": [] if moments is None else moments.time[chosen].tolist(),
        "left_out": ""
        if moments is None or len(chosen) == len(moments.time)
        else f" shown, evenly chosen from {len(moments.time)}",
        "snapshot_threshold": 0.0 if moments is None else moments.threshold,
    }


def title_of(drawn: PointsAndLines) -> str:
    """Lattice, law and seed."""
    scene = drawn.scene
    source = f"seed {scene.seeds[0]}" if scene.drawn else "coefficients given"
    return f"{'×'.join(map(str, scene.lattice.shape))} {scene.law}{scene.closed}, {source}"


def _subtitle(drawn: PointsAndLines) -> str:
    """Method, power and what is proven of it."""
    solution, scene = drawn.solution, drawn.scene
    unit = scene.strength * scene.lattice.radius * abs(scene.imposed[0])
    natural = f" = {solution.power[0] / unit:.6g} Fₙ R ω_T" if scene.law.is_rate_independent and unit > 0 else ""
    of = "" if scene.law.minimises == "power" else f"its {scene.law.minimises} "
    gap = f"{of}proven within {solution.gap[0]:.1e}" if np.isfinite(solution.gap[0]) else "without a proven bound"
    power = f"P = {solution.power[0]:.6g}{natural}, {gap}"
    return f"{solution.method}: {solution.status.value}; {power}; contact states {_decided(drawn)}"


def _decided(drawn: PointsAndLines) -> str:
    """What the contact states of the run rest on."""
    by = "slip and friction" if drawn.scene.law.holds else "slip"
    return "proven" if drawn.solution.states_proven[0] else f"decided by {by}, not proven"
