"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

from functools import lru_cache

import taichi as ti

from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import clamp, coulomb_force, viscous_force
from taichi_bearings.kernels.memory import BLOCKS, VALUES, difference, in_range, new_block, places, read, write
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Team, meet

FORCE_LAWS = {"coulomb": coulomb_force, "viscous": viscous_force}


@lru_cache
def descent_sweeps(spec: FieldSpec, stencil: Stencil, law: str, averaging: bool) -> "DescentSweeps":
    """One for each configuration, so that the next scene finds its kernels compiled."""
    return DescentSweeps(spec, stencil, law, averaging)


@ti.data_oriented
class DescentSweeps:
    """Sweeps over the fields `point`, `point_next`, `coefficient`, `inverse_weight` and, with momentum,
    `spin`.

    The k-th sweep since the last restart, with beta = k / (k + 3), or 0 without momentum:

        spin_new = clip(point + step * inverse_weight * (sum of the forces that pull on the sphere at `point`), box)
        point    = spin_new + beta (spin_new - spin)

    inverse_weight is 1 / (sum of the coefficients of the sphere's contacts), for each component; 0 for driven spheres,
    which therefore stay. With `averaging`, the points and the contact forces at the points are summed up in `spin_sum`
    and `force_sum`. Without momentum `spin` is not used: `point` is the spin.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, law: str, averaging: bool):
        self.slot = slot = first_slots(spec)
        self.stencil, self.block, self.force_law = stencil, stencil.block, FORCE_LAWS[law]
        self.momentum, self.averaging = "spin" in slot, averaging
        self.components = tuple(range(stencil.components))

        def of_kept(name: str) -> tuple[tuple[int, ...], ...]:
            return tuple(tuple(slot[name] + c for c in kept) for kept in stencil.kept)

        def of_sites(name: str) -> tuple[int, ...]:
            return tuple(slot[name] + c for c in self.components)

        # sweeps of even parity read `point` and write `point_next`, the others go back
        self.kept = of_kept("point"), of_kept("point_next")
        self.point, self.target = (
            (of_sites("point"), of_sites("point_next")),
            (of_sites("point_next"), of_sites("point")),
        )
        self.weight, self.spin = of_sites("inverse_weight"), of_sites("spin") if self.momentum else ()
        if averaging:
            self.spin_sum = of_sites("spin_sum")
            first = [slot["force_sum"] + stencil.force_slot[axis] for axis in range(stencil.dimension)]
            self.force_sum = tuple(
                tuple(range(first[axis], first[axis] + count)) for axis, count in enumerate(stencil.kept_count)
            )

    def run(self, fields: Fields, team: Team, pairs: int, age: int, numbers: tuple[float, ...]) -> None:
        """Make `pairs` pairs of sweeps in one launch, or on a GPU in one each.

        age : sweeps since the last restart. numbers : step, sharpness, and the lower and upper ends of the box.
        """
        layout = fields.layout
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 1
        sizes = (layout.length, layout.margin, layout.blocks, layout.strides[0], stride_y)
        if team.size:
            team.launch(self.pairs_by_team, pairs, fields.values, fields.blocks, age, *sizes, *numbers)
        else:
            for pair in range(pairs):
                self.pair_on_gpu(fields.values, age + 2 * pair, *sizes, *numbers)

    def compile(self, fields: Fields, team: Team) -> None:
        """Compile the kernel that `run` will launch, on no sites at all."""
        nothing = (0.0,) * 8
        if team.size:
            self.run(fields, team, 0, 0, nothing)
        else:
            self.pair_on_gpu(fields.values, 0, *(0,) * 5, *nothing)

    @ti.func
    def force(self, values: ti.template(), lower: ti.template(), upper: ti.template(), coefficient, m, sharpness):
        return self.force_law(difference(values, lower, upper, m), values[coefficient + m], sharpness)

    @ti.func
    def update_block(
        self,
        values: ti.template(),
        blocks: ti.template(),
        parity: ti.template(),
        row,
        first,
        strides: ti.template(),
        beta,
        step,
        sharpness,
        low: ti.template(),
        high: ti.template(),
    ):
        """Update one block of sites."""
        height = ti.static(self.stencil.height)
        axes = ti.static(range(self.stencil.dimension))
        here = [places(self.kept[parity][axis], row, first) for axis in axes]
        up = [places(self.kept[parity][axis], row, first + strides[axis]) for axis in axes]
        down = [places(self.kept[parity][axis], row, first - strides[axis]) for axis in axes]
        own = [in_range((self.slot["coefficient"] + axis) * row + first) for axis in axes]
        lower = [in_range((self.slot["coefficient"] + axis) * row + first - strides[axis]) for axis in axes]
        point, weight = places(self.point[parity], row, first), places(self.weight, row, first)
        old = places(self.spin, row, first)  # empty without momentum
        moved, ahead = new_block(self.stencil.components, self.block), new_block(ti.static(len(old)), self.block)
        below_height = self.force(values, down[height], here[height], lower[height], 0, sharpness)
        for m in range(self.block):
            pull = [0.0 for _ in ti.static(self.components)]
            for axis in ti.static(self.stencil.sideways_axes):
                above = self.force(values, here[axis], up[axis], own[axis], m, sharpness)
                below = self.force(values, down[axis], here[axis], lower[axis], m, sharpness)
                for t in ti.static(range(len(above))):
                    pull[self.stencil.kept[axis][t]] += above[t] - below[t]
            above_height = self.force(values, here[height], up[height], own[height], m, sharpness)
            for t in ti.static(range(len(above_height))):
                pull[self.stencil.kept[height][t]] += above_height[t] - below_height[t]
                below_height[t] = above_height[t]  # carried up the column, so that each is computed once
            for c in ti.static(self.components):
                new = values[point[c] + m] + step * values[weight[c] + m] * pull[c]
                new = clamp(new, low[c], high[c])
                moved[c][m] = new
                if ti.static(self.momentum):
                    ahead[c][m] = new + beta * (new - values[old[c] + m])
        if ti.static(self.averaging):
            self.add_to_sums(values, blocks, parity, row, first, strides, sharpness)
        to = places(self.target[parity], row, first)
        if ti.static(self.momentum):
            write(blocks, self.block, to, ahead)
            write(blocks, self.block, old, moved)
        else:
            write(blocks, self.block, to, moved)

    @ti.func
    def add_to_sums(
        self,
        values: ti.template(),
        blocks: ti.template(),
        parity: ti.template(),
        row,
        first,
        strides: ti.template(),
        sharpness,
    ):
        """Add the points and the forces of the contacts above them to `spin_sum` and `force_sum`."""
        point, spin_sum = places(self.point[parity], row, first), places(self.spin_sum, row, first)
        spins = new_block(self.stencil.components, self.block)
        for m in range(self.block):
            for c in ti.static(self.components):
                spins[c][m] = values[spin_sum[c] + m] + values[point[c] + m]
        write(blocks, self.block, spin_sum, spins)
        for axis in ti.static(self.stencil.slipping_axes):
            here = places(self.kept[parity][axis], row, first)
            up = places(self.kept[parity][axis], row, first + strides[axis])
            own = in_range((self.slot["coefficient"] + axis) * row + first)
            force_sum = places(self.force_sum[axis], row, first)
            forces = new_block(ti.static(len(force_sum)), self.block)
            for m in range(self.block):
                before, force = read(values, force_sum, m), self.force(values, here, up, own, m, sharpness)
                for t in ti.static(range(len(force))):
                    forces[t][m] = before[t] + force[t]
            write(blocks, self.block, force_sum, forces)

    @ti.kernel
    def pairs_by_team(
        self,
        arrived: COUNTER,
        workers: int,
        pairs: int,
        values: VALUES,
        blocks: BLOCKS,
        age: int,
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
                begin, end = count * worker // workers, count * (worker + 1) // workers
                strides = [in_range(stride_x), in_range(stride_y), 1]
                low, high = [low_0, low_1, low_2], [high_0, high_1, high_2]
                for pair in range(pairs):
                    for parity in ti.static(range(2)):
                        beta = momentum(age + 2 * pair + parity)
                        for b in range(begin, end):
                            first = in_range(margin + b * self.block)
                            self.update_block(
                                values, blocks, parity, row, first, strides, beta, step, sharpness, low, high
                            )
                        meet(arrived, (2 * pair + parity + 1) * workers)

    @ti.kernel
    def pair_on_gpu(
        self,
        values: VALUES,
        age: int,
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
                self.update_block(
                    values,
                    values,
                    parity,
                    row,
                    margin + b,
                    strides,
                    momentum(age + parity),
                    step,
                    sharpness,
                    low,
                    high,
                )


@ti.func
def momentum(age):
    """beta of the sweep that is this old."""
    return ti.cast(age, float) / ti.cast(age + 3, float)
