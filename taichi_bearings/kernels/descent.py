"""Descent sweeps: every free sphere moves against the gradient of the dissipated power (paper Eqs. 5 and 6)."""

import taichi as ti

from taichi_bearings.kernels.contact import clamp, coulomb_force, difference, viscous_force
from taichi_bearings.kernels.stencil import Stencil, copy_out

FORCE_LAWS = {"coulomb": coulomb_force, "viscous": viscous_force}


@ti.data_oriented
class DescentSweeps:
    """Sweeps over the fields `spin`, `point`, `point_next`, `coefficient`, `inverse_weight` and `box`.

    The k-th sweep since the last restart, with beta = k / (k + 3), or 0 without momentum:

        spin_new = clip(point + step * inverse_weight * (sum of the forces that pull on the sphere at `point`), box)
        point    = spin_new + beta (spin_new - spin)

    inverse_weight is 1 / (sum of the coefficients of the sphere's contacts), for each component; 0 for driven spheres,
    which therefore stay. With `averaging`, the points and the contact forces at the points are summed up in `spin_sum`
    and `force_sum`. Without momentum `spin` is not used: `point` is the spin.
    """

    def __init__(self, fields, stencil: Stencil, law: str, momentum: bool, averaging: bool):
        self.spin, self.point, self.point_next = fields.get("spin"), fields["point"], fields["point_next"]
        self.coefficient, self.inverse_weight, self.box = fields["coefficient"], fields["inverse_weight"], fields["box"]
        self.spin_sum, self.force_sum = fields.get("spin_sum"), fields.get("force_sum")
        self.stencil, self.force_law = stencil, FORCE_LAWS[law]
        self.momentum, self.averaging = momentum, averaging

    def run(self, pairs, layout, step, sharpness, age, serial):
        """Make `pairs` pairs of sweeps, serially in one launch or in parallel over blocks; both give the same bits."""
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 0
        constants = (layout.blocks, layout.margin, layout.strides[0], stride_y, step, sharpness)
        if serial:
            self.pairs_serial(pairs, age, *constants)
            return
        for pair in range(pairs):
            self.pair_parallel(age + 2 * pair, *constants)

    def compile(self, serial):
        """Compile the kernel that `run` will launch, on no sites at all."""
        if serial:
            self.pairs_serial(0, 0, 0, 0, 0, 0, 0.0, 0.0)
        else:
            self.pair_parallel(0, 0, 0, 0, 0, 0.0, 0.0)

    @ti.func
    def force(self, points: ti.template(), lower, upper, axis: ti.template(), sharpness):
        spin_difference = difference(points[lower], points[upper], self.stencil.kept[axis])
        return self.force_law(spin_difference, self.coefficient[lower][axis], sharpness)

    @ti.func
    def update_block(self, points: ti.template(), points_new: ti.template(), first, stride_x, stride_y, step, sharpness, beta):
        """Update one block of sites. Results go to local arrays first: then the loops over sites vectorise."""
        # forces along the height from `lead` sites below the block on, so that each is computed once
        rows = ti.static(max(self.stencil.height_kept, 1))
        along_height = ti.Matrix.zero(float, rows, self.stencil.block + self.stencil.lead)
        if ti.static(self.stencil.height_kept > 0):
            for m in range(self.stencil.block + self.stencil.lead):
                site = first + m - self.stencil.lead
                force = self.force(points, site, site + 1, self.stencil.height, sharpness)
                for t in ti.static(range(self.stencil.height_kept)):
                    along_height[t, m] = force[t]
        moved = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        ahead = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        acting = ti.Matrix.zero(float, self.stencil.force_components, self.stencil.block)
        low, high = self.box[0], self.box[1]
        for m in range(self.stencil.block):
            site = first + m
            pull = ti.Vector.zero(float, self.stencil.components)
            for axis in ti.static(self.stencil.sideways_axes):
                stride = stride_x if ti.static(axis == 0) else stride_y
                above = self.force(points, site, site + stride, axis, sharpness)
                below = self.force(points, site - stride, site, axis, sharpness)
                for t, slot in ti.static(enumerate(self.stencil.kept[axis])):
                    pull[slot] += above[t] - below[t]
                    if ti.static(self.averaging):
                        acting[self.stencil.force_slot[axis] + t, m] = above[t]
            for t, slot in ti.static(enumerate(self.stencil.kept[self.stencil.height])):
                above_height = along_height[t, m + self.stencil.lead]
                pull[slot] += above_height - along_height[t, m + self.stencil.lead - 1]
                if ti.static(self.averaging):
                    acting[self.stencil.force_slot[self.stencil.height] + t, m] = above_height
            for c in ti.static(range(self.stencil.components)):
                here = points[site][c]
                weight = self.inverse_weight[site][c]
                new = clamp(here + step * weight * pull[c], low[c], high[c])
                if ti.static(self.momentum):
                    ahead[c, m] = new + beta * (new - self.spin[site][c])
                moved[c, m] = new
        if ti.static(self.averaging):
            for m in range(self.stencil.block):
                self.spin_sum[first + m] = self.spin_sum[first + m] + points[first + m]
            for v in ti.static(range(self.stencil.force_components)):
                for m in range(self.stencil.block):
                    self.force_sum[first + m][v] = self.force_sum[first + m][v] + acting[v, m]
        if ti.static(self.momentum):
            copy_out(ahead, points_new, first, self.stencil.components, self.stencil.block)
            copy_out(moved, self.spin, first, self.stencil.components, self.stencil.block)
        else:
            copy_out(moved, points_new, first, self.stencil.components, self.stencil.block)

    @ti.func
    def sweep_pair(self, age, blocks, margin, stride_x, stride_y, step, sharpness):
        """Two sweeps, from `point` to `point_next` and back; parallel over blocks if called at a kernel's top level."""
        for b in range(blocks):
            beta = ti.cast(age, float) / ti.cast(age + 3, float)
            first = margin + b * self.stencil.block
            self.update_block(self.point, self.point_next, first, stride_x, stride_y, step, sharpness, beta)
        for b in range(blocks):
            beta = ti.cast(age + 1, float) / ti.cast(age + 4, float)
            first = margin + b * self.stencil.block
            self.update_block(self.point_next, self.point, first, stride_x, stride_y, step, sharpness, beta)

    @ti.kernel
    def pairs_serial(
        self, pairs: int, age: int, blocks: int, margin: int, stride_x: int, stride_y: int, step: float, sharpness: float
    ):
        ti.loop_config(serialize=True)
        for pair in range(pairs):
            self.sweep_pair(age + 2 * pair, blocks, margin, stride_x, stride_y, step, sharpness)

    @ti.kernel
    def pair_parallel(
        self, age: int, blocks: int, margin: int, stride_x: int, stride_y: int, step: float, sharpness: float
    ):
        self.sweep_pair(age, blocks, margin, stride_x, stride_y, step, sharpness)
