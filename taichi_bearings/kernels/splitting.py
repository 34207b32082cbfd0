"""The contact step of operator splitting: friction limits the force of each contact, then spheres sum their pull."""

from functools import lru_cache

import taichi as ti

from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp, length
from taichi_bearings.kernels.memory import BLOCKS, VALUES, difference, in_range, new_block, places, read, write
from taichi_bearings.kernels.stencil import Stencil


@lru_cache
def contact_step(spec: FieldSpec, stencil: Stencil) -> "ContactStep":
    """One for each configuration, so that the next scene finds its kernels compiled."""
    return ContactStep(spec, stencil)


@ti.data_oriented
class ContactStep:
    """A step over the fields of :class:`taichi_bearings.solvers.operator_splitting.OperatorSplitting`, on a CPU.

    friction : mu F_n of the contact above each site along each axis, 0 where there is none.
    trial : the force that each contact would need, before friction limits it; V numbers a site, as in Stencil.
    push : the limited force reflected, trial - 2 limited(trial).
    potential : the spins in units of force, penalty * spin; the penalty is part of it, so kernels need not know it.
    pull : what the pushes of its contacts add up to on each sphere.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil):
        self.slot, self.stencil, self.block = first_slots(spec), stencil, stencil.block
        self.potential = tuple(tuple(self.slot["potential"] + c for c in kept) for kept in stencil.kept)
        self.trial, self.push = (
            tuple(
                tuple(range(self.slot[name] + first, self.slot[name] + first + count))
                for first, count in zip(stencil.force_slot, stencil.kept_count, strict=True)
            )
            for name in ("trial", "push")
        )

    def run(self, fields: Fields, weights: tuple[float, float], relaxation: float) -> None:
        """Make one step. weights : of the springs sideways and along the height."""
        self._launch(fields, fields.layout.blocks, *weights, relaxation)

    def compile(self, fields: Fields) -> None:
        """Compile the kernel, on no sites at all."""
        self._launch(fields, 0, 0.0, 0.0, 0.0)

    def _launch(self, fields: Fields, blocks: int, *numbers: float) -> None:
        layout = fields.layout
        stride_x, stride_y = (*layout.strides, 1)[:2]
        self.step(fields.values, fields.blocks, layout.length, layout.margin, blocks, stride_x, stride_y, *numbers)

    @ti.func
    def limited(self, force: ti.template(), friction):
        """The force itself, bit by bit, if friction can bear it, else the nearest one that it can."""
        size = length(force)
        share = ti.select(size > friction, friction / size, 1.0)
        return [clamp(f, -friction, friction) if ti.static(len(force) == 1) else f * share for f in ti.static(force)]

    @ti.func
    def limit(
        self,
        values: ti.template(),
        blocks: ti.template(),
        axis: ti.template(),
        row,
        first,
        stride,
        weight,
        relaxation,
    ):
        """Contacts of one axis above one block of sites.

        With f the limited old force: trial = f + (1 - relaxation) (trial - f) + relaxation weight D(potential).
        """
        count = ti.static(self.stencil.kept_count[axis])
        here = places(self.potential[axis], row, first)
        above = places(self.potential[axis], row, first + stride)
        trial, push = places(self.trial[axis], row, first), places(self.push[axis], row, first)
        own = in_range((self.slot["friction"] + axis) * row + first)
        trials, pushes = new_block(count, self.block), new_block(count, self.block)
        for m in range(self.block):
            friction, old = values[own + m], read(values, trial, m)
            spin_difference, force = difference(values, here, above, m), self.limited(old, friction)
            moved = [
                force[t] + (1 - relaxation) * (old[t] - force[t]) + relaxation * weight * spin_difference[t]
                for t in ti.static(range(count))
            ]
            new = [ti.select(friction > 0, f, 0.0) for f in ti.static(moved)]
            reached = self.limited(new, friction)
            for t in ti.static(range(count)):
                trials[t][m] = new[t]
                pushes[t][m] = new[t] - 2 * reached[t]
        write(blocks, self.block, trial, trials)
        write(blocks, self.block, push, pushes)

    @ti.func
    def gather(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Each sphere of a block sums the pushes of the contacts below it minus those above it."""
        pulls = new_block(self.stencil.components, self.block)
        for axis in ti.static(self.stencil.slipping_axes):
            push = places(self.push[axis], row, first)
            push_below = places(self.push[axis], row, first - strides[axis])
            for m in range(self.block):
                pushed = difference(values, push, push_below, m)
                for t in ti.static(range(len(pushed))):
                    pulls[self.stencil.kept[axis][t]][m] += pushed[t]
        at = [in_range((self.slot["pull"] + c) * row + first) for c in ti.static(range(self.stencil.components))]
        write(blocks, self.block, at, pulls)

    @ti.kernel
    def step(
        self,
        values: VALUES,
        blocks: BLOCKS,
        row: int,
        margin: int,
        count: int,
        stride_x: int,
        stride_y: int,
        weight_sideways: float,
        weight_height: float,
        relaxation: float,
    ):
        for b in range(count):
            first, strides = in_range(margin + b * self.block), [in_range(stride_x), in_range(stride_y), 1]
            for axis in ti.static(self.stencil.slipping_axes):
                weight = weight_height if ti.static(axis == self.stencil.height) else weight_sideways
                self.limit(values, blocks, axis, row, first, strides[axis], weight, relaxation)
        for b in range(count):
            first, strides = in_range(margin + b * self.block), [in_range(stride_x), in_range(stride_y), 1]
            self.gather(values, blocks, row, first, strides)
