"""The cheapest interface between two rigid domains of one sample: a minimum cut.

If every sphere turned with the bottom or with the top, all slip would be at the interface of the two domains, and the
lightest one would dissipate least. In 2D with Coulomb friction that is the minimum itself; in 3D, and for the viscous
law, states between the two dissipate less (equations.md, 5).
"""

from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.minimum_cut import minimum_cut
from taichi_bearings.scene import Scene
from taichi_bearings.scene.initial_spins import cut_unit, cut_weights, minimum_cut_spin


@dataclass(frozen=True)
class Interface:
    """The minimum cut of one sample.

    above : N, True for the spheres that turn with the top. contacts : (E,) True for those that slip.
    between : N, True for the spheres that another cut, as light (in 3D: to 1e-12), may put on the other side; if there
        are none every other interface is proven to dissipate more.
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


def find_interface(scene: Scene, replica: int = 0) -> Interface:
    """The cheapest interface of one sample: of the least power, or what else the stationary state minimises."""
    weight = cut_weights(scene)[[replica]]
    cut, unit = minimum_cut(scene.lattice.by_axis(weight)), cut_unit(scene)
    low, high = cut.above[0].ravel()[scene.lattice.ends]
    power = unit * float(cut.weight[0])
    if scene.law.minimises != "power":
        spin, axes = minimum_cut_spin(scene.sample(replica)), scene.lattice.all_spin_axes
        power = float(scene.sample(replica).power(scene.staggered_spin(spin, axes), axes)[0])
    return Interface(
        above=cut.above[0],
        between=cut.between[0],
        contacts=(low != high) & (weight[0] > 0) & (scene.jump > 0),  # without a jump nothing slips
        power=power,
        lower_bound=unit * float(cut.lower_bound[0]),
        next_power=unit * float(cut.next_weight[0]),
    )
