"""The contact step of operator splitting: friction limits the force of each contact, then spheres sum their pull."""

import taichi as ti

from taichi_bearings.kernels.contact import clamp, length
from taichi_bearings.kernels.stencil import Stencil, in_range


@ti.data_oriented
class ContactStep:
    """Kernels over NumPy arrays (numbers a site, length of the flat layout), which a CPU works on without copying.

    friction : mu F_n of the contact above each site along each axis, 0 where there is none.
    trial : the force that each contact would need, before friction limits it; V numbers a site, as in Stencil.
    push : the limited force reflected, trial - 2 limited(trial).
    potential : the spins in units of force, penalty * spin; the penalty is part of it, so kernels need not know it.
    pull : what the pushes of its contacts add up to on each sphere.
    """

    def __init__(self, stencil: Stencil):
        self.stencil = stencil

    @ti.func
    def limited(self, force, friction):
        """The force itself, bit by bit, if friction can bear it, else the nearest one that it can."""
        result = force
        if ti.static(force.n == 1):
            result[0] = clamp(force[0], -friction, friction)
        else:
            size = length(force)
            result = force * ti.select(size > friction, friction / size, 1.0)
        return result

    @ti.func
    def limit(
        self,
        friction: ti.template(),
        trial: ti.template(),
        push: ti.template(),
        potential: ti.template(),
        axis: ti.template(),
        first,
        stride,
        weight,
        relaxation,
    ):
        """Contacts of one axis above one block of sites. Results go to local arrays first, so that the loop vectorises.

        With f the limited old force: trial = f + (1 - relaxation) (trial - f) + relaxation weight D(potential).
        """
        count = ti.static(self.stencil.kept_count[axis])
        slot = ti.static(self.stencil.force_slot[axis])
        trials = ti.Matrix.zero(float, count, self.stencil.block)
        pushes = ti.Matrix.zero(float, count, self.stencil.block)
        for m in range(self.stencil.block):
            site = first + m
            old = ti.Vector.zero(float, count)
            new = ti.Vector.zero(float, count)
            for t in ti.static(range(count)):
                old[t] = trial[slot + t, site]
            force = self.limited(old, friction[axis, site])
            for t, component in ti.static(enumerate(self.stencil.kept[axis])):
                difference = potential[component, site + stride] - potential[component, site]
                moved = force[t] + (1 - relaxation) * (old[t] - force[t]) + relaxation * weight * difference
                new[t] = ti.select(friction[axis, site] > 0, moved, 0.0)
            reached = self.limited(new, friction[axis, site])
            for t in ti.static(range(count)):
                trials[t, m] = new[t]
                pushes[t, m] = new[t] - 2 * reached[t]
        for t in ti.static(range(count)):
            for m in ti.static(range(self.stencil.block)):
                trial[slot + t, first + m] = trials[t, m]
                push[slot + t, first + m] = pushes[t, m]

    @ti.func
    def gather(self, push: ti.template(), pull: ti.template(), first, strides):
        """Each sphere of a block sums the pushes of the contacts below it minus those above it."""
        pulls = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        for m in range(self.stencil.block):
            site = first + m
            for axis in ti.static(self.stencil.slipping_axes):
                slot = ti.static(self.stencil.force_slot[axis])
                for t, component in ti.static(enumerate(self.stencil.kept[axis])):
                    pulls[component, m] += push[slot + t, site - strides[axis]] - push[slot + t, site]
        for component in ti.static(range(self.stencil.components)):
            for m in ti.static(range(self.stencil.block)):
                pull[component, first + m] = pulls[component, m]

    @ti.kernel
    def step(
        self,
        friction: ti.types.ndarray(ndim=2),
        trial: ti.types.ndarray(ndim=2),
        push: ti.types.ndarray(ndim=2),
        potential: ti.types.ndarray(ndim=2),
        pull: ti.types.ndarray(ndim=2),
        stride_x: int,
        stride_y: int,
        weight_sideways: float,
        weight_height: float,
        relaxation: float,
        margin: int,
        blocks: int,
    ):
        for b in range(blocks):
            first = in_range(margin + b * self.stencil.block)
            strides = self.strides(stride_x, stride_y)
            for axis in ti.static(self.stencil.slipping_axes):
                weight = weight_height if ti.static(axis == self.stencil.height) else weight_sideways
                self.limit(friction, trial, push, potential, axis, first, strides[axis], weight, relaxation)
        for b in range(blocks):
            first = in_range(margin + b * self.stencil.block)
            self.gather(push, pull, first, self.strides(stride_x, stride_y))

    @ti.func
    def strides(self, stride_x, stride_y):
        """Distance of the upper neighbour along each axis; along the height it is known to the compiler."""
        result = ti.Vector([in_range(stride_x), in_range(stride_y), 1])
        if ti.static(self.stencil.dimension == 2):
            result[1] = 1
        return result
