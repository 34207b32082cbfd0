"""Makes steps of a method on any network, whose spheres and contacts are stored as lists.

Let u = R omega be radius times spin, and T the two unit tangents of a contact. The slip is y = T (u_i + u_j), and the
friction f exerts the force -T f on both spheres i and j. One pass goes over the contacts and writes T f; another goes
over the spheres and sums T f over the contacts of each, in the order of a list, so that the number of threads changes
no bit. Both passes go through blocks of neighbours in memory. The order of the lists (fields/lists.py) is such that
what they read from elsewhere is near.

Letters: d unit tangents of a contact (1 of discs, 2 of spheres), C components of a spin (1 or 3).
"""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import block_size
from taichi_bearings.fields.lists import COPY_NUMBERS, ListSpec
from taichi_bearings.kernels.contact import FORCES, viscous_force
from taichi_bearings.kernels.cundall_strack import SpringsAndSpins
from taichi_bearings.kernels.descent import momentum
from taichi_bearings.kernels.memory import in_range, load, load_each, places, store, store_each, zero
from taichi_bearings.kernels.team import Sweeps


@ti.data_oriented
class ListSweeps(Sweeps):
    """A sweep over any network in two parts: part 0 at the contacts, part 1 at the spheres.

    Subclasses say what is done with a block (a group of neighbours in memory): `at_contacts`, and for each spin
    component `at_spheres`. Samples of the same network, called copies, stand one after another, each with COPY_NUMBERS
    constants of its own.

    Fields of contacts that all subclasses have, with so many numbers a contact (C components of a spin, d tangents of a
    contact: 3 and 2 of spheres, 1 and 1 of discs):

    across : d C, the unit tangents T; none for discs.
    coefficient : 1, the friction coefficient of the law, or its viscosity if it has no friction.
    viscosity : 1, only if the law has one besides.
    force : C, the friction force as a vector, T f, from its components f along the tangents.

    Five integers, `size`, tell kernels where numbers stand: lengths of the rows of spheres and of contacts of all
    copies; the same two of one copy; and the length of a row of constants. In `tables` they are followed by the lists:
    the two spheres of each contact, where the contacts of each sphere begin, and these contacts."""

    parts, measures, numbers = 2, 5, 1

    def __init__(self, spec: ListSpec, law: str, corrector: tuple[float, ...]):
        """Set the constants for which the kernel is compiled: in which rows of memory (a row is one number of every
        sphere, or of every contact) each field stands, and which fields there are. With a field `elongation` contacts
        have friction by springs, with `work` an energy balance is kept, with `force_sum` averages are taken, with
        `spin` there is a momentum.

        spec : two tuples of pairs (name of a field, number of its components): fields of spheres, and of contacts.
        law : name of a force law in `contact.FORCES`: "coulomb", "viscous" or "coulomb-viscous".
        corrector : coefficients of Gear's corrector; empty for gradient descent."""
        super().__init__(block_size())
        # rows of each field by name, counted from 0 for the fields of spheres and again for those of contacts
        self.rows, end = dict[str, tuple[int, ...]](), 0
        for name, count in (*spec[0], *spec[1]):
            self.rows[name], end = tuple(range(end, end + count)), end + count
        self.sphere_rows = sum(count for _, count in spec[0])
        for name, _ in spec[1]:
            self.rows[name] = tuple(row - self.sphere_rows for row in self.rows[name])
        # components of a spin, and unit tangents of a contact: 1 for discs, 2 for spheres
        self.components, self.tangents = len(self.rows["force"]), max(1, len(self.rows["across"]) // 3)
        gear = [f"gear_{n}" for n in range(len(corrector))]
        self.force_law, self.corrector, self.order = FORCES[law], corrector, len(corrector)
        self.rows["coefficients"] = self.rows["coefficient"] + self.rows.get("viscosity", ())
        self.holds, self.tally = "elongation" in self.rows, "work" in self.rows
        # for each spin component the rows that Gear's method keeps, and those that a step writes
        self.gear, self.written = (
            tuple(zip(*(self.rows[name] for name in names if name in self.rows), strict=True))
            for names in (gear, (*gear, "predicted", "integral"))
        )
        self.averages, self.momentum = "force_sum" in self.rows, "spin" in self.rows
        self.contact_rows = end - self.sphere_rows

    @ti.func
    def count(self, part: ti.template(), size: ti.template()):
        """Return the number of blocks (groups of neighbours in memory) of contacts for part 0 of a sweep, or of spheres
        for part 1.

        part : 0 or 1.
        size : integers, of which the first two are the lengths of the rows of spheres and of contacts."""
        return size[1 - part] // self.block

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), tables: ti.template(),
        size: ti.template(), number, numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Do one part of a sweep for one block of neighbours in memory, in place in `values`: new forces from the slips
        of contacts (part 0), or new spins from the torques on spheres (part 1).

        values : all fields one after the other, (numbers,). A field has several rows; a row has one number for each
            sphere, or for each contact.
        blocks : the same memory as vectors, one for each block.
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        size : five lengths, in numbers: of a row of spheres and of a row of contacts, of all samples; the same two of
            one sample; and of a row of constants.
        number : index of the block.
        numbers : not used, as each copy of the network has constants of its own among `values`.
        sweep : number of the sweep.
        carried : not used.
        """
        first = in_range(number * self.block)
        place = self.sphere_rows * size[0] + self.contact_rows * size[1] + first // size[3 - part] * self.block
        own = [values[in_range(place + k * size[4])] for k in ti.static(range(COPY_NUMBERS))]
        if ti.static(part == 0):
            across = load_each(values, self.contact_places("across", size, first), self.block)
            self.at_contacts(values, blocks, tables, first, size, across, own)
        else:
            for c in ti.static(range(self.components)):
                row = self.sphere_rows * size[0] + self.rows["force"][c] * size[1]
                pull = self.pull(values, row, tables, size, first)
                self.at_spheres(values, blocks, c, pull, first, size, own, sweep)

    @ti.func
    def contact_places(self, name: ti.template(), size: ti.template(), first):
        """Return a list: for each row of a field of contacts the index, in the flat array of all fields, of its number
        for the first contact of a block. A row is one number of every contact.

        name : name of the field.
        size : integers, of which the first two are the lengths of the rows of spheres and of contacts.
        first : number of the block's first contact."""
        return places(self.rows[name], size[1], self.sphere_rows * size[0] + first)

    @ti.func
    def slip(
        self, values: ti.template(), name: ti.template(), across: ti.template(), tables: ti.template(),
        size: ti.template(), first,
    ):  # fmt: skip
        """Return the slips T (u_i + u_j) of a block of contacts, length/time: a list with an entry for each tangent, a
        vector over the contacts of the block.

        u is radius times spin of the two spheres i and j, T the unit tangents of the contact.

        values : all fields, flat.
        name : name of the field of spheres that holds u.
        across : unit tangents T, a list of the 6 components of both; not used for discs.
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        size : five integers: lengths of the rows of spheres and of contacts (a row has one number of each) of all
            copies of the network, that is of all samples; the same two of one copy; and that of a row of constants.
        first : number of the block's first contact.
        """
        both = [zero(self.block) for _ in self.rows[name]]
        for k in ti.static(range(len(both))):
            row, lower = self.rows[name][k] * size[0], self.measures + first
            both[k] = self.gathered(values, row, tables, lower) + self.gathered(values, row, tables, size[1] + lower)
        if ti.static(self.components == 1):
            return both
        return [dot(across[:3], both), dot(across[3:], both)]

    @ti.func
    def gathered(self, values: ti.template(), row, tables: ti.template(), first):
        """Return as many numbers of spheres as a block has sites, in the order of a list of spheres: a vector, or one
        number if a block is one site.

        values : all fields, flat.
        row : index in `values` at which the row begins that has these numbers for all spheres.
        tables : integers, among them lists of spheres.
        first : index in `tables` of the number of the first sphere; those of the others follow.
        """
        if ti.static(self.block == 1):
            return values[in_range(row + tables[first])]
        result = ti.Vector.zero(float, self.block)
        for m in range(self.block):
            result[m] = values[in_range(row + tables[first + m])]
        return result

    @ti.func
    def store_force(
        self, values: ti.template(), blocks: ti.template(), rows: ti.template(), across: ti.template(),
        force: ti.template(),
    ):  # fmt: skip
        """Write the friction forces of a block of contacts as vectors, T f: the unit tangents T times the components f
        along them.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (neighbours in memory that are worked on together).
        rows : list of the indices in `values` of the components of the force on the block's first contact.
        across : T, a list of the 6 components of both tangents; not used for discs.
        force : f, a list with an entry for each tangent.
        """
        if ti.static(self.components == 1):
            store_each(values, blocks, rows, self.block, force)
        else:
            pull = [across[c] * force[0] + across[3 + c] * force[1] for c in ti.static(range(3))]
            store_each(values, blocks, rows, self.block, pull)

    @ti.func
    def pull(self, values: ti.template(), row, tables: ti.template(), size: ti.template(), first):
        """Return one component of the force on each sphere of a block, minus the sum of T f over its contacts: a
        vector, or one number if a block is one site.

        T f is the friction force of a contact as a vector, from its tangents T and the components f along them.

        values : all fields, flat.
        row : index in `values` at which the row of that component of T f begins.
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        size : five integers: lengths of the rows of spheres and of contacts (a row has one number of each) of all
            copies of the network, that is of all samples; the same two of one copy; and that of a row of constants.
        first : number of the block's first sphere.
        """
        if ti.static(self.block == 1):
            return self.pull_on(values, row, tables, size, first)
        result = ti.Vector.zero(float, self.block)
        for m in range(self.block):
            result[m] = self.pull_on(values, row, tables, size, first + m)
        return result

    @ti.func
    def pull_on(self, values: ti.template(), row, tables: ti.template(), size: ti.template(), sphere):
        """Return one component of the force on a sphere, minus the sum of T f over its contacts.

        T f is the friction force of a contact as a vector, from its tangents T and the components f along them.

        values : all fields, flat.
        row : index in `values` at which the row of that component of T f begins.
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        size : five integers: lengths of the rows of spheres and of contacts (a row has one number of each) of all
            copies of the network, that is of all samples; the same two of one copy; and that of a row of constants.
        sphere : number of the sphere.
        """
        total, start = 0.0, self.measures + 2 * size[1]
        incident = start + size[0] + 1
        for n in range(incident + tables[start + sphere], incident + tables[start + sphere + 1]):
            total -= values[in_range(row + tables[n])]
        return total


