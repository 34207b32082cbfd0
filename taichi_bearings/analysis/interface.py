"""The cheapest interface between two rigid domains of one sample, a minimum cut, and how it compares with what slips.

If every sphere turned with the bottom or with the top, all slip would be at the interface of the two domains, and the
lightest one would dissipate least. In 2D with Coulomb friction that is the minimum itself; in 3D, and for the viscous
law, states between the two dissipate less (equations.md, 5).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from taichi_bearings.numerics.minimum_cut import minimum_cut
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import cut_unit, cut_weights, minimum_cut_spin


@dataclass(frozen=True)
class Interface:
    """The minimum cut of one sample.

    above : N, True for the spheres that turn with the top. between : N, True for those that another cut, as light (in
        3D: to 1e-12), may put on the other side.
    contacts : (E,) True for those that slip.
    power : energy/time, if the two domains are rigid. lower_bound : no two rigid domains dissipate less, or have less
        of what the stationary state minimises if that is not the power; proven.
    next_power : the same of the cheapest other interface that leaves either domain in one piece; NaN in 3D, where it is
        known only if grids are apart (see :func:`taichi_bearings.numerics.minimum_cut.next_cut`).
    """

    above: np.ndarray
    between: np.ndarray
    contacts: np.ndarray
    power: float
    lower_bound: float
    next_power: float

    @property
    def unique(self) -> bool:
        """True if every other interface is proven to dissipate more, in 3D by over 1e-12."""
        return not self.between.any()

    @property
    def size(self) -> int:
        """Number of its contacts."""
        return int(self.contacts.sum())

    @cached_property
    def crossings(self) -> np.ndarray:
        """True where a column passes from one domain to the other, shape of the contacts along the height."""
        return np.diff(self.above, axis=-1)

    @property
    def lowest(self) -> np.ndarray:
        """Height at which each column first leaves the bottom's domain, in lattice spacings above the bottom plane."""
        return self.crossings.argmax(axis=-1) + 0.5

    @property
    def highest(self) -> np.ndarray:
        """Height from which on each column belongs to the top; above `lowest` where the surface overhangs."""
        return self.crossings.shape[-1] - self.crossings[..., ::-1].argmax(axis=-1) - 0.5


def find_interface(scene: Scene, replica: int = 0) -> Interface:
    """The cheapest interface of one sample: of the least power, or what else the stationary state minimises."""
    slips = scene.jump > 0  # else no contact of any interface slips
    weight = cut_weights(scene)[[replica]]
    cut, unit = minimum_cut(scene.lattice.by_axis(weight)), cut_unit(scene)
    above = cut.above[0]
    low, high = above.ravel()[scene.lattice.ends]
    contacts = (low != high) & (weight[0] > 0) & slips
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        spin, axes = minimum_cut_spin(scene.sample(replica)), scene.lattice.all_spin_axes
        power = float(scene.sample(replica).power(scene.staggered_spin(spin, axes), axes)[0])
    return Interface(
        above=above,
        between=cut.between[0],
        contacts=contacts,
        power=power,
        lower_bound=unit * float(cut.lower_bound[0]),
        next_power=unit * float(cut.next_weight[0]),
    )


@dataclass(frozen=True)
class Difference:
    """Contacts that slip but are not of the interface, and contacts of the interface that do not slip; numbers."""

    only_slipping: int
    only_interface: int

    @property
    def identical(self) -> bool:
        return self.only_slipping == self.only_interface == 0


def compare(slipping: np.ndarray, interface: np.ndarray) -> Difference:
    """What tells the slipping contacts of a state from those of an interface; masks (E,)."""
    return Difference(int((slipping & ~interface).sum()), int((interface & ~slipping).sum()))


__all__ = ["Difference", "Interface", "compare", "find_interface"]
