"""Steps over spheres and contacts that stand in lists: any network, with the laws and numbers of the lattice kernels.

With u = R omega and two unit tangents T of a contact its slip is y = T (u_i + u_j), and its friction pulls both spheres
by -T f: no side, no sign. A pass over the contacts writes T f, a pass over the spheres gathers it from the contacts of
each, in the order of a list: no atomics, and the same bits on any number of threads. Both walk in blocks, row by row as
on lattices; what they gather from elsewhere is near, by the order of the lists (fields/lists.py).
"""

from functools import lru_cache

from taichi_bearings.compiler import ti
from taichi_bearings.fields.lists import ListSpec, list_block
from taichi_bearings.kernels.contact import FORCES, viscous_force
from taichi_bearings.kernels.cundall_strack import SpringsAndSpins
from taichi_bearings.kernels.descent import momentum
from taichi_bearings.kernels.memory import BLOCKS, VALUES, in_range, load, load_each, places, store, store_each, zero
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Sweeps, meet

LIST = ti.types.ndarray(dtype=ti.i32, ndim=1)


@lru_cache
def list_sweeps(sweeps: type["ListSweeps"], spec: ListSpec, law: str, corrector: tuple[float, ...]) -> "ListSweeps":
    """One for each configuration, so that the next packing finds its kernels compiled."""
    return sweeps(spec, law, corrector)


