"""Slow twins of the kernels, from the paper's equations in the laboratory frame: cross products, loops over contacts.

They share nothing with the kernels: no staggered spins, no dropped components, no flat layout.
"""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

R = 0.5


def neighbours(shape, contacts=None):
    """(lower site, upper site, axis) of every contact. contacts : an array of numbers of them for each axis, which has
    one for each sphere along an axis that closes on itself."""
    for axis in range(len(shape)):
        sides = contacts[axis].shape if contacts else tuple(n - (a == axis) for a, n in enumerate(shape))
        for site in np.ndindex(*sides):
            yield site, tuple((i + (a == axis)) % shape[a] for a, i in enumerate(site)), axis


def arm(axis):
    return R * np.eye(3)[axis]


def slip(omega, lower, upper, axis):
    """Paper Eq. (2), with r_ij from the lower to the upper sphere."""
    return np.cross(omega[upper], -arm(axis)) - np.cross(omega[lower], arm(axis))


def is_driven(site, shape):
    return site[-1] in (0, shape[-1] - 1)


def descent_sweep(omega, coefficient, law, step, width, box, parity, viscosity=None, reach=0.0):
    """One sweep of (sub)gradient descent on P in the metric of the contact weights; returns omega after it.

    The gradient is Eqs. (5) and (6): force times (k x r), with |v| bounded from below by R width for Coulomb. Also
    returns the force of every contact. viscosity : beside friction, in its units; `reach` of it counts in the metric.
    """
    shape = omega.shape[:-1]
    torque, weight, forces = np.zeros_like(omega), np.zeros_like(omega), {}
    for lower, upper, axis in neighbours(shape, coefficient):
        if is_driven(lower, shape) and is_driven(upper, shape):
            continue
        mu = coefficient[axis][lower]
        v = slip(omega, lower, upper, axis)
        eta = 0.0 if viscosity is None else viscosity[axis][lower]
        scale = mu if law == "viscous" else mu / max(np.linalg.norm(v) / R, width) + eta
        force = scale * v / R  # on the scale of the kernels: friction coefficient times spin difference
        forces[lower, axis] = force
        for site, r, pull in ((lower, arm(axis), force), (upper, -arm(axis), -force)):
            for k in range(3):
                torque[site][k] += pull @ np.cross(np.eye(3)[k], r) / R
                weight[site][k] += (mu + reach * eta) * (k != axis)
    after = omega.copy()
    for site in np.ndindex(*shape):
        if not is_driven(site, shape):
            moved = omega[site] + step * torque[site] / np.where(weight[site] > 0, weight[site], np.inf)
            after[site] = parity[site] * np.clip(parity[site] * moved, box[0], box[1])
    return after, forces


def cundall_strack_step(gear, elongation, last_error, coefficient, law, constants, corrector, viscosity=None):
    """One step of Gear's method for Eq. (10) with the friction of Eqs. (7)-(9); changes its arguments, returns forces.

    gear : list of scaled derivatives of omega. elongation : {(lower, axis): vector}. last_error : the corrector's
    correction of the scaled first derivative in the step before, which also corrects the elongation it had predicted.
    viscosity : of contacts that have it beside spring, damper and friction.
    """
    stiffness, damping, normal_force, static_ratio, inertia, h, relaxes = constants
    shape, order = gear[0].shape[:-1], len(gear)
    mean = sum(g / (n + 1) for n, g in enumerate(gear)) + corrector[0] ** 2 * last_error
    taylor = [
        sum(np.prod(range(k + 1, n + 1)) / np.prod(range(1, n - k + 1)) * gear[n] for n in range(k, order))
        for k in range(order)
    ]
    torque, forces = np.zeros_like(gear[0]), {}
    for lower, upper, axis in neighbours(shape, coefficient):
        if is_driven(lower, shape) and is_driven(upper, shape):
            continue
        mu, v = coefficient[axis][lower], slip(taylor[0], lower, upper, axis)
        if law == "viscous":
            force = -mu * v
        else:
            delta = elongation[lower, axis] + h * slip(mean, lower, upper, axis)
            force = -stiffness * delta - damping * v
            if np.linalg.norm(force) > static_ratio * mu * normal_force:
                force *= mu * normal_force / np.linalg.norm(force)
                target, rate = -force / stiffness, h * stiffness / damping
                delta = (elongation[lower, axis] + rate * target) / (1 + rate) if relaxes else target
            elongation[lower, axis] = delta
            force = force if viscosity is None else force - viscosity[axis][lower] * v
        forces[lower, axis] = force
        torque[upper] += np.cross(-arm(axis), force)
        torque[lower] += np.cross(arm(axis), -force)
    for site in np.ndindex(*shape):
        if is_driven(site, shape):
            torque[site] = 0
    error = h / inertia * torque - taylor[1]
    for n in range(order):
        gear[n][...] = taylor[n] + corrector[n] * error
    last_error[...] = error
    return forces


def incidence(shape):
    """(contacts x sites) matrix of the staggered differences, with axis and lower site of each row."""
    rows, columns, values, where = [], [], [], []
    for lower, upper, axis in neighbours(shape):
        if is_driven(lower, shape) and is_driven(upper, shape):
            continue
        for site, sign in ((upper, 1.0), (lower, -1.0)):
            rows.append(len(where))
            columns.append(np.ravel_multi_index(site, shape))
            values.append(sign)
        where.append((axis, lower))
    return csr_matrix(coo_matrix((values, (rows, columns)), (len(where), int(np.prod(shape))))), where
