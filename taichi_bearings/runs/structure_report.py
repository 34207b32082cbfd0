"""The structure of one sample as a report: numbers for people and programs, arrays for the group /analysis."""

from dataclasses import asdict, fields
from typing import Any

import numpy as np

from taichi_bearings.analysis.interface import compare
from taichi_bearings.analysis.network import planes_crossed
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.analysis.thresholds import THRESHOLDS, View
from taichi_bearings.files.analysis_file import Finding
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run_file import AXES

LISTED = 10  # most loaded links in a report


def numbers_of(structure: Structure) -> dict[str, Any]:
    """The structure of one sample as numbers, as in `--json` of `analyse`."""
    scene = structure.scene
    slipless = structure.contacts_in(ContactState.SLIPLESS)
    return {
        "seed": scene.seeds[0],
        "power": structure.power,
        "lower_bound": structure.lower_bound,
        "slipping": structure.contacts_in(ContactState.SLIPPING),
        "slipless": slipless,
        "undecided": structure.contacts_in(ContactState.UNDECIDED),
        "critical": structure.critical,
        "tied_contacts": structure.tied,
        "slipless_fraction": slipless / scene.lattice.contacts,
        **_interface_numbers(structure),
        **_network_numbers(structure),
        "minimum_is_unique": structure.minimum_is_unique,
        **_domain_numbers(structure),
        **_bottleneck_numbers(structure),
        **_force_numbers(structure),
        "by_threshold": [
            {"threshold": threshold} | asdict(seen)
            for threshold, seen in zip(THRESHOLDS, structure.views_by_threshold, strict=True)
        ],
    }


def _interface_numbers(structure: Structure) -> dict[str, Any]:
    cut = structure.interface
    slipping = structure.state == ContactState.SLIPPING
    return {
        "power_minimum_cut": cut.power,
        "power_over_cut": structure.power / cut.power if cut.power > 0 else None,
        "cut_is_unique": cut.unique and cut.power > 0,  # without a jump every cut weighs nothing
        "next_cut_over_cut": cut.next_power / cut.power if np.isfinite(cut.next_power) and cut.power > 0 else None,
        "cut_contacts": cut.size,
        "slipping_contacts_are_the_cut": compare(slipping, cut.contacts).identical,
    }


def _network_numbers(structure: Structure) -> dict[str, Any]:
    network, path = structure.network, structure.network.shortest_path
    return {
        "components": network.components,
        "spans": network.spans,
        "reached_fraction": network.reached_fraction,
        "spanning_fraction": network.spanning_fraction,
        "shortest_path": len(path) - 1 if network.spans else None,
        "planes_crossed": list(planes_crossed(path)),
        "disjoint_paths": network.disjoint_paths.number,
    }


def _domain_numbers(structure: Structure) -> dict[str, Any]:
    domains = structure.domains
    return {
        "domains": domains.number,
        "domains_locked_to": domains.domains_of_kind(),
        "free_spheres_locked_to": domains.spheres_of_kind(~structure.scene.lattice.is_driven),
        "largest_intermediate_domain": structure.view.largest_intermediate,
        "largest_spread_in_a_domain": domains.spread,
    }


def _bottleneck_numbers(structure: Structure) -> dict[str, Any]:
    found, spans = structure.bottlenecks, structure.network.spans
    return {
        "connected_pairs": found.betweenness.pairs,
        "mean_distance": found.betweenness.mean_distance if spans else None,
        "betweenness_is_exact": found.betweenness.is_exact,
        "betweenness_sources": found.betweenness.sources,
        "betweenness_all_sources": found.betweenness.all_sources,
        "busiest_link_share": found.concentration.largest if spans else None,
        "busiest_link_current": found.current_concentration.largest if spans else None,
        "backbone_links": int(found.backbone.links.sum()),
        "bridges": int(found.backbone.bridges.sum()),
        "articulation_spheres": int(found.backbone.articulation.sum()),
        "parting_links": int(found.backbone.parting_links.sum()),
        "resistance": found.current.resistance if spans else None,
        "path_concentration": asdict(found.concentration),
        "current_concentration": asdict(found.current_concentration),
        "most_loaded": [asdict(link) for link in found.most_loaded(LISTED)],
    }


def _force_numbers(structure: Structure) -> dict[str, Any]:
    numbers: dict[str, Any] = {"self_stress_states": structure.self_stress.total}
    flow, load = structure.torque_flow, structure.friction_load
    if flow is not None:
        numbers |= {
            "driving_torque": flow.total.tolist(),
            "torque_deviation": flow.deviation,
            "slipless_share_of_torque": flow.slipless_share,
        }
    if load is not None:
        numbers |= {
            "mean_saturation": load.mean if len(load.saturation) else None,
            "smallest_margin": load.margin,
            "slipless_within_1_percent": load.within(0.01),
        }
    return numbers


