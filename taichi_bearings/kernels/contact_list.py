"""Steps over spheres and contacts that stand in lists: any network, with the laws and numbers of the lattice kernels.

With u = R omega and two unit tangents T of a contact its slip is y = T (u_i + u_j), and its friction pulls both spheres
by -T f: no side, no sign. A pass over the contacts writes T f, a pass over the spheres gathers it from the contacts of
each, in the order of a list: no atomics, and the same bits on any number of threads. What a sphere or contact has by
one name stands together, and spheres in an order in which neighbours are near (fields/lists.py).
"""

from functools import lru_cache

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.fields.lists import ListSpec
from taichi_bearings.kernels.contact import FORCES, viscous_force
from taichi_bearings.kernels.cundall_strack import SpringsAndSpins
from taichi_bearings.kernels.descent import momentum
from taichi_bearings.kernels.memory import VALUES
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Sweeps, meet

LIST = ti.types.ndarray(dtype=ti.i32, ndim=1)


@lru_cache
def list_sweeps(sweeps: type["ListSweeps"], spec: ListSpec, law: str, corrector: tuple[float, ...]) -> "ListSweeps":
    """One for each configuration, so that the next packing finds its kernels compiled."""
    return sweeps(spec, law, corrector)


@ti.data_oriented
class ListSweeps(Sweeps):
    """Part 0 walks over the contacts, part 1 over the spheres. d tangents, C components of a spin.

    Fields of all: of contacts `across` (d, C), but for discs, `coefficient`, `viscosity`, and `force`, T f, (C).
    """

    parts = 2

    def __init__(self, spec: ListSpec, law: str, corrector: tuple[float, ...]):
        super().__init__(1)
        (self.at, self.of_spheres), (self.on, _) = map(slots, spec)
        names, self.components = set(self.on), dict(spec[1])["force"]
        self.tangents = 1 if self.components == 1 else 2
        self.force_law, self.corrector, self.order = FORCES[law], corrector, len(corrector)
        self.beside = tuple(name for name in ("coefficient", "viscosity") if name in names)
        self.holds, self.tally, self.averages = "elongation" in names, "work" in names, "force_sum" in names
        self.momentum = "spin" in self.at
        self.gear = tuple(f"gear_{n}" for n in range(self.order))
        self.written = (*self.gear, "predicted", *(("integral",) if self.holds else ()))

    @ti.func
    def of_sphere(self, name: ti.template(), sphere, size: ti.template()):
        """Where what it has by this name begins."""
        return ti.static(self.at[name][0]) * size[0] + ti.static(self.at[name][1]) * sphere

    @ti.func
    def of_contact(self, name: ti.template(), contact, size: ti.template()):
        first = self.of_spheres * size[0] + ti.static(self.on[name][0]) * size[1]
        return first + ti.static(self.on[name][1]) * contact

    @ti.func
    def slip(self, values: ti.template(), name: ti.template(), ends: ti.template(), contact, size: ti.template()):
        """T (u_i + u_j) of the spins, or what else the spheres have by this name."""
        i = self.of_sphere(name, ends[2 * contact], size)
        j = self.of_sphere(name, ends[2 * contact + 1], size)
        both = [values[i + c] + values[j + c] for c in ti.static(range(self.components))]
        if ti.static(self.components == 1):
            return both
        first = self.of_contact("across", contact, size)
        return [dot3(values, first + 3 * t, both) for t in ti.static(range(2))]

    @ti.func
    def write_force(self, values: ti.template(), contact, size: ti.template(), force: ti.template()):
        at = self.of_contact("force", contact, size)
        if ti.static(self.components == 1):
            values[at] = force[0]
        else:
            first = self.of_contact("across", contact, size)
            for c in ti.static(range(3)):
                values[at + c] = values[first + c] * force[0] + values[first + 3 + c] * force[1]

    @ti.func
    def own(self, values: ti.template(), contact, size: ti.template()):
        """Its coefficients."""
        return [values[self.of_contact(name, contact, size)] for name in ti.static(self.beside)]

    @ti.func
    def pull(self, values: ti.template(), start: ti.template(), incident: ti.template(), sphere, size: ti.template()):
        """Sum of the forces on a sphere, a vector."""
        gathered = ti.Vector.zero(float, self.components)
        for n in range(start[sphere], start[sphere + 1]):
            at = self.of_contact("force", incident[n], size)
            for c in ti.static(range(self.components)):
                gathered[c] -= values[at + c]
        return gathered

    @ti.func
    def at_contact(
        self, values: ti.template(), ends: ti.template(), contact, size: ti.template(), numbers: ti.template()
    ):
        """The first part of a step."""

    @ti.func
    def at_sphere(self, values: ti.template(), sphere, pull, size: ti.template(), numbers: ti.template(), sweep):
        """The second one."""

    @ti.func
    def visit(
        self, part: ti.template(), values: ti.template(), ends: ti.template(), start: ti.template(),
        incident: ti.template(), k, size: ti.template(), numbers: ti.template(), sweep,
    ):  # fmt: skip
        if ti.static(part == 0):
            self.at_contact(values, ends, k, size, numbers)
        else:
            self.at_sphere(values, k, self.pull(values, start, incident, k, size), size, numbers, sweep)

    @ti.kernel
    def turns(
        self, arrived: COUNTER, workers: int, begin: int, end: int, values: VALUES, ends: LIST, start: LIST,
        incident: LIST, spheres: int, contacts: int, constants: VALUES,
    ):  # fmt: skip
        """Turns `begin` ... `end` - 1, as those of all sweeps."""
        if ti.static(self.on_gpu):
            for again, part in ti.static(ti.ndrange(self.repeats, 2)):
                for k in range((contacts if ti.static(part == 0) else spheres) * (end - begin)):
                    numbers = [constants[n] for n in ti.static(range(self.numbers))]
                    size = [spheres, contacts]
                    self.visit(part, values, ends, start, incident, k, size, numbers, begin * self.repeats + again)
        else:
            for item in range(workers * LEAST_CHUNK):
                if item % LEAST_CHUNK == 0:
                    worker, met, size = item // LEAST_CHUNK, 0, [spheres, contacts]
                    numbers = [constants[n] for n in ti.static(range(self.numbers))]
                    for sweep in range(begin * self.repeats, end * self.repeats):
                        for part in ti.static(range(2)):
                            count = size[1 - part]
                            for k in range(share(count, worker, workers), share(count, worker + 1, workers)):
                                self.visit(part, values, ends, start, incident, k, size, numbers, sweep)
                            met += workers
                            meet(arrived, met)