@ti.func
def dot(a: ti.template(), b: ti.template()):
    """Return the scalar product of two lists of three numbers, or of three vectors over the sites of a block.

    a, b : the lists.
    """
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.data_oriented
class CundallStrackLists(SpringsAndSpins, ListSweeps):
    """Cundall-Strack steps over lists: springs at the contacts, Gear's method for the spins. The unknowns are u =
    radius * spin, length/time.

    Fields of spheres, with a number for each spin component:

    gear_n : the n-th time derivative of u times (time step)^n / n!.
    predicted : u extrapolated to the end of the next step.
    integral : its mean over that step; only with friction.
    is_free : one number a sphere: 1 / inertia, 0 of driven ones.
    impulse : sum over the steps of the forces on driven spheres; only with an energy balance.

    Fields of contacts:

    elongation : stretch of the spring along each tangent; only with friction.
    force : the tangential force, a vector.
    work : sum over the steps of force times slip; only with an energy balance."""

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), tables: ti.template(), first, size: ti.template(),
        across: ti.template(), numbers: ti.template(),
    ):  # fmt: skip
        """Stretch the springs of a block of contacts, and write their elongations and forces into the fields. Before
        that, add the work of the last step to its sum if an energy balance is kept.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (neighbours in memory that are worked on together).
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        first : number of the block's first contact.
        size : five integers: lengths of the rows of spheres and of contacts (a row has one number of each) of all
            copies of the network, that is of all samples; the same two of one copy; and that of a row of constants.
        across : unit tangents T, a list of the 6 components of both; empty for discs.
        numbers : constants: radius * time step, stiffness of the spring, damping * radius, kinetic and static friction
            of a contact whose coefficient is 1, compliance and memory of a spring that slips; others are not used."""
        # the work of the last step: its force times the slip speed at its end
        force = self.contact_places("force", size, first)
        if ti.static(self.tally):
            speed = self.slip(values, "gear_0", across, tables, size, first)
            before = load_each(values, force, self.block)
            work = self.contact_places("work", size, first)
            total = load(values, work[0], self.block)
            if ti.static(self.components == 1):
                total += before[0] * speed[0]
            else:
                total += dot(across[:3], before) * speed[0] + dot(across[3:], before) * speed[1]
            store(values, blocks, work[0], self.block, total)
        # the force at the predicted end of this step: by the springs with friction, else by viscosity alone
        own = load_each(values, self.contact_places("coefficients", size, first), self.block)
        speed = self.slip(values, "predicted", across, tables, size, first)
        if ti.static(self.holds):
            at = self.contact_places("elongation", size, first)
            moved = self.slip(values, "integral", across, tables, size, first)
            new = self.spring(moved, speed, load_each(values, at, self.block), own, numbers)
            store_each(values, blocks, at, self.block, new[: self.tangents])
            self.store_force(values, blocks, force, across, new[self.tangents :])
        else:
            self.store_force(values, blocks, force, across, viscous_force(speed, own, 0.0))

    @ti.func
    def at_spheres(
        self, values: ti.template(), blocks: ti.template(), c: ti.template(), pull, first, size: ti.template(),
        numbers: ti.template(), sweep,
    ):  # fmt: skip
        """Advance one spin component of a block of spheres by one time step (Gear's predictor-corrector). With an
        energy balance, add the force on driven spheres to the field `impulse`.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (neighbours in memory that are worked on together).
        c : number of the spin component.
        pull : this component of the force of its contacts on each sphere, a vector over the block.
        first : number of the block's first sphere.
        size : integers, of which the first two are the lengths of the rows of spheres and of contacts.
        numbers : constants of the step, of which the one at place 7 is the response, time step * radius / inertia.
        sweep : not used.
        """
        is_free = load(values, in_range(self.rows["is_free"][0] * size[0] + first), self.block)
        old = load_each(values, places(self.gear[c], size[0], first), self.block)
        new = self.motion(old, pull, is_free, numbers[7])
        store_each(values, blocks, places(self.written[c], size[0], first), self.block, new)
        if ti.static(self.tally):
            impulse = in_range(self.rows["impulse"][c] * size[0] + first)
            self.sum_up(values, blocks, [impulse], [ti.select(is_free > 0.0, 0.0, pull)])


