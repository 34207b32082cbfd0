"""Slow twins: Clarabel in the laboratory frame, and networks at random; nothing is shared with the solvers."""

import numpy as np
from scipy import sparse

import taichi_bearings as tb
from tests.clarabel_twin import least


def pair(shape, seed, law="coulomb", **driving):
    """A scene, and the same as packing: spheres in C order, contacts axis by axis."""
    scene = tb.Scene.random(shape, seed=seed, law=law, **driving)
    of = dict(zip(("friction", "viscosity"), [scene.coefficients, scene.viscosity], strict=True))
    flat = {name: np.concatenate([np.ravel(part) for part in parts]) for name, parts in of.items() if parts}
    kind = "cubic" if len(shape) == 3 else "square"
    return scene, tb.Packing.lattice(kind, shape, seed=seed, law=law, **driving, **flat)


def cross_matrix(n):
    """Matrix of a -> a x n."""
    return np.array([[0, n[2], -n[1]], [-n[2], 0, n[0]], [n[1], -n[0], 0.0]])


def laboratory_slips(packing):
    """Slips (E, k, ...) = A omega + c of contacts, omega of free spheres: rows as one matrix; k = 3, of discs 1."""
    count = packing.spheres
    k = 3 if packing.dimension == 3 else 1
    number = {int(i): m for m, i in enumerate(np.flatnonzero(packing.driven < 0))}
    rows, constant = [], []
    for e in range(packing.contacts):
        block, fixed = np.zeros((k, k * len(number))), np.zeros(k)
        for i in packing.contact[e]:
            part = packing.radius[i] * (cross_matrix(packing.normal[e]) if k == 3 else np.ones((1, 1)))
            if int(i) in number:
                block[:, k * number[int(i)] : k * number[int(i)] + k] -= part
            else:
                fixed -= part @ np.atleast_1d(packing.spin[i])
        rows.append(sparse.csr_array(block))
        constant.append(fixed)
    shape = (0, k * len(number))
    matrix = sparse.csc_array(sparse.vstack(rows) if rows else sparse.csc_array(shape))
    assert count
    return matrix, np.array(constant).reshape(-1, k)


def clarabel_least(packing):
    """Least potential, slips (E,), and Clarabel's word."""
    matrix, constant = laboratory_slips(packing)
    acts, law = (packing.driven[packing.contact] < 0).any(axis=1), packing.law.name
    of = [values[0, acts] for values in packing.material]
    nothing = np.zeros(acts.sum())
    found = least(
        matrix[np.repeat(acts, constant.shape[1])], constant[acts], nothing if law == "viscous" else of[0],
        nothing if law == "coulomb" else of[-1],
    )  # fmt: skip
    slip = np.zeros(packing.contacts)
    slip[acts] = found.slip
    return found.objective, slip, found.status


def random_packing(rng, dimension, law="coulomb", spheres=None, contrast=None, levels=None):
    """A network with odd loops, dangling and floating parts, several bodies, radii over two decades."""
    count = int(spheres or rng.integers(4, 30))
    center = rng.uniform(0, count ** (1 / dimension), (count, dimension))
    apart = np.linalg.norm(center[:, None] - center[None], axis=2) + 1e9 * np.tri(count)
    most = min(int(rng.uniform(0.8, 3.0) * count), count * (count - 1) // 2)
    near = np.argsort(apart, axis=None)[:most]
    contact = np.stack(np.unravel_index(near, apart.shape), axis=1)
    if rng.random() < 0.4:  # without odd loops
        side = rng.integers(0, 2, count)
        contact = contact[side[contact[:, 0]] != side[contact[:, 1]]]
    flip = rng.random(len(contact)) < 0.5
    contact[flip] = contact[flip, ::-1]
    vector = center[contact[:, 1]] - center[contact[:, 0]]
    normal = vector / np.linalg.norm(vector, axis=1)[:, None]
    driven = np.where(rng.random(count) < rng.uniform(0.1, 0.5), rng.integers(0, 4, count), -1)
    shape = (4, 3) if dimension == 3 else (4,)
    bodies = rng.integers(-2, 3, shape).astype(float) if rng.random() < 0.5 else rng.standard_normal(shape)
    radius = 10 ** rng.uniform(-1, 1, count) if rng.random() < 0.5 else np.ones(count)
    spin = bodies[driven]
    if levels:
        spin = np.round(rng.uniform(-1, 1, spin.shape) * levels)
    contrast = contrast if contrast is not None else (6 if rng.random() < 0.3 else 1)
    values = {"friction": 10 ** rng.uniform(-contrast, 0, len(contact))}
    if rng.random() < 0.2:
        values["friction"] = rng.integers(1, 3, len(contact)) / 2.0
    if law == "coulomb-viscous":
        values["viscosity"] = 10 ** rng.uniform(-contrast, 0, len(contact))
    return tb.Packing(
        center=center, contact=contact, driven=driven, spin=spin, radius=radius, normal=normal, law=law,
        normal_force=1.0, schematic=True, **values,
    )  # fmt: skip
