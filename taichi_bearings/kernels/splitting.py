"""The contact step of operator splitting: friction limits the force of contacts; then springs pull on the spheres."""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp, length
from taichi_bearings.kernels.memory import (
    in_range,
    load,
    load_differences,
    load_each,
    load_neighbours,
    places,
    store_each,
    zero,
)
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Sweeps

ABSENT_FRICTION = -1.0  # friction where the lattice has no contact


@ti.data_oriented
class ContactStep(Sweeps):
    """The kernel of an iteration of operator splitting, in two parts: first new forces at all contacts, then their sum
    at each sphere. (The spins that balance these sums are computed between two iterations, elsewhere.)

    The method puts a fictitious spring into each contact. Fields are, with numbers of each contact at its lower site,
    one for each spin component that makes it slip:

    friction : friction limit mu F_n of the contact above each site along each axis (one number each), ABSENT_FRICTION
        where there is none.
    trial : trial force of each contact, which may exceed the friction limit.
    spring : force of each spring: weight * (difference of `potential` across the contact) - (trial - 2 * trial force
        cut off at the friction limit).
    potential : at each site, for each spin component, stiffness of the springs * spin, a force; so kernels need not
        know the stiffness.
    potential_rest : what the rounding of `potential` leaves out, where that is stored: in single precision, as the
        differences of potentials are far smaller than these.
    pull : at each site, for each spin component, the sum of the spring forces on the sphere.

    Its constants, `numbers`: weight (relative stiffness) of the springs sideways, weight along the height, relaxation.
    """

    parts, numbers, looks_up = 2, 3, True

    def __init__(self, spec: FieldSpec, stencil: Stencil, kind: str):
        """Set the constants for which the kernel is compiled: in which rows of memory (a row is one number of every
        site) each field stands, by axis or by spin component.

        spec : names and numbers of components of the fields, in the order of their rows.
        stencil : spin components, dimension and periodic axes of the lattice.
        kind : type of the numbers of the fields, such as "float64", for which the kernel is compiled."""
        super().__init__(stencil.block, stencil.periodic)
        self.together = 1  # solving for the spins comes between two of these steps
        # slot: first row of each field by name. Then the rows that belong together: for each axis those of the spin
        # components that make its contacts slip, and those of its contact forces; `pull` has one for each component.
        self.slot, self.stencil, self.kind = first_slots(spec), stencil, kind
        self.potential, self.has_rest = stencil.spin_rows(self.slot["potential"]), "potential_rest" in self.slot
        self.rest = stencil.spin_rows(self.slot.get("potential_rest", 0))
        self.trial, self.spring = stencil.force_rows(self.slot["trial"]), stencil.force_rows(self.slot["spring"])
        self.pull = tuple(self.slot["pull"] + c for c in range(stencil.components))

    @ti.func
    def limited(self, force: ti.template(), friction):
        """Return tangential forces cut off at the friction limit: where one is larger, it is scaled down to the limit;
        the others stay as they are, bit by bit. The result is a list like `force`.

        force : a list of one or two components, each a vector over the contacts of a block.
        friction : friction limit of each contact of the block, 0 or more.
        """
        if ti.static(len(force) == 1):
            return [clamp(force[0], 0.0 - friction, friction)]
        size = length(force)
        share = ti.select(size > friction, friction / size, 1.0)
        return [f * share for f in ti.static(force)]

    @ti.func
    def limit(self, difference: ti.template(), old: ti.template(), own: ti.template(), weight, relaxation):
        """Return new trial and spring forces of a block of contacts: a list with the components of the first, then of
        the second; all 0 where the lattice has no contact.

        With f the old trial force cut off at the friction limit, the new trial force is f + (1 - relaxation) (old - f)
        + relaxation * weight * difference. The spring force is weight * difference - (new - 2 * new cut off).

        difference : upper less lower sphere of the field `potential`, spins in units of force: a list with an entry for
            each component that makes the contacts slip.
        old : trial forces before, a list of the same length.
        own : friction limit of each contact, negative where the lattice has no contact.
        weight : relative stiffness of these springs.
        relaxation : factor alpha of the over-relaxation; with 0 the trial forces stay as they were."""
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
        """Write new trial and spring forces, which :meth:`limit` computes, of the contacts from a block of sites to
        their upper neighbours.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        numbers : relative stiffness of springs sideways and along the height, and the relaxation alpha."""
        for axis in ti.static(self.stencil.slipping_axes):
            side = strides[axis::3]
            difference = load_differences(values, self.potential[axis], row, first, side, self.block)
            if ti.static(self.has_rest):
                rest = load_differences(values, self.rest[axis], row, first, side, self.block)
                for t in ti.static(range(len(rest))):
                    difference[t] += rest[t]
            trial, spring = places(self.trial[axis], row, first), places(self.spring[axis], row, first)
            own = load(values, in_range((self.slot["friction"] + axis) * row + first), self.block)
            weight = numbers[ti.static(1 if axis == self.stencil.height else 0)]
            old = load_each(values, trial, self.block)
            new = self.limit(difference, old, own, weight, numbers[2])
            store_each(values, blocks, trial + spring, self.block, new)

    @ti.func
    def gather_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Write the sum of the spring forces on each sphere of a block, upper contacts less lower ones, into the field
        `pull`, by spin component.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every sphere.
        first : index in a row of the first sphere of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis."""
        pulls = [zero(self.block) for _ in ti.static(range(self.stencil.components))]
        for axis in ti.static(self.stencil.slipping_axes):
            above = load_each(values, places(self.spring[axis], row, first), self.block)
            below = load_neighbours(values, self.spring[axis], row, first, strides[axis::3], -1, self.block)
            for t in ti.static(range(len(above))):
                pulls[self.stencil.slip_components[axis][t]] += above[t] - below[t]
        store_each(values, blocks, places(self.pull, row, first), self.block, pulls)

    @ti.func
    def at_sites(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Do one part of an iteration for a block of sites: part 0, new forces of the contacts with their upper
        neighbours; part 1, the sum of the spring forces on each of their spheres.

        part : 0 for the contacts, 1 for the spheres.
        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        numbers : relative stiffness of springs sideways and along the height, and the relaxation alpha.
        sweep : not used; `at_sites` takes the same arguments in all methods.
        carried : not used."""
        if ti.static(part == 0):
            self.limit_block(values, blocks, row, first, strides, numbers)
        else:
            self.gather_block(values, blocks, row, first, strides)
