"""Steps over spheres and contacts that stand in lists: any network, with the laws and numbers of the lattice kernels.

With u = R omega (radius times spin) and two unit tangents T of a contact its slip is y = T (u_i + u_j), and its
friction f pulls both spheres by -T f: no side, no sign. A pass over the contacts writes T f. A pass over the spheres
sums it over the contacts of each, in the order of a list: no atomics, and the same bits on any number of threads. Both
passes walk in blocks, row by row as on lattices; what they read from elsewhere is near, by the order of the lists
(fields/lists.py).

Letters: d tangents of a contact, C components of a spin.
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
    """A sweep in two parts: part 0 walks over the contacts, part 1 over the spheres.

    Subclasses say what is done with a block: `at_contacts`, and for each spin component `at_spheres`.

    Copies of the network, which are samples, stand one after another, each with constants of its own (`COPY_NUMBERS`).

    Fields that all have, each of contacts: `across`, the tangents (d C), but for discs; `coefficient`; `viscosity`, if
    the law has one; `force`, T f (C). Measures, `size` : lengths of the rows of spheres and of contacts, of all
    copies and then of one, and of the rows of constants; in `tables` the lists of `Lists` follow them.
    """

    parts, measures, numbers = 2, 5, 1

    def __init__(self, spec: ListSpec, law: str, corrector: tuple[float, ...]):
        """spec : fields of spheres and of contacts. corrector : of Gear's method, empty for a descent."""
        super().__init__(block_size())
        self.rows, end = dict[str, tuple[int, ...]](), 0
        for name, count in (*spec[0], *spec[1]):
            self.rows[name], end = tuple(range(end, end + count)), end + count
        self.sphere_rows = sum(count for _, count in spec[0])
        for name, _ in spec[1]:
            self.rows[name] = tuple(row - self.sphere_rows for row in self.rows[name])
        self.components, self.tangents = len(self.rows["force"]), max(1, len(self.rows["across"]) // 3)
        gear = [f"gear_{n}" for n in range(len(corrector))]
        self.force_law, self.corrector, self.order = FORCES[law], corrector, len(corrector)
        self.rows["coefficients"] = self.rows["coefficient"] + self.rows.get("viscosity", ())
        self.holds, self.tally = "elongation" in self.rows, "work" in self.rows
        self.gear, self.written = (
            tuple(zip(*(self.rows[name] for name in names if name in self.rows), strict=True))
            for names in (gear, (*gear, "predicted", "integral"))
        )  # of each component
        self.averages, self.momentum = "force_sum" in self.rows, "spin" in self.rows
        self.contact_rows = end - self.sphere_rows

    @ti.func
    def count(self, part: ti.template(), size: ti.template()):
        """Return the number of blocks of contacts (part 0) or of spheres (part 1)."""
        return size[1 - part] // self.block

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), tables: ti.template(),
        size: ti.template(), number, numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Work on the block of contacts, or of spheres, of this number. Of what all copies of the lists are given,
        `numbers`, it takes nothing: each copy has constants of its own."""
        first = in_range(number * self.block)
        place = self.sphere_rows * size[0] + self.contact_rows * size[1] + first // size[3 - part] * self.block
        own = [values[in_range(place + k * size[4])] for k in ti.static(range(COPY_NUMBERS))]
        if ti.static(part == 0):
            across = load_each(values, self.on("across", size, first), self.block)
            self.at_contacts(values, blocks, tables, first, size, across, own)
        else:
            for c in ti.static(range(self.components)):
                row = self.sphere_rows * size[0] + self.rows["force"][c] * size[1]
                pull = self.pull(values, row, tables, size, first)
                self.at_spheres(values, blocks, c, pull, first, size, own, sweep)

    @ti.func
    def on(self, name: ti.template(), size: ti.template(), first):
        """Return where the numbers of the field `name` stand for the block of contacts that begins at `first`."""
        return places(self.rows[name], size[1], self.sphere_rows * size[0] + first)

    @ti.func
    def slip(
        self, values: ti.template(), name: ti.template(), across: ti.template(), tables: ti.template(),
        size: ti.template(), first,
    ):  # fmt: skip
        """Return T (u_i + u_j) for a block of contacts, where u is the field `name` of the spheres. across : the
        tangents T.
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
        """Return the numbers, in the row that begins at `row`, of the spheres that `tables` lists from `first` on."""
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
        """Write T f for a block of contacts. force : f, by tangent."""
        if ti.static(self.components == 1):
            store_each(values, blocks, rows, self.block, force)
        else:
            pull = [across[c] * force[0] + across[3 + c] * force[1] for c in ti.static(range(3))]
            store_each(values, blocks, rows, self.block, pull)

    @ti.func
    def pull(self, values: ti.template(), row, tables: ti.template(), size: ti.template(), first):
        """Return one component of the sum of the contact forces on each sphere of a block."""
        if ti.static(self.block == 1):
            return self.pull_on(values, row, tables, size, first)
        result = ti.Vector.zero(float, self.block)
        for m in range(self.block):
            result[m] = self.pull_on(values, row, tables, size, first + m)
        return result

    @ti.func
    def pull_on(self, values: ti.template(), row, tables: ti.template(), size: ti.template(), sphere):
        """Return one component of the sum of the contact forces on one sphere."""
        total, start = 0.0, self.measures + 2 * size[1]
        incident = start + size[0] + 1
        for n in range(incident + tables[start + sphere], incident + tables[start + sphere + 1]):
            total -= values[in_range(row + tables[n])]
        return total