@ti.data_oriented
class DescentLists(ListSweeps):
    """Sweeps of gradient descent over lists: each moves all free spins down the gradient of the dissipated power. The
    unknowns are u = radius * spin, length/time.

    Fields of spheres, with a number for each spin component:

    point : u at which forces are computed.
    inverse_weight : 1 / (sum over the sphere's contacts of a bound on their curvature); 0 for driven spheres, which
        therefore stay.
    spin : u before the momentum is added; only with a momentum.
    spin_sum : sum of `point` over sweeps; only for averages.

    Fields of contacts: `force`, the friction force as a vector, and `force_sum`, the sum of its components along the
    tangents over sweeps; only for averages. Spins are not kept within an interval, as they are on lattices: that would
    be wrong where the normals of contacts are oblique."""

    repeats = 2

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), tables: ti.template(), first, size: ti.template(),
        across: ti.template(), numbers: ti.template(),
    ):  # fmt: skip
        """Write the friction forces of a block of contacts at the spins in the field `point`.

        They are also added to the field `force_sum` if there is one and the constant numbers[8] is above 0.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (neighbours in memory that are worked on together).
        tables : integers that say which spheres each contact joins and which contacts each sphere has.
        first : number of the block's first contact.
        size : five integers: lengths of the rows of spheres and of contacts (a row has one number of each) of all
            copies of the network, that is of all samples; the same two of one copy; and that of a row of constants.
        across : unit tangents T, a list of the 6 components of both; empty for discs.
        numbers : constants of the sweep. Place 1: 1 over the slip speed up to which friction grows. Place 8: above 0 to
            add the forces to their sums.
        """
        own = load_each(values, self.contact_places("coefficients", size, first), self.block)
        force = self.force_law(self.slip(values, "point", across, tables, size, first), own, numbers[1])
        self.store_force(values, blocks, self.contact_places("force", size, first), across, force)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, self.contact_places("force_sum", size, first), force)

    @ti.func
    def at_spheres(
        self, values: ti.template(), blocks: ti.template(), c: ti.template(), pull, first, size: ti.template(),
        numbers: ti.template(), sweep,
    ):  # fmt: skip
        """Move one spin component of a block of spheres down the gradient of the power, and on by its momentum if there
        is one; for averages add it, as it was before, to its sum.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (neighbours in memory that are worked on together).
        c : number of the spin component.
        pull : this component of the force of its contacts on each sphere, a vector over the block.
        first : number of the block's first sphere.
        size : integers, of which the first two are the lengths of the rows of spheres and of contacts.
        numbers : constants of the sweep. Place 0: the step. Place 8: 1 if spins are to be added to their sums. Place 9:
            sweeps that were made, before this launch, since the momentum was last set to zero.
        sweep : number of the sweep within the launch.
        """
        at = places([self.rows["point"][c], self.rows["inverse_weight"][c]], size[0], first)
        point, weight = load(values, at[0], self.block), load(values, at[1], self.block)
        if ti.static(self.averages):  # noqa: SIM102
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, places([self.rows["spin_sum"][c]], size[0], first), [point])
        # down the gradient, and on by the momentum
        new = point + numbers[0] * weight * pull
        if ti.static(self.momentum):
            spin = in_range(self.rows["spin"][c] * size[0] + first)
            beyond = momentum(sweep + ti.cast(numbers[9], int)) * (new - load(values, spin, self.block))
            store(values, blocks, at[0], self.block, new + beyond)
            store(values, blocks, spin, self.block, new)
        else:
            store(values, blocks, at[0], self.block, new)
