"""The state of a lattice in which no contact slips, for samples that have one."""

from dataclasses import replace

import numpy as np

from taichi_bearings.numerics.graphs import pieces
from taichi_bearings.scene import Progress, Scene


def without_slip(scene: Scene, final: Progress) -> Progress:
    """Return the end of a minimisation, with the slipless state put in for every sample whose least objective is 0.
    Other samples are not changed.

    The least objective is 0 in a sample whose driven planes have the same spins, or are not joined by contacts. In the
    slipless state no contact bears a force. Spheres that contacts join to the top plane have the spin of the top, all
    others that of the bottom.

    scene : the lattice.
    final : the progress that the method has reached at its end.
    """
    idle = np.flatnonzero(scene.is_cut_off | (scene.jump == 0))
    if not len(idle):
        return final
    staggered, axes = final.staggered.copy(), final.spin_axes
    top = scene.top_spin(axes)[..., None]  # (C, *plane, 1), of component k the same all along its layer x_k
    for replica in idle:
        # a contact couples only the spin components across its normal, so that each component has a graph of its own
        for slot, couples in enumerate(scene.lattice.tangential_mask(axes)):
            with_top = _joined_to_top(scene, couples & (scene.acting_coefficient[replica] > 0))
            staggered[slot, replica] = np.where(with_top, top[slot], 0.0)
    some = np.isin(np.arange(scene.replicas), idle)
    rest, slip = final.rest, final.slip
    if rest is not None:
        rest = np.where(some.reshape(1, -1, *(1,) * scene.lattice.dimension), 0.0, rest)
    if slip is not None:
        slip = np.where(some[:, None], 0.0, slip)
    force = np.where(some[:, None], 0.0, final.force)
    return replace(final, staggered=staggered, rest=rest, force=force, slip=slip)


def _joined_to_top(scene: Scene, contacts: np.ndarray) -> np.ndarray:
    """Return the mask (*N,) of the top plane and of all spheres that contacts join to it, *N the shape of the lattice.

    scene : the lattice, with *N its shape.
    contacts : (E contacts,), mask of the contacts that join.
    """
    sites = scene.lattice.sites
    sphere = np.arange(sites).reshape(scene.lattice.shape)
    sphere[..., -1] = sites - 1
    label = pieces(sites, *sphere.ravel()[scene.lattice.ends][:, contacts])
    return np.asarray(label[sphere] == label[sites - 1])