@ti.func
def dot(a: ti.template(), b: ti.template()):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.data_oriented
class CundallStrackLists(SpringsAndSpins, ListSweeps):
    """Cundall-Strack steps over lists: fields and constants as in `CundallStrackSteps`, with two differences.

    `is_free` holds 1 / inertia of each sphere, 0 of driven ones; `work` is that of each contact.
    """

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), tables: ti.template(), first, size: ti.template(),
        across: ti.template(), numbers: ti.template(),
    ):  # fmt: skip
        """Add up the work of the last step, then stretch the springs and write the forces, for a block of contacts."""
        force = self.on("force", size, first)
        if ti.static(self.tally):
            speed = self.slip(values, "gear_0", across, tables, size, first)
            before = load_each(values, force, self.block)
            work = self.on("work", size, first)
            total = load(values, work[0], self.block)
            if ti.static(self.components == 1):
                total += before[0] * speed[0]
            else:
                total += dot(across[:3], before) * speed[0] + dot(across[3:], before) * speed[1]
            store(values, blocks, work[0], self.block, total)
        own = load_each(values, self.on("coefficients", size, first), self.block)
        speed = self.slip(values, "predicted", across, tables, size, first)
        if ti.static(self.holds):
            at = self.on("elongation", size, first)
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
        """Step one spin component of a block of spheres. pull : sum of the contact forces on each."""
        is_free = load(values, in_range(self.rows["is_free"][0] * size[0] + first), self.block)
        old = load_each(values, places(self.gear[c], size[0], first), self.block)
        new = self.motion(old, pull, is_free, numbers[7])
        store_each(values, blocks, places(self.written[c], size[0], first), self.block, new)
        if ti.static(self.tally):
            impulse = in_range(self.rows["impulse"][c] * size[0] + first)
            self.sum_up(values, blocks, [impulse], [ti.select(is_free > 0.0, 0.0, pull)])


@ti.data_oriented
class DescentLists(ListSweeps):
    """Descent sweeps over lists: fields and constants as in `DescentSweeps`.

    Spins are kept in no box, which would be wrong where normals are oblique.
    """

    repeats = 2

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), tables: ti.template(), first, size: ti.template(),
        across: ti.template(), numbers: ti.template(),
    ):  # fmt: skip
        """Write the friction forces of a block of contacts; add them to the averages if the last constant asks for
        it.
        """
        own = load_each(values, self.on("coefficients", size, first), self.block)
        force = self.force_law(self.slip(values, "point", across, tables, size, first), own, numbers[1])
        self.store_force(values, blocks, self.on("force", size, first), across, force)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, self.on("force_sum", size, first), force)

    @ti.func
    def at_spheres(
        self, values: ti.template(), blocks: ti.template(), c: ti.template(), pull, first, size: ti.template(),
        numbers: ti.template(), sweep,
    ):  # fmt: skip
        """Move one spin component of a block of spheres down the gradient, and on by its momentum.

        pull : sum of the contact forces on each. sweep : number of the sweep since the last restart.
        """
        at = places([self.rows["point"][c], self.rows["inverse_weight"][c]], size[0], first)
        point, weight = load(values, at[0], self.block), load(values, at[1], self.block)
        if ti.static(self.averages):  # noqa: SIM102
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, places([self.rows["spin_sum"][c]], size[0], first), [point])
        new = point + numbers[0] * weight * pull
        if ti.static(self.momentum):
            spin = in_range(self.rows["spin"][c] * size[0] + first)
            beyond = momentum(sweep + ti.cast(numbers[9], int)) * (new - load(values, spin, self.block))
            store(values, blocks, at[0], self.block, new + beyond)
            store(values, blocks, spin, self.block, new)
        else:
            store(values, blocks, at[0], self.block, new)
