"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

import taichi as ti

from taichi_bearings.kernels.contact import clamp, coulomb_force, difference, viscous_force
from taichi_bearings.kernels.stencil import Stencil, copy_out, in_range
from taichi_bearings.kernels.team import LEAST_CHUNK, Team
from taichi_bearings.lattice.layout import Layout

FORCE_LAWS = {"coulomb": coulomb_force, "viscous": viscous_force}


@ti.data_oriented
class DescentSweeps(Team):
    """Sweeps over the fields `spin`, `point`, `point_next`, `coefficient`, `inverse_weight` and `box`.

    The k-th sweep since the last restart, with beta = k / (k + 3), or 0 without momentum:

        spin_new = clip(point + step * inverse_weight * (sum of the forces that pull on the sphere at `point`), box)
        point    = spin_new + beta (spin_new - spin)

    inverse_weight is 1 / (sum of the coefficients of the sphere's contacts), for each component; 0 for driven spheres,
    which therefore stay. With `averaging`, the points and the contact forces at the points are summed up in `spin_sum`
    and `force_sum`. Without momentum `spin` is not used: `point` is the spin.
    """

    def __init__(self, fields, stencil: Stencil, workers: int, law: str, momentum: bool, averaging: bool):
        super().__init__(fields, workers)
        self.spin, self.point, self.point_next = fields.get("spin"), fields["point"], fields["point_next"]
        self.coefficient, self.inverse_weight, self.box = fields["coefficient"], fields["inverse_weight"], fields["box"]
        self.spin_sum, self.force_sum = fields.get("spin_sum"), fields.get("force_sum")
        self.stencil, self.force_law = stencil, FORCE_LAWS[law]
        self.momentum, self.averaging = momentum, averaging

    def run(self, pairs, layout, step, sharpness, age):
        """Make `pairs` pairs of sweeps in one launch: alone, as a team, or on a GPU with one thread a site."""
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 0
        constants = (layout.blocks, layout.margin, layout.strides[0], stride_y, step, sharpness)
        if self.workers > 0:
            self.launch(self.pairs_alone, self.pairs_by_team, pairs, age, *constants)
        else:
            for pair in range(pairs):
                self.pair_on_gpu(age + 2 * pair, *constants)

    def compile(self):
        """Compile the kernel that `run` will launch, on no sites at all."""
        self.run(0 if self.workers else 1, Layout(0, (0, 0), block=1), 0.0, 0.0, 0)

    @ti.func
    def force(self, points: ti.template(), lower, upper, axis: ti.template(), sharpness):
        spin_difference = difference(points[lower], points[upper], self.stencil.kept[axis])
        return self.force_law(spin_difference, self.coefficient[lower][axis], sharpness)

    @ti.func
    def update_block(self, points: ti.template(), points_new: ti.template(), first_site, x, y, step, sharpness, beta):
        """Update one block of sites. Results go to local arrays first: then the loop over sites vectorises."""
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        moved = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        ahead = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        low, high = self.box[0], self.box[1]
        below_height = ti.Vector.zero(float, ti.static(max(self.stencil.height_kept, 1)))
        if ti.static(self.stencil.height_kept > 0):
            below_height = self.force(points, first - 1, first, self.stencil.height, sharpness)
        for m in range(self.stencil.block):
            site = first + m
            pull = ti.Vector.zero(float, self.stencil.components)
            for axis in ti.static(self.stencil.sideways_axes):
                above = self.force(points, site, site + strides[axis], axis, sharpness)
                below = self.force(points, site - strides[axis], site, axis, sharpness)
                for t, slot in ti.static(enumerate(self.stencil.kept[axis])):
                    pull[slot] += above[t] - below[t]
            if ti.static(self.stencil.height_kept > 0):
                above_height = self.force(points, site, site + 1, self.stencil.height, sharpness)
                for t, slot in ti.static(enumerate(self.stencil.kept[self.stencil.height])):
                    pull[slot] += above_height[t] - below_height[t]
                below_height = above_height  # carried up the column, so that each is computed once
            for c in ti.static(range(self.stencil.components)):
                new = clamp(points[site][c] + step * self.inverse_weight[site][c] * pull[c], low[c], high[c])
                moved[c, m] = new
                if ti.static(self.momentum):
                    ahead[c, m] = new + beta * (new - self.spin[site][c])
        if ti.static(self.averaging):
            self.add_to_sums(points, first, strides, sharpness)
        if ti.static(self.momentum):
            copy_out(ahead, points_new, 0, first, self.stencil.block)
            copy_out(moved, self.spin, 0, first, self.stencil.block)
        else:
            copy_out(moved, points_new, 0, first, self.stencil.block)

    @ti.func
    def add_to_sums(self, points: ti.template(), first, strides, sharpness):
        """Add the points and the forces of the contacts above them to `spin_sum` and `force_sum`."""
        spins = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        for m in range(self.stencil.block):
            for c in ti.static(range(self.stencil.components)):
                spins[c, m] = self.spin_sum[first + m][c] + points[first + m][c]
        copy_out(spins, self.spin_sum, 0, first, self.stencil.block)
        for axis in ti.static(self.stencil.slipping_axes):
            slot = ti.static(self.stencil.force_slot[axis])
            stride = strides[axis] if ti.static(axis < self.stencil.height) else 1
            forces = ti.Matrix.zero(float, self.stencil.kept_count[axis], self.stencil.block)
            for m in range(self.stencil.block):
                force = self.force(points, first + m, first + m + stride, axis, sharpness)
                for t in ti.static(range(self.stencil.kept_count[axis])):
                    forces[t, m] = self.force_sum[first + m][slot + t] + force[t]
            copy_out(forces, self.force_sum, slot, first, self.stencil.block)

    @ti.func
    def half_pair(self, back: ti.template(), age, low, high, margin, stride_x, stride_y, step, sharpness):
        """One sweep over blocks low ... high - 1: from `point` to `point_next`, or back."""
        beta = ti.cast(age, float) / ti.cast(age + 3, float)
        for b in range(low, high):
            first = margin + b * self.stencil.block
            if ti.static(back):
                self.update_block(self.point_next, self.point, first, stride_x, stride_y, step, sharpness, beta)
            else:
                self.update_block(self.point, self.point_next, first, stride_x, stride_y, step, sharpness, beta)

    @ti.kernel
    def pairs_alone(
        self,
        pairs: int,
        age: int,
        blocks: int,
        margin: int,
        stride_x: int,
        stride_y: int,
        step: float,
        sharpness: float,
    ):
        ti.loop_config(serialize=True)
        for pair in range(pairs):
            for back in ti.static((0, 1)):
                self.half_pair(back, age + 2 * pair + back, 0, blocks, margin, stride_x, stride_y, step, sharpness)

    @ti.kernel
    def pairs_by_team(
        self,
        pairs: int,
        age: int,
        blocks: int,
        margin: int,
        stride_x: int,
        stride_y: int,
        step: float,
        sharpness: float,
    ):
        self.arrived[None] = 0
        for item in range(self.items):
            if item % LEAST_CHUNK == 0:
                worker = item // LEAST_CHUNK
                low, high = blocks * worker // self.workers, blocks * (worker + 1) // self.workers
                for pair in range(pairs):
                    for back in ti.static((0, 1)):
                        self.half_pair(
                            back, age + 2 * pair + back, low, high, margin, stride_x, stride_y, step, sharpness
                        )
                        self.meet((2 * pair + back + 1) * self.workers)

    @ti.kernel
    def pair_on_gpu(
        self, age: int, blocks: int, margin: int, stride_x: int, stride_y: int, step: float, sharpness: float
    ):
        for b in range(blocks):
            self.half_pair(0, age, b, b + 1, margin, stride_x, stride_y, step, sharpness)
        for b in range(blocks):
            self.half_pair(1, age + 1, b, b + 1, margin, stride_x, stride_y, step, sharpness)
