"""Cundall–Strack steps: springs at the contacts (paper Eqs. 7-9) and Gear's integration of the spins (Eq. 10).

A step is two passes. The contact pass stretches the springs by the predicted slip and caps the force by friction; the
sphere pass gathers the torques, corrects the spins and predicts the next step, so that every field is read and written
once a pass.
"""

from math import comb

import taichi as ti

from taichi_bearings.kernels.contact import difference, length
from taichi_bearings.kernels.stencil import Stencil, copy_out, in_range
from taichi_bearings.kernels.team import LEAST_CHUNK, Team
from taichi_bearings.lattice.layout import Layout


@ti.data_oriented
class CundallStrackSteps(Team):
    """Steps over the fields `gear_0` ... `gear_q`, `predicted`, `is_free`, `force`, `coefficient` and, for Coulomb,
    `integral` and `elongation`.

    gear_n : the n-th derivative of the staggered spin times (time step)^n / n!.
    predicted, integral : the spin extrapolated to the end of the step, and its mean over the step.
    elongation, force : spring stretch and tangential force of each contact, along the difference of the spins. The
    spins stand at the end of the last step; the force is that at its predicted end.

    tally : keep energy books too, in `work` and `impulse`: sums over the steps, without the last one and with it.
    work : of each sphere's upper contacts: force times spin difference. impulse : forces that pull on a driven sphere.
    """

    def __init__(self, fields, stencil: Stencil, workers: int, law: str, corrector: tuple[float, ...], tally: bool):
        super().__init__(fields, workers)
        self.tally = tally
        if tally:
            self.work, self.impulse = fields["work"], fields["impulse"]
        self.gear = [fields[f"gear_{n}"] for n in range(len(corrector))]
        self.predicted, self.is_free = fields["predicted"], fields["is_free"]
        self.force, self.coefficient = fields["force"], fields["coefficient"]
        self.integral, self.elongation = fields.get("integral"), fields.get("elongation")
        self.stencil, self.coulomb, self.corrector, self.order = stencil, law == "coulomb", corrector, len(corrector)

    def run(self, steps, layout, numbers):
        """Make `steps` time steps in one launch: alone, as a team, or on a GPU. numbers: from `reach` to `response`."""
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 0
        constants = (layout.blocks, layout.margin, layout.strides[0], stride_y, *numbers)
        if self.workers > 0:
            self.launch(self.steps_alone, self.steps_by_team, steps, *constants)
        else:
            for _ in range(steps):
                self.step_on_gpu(*constants)

    def compile(self):
        """Compile the kernel that `run` will launch, on no sites at all."""
        self.run(0 if self.workers else 1, Layout(0, (0, 0), block=1), (0.0,) * 8)

    @ti.func
    def spring_block(self, first_site, x, y, reach, stiffness, damping, kinetic, static, compliance, memory):
        """Coulomb contacts of one block. reach: radius * time step; damping: A_t * radius.

        kinetic, static: the normal force, times the ratio of static to kinetic friction for `static`.
        compliance, memory: elongation after a slip, from the force and from the elongation before.
        """
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        for axis in ti.static(self.stencil.slipping_axes):
            slot = ti.static(self.stencil.force_slot[axis])
            forces = ti.Matrix.zero(float, self.stencil.kept_count[axis], self.stencil.block)
            stretches = ti.Matrix.zero(float, self.stencil.kept_count[axis], self.stencil.block)
            stride = strides[axis] if ti.static(axis < self.stencil.height) else 1
            for m in range(self.stencil.block):
                site = first + m
                moved = difference(self.integral[site], self.integral[site + stride], self.stencil.kept[axis])
                speed = difference(self.predicted[site], self.predicted[site + stride], self.stencil.kept[axis])
                stretch = reach * moved
                for t in ti.static(range(moved.n)):
                    stretch[t] += self.elongation[site][slot + t]
                trial = stiffness * stretch + damping * speed
                friction = self.coefficient[site][axis]
                size = length(trial)
                slips = size > static * friction
                share = ti.select(slips, kinetic * friction / size, 1.0)
                for t in ti.static(range(moved.n)):
                    force = share * trial[t]
                    forces[t, m] = force
                    left = force * compliance + memory * self.elongation[site][slot + t]
                    stretches[t, m] = ti.select(slips, left, stretch[t])
            copy_out(forces, self.force, slot, first, self.stencil.block)
            copy_out(stretches, self.elongation, slot, first, self.stencil.block)

    @ti.func
    def dashpot_block(self, first_site, x, y, radius):
        """Viscous contacts of one block."""
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        for axis in ti.static(self.stencil.slipping_axes):
            forces = ti.Matrix.zero(float, self.stencil.kept_count[axis], self.stencil.block)
            stride = strides[axis] if ti.static(axis < self.stencil.height) else 1
            for m in range(self.stencil.block):
                site = first + m
                speed = difference(self.predicted[site], self.predicted[site + stride], self.stencil.kept[axis])
                for t in ti.static(range(speed.n)):
                    forces[t, m] = self.coefficient[site][axis] * radius * speed[t]
            copy_out(forces, self.force, self.stencil.force_slot[axis], first, self.stencil.block)

    @ti.func
    def work_block(self, first_site, x, y):
        """Add the power that the contacts of one block take from the spins at the end of the last step."""
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        total = ti.Matrix.zero(float, 1, self.stencil.block)
        for m in range(self.stencil.block):
            total[0, m] = self.work[first + m][0]
        for axis in ti.static(self.stencil.slipping_axes):
            slot = ti.static(self.stencil.force_slot[axis])
            stride = strides[axis] if ti.static(axis < self.stencil.height) else 1
            for m in range(self.stencil.block):
                site = first + m
                speed = difference(self.gear[0][site], self.gear[0][site + stride], self.stencil.kept[axis])
                for t in ti.static(range(speed.n)):
                    total[0, m] += self.force[site][slot + t] * speed[t]
        copy_out(total, self.work, 0, first, self.stencil.block)

    @ti.func
    def impulse_block(self, first_site, x, y):
        """Add what the contacts pull on the driven spheres of one block."""
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        for c in ti.static(range(self.stencil.components)):
            total = ti.Matrix.zero(float, 1, self.stencil.block)
            for m in range(self.stencil.block):
                site = first + m
                pull = self.pull(site, strides, c)
                total[0, m] = self.impulse[site][c] + (1.0 - self.is_free[site][0]) * pull
            copy_out(total, self.impulse, c, first, self.stencil.block)

    @ti.func
    def pull(self, site, strides, c: ti.template()):
        """Sum of the contact forces that pull on a sphere, component `c`."""
        total = 0.0
        for axis in ti.static(self.stencil.slipping_axes):
            if ti.static(c in self.stencil.kept[axis]):
                v = ti.static(self.stencil.force_slot[axis] + self.stencil.kept[axis].index(c))
                stride = strides[axis] if ti.static(axis < self.stencil.height) else 1
                total += self.force[site][v] - self.force[site - stride][v]
        return total

    @ti.func
    def sphere_block(self, first_site, x, y, response):
        """Correct the spins of one block and predict the next step. response: time step * radius / inertia."""
        first, strides = in_range(first_site), ti.Vector([in_range(x), in_range(y)])
        for c in ti.static(range(self.stencil.components)):
            error = ti.Matrix.zero(float, 1, self.stencil.block)
            for m in range(self.stencil.block):
                site = first + m
                pull = self.pull(site, strides, c)
                derivative = 0.0
                for k in ti.static(range(1, self.order)):
                    derivative += ti.static(float(k)) * self.gear[k][site][c]
                error[0, m] = response * self.is_free[site][0] * pull - derivative
            ahead = ti.Matrix.zero(float, 1, self.stencil.block)
            mean = ti.Matrix.zero(float, 1, self.stencil.block)
            for n in ti.static(range(self.order)):  # ascending, so that the higher ones are still the old ones
                corrected = ti.Matrix.zero(float, 1, self.stencil.block)
                for m in range(self.stencil.block):
                    value = self.corrector[n] * error[0, m]
                    for k in ti.static(range(n, self.order)):  # the Taylor series one step on
                        value += ti.static(float(comb(k, n))) * self.gear[k][first + m][c]
                    corrected[0, m] = value
                    ahead[0, m] += value
                    mean[0, m] += value * ti.static(1.0 / (n + 1))
                copy_out(corrected, self.gear[n], c, first, self.stencil.block)
            copy_out(ahead, self.predicted, c, first, self.stencil.block)
            if ti.static(self.coulomb):
                for m in range(self.stencil.block):
                    # the stretch of the last step was a prediction: this term is Gear's correction of it
                    mean[0, m] += ti.static(self.corrector[0] ** 2) * error[0, m]
                copy_out(mean, self.integral, c, first, self.stencil.block)

    @ti.func
    def contact_pass(
        self, low, high, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static, compliance, memory
    ):
        """Forces of blocks low ... high - 1. kinetic, static: normal force, times mu_s / mu_k for `static`."""
        for b in range(low, high):
            first = margin + b * self.stencil.block
            if ti.static(self.tally):
                self.work_block(first, stride_x, stride_y)
            if ti.static(self.coulomb):
                self.spring_block(
                    first, stride_x, stride_y, reach, stiffness, damping, kinetic, static, compliance, memory
                )
            else:
                self.dashpot_block(first, stride_x, stride_y, damping)

    @ti.func
    def sphere_pass(self, low, high, margin, stride_x, stride_y, response):
        for b in range(low, high):
            first = margin + b * self.stencil.block
            self.sphere_block(first, stride_x, stride_y, response)
            if ti.static(self.tally):
                self.impulse_block(first, stride_x, stride_y)

    @ti.kernel
    def steps_alone(
        self,
        steps: int,
        blocks: int,
        margin: int,
        stride_x: int,
        stride_y: int,
        reach: float,
        stiffness: float,
        damping: float,
        kinetic: float,
        static: float,
        compliance: float,
        memory: float,
        response: float,
    ):
        ti.loop_config(serialize=True)
        for _ in range(steps):
            self.contact_pass(
                0, blocks, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static, compliance, memory
            )
            self.sphere_pass(0, blocks, margin, stride_x, stride_y, response)

    @ti.kernel
    def steps_by_team(
        self,
        steps: int,
        blocks: int,
        margin: int,
        stride_x: int,
        stride_y: int,
        reach: float,
        stiffness: float,
        damping: float,
        kinetic: float,
        static: float,
        compliance: float,
        memory: float,
        response: float,
    ):
        self.arrived[None] = 0
        for item in range(self.items):
            if item % LEAST_CHUNK == 0:
                worker = item // LEAST_CHUNK
                low, high = blocks * worker // self.workers, blocks * (worker + 1) // self.workers
                for step in range(steps):
                    self.contact_pass(
                        low,
                        high,
                        margin,
                        stride_x,
                        stride_y,
                        reach,
                        stiffness,
                        damping,
                        kinetic,
                        static,
                        compliance,
                        memory,
                    )
                    self.meet((2 * step + 1) * self.workers)
                    self.sphere_pass(low, high, margin, stride_x, stride_y, response)
                    self.meet((2 * step + 2) * self.workers)

    @ti.kernel
    def step_on_gpu(
        self,
        blocks: int,
        margin: int,
        stride_x: int,
        stride_y: int,
        reach: float,
        stiffness: float,
        damping: float,
        kinetic: float,
        static: float,
        compliance: float,
        memory: float,
        response: float,
    ):
        for b in range(blocks):
            self.contact_pass(
                b, b + 1, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static, compliance, memory
            )
        for b in range(blocks):
            self.sphere_pass(b, b + 1, margin, stride_x, stride_y, response)