def findings_of(structure: Structure) -> dict[str, Finding]:
    """The structure of one sample as arrays, by their names in the group /analysis."""
    return {
        **_interface_findings(structure),
        **_network_findings(structure),
        **_domain_findings(structure),
        **_bottleneck_findings(structure),
        **_force_findings(structure),
        **_threshold_findings(structure),
    }


def _interface_findings(structure: Structure) -> dict[str, Finding]:
    cut = structure.interface
    return {
        **_by_axis("minimum_cut", structure, cut.contacts, "contacts of the lightest interface of two rigid domains"),
        "minimum_cut/above": Finding(cut.above, "1", "spheres on the top side of the minimum cut"),
    }


def _network_findings(structure: Structure) -> dict[str, Finding]:
    network, disjoint = structure.network, structure.network.disjoint_paths
    text = "piece of the slipless network of each sphere; 0 holds the bottom plane"
    found = {
        "component": Finding(network.component.astype(np.int32), "1", text),
        "path": Finding(network.shortest_path, "1", "spheres along one shortest slipless path from bottom to top"),
    }
    for name, plane, edges in (("lowest", "bottom", disjoint.lowest), ("highest", "top", disjoint.highest)):
        chosen = np.zeros(len(network.axis), dtype=bool)
        chosen[edges] = True
        text = f"fewest contacts whose removal parts the planes; of such sets the one nearest the {plane}"
        found |= _by_axis(f"parting_{name}", structure, network.on_contacts(chosen), text)
    return found


def _domain_findings(structure: Structure) -> dict[str, Finding]:
    domains = structure.domains
    names = ", ".join(AXES[component] for component in domains.spin_axes)
    lock = "what ties each component: 0 neither plane, 1 the bottom, 2 the top, 3 both"
    return {
        "domain": Finding(domains.domain.astype(np.int32), "1", "rigid domain of each sphere, the largest is 0"),
        "domains/spheres": Finding(domains.spheres, "1", "spheres of each rigid domain, driven ones included"),
        "domains/staggered_spin": Finding(
            domains.staggered, "1/time", f"spin of each rigid domain, components {names}"
        ),
        "domains/lock": Finding(domains.lock.astype(np.int8), "1", f"{lock}; components {names}"),
        **{
            f"component_domain/{AXES[k]}": Finding(label.astype(np.int32), "1", f"domain of spin component {AXES[k]}")
            for k, label in zip(domains.spin_axes, domains.component_domain, strict=True)
        },
    }


def _bottleneck_findings(structure: Structure) -> dict[str, Finding]:
    network, found = structure.network, structure.bottlenecks
    visits = found.betweenness.sphere.reshape(network.lattice.shape) / max(1, found.betweenness.pairs)
    findings = {"betweenness/sphere": Finding(visits, "1", "share of the shortest paths that visit the sphere")}
    for name, values, text in (
        ("betweenness", found.share, "share of the shortest slipless paths, of all pairs of a bottom and a top sphere"),
        ("current", found.current.link, "share of a current from bottom to top, slipless contacts conducting alike"),
        ("bridge", found.backbone.bridges, "removal breaks the piece that joins the planes"),
        ("backbone", found.backbone.links, "on some path from bottom to top"),
    ):
        findings |= _by_axis(name, structure, network.on_contacts(values), text)
    return findings


def _force_findings(structure: Structure) -> dict[str, Finding]:
    flow, load, forces = structure.torque_flow, structure.friction_load, structure.force_distribution
    found: dict[str, Finding] = {}
    if flow is not None:
        names = ", ".join(AXES[component] for component in flow.spin_axes)
        for key, which in (("through_gap", "all"), ("slipless", "slipless"), ("slipping", "slipping")):
            text = f"torque through each gap between layers, by {which} contacts; components {names}"
            found[f"torque_flow/{key}"] = Finding(getattr(flow, key), "force*length", text)
    for group, histogram, text in (
        ("saturation", load, "contacts in each bin of |f| / (mu F_n)"),
        ("force_distribution", forces, "probability density of the size of the force over its mean"),
    ):
        if histogram is not None:
            found[f"{group}/edges"] = Finding(histogram.edges, "1", "edges of the bins")
            for key in ("slipless", "slipping"):
                found[f"{group}/{key}"] = Finding(getattr(histogram, key), "1", f"{text}, {key} contacts")
    return found


def _threshold_findings(structure: Structure) -> dict[str, Finding]:
    views = structure.views_by_threshold
    found = {"by_threshold/threshold": Finding(np.array(THRESHOLDS), "1", "slip over R times the imposed jump")}
    for item in fields(View):
        values = np.array([getattr(seen, item.name) for seen in views])
        text = f"{item.name} if contacts that slip no more than the threshold are taken for slipless"
        found[f"by_threshold/{item.name}"] = Finding(values, "1", text)
    return found


def _by_axis(name: str, structure: Structure, values: np.ndarray, description: str) -> dict[str, Finding]:
    """Values (E,) of the contacts as files have them."""
    parts = structure.scene.lattice.by_axis(values)
    return {f"{name}/{AXES[axis]}": Finding(part, "1", description) for axis, part in enumerate(parts)}
