"""The structure of one sample as a report: numbers for people and programs, arrays for /analysis and other programs."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from taichi_bearings.analysis.packing_structure import PackingStructure
from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.quantities import ANALYSED, Quantity, plain
from taichi_bearings.runs.run_file import AXES
from taichi_bearings.scene import Scene, Solution


@dataclass(frozen=True)
class Finding:
    """An array of one sample with its unit and what it is."""

    values: np.ndarray
    units: str
    description: str


# fmt: off
BOTTLENECK_ROWS = (
    Quantity("betweenness", "1", "share of the shortest slipless paths, of all pairs of a bottom and a top sphere",
             lambda s: s.network.on_contacts(s.bottlenecks.share)),
    Quantity("backbone", "1", "on some path from bottom to top",
             lambda s: s.network.on_contacts(s.bottlenecks.backbone)),
)
ON_CONTACTS = (
    Quantity("minimum_cut", "1", "contacts of the lightest interface of two rigid domains",
             lambda s: s.interface.contacts),
    *BOTTLENECK_ROWS,
)
"""Of a Structure, (E,): in files one array an axis."""

SPHERE_BETWEENNESS = Quantity(
    "betweenness/sphere", "1", "share of the shortest paths that visit the sphere", lambda s: s.bottlenecks.visits
)
ARRAYS = (
    Quantity("minimum_cut/above", "1", "spheres on the top side of the minimum cut", lambda s: s.interface.above),
    Quantity("component", "1", "piece of the slipless network of each sphere; 0 holds the bottom plane",
             lambda s: s.network.component.astype(np.int32)),
    Quantity("path", "1", "spheres along one shortest slipless path from bottom to top",
             lambda s: s.network.shortest_path),
    Quantity("domain", "1", "rigid domain of each sphere, the largest is 0",
             lambda s: s.rigid_domains.domain.astype(np.int32)),
    Quantity("domains/spheres", "1", "spheres of each rigid domain, driven ones included",
             lambda s: s.rigid_domains.spheres),
    Quantity("domains/staggered_spin", "1/time", "spin of each rigid domain, components {components}",
             lambda s: s.rigid_domains.staggered),
    Quantity("domains/lock", "1",
             "what ties each component: 0 neither plane, 1 the bottom, 2 the top, 3 both; components {components}",
             lambda s: s.rigid_domains.lock.astype(np.int8)),
    SPHERE_BETWEENNESS,
)
"""Of a Structure."""
# fmt: on
STRUCTURE_COLUMNS = {
    "domain": "rigid domain: spheres that slipless contacts make turn as one",
    "component": "connected piece of the slipless network; a driven body joins its spheres",
    "above_cut": "on the second body's side of the minimum cut",
    "on_cut": "on the minimum cut",
}
"""Of a PackingStructure."""


def structure_of_any(
    solution: Solution, number: int = 0, threshold: float | None = None
) -> Structure | PackingStructure:
    """One sample of a solution, a lattice or a packing; threshold as of :func:`structure_of`."""
    if isinstance(solution.scene, Scene):
        return structure_of(solution, number, threshold)
    return PackingStructure.of(solution.sample(number), threshold)


def numbers_of(structure: Structure | PackingStructure) -> dict[str, Any]:
    """The structure of one sample as numbers, as in `--json` of `analyse`; without those that are not known, and None
    for those that are not finite."""
    if isinstance(structure, PackingStructure):
        return structure.numbers
    found = {row.name: row.of(structure) for row in ANALYSED.values()}
    return {
        "seed": structure.scene.seeds[0],
        "power": structure.power,
        "lower_bound": structure.lower_bound,
        "slipping": structure.contacts_in(ContactState.SLIPPING),
        "slipless": structure.contacts_in(ContactState.SLIPLESS),
        "undecided": structure.contacts_in(ContactState.UNDECIDED),
        "critical": structure.critical,
        "tied_contacts": structure.tied,
        "minimum_is_unique": structure.minimum_is_unique,
        **{name: plain(value) for name, value in found.items() if value is not None},
    }


def findings_of(structure: Structure | PackingStructure) -> dict[str, Finding]:
    """The structure of one sample as arrays, by their names in the group /analysis."""
    if isinstance(structure, PackingStructure):
        spheres, contacts = columns_of_structure(structure)
        return spheres | contacts
    domains, found = structure.rigid_domains, {}
    components = ", ".join(AXES[component] for component in domains.spin_axes)
    for row in ARRAYS:
        found[row.name] = Finding(row.of(structure), row.unit, row.text.format(components=components))
    for k, label in zip(domains.spin_axes, domains.component_domain, strict=True):
        text = f"domain of spin component {AXES[k]}"
        found[f"component_domain/{AXES[k]}"] = Finding(label.astype(np.int32), "1", text)
    for row in ON_CONTACTS:
        for axis, part in enumerate(structure.scene.lattice.by_axis(row.of(structure))):
            found[f"{row.name}/{AXES[axis]}"] = Finding(part, row.unit, row.text)
    return found


def columns_of_structure(structure: PackingStructure) -> tuple[dict[str, Finding], dict[str, Finding]]:
    """The structure of a packing as arrays by name: of spheres (N,) and of contacts (E,)."""
    spheres, contacts = (
        {name: Finding(values, "1", STRUCTURE_COLUMNS[name]) for name, values in columns.items()}
        for columns in structure.columns
    )
    if structure.has_pairs:
        contacts |= {row.name: Finding(row.of(structure), row.unit, row.text) for row in BOTTLENECK_ROWS}
        spheres["sphere_betweenness"] = Finding(structure.bottlenecks.visits, "1", SPHERE_BETWEENNESS.text)
    return spheres, contacts
