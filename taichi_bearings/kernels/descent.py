"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

from collections.abc import Callable
from typing import Any

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp
from taichi_bearings.kernels.memory import (
    in_range,
    last,
    load,
    load_each,
    load_neighbours,
    minus,
    places,
    pushed,
    store,
    zero,
)  # fmt: skip
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Sweeps


@ti.data_oriented
class DescentSweeps(Sweeps):
    """Sweeps of gradient descent on a lattice: each moves all free spins down the gradient of the dissipated power.

    The k-th sweep since the momentum was last set to zero makes, with beta = k / (k + 3), or 0 without momentum,

        spin_new = clip(point + step * inverse_weight * (sum of the contact forces on the sphere at `point`), box)
        point    = spin_new + beta (spin_new - spin)

    Fields, with one number a site and spin component where nothing else is said:

    * `point`, `point_next` : spins at which forces are computed; even sweeps go from the first to the second, odd ones
      back.
    * `spin` : spins before the momentum is added; only with momentum, else `point` is the spin.
    * `inverse_weight` : 1 / (sum over the sphere's contacts of a bound on their curvature); 0 for driven spheres, which
      therefore stay.
    * `coefficient`, and `viscosity` for a law with two coefficients : of the contact above the site along each axis.
    * `spin_sum`, `force_sum` : sums of the points, and of the contact forces there, over sweeps; only for averages.

    Its constants, `numbers`: step; sharpness (1 over the spin difference up to which friction grows); three lower and
    three upper ends of the box, the interval in which spins stay; and 1 to add to the sums in this launch or 0 not to.
    Sweeps come in pairs, numbered by k.
    """

    repeats, numbers = 2, 9

    def __init__(self, spec: FieldSpec, stencil: Stencil, force_law: Callable[..., Any]):
        """Set the constants for which the kernel is compiled: in which rows of memory (a row is one number of every
        site) each field stands, by axis or by spin component; and which fields there are: with `spin` sweeps have a
        momentum, with `spin_sum` averages are taken.

        spec : names and numbers of components of the fields, in the order of their rows.
        stencil : spin components, dimension and periodic axes of the lattice.
        force_law : a force law, such as one of those in `contact.FORCES`."""
        super().__init__(stencil.block, stencil.periodic)
        # slot: first row of each field by name; components: numbers of the spin components; coefficients: for each axis
        # the row of the friction coefficient, and of the viscosity if there is one
        self.slot = slot = first_slots(spec)
        self.stencil, self.force_law = stencil, force_law
        self.momentum, self.averages = "spin" in slot, "spin_sum" in slot
        self.components = tuple(range(stencil.components))
        first = [slot[name] for name in ("coefficient", "viscosity") if name in slot]
        self.coefficients = tuple(tuple(row + axis for row in first) for axis in range(stencil.dimension))

        def of_sites(name: str) -> tuple[int, ...]:
            """Return the numbers of the rows of a field of sites, one row for each spin component; a row is one number
            of every site.

            name : name of the field."""
            return tuple(slot[name] + c for c in self.components)

        # sweeps of even parity go from `point` to `point_next`, which begins `apart` rows further, the others back
        self.point, self.apart = of_sites("point"), slot["point_next"] - slot["point"]
        # for each axis, the rows of `point` for the spin components that make its contacts slip
        self.point_rows = stencil.spin_rows(slot["point"])
        self.weight, self.spin = of_sites("inverse_weight"), of_sites("spin") if self.momentum else ()
        if self.averages:
            self.spin_sum = of_sites("spin_sum")
            self.force_sum = stencil.force_rows(slot["force_sum"])

    @ti.func
    def initial_carry(self, values: ti.template(), size: ti.template(), low, numbers: ti.template(), sweep):
        """Return the force of the contact below a worker's first site, along the height: a list with an entry for each
        spin component that makes it slip. (A worker is a thread, which goes through its blocks of sites in the order of
        memory; each block takes this force from the block before, so only the first one needs it.)

        values : all fields, flat.
        size : integers, of which the first two are the length of a row (one number of every site) and the numbers in it
            before the first site.
        low : number of the worker's first block.
        numbers : constants of the sweep; at place 1 is 1 over the spin difference up to which friction grows.
        sweep : number of the sweep, whose parity says which of the two fields of points is read."""
        height = ti.static(self.stencil.height)
        row, first = size[0], in_range(size[1] + low * self.block)
        source = first + (sweep & 1) * self.apart * row
        lower = load_each(values, places(self.point_rows[height], row, source - 1), 1)
        upper = load_each(values, places(self.point_rows[height], row, source), 1)
        own = load_each(values, places(self.coefficients[height], row, first - 1), 1)
        return self.force_law(minus(upper, lower), own, numbers[1])

    @ti.func
    def add(self, total: ti.template(), axis: ti.template(), above: ti.template(), below: ti.template()):
        """Add the forces of the contacts along one axis to the force on each sphere, in place. An entry of a list is a
        vector over the sites of a block, or one number if a block is one site.

        total : force on the spheres of a block, a list with an entry for each spin component.
        axis : number of the axis.
        above : force of the contact with the upper neighbour, which pulls the sphere up: a list with an entry for each
            component that makes these contacts slip.
        below : force of the contact with the lower neighbour, which pulls the sphere down, as such a list.
        """
        for t in ti.static(range(len(self.stencil.slip_components[axis]))):
            total[self.stencil.slip_components[axis][t]] += above[t] - below[t]

    @ti.func
    def add_along_the_height(self, total: ti.template(), above: ti.template(), carried: ti.template()):
        """Add the forces of the contacts along the height to the force on each sphere, in place. An entry of a list is
        a vector over the sites of a block, or one number if a block is one site.

        The sites of a block stand above each other, so the force below a site is the force above the site before.

        total : force on the spheres of a block, a list with an entry for each spin component.
        above : force of the contact above each site of the block, a list with an entry for each component.
        carried : force of the contact below the block, a list with a number for each component; replaced by that above
            the last site, for the next block.
        """
        below = [pushed(above[t], carried[t], self.block) for t in ti.static(range(len(above)))]
        self.add(total, self.stencil.height, above, below)
        for t in ti.static(range(len(above))):
            carried[t] = last(above[t], self.block)

    @ti.func
    def at_sites(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Make one sweep of gradient descent for a block of sites: compute the contact forces on its spheres at the
        spins in the field `point`, move their spins down the gradient, and write the new ones into `point_next`. Odd
        sweeps go the other way, from `point_next` to `point`.

        part : not used, as a sweep has one part.
        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        numbers : step; sharpness, 1 over the spin difference up to which friction grows; three lower and three upper
            ends of the interval in which spins stay; 1 to add spins and forces to their sums, else 0.
        sweep : number of the sweep since the momentum was last set to zero.
        carried : force of the contact below the block, along the height: a list with a number for each component that
            makes it slip; replaced by the force below the next block."""
        step, sharpness, low, high, averaging = numbers[0], numbers[1], numbers[2:5], numbers[5:8], numbers[8] > 0.0
        parity, beta = sweep & 1, momentum(sweep)
        source, target = first + parity * self.apart * row, first + (1 - parity) * self.apart * row
        point = load_each(values, places(self.point, row, source), self.block)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if averaging:
                self.sum_up(values, blocks, places(self.spin_sum, row, first), point)
        # the force on each sphere: that of its upper contact less that of its lower one, along each axis
        pulled = [zero(self.block) for _ in self.components]
        for axis in ti.static(self.stencil.slipping_axes):
            here, side = [point[c] for c in ti.static(self.stencil.slip_components[axis])], strides[axis::3]
            up = load_neighbours(values, self.point_rows[axis], row, source, side, 1, self.block)
            own = load_each(values, places(self.coefficients[axis], row, first), self.block)
            above = self.force_law(minus(up, here), own, sharpness)
            if ti.static(self.averages):  # noqa: SIM102
                if averaging:
                    self.sum_up(values, blocks, places(self.force_sum[axis], row, first), above)
            if ti.static(axis == self.stencil.height):
                self.add_along_the_height(pulled, above, carried)
            else:
                down = load_neighbours(values, self.point_rows[axis], row, source, side, -1, self.block)
                lower = load_neighbours(values, self.coefficients[axis], row, first, side, -1, self.block)
                self.add(pulled, axis, above, self.force_law(minus(here, down), lower, sharpness))
        # the step down the gradient, within the box, and on by the momentum
        weight, to = places(self.weight, row, first), places(self.point, row, target)
        for c in ti.static(self.components):
            new = clamp(point[c] + step * load(values, weight[c], self.block) * pulled[c], low[c], high[c])
            if ti.static(self.momentum):
                spin = in_range(self.spin[c] * row + first)
                store(values, blocks, to[c], self.block, new + beta * (new - load(values, spin, self.block)))
                store(values, blocks, spin, self.block, new)
            else:
                store(values, blocks, to[c], self.block, new)


@ti.func
def momentum(age):
    """Return beta = k / (k + 3), the factor of Nesterov's momentum.

    age : k, number of the sweep since the momentum was last set to zero.
    """
    return ti.cast(age, float) / ti.cast(age + 3, float)
