"""What figures and exports show of the structure of a sample: read from the group /analysis of its run.h5, or computed.

Letters: N spheres, E contacts, L spheres along a path.
"""

from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.analysis.domains import Lock, RigidDomains
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.errors import FileError
from taichi_bearings.files.whole_file import Finding
from taichi_bearings.hdf5 import open_hdf5
from taichi_bearings.runs.run_layout import AXES
from taichi_bearings.runs.structure_report import ON_CONTACTS, ON_SPHERES, columns_of, names_in_file

GROUP = "analysis"
BY_THRESHOLD = "threshold"
"""Value of the group's attribute `states` if the structure was found with a slip threshold in place of the contact
states of the run."""


@dataclass(frozen=True)
class Drawn:
    """What figures and exports show of the structure of a sample; empty if the sample was not analysed.

    spheres, contacts : columns by name, with units, (spheres N,) over the spheres, and (contacts E,) over the contacts.
    domains : the rigid domains of a lattice, None for packings.
    path : (L,), numbers of the L spheres along one shortest path of slipless contacts, empty if there is none.
    is_known : True if the sample was analysed.
    """

    spheres: dict[str, Finding] = field(default_factory=dict)
    contacts: dict[str, Finding] = field(default_factory=dict)
    domains: RigidDomains | None = None
    path: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    is_known: bool = False

    @classmethod
    def computed(cls, structure: Structure) -> "Drawn":
        """Compute the structure of a sample and return what figures and exports show of it.

        structure : the sample.
        """
        spheres, contacts = columns_of(structure)
        domains = None if structure.whole.lattice is None else structure.rigid_domains
        return cls(spheres, contacts, domains, structure.network.path, True)

    @classmethod
    def stored(cls, path: Path, structure: Structure, replica: int | None) -> "Drawn":
        """Return what `bearings analyse` has stored of the structure of a sample; empty if it has stored nothing, or if
        a slip threshold was used in place of the contact states.

        path : the run.h5.
        structure : structure of the sample; only its spheres, contacts and spins are used, so that nothing is computed.
        replica : number of the sample; None if the file has no axis of samples.

        Raises FileError if the file holds something else there.
        """
        with open_hdf5(path, "a run") as file:
            group = file.get(GROUP)
            if not isinstance(group, h5py.Group) or str(group.attrs.get("states", BY_THRESHOLD)) == BY_THRESHOLD:
                return cls()
            try:
                return _Stored(group, structure, replica).drawn()
            except (KeyError, ValueError, IndexError, TypeError, AttributeError, OverflowError) as error:
                again = "`bearings analyse` writes it anew"
                raise FileError(f"the group {GROUP} of {path} is damaged or was changed: {error}; {again}") from None


