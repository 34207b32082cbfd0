"""Cundall–Strack steps: springs at the contacts (paper Eqs. 7-9) and Gear's integration of the spins (Eq. 10).

A step is two passes. The contact pass stretches the springs by the predicted slip and caps the force by friction; the
sphere pass gathers the torques, corrects the spins and predicts the next step, so that every field is read and written
once a pass.
"""

from math import comb

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.contact import length, viscous_force
from taichi_bearings.kernels.memory import (
    in_range,
    load,
    load_each,
    load_neighbour,
    load_neighbours,
    minus,
    places,
    store,
    store_each,
    zero,
)  # fmt: skip
from taichi_bearings.kernels.stencil import Stencil
from taichi_bearings.kernels.team import Sweeps


class SpringsAndSpins:
    """The law of one contact, and Gear's step of one spin.

    order : spin and derivatives that Gear's method keeps. corrector : its coefficients, one for each of them.
    """

    order: int
    corrector: tuple[float, ...]

    @ti.func
    def spring(
        self,
        moved: ti.template(),
        speed: ti.template(),
        before: ti.template(),
        coefficients: ti.template(),
        numbers: ti.template(),
    ):
        """Return elongation and force of contacts with friction, after one step.

        A spring and a damper slip together; the viscosity, if there is one, acts beside them.

        moved, speed : differences of the spins, integrated over the step and at its end.
        before : elongation before the step.
        coefficients : normal force, and viscosity if there is one.
        numbers : in this order

        * reach, radius * time step;
        * stiffness of the spring, and damping, A_t * radius;
        * kinetic and static friction coefficient, by which the normal force is multiplied;
        * compliance and memory: after a slip the elongation is compliance * force + memory * elongation before.
        """
        reach, stiffness, damping, kinetic, static, compliance, memory = numbers[:7]
        friction = coefficients[0]
        stretch = [reach * moved[t] + before[t] for t in ti.static(range(len(moved)))]
        trial = [stiffness * stretch[t] + damping * speed[t] for t in ti.static(range(len(moved)))]
        size = length(trial)
        slips = size > static * friction
        share = ti.select(slips, kinetic * friction / size, 1.0)
        force = [share * f for f in ti.static(trial)]
        left = [force[t] * compliance + memory * before[t] for t in ti.static(range(len(force)))]
        if ti.static(len(coefficients) > 1):
            flowing = viscous_force(speed, coefficients, 0.0)
            for t in ti.static(range(len(force))):
                force[t] += flowing[t]
        return [ti.select(slips, left[t], stretch[t]) for t in ti.static(range(len(left)))] + force

    @ti.func
    def motion(self, old: ti.template(), pull, is_free, response):
        """Return one component of the spheres' motion: corrected spin and derivatives, the prediction, and its mean.

        old : the spin and its derivatives. pull : torque over the radius. is_free : 0 for driven spheres.
        response : time step * radius / inertia.
        """
        derivative = old[1]
        for k in ti.static(range(2, self.order)):
            derivative += ti.static(float(k)) * old[k]
        error = response * is_free * pull - derivative
        corrected = [self.corrector[n] * error for n in ti.static(range(self.order))]
        for n in ti.static(range(self.order)):
            for k in ti.static(range(n, self.order)):  # the Taylor series one step on
                corrected[n] += ti.static(float(comb(k, n))) * old[k]
        end, mean = corrected[0], corrected[0]
        for n in ti.static(range(1, self.order)):
            end += corrected[n]
            mean += corrected[n] * ti.static(1.0 / (n + 1))
        # the stretch of the last step was a prediction: the second term is Gear's correction of it
        return corrected + [end, mean + ti.static(self.corrector[0] ** 2) * error]


