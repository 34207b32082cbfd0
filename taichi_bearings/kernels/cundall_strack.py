"""Cundall–Strack steps: springs at the contacts (paper Eqs. 7-9) and Gear's integration of the spins (Eq. 10).

A step is two passes. The contact pass stretches the springs by the predicted slip and caps the force by friction; the
sphere pass gathers the torques, corrects the spins and predicts the next step, so that every field is read and written
once a pass.
"""

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
    """

    def __init__(self, fields, stencil: Stencil, workers: int, law: str, corrector: tuple[float, ...]):
        super().__init__(fields, workers)
        self.gear = [fields[f"gear_{n}"] for n in range(len(corrector))]
        self.predicted, self.is_free = fields["predicted"], fields["is_free"]
        self.force, self.coefficient = fields["force"], fields["coefficient"]
        self.integral, self.elongation = fields.get("integral"), fields.get("elongation")
        self.stencil, self.coulomb, self.corrector, self.order = stencil, law == "coulomb", corrector, len(corrector)

    def run(self, steps, layout, numbers):
        """Make `steps` time steps in one launch: alone, as a team, or on a GPU. numbers: from `reach` to `response`."""
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 0
        constants = (layout.blocks, layout.margin, layout.strides[0], stride_y, *numbers)
        if self.workers > 1:
            self.steps_by_team(steps, *constants)
            self.check()
        elif self.workers == 1:
            self.steps_alone(steps, *constants)
        else:
            for _ in range(steps):
                self.step_on_gpu(*constants)

    def compile(self):
        """Compile the kernel that `run` will launch, on no sites at all."""
        self.run(1, Layout(0, (0, 0), block=1), (0.0,) * 6)

    @ti.func
    def spring_block(self, first_site, x, y, reach, stiffness, damping, kinetic, static, compliance):
        """Coulomb contacts of one block. reach: radius * time step; damping: A_t * radius; compliance: 1 / K_t.

        kinetic, static: the normal force, times the ratio of static to kinetic friction for `static`.
        """
        first, stride_x, stride_y = in_range(first_site), in_range(x), in_range(y)
        forces = ti.Matrix.zero(float, self.stencil.force_components, self.stencil.block)
        stretches = ti.Matrix.zero(float, self.stencil.force_components, self.stencil.block)
        for m in range(self.stencil.block):
            site = first + m
            for axis in ti.static(self.stencil.slipping_axes):
                upper = site + 1
                if ti.static(axis < self.stencil.height):
                    upper = site + (stride_x if ti.static(axis == 0) else stride_y)
                moved = difference(self.integral[site], self.integral[upper], self.stencil.kept[axis])
                speed = difference(self.predicted[site], self.predicted[upper], self.stencil.kept[axis])
                stretch = reach * moved
                for t in ti.static(range(moved.n)):
                    stretch[t] += self.elongation[site][self.stencil.force_slot[axis] + t]
                trial = stiffness * stretch + damping * speed
                friction = self.coefficient[site][axis]
                size = length(trial)
                slips = size > static * friction
                share = ti.select(slips, kinetic * friction / size, 1.0)
                for t in ti.static(range(moved.n)):
                    force = share * trial[t]
                    forces[self.stencil.force_slot[axis] + t, m] = force
                    # after a slip the spring alone carries the friction force (paper Eq. 9, with a unit vector)
                    stretches[self.stencil.force_slot[axis] + t, m] = ti.select(slips, force * compliance, stretch[t])
        copy_out(forces, self.force, first, self.stencil.force_components, self.stencil.block)
        copy_out(stretches, self.elongation, first, self.stencil.force_components, self.stencil.block)

    @ti.func
    def dashpot_block(self, first_site, x, y, radius):
        """Viscous contacts of one block."""
        first, stride_x, stride_y = in_range(first_site), in_range(x), in_range(y)
        forces = ti.Matrix.zero(float, self.stencil.force_components, self.stencil.block)
        for m in range(self.stencil.block):
            site = first + m
            for axis in ti.static(self.stencil.slipping_axes):
                upper = site + 1
                if ti.static(axis < self.stencil.height):
                    upper = site + (stride_x if ti.static(axis == 0) else stride_y)
                speed = difference(self.predicted[site], self.predicted[upper], self.stencil.kept[axis])
                for t in ti.static(range(speed.n)):
                    forces[self.stencil.force_slot[axis] + t, m] = self.coefficient[site][axis] * radius * speed[t]
        copy_out(forces, self.force, first, self.stencil.force_components, self.stencil.block)

    @ti.func
    def sphere_block(self, first_site, x, y, response):
        """Correct the spins of one block and predict the next step. response: time step * radius / inertia."""
        first, stride_x, stride_y = in_range(first_site), in_range(x), in_range(y)
        corrected = ti.Matrix.zero(float, self.order * self.stencil.components, self.stencil.block)
        predicted = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        integral = ti.Matrix.zero(float, self.stencil.components, self.stencil.block)
        for m in range(self.stencil.block):
            site = first + m
            pull = ti.Vector.zero(float, self.stencil.components)
            for axis in ti.static(self.stencil.slipping_axes):
                below = site - 1
                if ti.static(axis < self.stencil.height):
                    below = site - (stride_x if ti.static(axis == 0) else stride_y)
                for t, slot in ti.static(enumerate(self.stencil.kept[axis])):
                    v = self.stencil.force_slot[axis] + t
                    pull[slot] += self.force[site][v] - self.force[below][v]
            for c in ti.static(range(self.stencil.components)):
                derivative = ti.Vector.zero(float, self.order)
                for n in ti.static(range(self.order)):
                    derivative[n] = self.gear[n][site][c]
                for lowest in ti.static(range(self.order - 1)):  # Pascal's triangle: the Taylor series one step on
                    for n in ti.static(range(self.order - 2, lowest - 1, -1)):
                        derivative[n] += derivative[n + 1]
                error = response * self.is_free[site][0] * pull[c] - derivative[1]
                ahead, mean = 0.0, 0.0
                for n in ti.static(range(self.order)):
                    value = derivative[n] + self.corrector[n] * error
                    corrected[n * self.stencil.components + c, m] = value
                    ahead += value
                    mean += value * ti.static(1.0 / (n + 1))
                predicted[c, m] = ahead
                # the stretch of the last step was predicted: the term in `error` is Gear's correction of it
                integral[c, m] = mean + ti.static(self.corrector[0] ** 2) * error
        for n in ti.static(range(self.order)):
            for c in ti.static(range(self.stencil.components)):
                for m in ti.static(range(self.stencil.block)):
                    self.gear[n][first + m][c] = corrected[n * self.stencil.components + c, m]
        copy_out(predicted, self.predicted, first, self.stencil.components, self.stencil.block)
        if ti.static(self.coulomb):
            copy_out(integral, self.integral, first, self.stencil.components, self.stencil.block)

    @ti.func
    def contact_pass(self, low, high, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static):
        """Forces of blocks low ... high - 1. kinetic, static: normal force, times mu_s / mu_k for `static`."""
        for b in range(low, high):
            first = margin + b * self.stencil.block
            if ti.static(self.coulomb):
                self.spring_block(
                    first, stride_x, stride_y, reach, stiffness, damping, kinetic, static, 1.0 / stiffness
                )
            else:
                self.dashpot_block(first, stride_x, stride_y, damping)

    @ti.func
    def sphere_pass(self, low, high, margin, stride_x, stride_y, response):
        for b in range(low, high):
            self.sphere_block(margin + b * self.stencil.block, stride_x, stride_y, response)

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
        response: float,
    ):
        ti.loop_config(serialize=True)
        for _ in range(steps):
            self.contact_pass(0, blocks, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static)
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
        response: float,
    ):
        self.arrived[None] = 0
        for item in range(self.items):
            if item % LEAST_CHUNK == 0:
                worker = item // LEAST_CHUNK
                low, high = blocks * worker // self.workers, blocks * (worker + 1) // self.workers
                for step in range(steps):
                    self.contact_pass(low, high, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static)
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
        response: float,
    ):
        for b in range(blocks):
            self.contact_pass(b, b + 1, margin, stride_x, stride_y, reach, stiffness, damping, kinetic, static)
        for b in range(blocks):
            self.sphere_pass(b, b + 1, margin, stride_x, stride_y, response)