@dataclass(frozen=True)
class _Stored:
    """Reader of what a file has stored of the structure of one sample.

    group : the group /analysis of the file.
    structure : spheres, contacts and spins of the sample.
    replica : number of the sample; None if the file has no axis of samples.
    """

    group: h5py.Group
    structure: Structure
    replica: int | None

    def drawn(self) -> Drawn:
        """Return what figures and exports show of the stored structure; raise ValueError or KeyError for damage."""
        spheres, contacts = self._columns()
        domain = spheres["domain"].values
        count = self.structure.whole.spheres
        if not (domain.dtype.kind in "iu" and domain.min() >= 0 and domain.max() < count):
            raise ValueError("the data set domain must hold whole numbers, 0 or more: the rigid domain of each sphere")
        domains = None if self.structure.whole.lattice is None else self._domains(domain)
        return Drawn(spheres, contacts, domains, self._path(), True)

    def get(self, name: str, *shape: int | None) -> np.ndarray:
        """Return a data set of the sample as an array; raise ValueError if it is not made of finite numbers.

        name : name of the data set.
        shape : the shape that it must have, None for any length.
        """
        stored = self.group[name]
        found = np.asarray(stored[()] if self.replica is None else stored[self.replica])
        fits = len(found.shape) == len(shape) and all(w in (None, n) for n, w in zip(found.shape, shape, strict=True))
        if not fits or found.dtype.kind not in "biuf" or (found.dtype.kind == "f" and not np.isfinite(found).all()):
            raise ValueError(
                f"the data set {name} must hold finite numbers of shape {shape}; it has {found.dtype} of shape "
                f"{found.shape}"
            )
        return found

    def _columns(self) -> tuple[dict[str, Finding], dict[str, Finding]]:
        """Return the stored columns of the spheres and of the contacts, by name."""
        network, lattice = self.structure.whole, self.structure.whole.lattice
        of_spheres, of_contacts = names_in_file(lattice is not None)
        shapes: dict[str, tuple[int, ...]] = {"": (network.contacts,)}  # of the data sets of a column of contacts
        if lattice is not None:
            shapes = {f"/{AXES[k]}": lattice.contact_shape(k) for k in range(lattice.dimension)}
        spheres, contacts = dict[str, Finding](), dict[str, Finding]()
        for row in ON_SPHERES:
            if (name := of_spheres[row.name]) in self.group:
                spheres[row.name] = Finding(self.get(name, *network.shape).ravel(), row.unit, row.text)
        for row in ON_CONTACTS:
            if (name := of_contacts[row.name]) in self.group:
                parts = [self.get(name + axis, *shape).ravel() for axis, shape in shapes.items()]
                contacts[row.name] = Finding(np.concatenate(parts), row.unit, row.text)
        return spheres, contacts

    def _domains(self, domain: np.ndarray) -> RigidDomains:
        """Return the stored rigid domains of a lattice.

        domain : (spheres N,), number of the domain of each sphere.
        """
        scene, shape, count = self.structure.scene, self.structure.whole.shape, int(domain.max()) + 1
        axes = scene.minimum_spin_axes
        # staggered spins of all spheres; at each sphere those of the top plane; and their mean in each domain
        spins = scene.staggered_spin(self.structure.spin[None], axes).reshape(len(axes), *shape)
        of_top = np.broadcast_to(spins[..., -1:], spins.shape).reshape(len(axes), -1)
        numbers, first_sphere = np.unique(domain, return_index=True)
        # `lock` says to which driven planes slipless contacts join a domain, `labels` the domains in each component
        lock = self.get("domains/lock", None, len(axes))[:count]
        spheres = np.bincount(domain)
        mean_spin = np.stack([np.bincount(domain, values) / spheres for values in spins.reshape(len(axes), -1)], axis=1)
        if len(numbers) != count or len(lock) != count or lock.min() < 0 or lock.max() > Lock.BOTH:
            raise ValueError("the data set domains/lock must have one row for each domain in domains/labels")
        names = [f"component_domain/{AXES[k]}" for k in axes]
        labels = np.stack([self.get(name, *shape) for name in names])
        return RigidDomains(
            axes, labels, domain.reshape(shape), spheres, mean_spin, 0.0, lock, of_top[:, first_sphere].T
        )

    def _path(self) -> np.ndarray:
        """Return the numbers (n,) of the n spheres along the stored path."""
        structure, count = self.structure, self.structure.whole.spheres
        if "path" not in self.group:
            return np.empty(0, dtype=int)
        if structure.whole.lattice is None:
            path = self.get("path", None)
        else:
            shape = structure.whole.shape
            places = self.get("path", None, len(shape))
            places = places[(places >= 0).all(axis=1)]  # samples with shorter paths are padded
            path = np.ravel_multi_index(tuple(places.T), shape) if len(places) else np.empty(0, dtype=int)
        path = path[path >= 0]
        if len(path) and (path.dtype.kind not in "iu" or path.max() >= count):
            raise ValueError(f"the data set 'path' must hold numbers of spheres, whole numbers below {count:,}")
        return np.asarray(path)
