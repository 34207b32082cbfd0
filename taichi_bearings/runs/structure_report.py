"""The structure of one sample as arrays, for the group /analysis of run.h5 and for other programs.

In the tables below the functions take a `Structure`. N is the shape of arrays over the spheres, E the number of
contacts, C that of spin components. Pairs of a bottom and a top sphere define the shortest paths.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from taichi_bearings.analysis.structure import Structure
from taichi_bearings.files.whole_file import Finding
from taichi_bearings.quantities import Quantity, found_in
from taichi_bearings.runs.run_layout import AXES

# fmt: off
ON_SPHERES = (
    Quantity("domain", "1", "number of the rigid domain (spheres that turn as one) of each sphere; 0 is the largest",
             lambda s: s.rigid_domains.domain.astype(np.int32)),
    Quantity("component", "1",
             "number of the piece of the slipless network (spheres joined by contacts without slip) to which each "
             "sphere belongs; 0 is the piece of the bottom plane or the first driven body",
             lambda s: s.network.component.astype(np.int32)),
    Quantity("betweenness", "1", "share of the shortest slipless paths from bottom to top that go through the sphere",
             lambda s: s.bottlenecks and s.bottlenecks.visits),
    Quantity("above_cut", "1",
             "1 for spheres on the side of the minimum cut that turns with the top (or the second driven body)",
             lambda s: s.interface and s.interface.above),
)
ON_CONTACTS = (
    Quantity("on_cut", "1",
             "1 for contacts of the minimum cut, across which one sphere turns with the bottom, one with the top",
             lambda s: s.interface and s.interface.contacts),
    Quantity("betweenness", "1", "share of the shortest slipless paths from bottom to top that use the contact",
             lambda s: s.bottlenecks and s.network.on_contacts(s.bottlenecks.share)),
    Quantity("backbone", "1", "1 for contacts that lie on some slipless path from bottom to top",
             lambda s: s.bottlenecks and s.network.on_contacts(s.bottlenecks.backbone)),
    Quantity("on_path", "1", "1 for contacts of one shortest slipless path from bottom to top",
             lambda s: s.network.on_path),
)
"""Columns of the spheres, of shape N, and of the contacts, (E,); None where a structure has no such column."""
IN_FILES = {"above_cut": "minimum_cut/above", "on_cut": "minimum_cut"}
"""Names that differ in the file of a lattice, by column."""
DOMAINS = (
    Quantity("path", "1", "indices of the spheres along one shortest slipless path from bottom to top, in order",
             lambda s: s.network.shortest_path),
    Quantity("domains/spheres", "1", "number of spheres of each rigid domain, driven ones included",
             lambda s: s.rigid_domains.spheres),
    Quantity("domains/staggered_spin", "1/time",
             "staggered spin of each rigid domain: the spin with a sign that alternates between neighbours; components "
             "{components}",
             lambda s: s.rigid_domains.staggered),
    Quantity("domains/lock", "1",
             "driven planes with which each rigid domain turns, by component: 0 none, 1 the bottom, 2 the top, 3 both; "
             "components {components}",
             lambda s: s.rigid_domains.lock.astype(np.int8)),
)
"""Further arrays in the file of a lattice in D dimensions: a path of L spheres, (L, D), and one row for each rigid
domain, (domains,) or (domains, C)."""
# fmt: on


def columns_of(structure: Structure) -> tuple[dict[str, Finding], dict[str, Finding]]:
    """Return the columns of the spheres, flat in C order, and those of the contacts, (contacts E,), by name.

    structure : what the contacts of a sample form.
    """

    def found(rows: Iterable[Quantity]) -> dict[str, Finding]:
        """Return the columns that the structure has among some rows of the tables, by name, with units."""
        known = found_in(structure, {row.name: row for row in rows})
        return {row.name: Finding(values.ravel(), row.unit, row.text) for row, values in known}

    return found(ON_SPHERES), found(ON_CONTACTS)


def names_in_file(is_lattice: bool) -> tuple[dict[str, str], dict[str, str]]:
    """Return two dictionaries, for columns of spheres and for columns of contacts: by the name of a column its name in
    the group /analysis. On a lattice a column of contacts is a group with a data set for each axis.
    """
    spheres, contacts = ([row.name for row in rows] for rows in (ON_SPHERES, ON_CONTACTS))
    of_spheres = "{}/sphere" if is_lattice else "sphere_{}"  # of columns that contacts have, too
    in_files = IN_FILES if is_lattice else {}
    names = {name: of_spheres.format(name) if name in contacts else in_files.get(name, name) for name in spheres}
    return names, {name: in_files.get(name, name) for name in contacts}


def findings_of(structure: Structure) -> dict[str, Finding]:
    """Return the structure of one sample as arrays, by their names in the group /analysis.

    structure : what the contacts of the sample form. On a lattice arrays over the contacts are split by axis, and
        arrays over the spheres have its shape; in a packing they are (contacts E,) and (spheres N,).
    """
    (spheres, contacts), lattice = columns_of(structure), structure.whole.lattice
    of_spheres, of_contacts = names_in_file(lattice is not None)
    spheres = {of_spheres[name]: column for name, column in spheres.items()}
    if lattice is None:
        path = Finding(structure.network.path, "1", "numbers of the spheres along one shortest slipless path")
        return spheres | contacts | {"path": path}
    domains = structure.rigid_domains
    components = ", ".join(AXES[component] for component in domains.spin_axes)
    found = {name: replace(of, values=of.values.reshape(lattice.shape)) for name, of in spheres.items()}
    for row in DOMAINS:
        found[row.name] = Finding(row.of(structure), row.unit, row.text.format(components=components))
    for k, label in zip(domains.spin_axes, domains.component_domain, strict=True):
        text = f"domain of spin component {AXES[k]}"
        found[f"component_domain/{AXES[k]}"] = Finding(label.astype(np.int32), "1", text)
    for name, column in contacts.items():
        for axis, part in zip(AXES, lattice.by_axis(column.values), strict=False):
            found[f"{of_contacts[name]}/{axis}"] = replace(column, values=part)
    return found