@ti.func
def share(count, worker, workers):
    """Where the share of a worker begins."""
    return ti.cast(ti.cast(count, ti.i64) * worker // workers, int)


@ti.func
def dot3(values: ti.template(), first, vector: ti.template()):
    return values[first] * vector[0] + values[first + 1] * vector[1] + values[first + 2] * vector[2]


def slots(spec: FieldSpec) -> tuple[dict[str, tuple[int, int]], int]:
    """Of each name how many numbers stand before and how many there are; and how many there are in all."""
    return {name: (row, dict(spec)[name]) for name, row in first_slots(spec).items()}, sum(dict(spec).values())


@ti.data_oriented
class CundallStrackLists(SpringsAndSpins, ListSweeps):
    """As `CundallStrackSteps`, with its constants; `is_free` holds 1 / inertia, 0 of driven spheres, and `work` is of
    each contact."""

    numbers = 8

    @ti.func
    def at_contact(
        self, values: ti.template(), ends: ti.template(), contact, size: ti.template(), numbers: ti.template()
    ):
        if ti.static(self.tally):
            speed, at = self.slip(values, "gear_0", ends, contact, size), self.of_contact("force", contact, size)
            work = self.of_contact("work", contact, size)
            if ti.static(self.components == 1):
                values[work] += values[at] * speed[0]
            else:
                first = self.of_contact("across", contact, size)
                force = [values[at + c] for c in ti.static(range(3))]
                values[work] += dot3(values, first, force) * speed[0] + dot3(values, first + 3, force) * speed[1]
        speed, coefficients = self.slip(values, "predicted", ends, contact, size), self.own(values, contact, size)
        if ti.static(self.holds):
            at = self.of_contact("elongation", contact, size)
            before = [values[at + t] for t in ti.static(range(self.tangents))]
            moved = self.slip(values, "integral", ends, contact, size)
            new = self.spring(moved, speed, before, coefficients, numbers)
            for t in ti.static(range(self.tangents)):
                values[at + t] = new[t]
            self.write_force(values, contact, size, new[self.tangents :])
        else:
            self.write_force(values, contact, size, viscous_force(speed, coefficients, 0.0))

    @ti.func
    def at_sphere(self, values: ti.template(), sphere, pull, size: ti.template(), numbers: ti.template(), sweep):
        is_free = values[self.of_sphere("is_free", sphere, size)]
        for c in ti.static(range(self.components)):
            to = [self.of_sphere(name, sphere, size) + c for name in ti.static(self.written)]
            old = [values[to[n]] for n in ti.static(range(self.order))]
            new = self.motion(old, pull[c], is_free, numbers[7])
            for n in ti.static(range(len(to))):
                values[to[n]] = new[n]
            if ti.static(self.tally):
                if is_free == 0.0:
                    values[self.of_sphere("impulse", sphere, size) + c] += pull[c]


@ti.data_oriented
class DescentLists(ListSweeps):
    """As `DescentSweeps`, with its constants but no box, which would be wrong where normals are oblique."""

    repeats, numbers = 2, 9

    @ti.func
    def at_contact(
        self, values: ti.template(), ends: ti.template(), contact, size: ti.template(), numbers: ti.template()
    ):
        slip, coefficients = self.slip(values, "point", ends, contact, size), self.own(values, contact, size)
        force = self.force_law(slip, coefficients, numbers[1])
        self.write_force(values, contact, size, force)
        if ti.static(self.averages):
            if numbers[8] > 0.0:
                at = self.of_contact("force_sum", contact, size)
                for t in ti.static(range(self.tangents)):
                    values[at + t] += force[t]

    @ti.func
    def at_sphere(self, values: ti.template(), sphere, pull, size: ti.template(), numbers: ti.template(), sweep):
        for c in ti.static(range(self.components)):
            at = self.of_sphere("point", sphere, size) + c
            if ti.static(self.averages):
                if numbers[8] > 0.0:
                    values[self.of_sphere("spin_sum", sphere, size) + c] += values[at]
            new = values[at] + numbers[0] * values[self.of_sphere("inverse_weight", sphere, size) + c] * pull[c]
            if ti.static(self.momentum):
                spin = self.of_sphere("spin", sphere, size) + c
                values[at] = new + momentum(sweep) * (new - values[spin])
                values[spin] = new
            else:
                values[at] = new