@ti.data_oriented
class ListSweeps(Sweeps):
    """Part 0 walks over the contacts, part 1 over the spheres. d tangents, C components of a spin.

    Fields of all: of contacts `across` (d C), but for discs, `coefficient`, `viscosity`, and `force`, T f, (C).
    """

    parts = 2

    def __init__(self, spec: ListSpec, law: str, corrector: tuple[float, ...]):
        super().__init__(list_block())
        self.rows, end = dict[str, tuple[int, ...]](), 0
        for name, count in (*spec[0], *spec[1]):
            self.rows[name], end = tuple(range(end, end + count)), end + count
        self.sphere_rows = sum(count for _, count in spec[0])
        for name, _ in spec[1]:
            self.rows[name] = tuple(row - self.sphere_rows for row in self.rows[name])
        self.components, self.tangents = len(self.rows["force"]), max(1, len(self.rows["across"]) // 3)
        gear = [f"gear_{n}" for n in range(len(corrector))]
        self.force_law, self.corrector, self.order = FORCES[law], corrector, len(corrector)
        self.coefficients = sum((self.rows.get(name, ()) for name in ("coefficient", "viscosity")), ())
        self.holds, self.tally = "elongation" in self.rows, "work" in self.rows
        self.gear, self.written = (
            tuple(zip(*(self.rows[name] for name in names if name in self.rows), strict=True))
            for names in (gear, (*gear, "predicted", "integral"))
        )  # of each component
        self.averages, self.momentum = "force_sum" in self.rows, "spin" in self.rows

    @ti.func
    def slip(
        self, values: ti.template(), rows: ti.template(), across: ti.template(), ends: ti.template(),
        size: ti.template(), first,
    ):  # fmt: skip
        """T (u_i + u_j) of a block of contacts, for the numbers of the spheres in these rows."""
        both = [zero(self.block) for _ in rows]
        for k in ti.static(range(len(rows))):
            both[k] = self.gathered(values, rows[k] * size[0], ends, first) + self.gathered(
                values, rows[k] * size[0], ends, size[1] + first
            )
        if ti.static(self.components == 1):
            return both
        return [dot(across[:3], both), dot(across[3:], both)]

    @ti.func
    def gathered(self, values: ti.template(), row, ends: ti.template(), first):
        """Of the spheres whose numbers stand in the list from `first` on."""
        if ti.static(self.block == 1):
            return values[in_range(row + ends[first])]
        result = ti.Vector.zero(float, self.block)
        for m in range(self.block):
            result[m] = values[in_range(row + ends[first + m])]
        return result

    @ti.func
    def store_force(
        self, values: ti.template(), blocks: ti.template(), rows: ti.template(), across: ti.template(),
        force: ti.template(),
    ):  # fmt: skip
        if ti.static(self.components == 1):
            store_each(values, blocks, rows, self.block, force)
        else:
            pull = [across[c] * force[0] + across[3 + c] * force[1] for c in ti.static(range(3))]
            store_each(values, blocks, rows, self.block, pull)

    @ti.func
    def pull(self, values: ti.template(), row, start: ti.template(), incident: ti.template(), first):
        """Sum of the forces on a block of spheres, of one component."""
        if ti.static(self.block == 1):
            return self.pull_on(values, row, start, incident, first)
        result = ti.Vector.zero(float, self.block)
        for m in range(self.block):
            result[m] = self.pull_on(values, row, start, incident, first + m)
        return result

    @ti.func
    def pull_on(self, values: ti.template(), row, start: ti.template(), incident: ti.template(), sphere):
        total = 0.0
        for n in range(start[sphere], start[sphere + 1]):
            total -= values[in_range(row + incident[n])]
        return total

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), ends: ti.template(), first, size: ti.template(),
        numbers: ti.template(),
    ):  # fmt: skip
        """The first part of a step, for a block. size : lengths of the rows of spheres and of contacts."""

    @ti.func
    def at_spheres(
        self, values: ti.template(), blocks: ti.template(), c: ti.template(), pull, first, size: ti.template(),
        numbers: ti.template(), sweep,
    ):  # fmt: skip
        """The second one, for one component."""

    @ti.func
    def on(self, name: ti.template(), size: ti.template(), first):
        """Where the numbers of a block of contacts by this name stand."""
        return places(self.rows[name], size[1], self.sphere_rows * size[0] + first)

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), ends: ti.template(),
        start: ti.template(), incident: ti.template(), first, size: ti.template(), numbers: ti.template(), sweep,
    ):  # fmt: skip
        """A block of contacts, or of spheres."""
        if ti.static(part == 0):
            self.at_contacts(values, blocks, ends, first, size, numbers)
        else:
            for c in ti.static(range(self.components)):
                row = self.sphere_rows * size[0] + self.rows["force"][c] * size[1]
                pull = self.pull(values, row, start, incident, first)
                self.at_spheres(values, blocks, c, pull, first, size, numbers, sweep)

    @ti.kernel
    def turns(
        self, arrived: COUNTER, workers: int, begin: int, end: int, values: VALUES, blocks: BLOCKS, ends: LIST,
        start: LIST, incident: LIST, spheres: int, contacts: int, constants: VALUES,
    ):  # fmt: skip
        """Turns `begin` ... `end` - 1, as those of all sweeps."""
        if ti.static(self.on_gpu):
            for turn, again, part in ti.static(ti.ndrange(self.together, self.repeats, 2)):
                for k in range((contacts if ti.static(part == 0) else spheres) * (begin + turn < end)):
                    numbers, size = [constants[n] for n in ti.static(range(self.numbers))], [spheres, contacts]
                    sweep = (begin + turn) * self.repeats + again
                    self.visit(part, values, values, ends, start, incident, k, size, numbers, sweep)
        else:
            for item in range(workers * LEAST_CHUNK):
                if item % LEAST_CHUNK == 0:
                    worker, met, size = item // LEAST_CHUNK, 0, [in_range(spheres), in_range(contacts)]
                    numbers = [constants[n] for n in ti.static(range(self.numbers))]
                    for sweep in range(begin * self.repeats, end * self.repeats):
                        for part in ti.static(range(2)):
                            count = size[1 - part] // self.block
                            for k in range(count * worker // workers, count * (worker + 1) // workers):
                                first = in_range(k * self.block)
                                self.visit(part, values, blocks, ends, start, incident, first, size, numbers, sweep)
                            met += workers
                            meet(arrived, met)


@ti.func
def dot(a: ti.template(), b: ti.template()):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@ti.data_oriented
class CundallStrackLists(SpringsAndSpins, ListSweeps):
    """As `CundallStrackSteps`, with its constants; `is_free` holds 1 / inertia, 0 of driven spheres, and `work` is of
    each contact."""

    numbers = 8

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), ends: ti.template(), first, size: ti.template(),
        numbers: ti.template(),
    ):  # fmt: skip
        force = self.on("force", size, first)
        across = load_each(values, self.on("across", size, first), self.block)
        if ti.static(self.tally):
            work, speed = (
                self.on("work", size, first),
                self.slip(values, self.rows["gear_0"], across, ends, size, first),
            )
            total, before = load(values, work[0], self.block), load_each(values, force, self.block)
            if ti.static(self.components == 1):
                total += before[0] * speed[0]
            else:
                total += dot(across[:3], before) * speed[0] + dot(across[3:], before) * speed[1]
            store(values, blocks, work[0], self.block, total)
        own = load_each(values, places(self.coefficients, size[1], self.sphere_rows * size[0] + first), self.block)
        speed = self.slip(values, self.rows["predicted"], across, ends, size, first)
        if ti.static(self.holds):
            at = self.on("elongation", size, first)
            moved = self.slip(values, self.rows["integral"], across, ends, size, first)
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
        is_free = load(values, in_range(self.rows["is_free"][0] * size[0] + first), self.block)
        old = load_each(values, places(self.gear[c], size[0], first), self.block)
        new = self.motion(old, pull, is_free, numbers[7])
        store_each(values, blocks, places(self.written[c], size[0], first), self.block, new)
        if ti.static(self.tally):
            impulse = in_range(self.rows["impulse"][c] * size[0] + first)
            felt = ti.select(is_free > 0.0, 0.0, pull)
            store(values, blocks, impulse, self.block, load(values, impulse, self.block) + felt)