@ti.data_oriented
class CundallStrackSteps(SpringsAndSpins, Sweeps):
    """Cundall-Strack steps on a lattice.

    Fields: `gear_0` ... `gear_q`, `predicted`, `is_free`, `force`, `coefficient`; with friction also `integral` and
    `elongation`; with damping beside it `viscosity`.

    gear_n : the n-th derivative of the staggered spin times (time step)^n / n!.
    predicted, integral : the spin extrapolated to the end of the step, and its mean over the step.
    elongation, force : spring stretch and tangential force of each contact, along the difference of the spins. The
        spins stand at the end of the last step; the force is that at its predicted end.

    With fields `work` and `impulse` an energy balance is kept too, in sums over the steps:

    work : of each sphere's upper contacts, force times spin difference, without the last step.
    impulse : forces that pull on a driven sphere, with the last step.

    Its constants are the numbers of :meth:`spring`, and response, time step * radius / inertia.
    """

    parts, numbers = 2, 8

    def __init__(self, spec: FieldSpec, stencil: Stencil, corrector: tuple[float, ...]):
        """spec : fields, in the order of their rows. corrector : coefficients of Gear's method."""
        super().__init__(stencil.block, stencil.periodic)
        slot, axes, self.stencil = first_slots(spec), range(stencil.dimension), stencil
        self.slot, self.corrector, self.order, self.tally = slot, corrector, len(corrector), "work" in slot
        self.spin, self.predicted = stencil.spin_rows(slot["gear_0"]), stencil.spin_rows(slot["predicted"])
        self.force = stencil.force_rows(slot["force"])
        self.holds = "elongation" in slot
        if self.holds:
            self.integral = stencil.spin_rows(slot["integral"])
            self.elongation = stencil.force_rows(slot["elongation"])
        names = [name for name in ("coefficient", "viscosity") if name in slot]
        self.coefficients = tuple(tuple(slot[name] + axis for name in names) for axis in axes)
        # rows of the first component that a step writes; those of the others follow
        moved = [*(f"gear_{n}" for n in range(self.order)), "predicted", "integral"]
        self.moved = tuple(slot[name] for name in moved if name in slot)
        # felt: for each component the two axes whose contacts it makes slip, and the rows of their forces
        felt = [
            [(a, self.force[a][kept.index(c)]) for a, kept in enumerate(stencil.kept) if c in kept]
            for c in range(stencil.components)
        ]
        self.felt = tuple(zip(*felt, strict=True))

    @ti.func
    def difference(self, values: ti.template(), rows: ti.template(), row, first, side: ti.template()):
        """Return the numbers of these rows at the upper neighbours, minus those at the block of sites itself."""
        up = load_neighbours(values, rows, row, first, side, 1, self.block)
        return minus(up, load_each(values, places(rows, row, first), self.block))

    @ti.func
    def contact_pass(
        self,
        values: ti.template(),
        blocks: ti.template(),
        row,
        first,
        strides: ti.template(),
        numbers: ti.template(),
    ):
        """Write the forces of the contacts above the block of sites from `first` on. row : length of a row of
        numbers.
        """
        if ti.static(self.tally):
            self.add_work(values, blocks, row, first, strides)
        for axis in ti.static(self.stencil.slipping_axes):
            coefficients = load_each(values, places(self.coefficients[axis], row, first), self.block)
            force, side = places(self.force[axis], row, first), strides[axis::3]
            speed = self.difference(values, self.predicted[axis], row, first, side)
            if ti.static(self.holds):
                elongation = places(self.elongation[axis], row, first)
                moved = self.difference(values, self.integral[axis], row, first, side)
                before = load_each(values, elongation, self.block)
                new = self.spring(moved, speed, before, coefficients, numbers)
                store_each(values, blocks, elongation + force, self.block, new)
            else:
                damping = numbers[2]
                store_each(values, blocks, force, self.block, [coefficients[0] * damping * d for d in ti.static(speed)])

    @ti.func
    def add_work(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Add the power at the end of the last step to the work of the contacts above a block of spheres."""
        work = in_range(self.slot["work"] * row + first)
        total = load(values, work, self.block)
        for axis in ti.static(self.stencil.slipping_axes):
            force = load_each(values, places(self.force[axis], row, first), self.block)
            speed = self.difference(values, self.spin[axis], row, first, strides[axis::3])
            for t in ti.static(range(len(force))):
                total += force[t] * speed[t]
        store(values, blocks, work, self.block, total)

    @ti.func
    def sphere_pass(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), response):
        """Step the spins of one block. A loop over the components at run time is compiled and read once."""
        is_free = load(values, in_range(self.slot["is_free"] * row + first), self.block)
        for c in range(self.stencil.components):
            pull = zero(self.block)
            for of_components in ti.static(self.felt):
                place = in_range(chosen([force for _, force in ti.static(of_components)], c) * row + first)
                sides = [strides[axis::3] for axis, _ in ti.static(of_components)]
                side = [chosen([of[n] for of in sides], c) for n in ti.static(range(len(sides[0])))]
                pull += load(values, place, self.block) - load_neighbour(values, place, side, -1, self.block)
            at = places(self.moved, row, first + c * row)
            new = self.motion(load_each(values, at[: self.order], self.block), pull, is_free, response)
            store_each(values, blocks, at, self.block, new)
            if ti.static(self.tally):  # of driven spheres, which do not move
                impulse = in_range((self.slot["impulse"] + c) * row + first)
                self.sum_up(values, blocks, [impulse], [(1.0 - is_free) * pull])

    @ti.func
    def walk(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Work on the contacts above a block of sites in the first part of a step, on its spheres in the second."""
        if ti.static(part == 0):
            self.contact_pass(values, blocks, row, first, strides, numbers)
        else:
            self.sphere_pass(values, blocks, row, first, strides, numbers[7])


@ti.func
def chosen(options: ti.template(), number):
    """Return options[number], for a number that is known only at run time."""
    result = options[0]
    for other in ti.static(range(1, len(options))):
        result = ti.select(number == other, options[other], result)
    return result
