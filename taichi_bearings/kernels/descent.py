"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

from functools import lru_cache

from taichi_bearings.compiler import ti
from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import FORCES, clamp
from taichi_bearings.kernels.memory import (
    BLOCKS,
    VALUES,
    in_range,
    last,
    load,
    load_each,
    minus,
    places,
    pushed,
    store,
    zero,
)
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
        self,
        values: ti.template(),
        lower: ti.template(),
        upper: ti.template(),
        own: ti.template(),
        block: ti.template(),
        sharpness,
    ):
        """Forces of a block of contacts between spheres with these points."""
        return self.force_law(minus(upper, lower), load_each(values, own, block), sharpness)

    @ti.func
    def force_below(self, values: ti.template(), row, source, first, sharpness):
        """Force of the contact below the site `first` along the height."""
        height = ti.static(self.stencil.height)
        lower = load_each(values, places(self.kept[height], row, source - 1), 1)
        upper = load_each(values, places(self.kept[height], row, source), 1)
        return self.force(values, lower, upper, places(self.coefficients[height], row, first - 1), 1, sharpness)

    @ti.func
    def add(self, total: ti.template(), axis: ti.template(), above: ti.template(), below: ti.template()):
        """Add what contacts of one axis pull to the components that feel them."""
        for t in ti.static(range(self.stencil.kept_count[axis])):
            total[self.stencil.kept[axis][t]] += above[t] - below[t]

    @ti.func
    def add_along_the_height(self, total: ti.template(), above: ti.template(), carried: ti.template()):
        """The same for the height. carried : force of the contact below the block, carried up the column."""
        below = [pushed(above[t], carried[t], self.block) for t in ti.static(range(len(above)))]
        self.add(total, self.stencil.height, above, below)
        for t in ti.static(range(len(above))):
            carried[t] = last(above[t], self.block)

    @ti.func
    def sum_up(self, values: ti.template(), blocks: ti.template(), sums: ti.template(), new: ti.template()):
        """Add numbers of a block of sites to those at the places `sums`."""
        for k in ti.static(range(len(sums))):
            store(values, blocks, sums[k], self.block, load(values, sums[k], self.block) + new[k])

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
        carried: ti.template(),
    ):
        """Update the block of sites from `first` on. row: length of a row of numbers."""
        beta, step, sharpness, low, high = numbers
        source, target = first + parity * self.apart * row, first + (1 - parity) * self.apart * row
        point = load_each(values, places(self.point, row, source), self.block)
        if ti.static(self.averages):  # noqa: SIM102 (Taichi needs the statement to drop the branch)
            if averaging:
                self.sum_up(values, blocks, places(self.spin_sum, row, first), point)
        pulled = [zero(self.block) for _ in self.components]
        for axis in ti.static(self.stencil.slipping_axes):
            here = [point[c] for c in ti.static(self.stencil.kept[axis])]
            up = load_each(values, places(self.kept[axis], row, source + strides[axis]), self.block)
            own = places(self.coefficients[axis], row, first)
            above = self.force(values, here, up, own, self.block, sharpness)
            if ti.static(self.averages):  # noqa: SIM102
                if averaging:
                    self.sum_up(values, blocks, places(self.force_sum[axis], row, first), above)
            if ti.static(axis == self.stencil.height):
                self.add_along_the_height(pulled, above, carried)
            else:
                down = load_each(values, places(self.kept[axis], row, source - strides[axis]), self.block)
                lower = places(self.coefficients[axis], row, first - strides[axis])
                self.add(pulled, axis, above, self.force(values, down, here, lower, self.block, sharpness))
        weight, to = places(self.weight, row, first), places(self.point, row, target)
        for c in ti.static(self.components):
            new = clamp(point[c] + step * load(values, weight[c], self.block) * pulled[c], low[c], high[c])
            if ti.static(self.momentum):
                spin = in_range(self.spin[c] * row + first)
                store(values, blocks, to[c], self.block, new + beta * (new - load(values, spin, self.block)))
                store(values, blocks, spin, self.block, new)
            else:
                store(values, blocks, to[c], self.block, new)

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
                        begins = in_range(margin + first_block * self.block)
                        carried = self.force_below(values, row, begins + parity * self.apart * row, begins, sharpness)
                        for b in range(first_block, last_block):
                            first = in_range(margin + b * self.block)
                            self.update_block(values, blocks, parity, averaging, row, first, strides, numbers, carried)
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
                first = margin + b
                carried = self.force_below(values, row, first + parity * self.apart * row, first, sharpness)
                self.update_block(values, values, parity, averaging, row, first, strides, numbers, carried)


@ti.func
def momentum(age):
    """beta of the sweep that is this old."""
    return ti.cast(age, float) / ti.cast(age + 3, float)
