"""The contact step of operator splitting: friction limits the force of each contact, then springs pull on the
spheres.
"""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp, length
from taichi_bearings.kernels.memory import in_range, load, load_each, load_neighbours, minus, places, store_each, zero
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Sweeps

ABSENT_FRICTION = -1.0  # friction where the lattice has no contact


@ti.data_oriented
class ContactStep(Sweeps):
    """A step over the fields of :class:`taichi_bearings.solvers.operator_splitting.OperatorSplittingMethod`.

    friction : mu F_n of the contact above each site along each axis, ABSENT_FRICTION where the lattice has none.
    trial : the force that each contact would need, before friction limits it; as many numbers a site as
        `Stencil.force_components`.
    spring : the force of each spring, weight D(potential) - (trial - 2 limited(trial)), D the difference across
        contacts.
    potential : the spins in units of force, penalty * spin; the penalty is part of it, so kernels need not know it.
    pull : sum of the spring forces on each sphere.

    Its constants: weights of the springs sideways and along the height, relaxation.
    """

    parts, numbers = 2, 3

    def __init__(self, spec: FieldSpec, stencil: Stencil):
        """spec : fields, in the order of their rows."""
        super().__init__(stencil.block, stencil.periodic)
        self.together = 1  # solving for the spins comes between two of these steps
        self.slot, self.stencil = first_slots(spec), stencil
        self.potential = stencil.spin_rows(self.slot["potential"])
        self.trial, self.spring = stencil.force_rows(self.slot["trial"]), stencil.force_rows(self.slot["spring"])
        self.pull = tuple(self.slot["pull"] + c for c in range(stencil.components))

    @ti.func
    def limited(self, force: ti.template(), friction):
        """Return the force itself, bit by bit, if friction can bear it, else the nearest one that it can."""
        if ti.static(len(force) == 1):
            return [clamp(force[0], 0.0 - friction, friction)]
        size = length(force)
        share = ti.select(size > friction, friction / size, 1.0)
        return [f * share for f in ti.static(force)]

    @ti.func
    def limit(self, difference: ti.template(), old: ti.template(), own: ti.template(), weight, relaxation):
        """Return trial and spring forces of a block of contacts.

        With f the limited old force: trial = f + (1 - relaxation) (trial - f) + relaxation weight D(potential).

        difference : D(potential). old : trial forces before. own : friction.
        """
        is_inside, friction = own >= 0.0, ti.max(own, 0.0)
        force = self.limited(old, friction)
        moved = [
            force[t] + (1 - relaxation) * (old[t] - force[t]) + relaxation * weight * difference[t]
            for t in ti.static(range(len(old)))
        ]
        reached = self.limited(moved, friction)
        spring = [weight * difference[t] - (moved[t] - 2.0 * reached[t]) for t in ti.static(range(len(old)))]
        return [ti.select(is_inside, number, 0.0) for number in ti.static(moved + spring)]

    @ti.func
    def limit_block(
        self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), numbers: ti.template()
    ):
        """Write new trial forces and springs of the contacts above the block of sites from `first` on."""
        for axis in ti.static(self.stencil.slipping_axes):
            here = load_each(values, places(self.potential[axis], row, first), self.block)
            up = load_neighbours(values, self.potential[axis], row, first, strides[axis::3], 1, self.block)
            trial, spring = places(self.trial[axis], row, first), places(self.spring[axis], row, first)
            own = load(values, in_range((self.slot["friction"] + axis) * row + first), self.block)
            weight = numbers[ti.static(1 if axis == self.stencil.height else 0)]
            old = load_each(values, trial, self.block)
            new = self.limit(minus(up, here), old, own, weight, numbers[2])
            store_each(values, blocks, trial + spring, self.block, new)

    @ti.func
    def gather_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Write the sum of the spring forces on the spheres of the block."""
        pulls = [zero(self.block) for _ in ti.static(range(self.stencil.components))]
        for axis in ti.static(self.stencil.slipping_axes):
            above = load_each(values, places(self.spring[axis], row, first), self.block)
            below = load_neighbours(values, self.spring[axis], row, first, strides[axis::3], -1, self.block)
            for t in ti.static(range(len(above))):
                pulls[self.stencil.kept[axis][t]] += above[t] - below[t]
        store_each(values, blocks, places(self.pull, row, first), self.block, pulls)

    @ti.func
    def walk(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Work on the contacts above a block of sites in the first part, on its spheres in the second."""
        if ti.static(part == 0):
            self.limit_block(values, blocks, row, first, strides, numbers)
        else:
            self.gather_block(values, blocks, row, first, strides)
