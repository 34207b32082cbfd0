"""The contact step of operator splitting: friction limits the force of each contact, then spheres sum their pull."""

from functools import lru_cache

from taichi_bearings.compiler import ti
from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp, length
from taichi_bearings.kernels.memory import BLOCKS, VALUES, difference, each_site, in_range, places, read
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
        self.potential = stencil.spin_rows(self.slot["potential"])
        self.trial, self.push = stencil.force_rows(self.slot["trial"]), stencil.force_rows(self.slot["push"])
        self.pull = tuple(self.slot["pull"] + c for c in range(stencil.components))

    def run(self, fields: Fields, weights: tuple[float, float], relaxation: float) -> None:
        """Make one step. weights : of the springs sideways and along the height."""
        self.step(fields.values, fields.blocks, *fields.layout.measures, *weights, relaxation)

    def compile(self, fields: Fields) -> None:
        """Compile the kernel, on no sites at all."""
        self.step(fields.values, fields.blocks, *(0,) * 5, *(0.0,) * 3)

    @ti.func
    def limited(self, force: ti.template(), friction):
        """The force itself, bit by bit, if friction can bear it, else the nearest one that it can."""
        size = length(force)
        share = ti.select(size > friction, friction / size, 1.0)
        return [clamp(f, -friction, friction) if ti.static(len(force) == 1) else f * share for f in ti.static(force)]

    @ti.func
    def limit(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """Trial force and push of one contact.

        With f the limited old force: trial = f + (1 - relaxation) (trial - f) + relaxation weight D(potential).
        """
        here, above, trial, own = at
        weight, relaxation = numbers
        friction, old = values[own[0] + m], read(values, trial, m)
        spin_difference, force = difference(values, here, above, m), self.limited(old, friction)
        moved = [
            force[t] + (1 - relaxation) * (old[t] - force[t]) + relaxation * weight * spin_difference[t]
            for t in ti.static(range(len(old)))
        ]
        new = [ti.select(friction > 0, f, 0.0) for f in ti.static(moved)]
        reached = self.limited(new, friction)
        return new + [new[t] - 2 * reached[t] for t in ti.static(range(len(new)))]

    @ti.func
    def gather(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """The pushes of the contacts below a sphere minus those above it."""
        pulls = [0.0 for _ in ti.static(range(self.stencil.components))]
        for axis in ti.static(self.stencil.slipping_axes):
            pushed = difference(values, at[0][axis], at[1][axis], m)
            for t in ti.static(range(len(pushed))):
                pulls[self.stencil.kept[axis][t]] += pushed[t]
        return pulls

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
                here = places(self.potential[axis], row, first)
                above = places(self.potential[axis], row, first + strides[axis])
                trial, push = places(self.trial[axis], row, first), places(self.push[axis], row, first)
                own = places((self.slot["friction"] + axis,), row, first)
                weight = weight_height if ti.static(axis == self.stencil.height) else weight_sideways
                at = [here, above, trial, own]
                each_site(values, blocks, self.block, trial + push, self.limit, at, [weight, relaxation])
        for b in range(count):
            first, strides = in_range(margin + b * self.block), [in_range(stride_x), in_range(stride_y), 1]
            axes = ti.static(range(self.stencil.dimension))
            push = [places(self.push[axis], row, first) for axis in axes]
            push_below = [places(self.push[axis], row, first - strides[axis]) for axis in axes]
            each_site(values, blocks, self.block, places(self.pull, row, first), self.gather, [push, push_below], [0.0])
