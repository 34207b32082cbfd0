"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

from functools import lru_cache

from taichi_bearings.compiler import ti
from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import FORCES, clamp
from taichi_bearings.kernels.memory import BLOCKS, VALUES, difference, each_site, fill, in_range, new_rows, places, read
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Team, meet


@lru_cache
def descent_sweeps(spec: FieldSpec, stencil: Stencil, law: str) -> "DescentSweeps":
    """One for each configuration, so that the next scene finds its kernels compiled."""
    return DescentSweeps(spec, stencil, law)


@ti.data_oriented
class DescentSweeps:
    """Sweeps over the fields `point`, `point_next`, `coefficient`, for a law with two of them `viscosity`,
    `inverse_weight`, with momentum `spin`, and for averages `spin_sum` and `force_sum`.

    The k-th sweep since the last restart, with beta = k / (k + 3), or 0 without momentum:

        spin_new = clip(point + step * inverse_weight * (sum of the forces that pull on the sphere at `point`), box)
        point    = spin_new + beta (spin_new - spin)

    inverse_weight is 1 / (sum over the sphere's contacts of what bounds their curvature), for each component; 0 for
    driven spheres, which therefore stay. On request the points and the contact forces at the points are summed up in
    `spin_sum` and `force_sum`. Without momentum `spin` is not used: `point` is the spin.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, law: str):
        self.slot = slot = first_slots(spec)
        self.stencil, self.block, self.force_law = stencil, stencil.block, FORCES[law]
        self.momentum, self.averages = "spin" in slot, "spin_sum" in slot
        self.components = tuple(range(stencil.components))
        first = [slot[name] for name in ("coefficient", "viscosity") if name in slot]
        self.coefficients = tuple(tuple(row + axis for row in first) for axis in range(stencil.dimension))
        self.at_once = stencil.components == 1  # what one component reads fits the processor's registers, more does not

        def of_sites(name: str) -> tuple[int, ...]:
            return tuple(slot[name] + c for c in self.components)

        # sweeps of even parity go from `point` to `point_next`, which begins `apart` rows further, the others back
        self.point, self.apart = of_sites("point"), slot["point_next"] - slot["point"]
        self.kept = stencil.spin_rows(slot["point"])
        self.weight, self.spin = of_sites("inverse_weight"), of_sites("spin") if self.momentum else ()
        if self.averages:
            self.spin_sum = of_sites("spin_sum")
            self.force_sum = stencil.force_rows(slot["force_sum"])

    def run(
        self, fields: Fields, team: Team, pairs: int, age: int, averaging: bool, numbers: tuple[float, ...]
    ) -> None:
        """Make `pairs` pairs of sweeps in one launch, or on a GPU in one each.

        age : sweeps since the last restart. numbers : step, sharpness, and the lower and upper ends of the box.
        """
        numbers = (averaging, *fields.layout.measures, *numbers)
        if team.size:
            team.launch(self.pairs_by_team, pairs, fields.values, fields.blocks, age, *numbers)
        else:
            for pair in range(pairs):
                self.pair_on_gpu(fields.values, age + 2 * pair, *numbers)

    def compile(self, fields: Fields, team: Team) -> None:
        """Compile the kernel that `run` will launch, on no sites at all."""
        nothing = (0.0,) * 8
        if team.size:
            self.run(fields, team, 0, 0, False, nothing)
        else:
            self.pair_on_gpu(fields.values, 0, False, *(0,) * 5, *nothing)

    @ti.func
    def force(
        self, values: ti.template(), lower: ti.template(), upper: ti.template(), own: ti.template(), m, sharpness
    ):
        return self.force_law(difference(values, lower, upper, m), read(values, own, m), sharpness)

    @ti.func
    def pull(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """What the contacts of one axis pull on a sphere, for each component that they feel."""
        here, up, down, own, lower = at
        above = self.force(values, here, up, own, m, numbers[0])
        below = self.force(values, down, here, lower, m, numbers[0])
        return [above[t] - below[t] for t in ti.static(range(len(above)))]

    @ti.func
    def pull_along_the_height(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """The same for the height. at[-1] : force of the contact below, carried up the column."""
        above = self.force(values, at[0], at[1], at[2], m, numbers[0])
        pulled = [above[t] - at[3][t] for t in ti.static(range(len(above)))]
        for t in ti.static(range(len(above))):
            at[3][t] = above[t]
        return pulled

    @ti.func
    def add(self, total: ti.template(), axis: ti.template(), part: ti.template()):
        """Add what contacts of one axis pull to the components that feel them."""
        for t in ti.static(range(self.stencil.kept_count[axis])):
            total[self.stencil.kept[axis][t]] += part[t]

    @ti.func
    def moved(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """The next point and, with momentum, the next spin of one sphere.

        at[-1] : for each axis its pulls on the spheres of the block, or the places that they follow from.
        """
        point, weight, spin = at[:3]
        beta, step, sharpness, low, high = numbers
        pulled = [0.0 for _ in self.components]
        for axis in ti.static(self.stencil.slipping_axes):
            if ti.static(not self.at_once):
                self.add(pulled, axis, [row[m] for row in ti.static(at[3][axis])])
            elif ti.static(axis == self.stencil.height):
                self.add(pulled, axis, self.pull_along_the_height(values, at[3][axis], [sharpness], m))
            else:
                self.add(pulled, axis, self.pull(values, at[3][axis], [sharpness], m))
        new = [
            clamp(values[point[c] + m] + step * values[weight[c] + m] * pulled[c], low[c], high[c])
            for c in self.components
        ]
        ahead = [new[c] + beta * (new[c] - values[spin[c] + m]) for c in ti.static(range(len(spin)))]
        return ahead + new

    @ti.func
    def added_point(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """The sum of the points of one sphere, with this one added."""
        return [values[at[0][c] + m] + values[at[1][c] + m] for c in self.components]

    @ti.func
    def added_force(self, values: ti.template(), at: ti.template(), numbers: ti.template(), m):
        """The sum of the forces of one contact, with this one added."""
        total, here, up, own = at
        force = self.force(values, here, up, own, m, numbers[0])
        return [values[total[t] + m] + force[t] for t in ti.static(range(len(force)))]

    @ti.func
    def update_block(
        self,
        values: ti.template(),
        blocks: ti.template(),
        parity,
        averaging,
        row,
        first,
        strides: ti.template(),
        numbers: ti.template(),
    ):
        """Update the block of sites from `first` on. row: length of a row of numbers."""
        axes = ti.static(range(self.stencil.dimension))
        height = ti.static(self.stencil.height)
        sharpness = numbers[2]
        source, target = first + parity * self.apart * row, first + (1 - parity) * self.apart * row
        here = [places(self.kept[axis], row, source) for axis in axes]
        up = [places(self.kept[axis], row, source + strides[axis]) for axis in axes]
        down = [places(self.kept[axis], row, source - strides[axis]) for axis in axes]
        own = [places(self.coefficients[axis], row, first) for axis in axes]
        lower = [places(self.coefficients[axis], row, first - strides[axis]) for axis in axes]
        point, weight = places(self.point, row, source), places(self.weight, row, first)
        spin, to = places(self.spin, row, first), places(self.point, row, target)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if averaging:
                spin_sum = places(self.spin_sum, row, first)
                each_site(values, blocks, self.block, spin_sum, self.added_point, [spin_sum, point], numbers)
                for axis in ti.static(self.stencil.slipping_axes):
                    total = places(self.force_sum[axis], row, first)
                    at = [total, here[axis], up[axis], own[axis]]
                    each_site(values, blocks, self.block, total, self.added_force, at, [sharpness])
        carried = self.force(values, down[height], here[height], lower[height], 0, sharpness)
        contacts = [
            [here[axis], up[axis], own[axis], carried]
            if ti.static(axis == height)
            else [here[axis], up[axis], down[axis], own[axis], lower[axis]]
            for axis in axes
        ]
        if ti.static(self.at_once):
            at = [point, weight, spin, contacts]
            each_site(values, blocks, self.block, to + spin, self.moved, at, numbers)
        else:
            pulls = [new_rows(self.stencil.kept_count[axis], self.block) for axis in axes]
            for axis in ti.static(self.stencil.sideways_axes):
                fill(pulls[axis], values, self.block, self.pull, contacts[axis], [sharpness])
            if ti.static(self.stencil.height_kept > 0):
                fill(pulls[height], values, self.block, self.pull_along_the_height, contacts[height], [sharpness])
            at = [point, weight, spin, pulls]
            each_site(values, blocks, self.block, to + spin, self.moved, at, numbers)

    @ti.kernel
    def pairs_by_team(
        self,
        arrived: COUNTER,
        workers: int,
        begin: int,
        end: int,
        values: VALUES,
        blocks: BLOCKS,
        age: int,
        averaging: int,
        row: int,
        margin: int,
        count: int,
        stride_x: int,
        stride_y: int,
        step: float,
        sharpness: float,
        low_0: float,
        low_1: float,
        low_2: float,
        high_0: float,
        high_1: float,
        high_2: float,
    ):
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                worker = item // LEAST_CHUNK
                first_block, last_block = count * worker // workers, count * (worker + 1) // workers
                strides = [in_range(stride_x), in_range(stride_y), 1]
                low, high = [low_0, low_1, low_2], [high_0, high_1, high_2]
                for pair in range(begin, end):
                    for parity in range(2):
                        numbers = [momentum(age + 2 * pair + parity), step, sharpness, low, high]
                        for b in range(first_block, last_block):
                            first = in_range(margin + b * self.block)
                            self.update_block(values, blocks, parity, averaging, row, first, strides, numbers)
                        meet(arrived, (2 * (pair - begin) + parity + 1) * workers)

    @ti.kernel
    def pair_on_gpu(
        self,
        values: VALUES,
        age: int,
        averaging: int,
        row: int,
        margin: int,
        count: int,
        stride_x: int,
        stride_y: int,
        step: float,
        sharpness: float,
        low_0: float,
        low_1: float,
        low_2: float,
        high_0: float,
        high_1: float,
        high_2: float,
    ):
        for parity in ti.static(range(2)):
            for b in range(count):
                strides = [stride_x, stride_y, 1]
                low, high = [low_0, low_1, low_2], [high_0, high_1, high_2]
                numbers = [momentum(age + parity), step, sharpness, low, high]
                self.update_block(values, values, parity, averaging, row, margin + b, strides, numbers)


@ti.func
def momentum(age):
    """beta of the sweep that is this old."""
    return ti.cast(age, float) / ti.cast(age + 3, float)