@ti.data_oriented
class DescentLists(ListSweeps):
    """As `DescentSweeps`, with its constants but no box, which would be wrong where normals are oblique."""

    repeats, numbers = 2, 9

    @ti.func
    def at_contacts(
        self, values: ti.template(), blocks: ti.template(), ends: ti.template(), first, size: ti.template(),
        numbers: ti.template(),
    ):  # fmt: skip
        across = load_each(values, self.on("across", size, first), self.block)
        own = load_each(values, places(self.coefficients, size[1], self.sphere_rows * size[0] + first), self.block)
        force = self.force_law(self.slip(values, self.rows["point"], across, ends, size, first), own, numbers[1])
        self.store_force(values, blocks, self.on("force", size, first), across, force)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, self.on("force_sum", size, first), force)

    @ti.func
    def sum_up(self, values: ti.template(), blocks: ti.template(), sums: ti.template(), new: ti.template()):
        for k in ti.static(range(len(sums))):
            store(values, blocks, sums[k], self.block, load(values, sums[k], self.block) + new[k])

    @ti.func
    def at_spheres(
        self, values: ti.template(), blocks: ti.template(), c: ti.template(), pull, first, size: ti.template(),
        numbers: ti.template(), sweep,
    ):  # fmt: skip
        at = places([self.rows["point"][c], self.rows["inverse_weight"][c]], size[0], first)
        point, weight = load(values, at[0], self.block), load(values, at[1], self.block)
        if ti.static(self.averages):  # noqa: SIM102
            if numbers[8] > 0.0:
                self.sum_up(values, blocks, places([self.rows["spin_sum"][c]], size[0], first), [point])
        new = point + numbers[0] * weight * pull
        if ti.static(self.momentum):
            spin = in_range(self.rows["spin"][c] * size[0] + first)
            beyond = momentum(sweep) * (new - load(values, spin, self.block))
            store(values, blocks, at[0], self.block, new + beyond)
            store(values, blocks, spin, self.block, new)
        else:
            store(values, blocks, at[0], self.block, new)
