"""Cundall–Strack steps: springs at the contacts (paper Eqs. 7-9) and Gear's integration of the spins (Eq. 10).

A step is two passes. The contact pass stretches the springs by the predicted slip and caps the force by friction; the
sphere pass gathers the torques, corrects the spins and predicts the next step, so that every field is read and written
once a pass.
"""

from functools import lru_cache
from math import comb

import taichi as ti

from taichi_bearings.fields import Fields, FieldSpec, first_slots
from taichi_bearings.kernels.contact import length
from taichi_bearings.kernels.memory import BLOCKS, VALUES, difference, in_range, new_block, places, read, write
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import COUNTER, LEAST_CHUNK, Team, meet


@lru_cache
def cundall_strack_steps(
    spec: FieldSpec, stencil: Stencil, law: str, corrector: tuple[float, ...]
) -> "CundallStrackSteps":
    """One for each configuration, so that the next scene finds its kernels compiled."""
    return CundallStrackSteps(spec, stencil, law, corrector)


@ti.data_oriented
class CundallStrackSteps:
    """Steps over the fields `gear_0` ... `gear_q`, `predicted`, `is_free`, `force`, `coefficient` and, for Coulomb,
    `integral` and `elongation`.

    gear_n : the n-th derivative of the staggered spin times (time step)^n / n!.
    predicted, integral : the spin extrapolated to the end of the step, and its mean over the step.
    elongation, force : spring stretch and tangential force of each contact, along the difference of the spins. The
    spins stand at the end of the last step; the force is that at its predicted end.

    With fields `work` and `impulse` energy books are kept too: sums over the steps, without the last one and with it.
    work : of each sphere's upper contacts: force times spin difference. impulse : forces that pull on a driven sphere.
    """

    def __init__(self, spec: FieldSpec, stencil: Stencil, law: str, corrector: tuple[float, ...]):
        slot, axes = first_slots(spec), range(stencil.dimension)
        self.stencil, self.block, self.coulomb = stencil, stencil.block, law == "coulomb"
        self.corrector, self.order, self.tally = corrector, len(corrector), "work" in slot
        self.slot = slot

        def of_kept(name: str) -> tuple[tuple[int, ...], ...]:
            """For each axis, the rows of the spin components that make its contacts slip."""
            return tuple(tuple(slot[name] + c for c in stencil.kept[axis]) for axis in axes)

        def of_contacts(name: str) -> tuple[tuple[int, ...], ...]:
            first = [slot[name] + stencil.force_slot[axis] for axis in axes]
            return tuple(tuple(range(first[axis], first[axis] + stencil.kept_count[axis])) for axis in axes)

        self.spin, self.predicted, self.force = of_kept("gear_0"), of_kept("predicted"), of_contacts("force")
        if self.coulomb:
            self.integral, self.elongation = of_kept("integral"), of_contacts("elongation")
        self.gear = tuple(tuple(slot[f"gear_{n}"] + c for n in range(self.order)) for c in range(stencil.components))
        self.ahead = tuple(
            tuple(slot[name] + c for name in ("predicted", "integral") if name in slot)
            for c in range(stencil.components)
        )
        # for each component, the axes whose contacts it feels, and the rows of their forces
        self.felt = tuple(tuple(a for a in axes if c in stencil.kept[a]) for c in range(stencil.components))
        self.pulls = tuple(
            tuple(self.force[axis][stencil.kept[axis].index(c)] for axis in felt) for c, felt in enumerate(self.felt)
        )

    def run(self, fields: Fields, team: Team, steps: int, numbers: tuple[float, ...]) -> None:
        """Make `steps` time steps in one launch, or on a GPU in one each. numbers: from `reach` to `response`."""
        layout = fields.layout
        stride_y = layout.strides[1] if len(layout.strides) == 3 else 1
        sizes = (layout.length, layout.margin, layout.blocks, layout.strides[0], stride_y)
        if team.size:
            team.launch(self.steps_by_team, steps, fields.values, fields.blocks, *sizes, *numbers)
        else:
            for _ in range(steps):
                self.step_on_gpu(fields.values, *sizes, *numbers)

    def compile(self, fields: Fields, team: Team) -> None:
        """Compile the kernel that `run` will launch, on no sites at all."""
        nothing = (0.0,) * 8
        if team.size:
            self.run(fields, team, 0, nothing)
        else:
            self.step_on_gpu(fields.values, *(0,) * 5, *nothing)

    @ti.func
    def spring_block(
        self,
        values: ti.template(),
        blocks: ti.template(),
        row,
        first,
        strides: ti.template(),
        reach,
        stiffness,
        damping,
        kinetic,
        static,
        compliance,
        memory,
    ):
        """Coulomb contacts of the block of sites from `first` on. row: length of a row of numbers.

        reach: radius * time step; damping: A_t * radius.
        kinetic, static: the normal force, times the ratio of static to kinetic friction for `static`.
        compliance, memory: elongation after a slip, from the force and from the elongation before.
        """
        for axis in ti.static(self.stencil.slipping_axes):
            count = ti.static(self.stencil.kept_count[axis])
            above = first + strides[axis]
            integral, integral_above = places(self.integral[axis], row, first), places(self.integral[axis], row, above)
            spin, spin_above = places(self.predicted[axis], row, first), places(self.predicted[axis], row, above)
            elongation, force = places(self.elongation[axis], row, first), places(self.force[axis], row, first)
            coefficient = in_range((self.slot["coefficient"] + axis) * row + first)
            forces, stretches = new_block(count, self.block), new_block(count, self.block)
            for m in range(self.block):
                before, moved = read(values, elongation, m), difference(values, integral, integral_above, m)
                speed, friction = difference(values, spin, spin_above, m), values[coefficient + m]
                stretch = [reach * moved[t] + before[t] for t in ti.static(range(count))]
                trial = [stiffness * stretch[t] + damping * speed[t] for t in ti.static(range(count))]
                size = length(trial)
                slips = size > static * friction
                share = ti.select(slips, kinetic * friction / size, 1.0)
                for t in ti.static(range(count)):
                    limited = share * trial[t]
                    forces[t][m] = limited
                    stretches[t][m] = ti.select(slips, limited * compliance + memory * before[t], stretch[t])
            write(blocks, self.block, force, forces)
            write(blocks, self.block, elongation, stretches)

    @ti.func
    def dashpot_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), radius):
        """Viscous contacts of one block."""
        for axis in ti.static(self.stencil.slipping_axes):
            count = ti.static(self.stencil.kept_count[axis])
            spin = places(self.predicted[axis], row, first)
            spin_above = places(self.predicted[axis], row, first + strides[axis])
            coefficient = in_range((self.slot["coefficient"] + axis) * row + first)
            forces = new_block(count, self.block)
            for m in range(self.block):
                speed = difference(values, spin, spin_above, m)
                for t in ti.static(range(count)):
                    forces[t][m] = values[coefficient + m] * radius * speed[t]
            write(blocks, self.block, places(self.force[axis], row, first), forces)

    @ti.func
    def work_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Add the power that the contacts of one block take from the spins at the end of the last step."""
        work, total = places((self.slot["work"],), row, first), new_block(1, self.block)
        for m in range(self.block):
            total[0][m] = values[work[0] + m]
        for axis in ti.static(self.stencil.slipping_axes):
            force, spin = places(self.force[axis], row, first), places(self.spin[axis], row, first)
            spin_above = places(self.spin[axis], row, first + strides[axis])
            for m in range(self.block):
                speed = difference(values, spin, spin_above, m)
                for t in ti.static(range(self.stencil.kept_count[axis])):
                    total[0][m] += values[force[t] + m] * speed[t]
        write(blocks, self.block, work, total)

    @ti.func
    def impulse_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Add what the contacts pull on the driven spheres of one block."""
        is_free = in_range(self.slot["is_free"] * row + first)
        for c in ti.static(range(self.stencil.components)):
            impulse, total = places((self.slot["impulse"] + c,), row, first), new_block(1, self.block)
            above, below = places(self.pulls[c], row, first), self.pulls_below(row, first, strides, c)
            for m in range(self.block):
                pull = self.pull(values, below, above, m)
                total[0][m] = values[impulse[0] + m] + (1.0 - values[is_free + m]) * pull
            write(blocks, self.block, impulse, total)

    @ti.func
    def pulls_below(self, row, first, strides: ti.template(), c: ti.template()):
        """Where the forces stand of the contacts below a sphere that pull on its component c."""
        return [
            in_range(self.pulls[c][k] * row + first - strides[self.felt[c][k]])
            for k in ti.static(range(len(self.felt[c])))
        ]

    @ti.func
    def pull(self, values: ti.template(), below: ti.template(), above: ti.template(), m):
        """Sum of the contact forces that pull on one component of a sphere."""
        total = 0.0
        for force in ti.static(range(len(above))):
            total += values[above[force] + m] - values[below[force] + m]
        return total

    @ti.func
    def sphere_block(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), response):
        """Correct the spins of one block and predict the next step. response: time step * radius / inertia."""
        is_free = in_range(self.slot["is_free"] * row + first)
        for c in ti.static(range(self.stencil.components)):
            gear, ahead = places(self.gear[c], row, first), places(self.ahead[c], row, first)
            above, below = places(self.pulls[c], row, first), self.pulls_below(row, first, strides, c)
            corrected, predicted = (
                new_block(self.order, self.block),
                new_block(ti.static(len(self.ahead[c])), self.block),
            )
            for m in range(self.block):
                old = read(values, gear, m)
                derivative = 0.0
                for k in ti.static(range(1, self.order)):
                    derivative += ti.static(float(k)) * old[k]
                error = response * values[is_free + m] * self.pull(values, below, above, m) - derivative
                end, mean = 0.0, 0.0
                for n in ti.static(range(self.order)):
                    value = self.corrector[n] * error
                    for k in ti.static(range(n, self.order)):  # the Taylor series one step on
                        value += ti.static(float(comb(k, n))) * old[k]
                    corrected[n][m] = value
                    end += value
                    mean += value * ti.static(1.0 / (n + 1))
                predicted[0][m] = end
                if ti.static(self.coulomb):
                    # the stretch of the last step was a prediction: the second term is Gear's correction of it
                    predicted[1][m] = mean + ti.static(self.corrector[0] ** 2) * error
            write(blocks, self.block, gear, corrected)
            write(blocks, self.block, ahead, predicted)

    @ti.func
    def contact_pass(
        self,
        values: ti.template(),
        blocks: ti.template(),
        row,
        first,
        strides: ti.template(),
        reach,
        stiffness,
        damping,
        kinetic,
        static,
        compliance,
        memory,
    ):
        """Forces of one block. kinetic, static: normal force, times mu_s / mu_k for `static`."""
        if ti.static(self.tally):
            self.work_block(values, blocks, row, first, strides)
        if ti.static(self.coulomb):
            self.spring_block(
                values, blocks, row, first, strides, reach, stiffness, damping, kinetic, static, compliance, memory
            )
        else:
            self.dashpot_block(values, blocks, row, first, strides, damping)

    @ti.func
    def sphere_pass(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), response):
        self.sphere_block(values, blocks, row, first, strides, response)
        if ti.static(self.tally):
            self.impulse_block(values, blocks, row, first, strides)

    @ti.kernel
    def steps_by_team(
        self,
        arrived: COUNTER,
        workers: int,
        steps: int,
        values: VALUES,
        blocks: BLOCKS,
        row: int,
        margin: int,
        count: int,
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
        for item in range(workers * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                worker = item // LEAST_CHUNK
                begin, end = count * worker // workers, count * (worker + 1) // workers
                strides = [in_range(stride_x), in_range(stride_y), 1]
                for step in range(steps):
                    for b in range(begin, end):
                        self.contact_pass(
                            values,
                            blocks,
                            row,
                            in_range(margin + b * self.block),
                            strides,
                            reach,
                            stiffness,
                            damping,
                            kinetic,
                            static,
                            compliance,
                            memory,
                        )
                    meet(arrived, (2 * step + 1) * workers)
                    for b in range(begin, end):
                        self.sphere_pass(values, blocks, row, in_range(margin + b * self.block), strides, response)
                    meet(arrived, (2 * step + 2) * workers)

    @ti.kernel
    def step_on_gpu(
        self,
        values: VALUES,
        row: int,
        margin: int,
        count: int,
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
        for b in range(count):
            strides = [stride_x, stride_y, 1]
            self.contact_pass(
                values,
                values,
                row,
                margin + b,
                strides,
                reach,
                stiffness,
                damping,
                kinetic,
                static,
                compliance,
                memory,
            )
        for b in range(count):
            strides = [stride_x, stride_y, 1]
            self.sphere_pass(values, values, row, margin + b, strides, response)
