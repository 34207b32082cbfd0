"""Cundall–Strack steps: springs at the contacts (paper Eqs. 7-9) and Gear's integration of the spins (Eq. 10).

A step has two parts. The first goes over the contacts: it stretches the springs by the predicted slip and limits the
force by friction. The second goes over the spheres: it adds up the torques, corrects the spins and predicts the next
step. So each part reads and writes every field once.
"""

from collections.abc import Callable
from math import comb
from typing import Any

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.contact import length, viscous_force
from taichi_bearings.kernels.memory import (
    in_range,
    load,
    load_differences,
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
    """The force of a contact by its spring (:meth:`spring`), and a step of Gear's method for a spin (:meth:`motion`);
    lattices and lists of contacts share them.

    order : how many numbers Gear's method keeps of a spin: the spin and its time derivatives.
    corrector : (order,), coefficients of Gear's corrector, one for each of these numbers.
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
        """Return the elongation and the force of a block of contacts with friction after one step: a list of the 1 or 2
        components of the elongation, then of as many of the force.

        The spring and its damper bear a trial force, K stretch + A speed. If that exceeds static friction the contact
        slips: its force is cut off at kinetic friction, and its spring is set back. A viscosity adds a force to either.
        A component is a vector with an entry for each contact of the block, or one number if a block is one site.

        moved : mean over the step of the difference of the spins, by component, 1/time.
        speed : that difference at the end of the step, by component, 1/time.
        before : elongation before the step by component, length.
        coefficients : list of the friction coefficient of each contact, and of its viscosity if there is one.
        numbers : constants, in this order:

        * radius * time step;
        * stiffness K of the spring, and damping, A * radius;
        * kinetic and static friction of a contact whose coefficient is 1, force;
        * compliance and memory: after a slip the elongation is compliance * force + memory * elongation before.
        """
        radius_step, stiffness, damping, kinetic, static, compliance, memory = numbers[:7]
        friction = coefficients[0]
        stretch = [radius_step * moved[t] + before[t] for t in ti.static(range(len(moved)))]
        # spring and damper together, capped by kinetic friction if they exceed static friction
        trial = [stiffness * stretch[t] + damping * speed[t] for t in ti.static(range(len(moved)))]
        size = length(trial)
        slips = size > static * friction
        share = ti.select(slips, kinetic * friction / size, 1.0)
        force = [share * f for f in ti.static(trial)]
        # the elongation that is left to a contact which slips
        left = [force[t] * compliance + memory * before[t] for t in ti.static(range(len(force)))]
        if ti.static(len(coefficients) > 1):
            flowing = viscous_force(speed, coefficients, 0.0)
            for t in ti.static(range(len(force))):
                force[t] += flowing[t]
        return [ti.select(slips, left[t], stretch[t]) for t in ti.static(range(len(left)))] + force

    @ti.func
    def motion(self, old: ti.template(), pull, is_free, response):
        """Return one spin component after a step of Gear's method: the list `[x_0, ..., x_{order-1}, end, mean]`.

        x_n is the n-th time derivative of the spin times (time step)^n / n!, at the end of this step. `end` is the spin
        that is predicted for the end of the next step. `mean` is the mean spin predicted for the next step, plus Gear's
        correction of the mean of this step. All are spins, 1/time: vectors over the spheres of a block, or numbers.

        old : list of the numbers x_n before the step.
        pull : sum of the contact forces on each sphere, torque over radius.
        is_free : 0 for driven spheres, which no force accelerates; else the factor 1, or 1 / inertia where spheres
            differ.
        response : time step * radius / inertia, which turns a force into the change of a spin.
        """
        # the predicted derivative at the end of the step, and how far the torque's differs from it
        derivative = old[1]
        for k in ti.static(range(2, self.order)):
            derivative += ti.static(float(k)) * old[k]
        error = response * is_free * pull - derivative
        corrected = [self.corrector[n] * error for n in ti.static(range(self.order))]
        for n in ti.static(range(self.order)):
            for k in ti.static(range(n, self.order)):  # add the prediction, a Taylor series one step on
                corrected[n] += ti.static(float(comb(k, n))) * old[k]
        # predict the end and the mean of the next step by the Taylor series of the corrected numbers
        end, mean = corrected[0], corrected[0]
        for n in ti.static(range(1, self.order)):
            end += corrected[n]
            mean += corrected[n] * ti.static(1.0 / (n + 1))
        # the stretch of the last step was a prediction: the second term is Gear's correction of it
        return corrected + [end, mean + ti.static(self.corrector[0] ** 2) * error]


@ti.data_oriented
class CundallStrackSteps(SpringsAndSpins, Sweeps):
    """Cundall-Strack steps on a lattice: part 0 of a step is made at the contacts, part 1 at the spheres.

    Fields, with one number for each spin component of a sphere, or for each component of a contact's force:

    gear_n : for n = 0 ... q, with q the order of Gear's method, the n-th time derivative of the staggered spin (spin
        with signs by which neighbours differ) times (time step)^n / n!.
    predicted, integral : the spin extrapolated to the end of the next step, and its mean over that step; the second
        only with friction. On large lattices the first is not stored but added up: it is the sum of all `gear_n`.
    is_free : one number a sphere, 0 for driven ones and 1 for others.
    coefficient, viscosity : friction of each contact in a unit that all share; viscosity only where it acts beside it.
    elongation, force : stretch of the spring and tangential force of each contact, along the difference of the spins;
        the first only with friction. Spins in `gear_n` stand at the end of the last step; the force is that at its
        predicted end.

    With fields `work` and `impulse` an energy balance is kept too, in sums over the steps:

    work : of each sphere's upper contacts, force times spin difference, without the last step.
    impulse : forces that pull on a driven sphere, with the last step.

    The constants, `numbers`, are radius * time step, stiffness of the spring, damping * radius, kinetic and static
    friction of a contact whose coefficient is 1, compliance and memory of a spring that slips, and time step * radius /
    inertia."""

    parts, numbers, looks_up = 2, 8, True

    def __init__(
        self, spec: FieldSpec, stencil: Stencil, corrector: tuple[float, ...],
        force_law: Callable[..., Any] | None = None,
    ):  # fmt: skip
        """Set the constants for which the kernel is compiled: the rows of memory in which each field stands, and which
        fields there are. A row is one number of every site; a field has one row for each spin component or for each
        component of a contact's force.

        spec : pairs (name of a field, number of its rows), in the order of memory.
        stencil : spin components, dimension and periodic axes of the lattice.
        corrector : coefficients of Gear's corrector, that of the spin first.
        force_law : force of a law of one's own as a function of spin difference, coefficients and radius, like those of
            `contact.FORCES`; None for friction, viscosity or both.

        Attributes that the passes use:

        order : how many numbers are kept of a spin. tally : True if an energy balance is kept.
        holds : True if contacts have friction, by springs.
        unstored : 1 if the spin predicted for the end of a step has no field of its own, else 0.
        slot : first row of each field, by name. moved : first rows of the fields that a step of the spheres writes.
        spin, integral : for each axis, the rows of the spin components that make its contacts slip.
        force, elongation : for each axis, the rows of the forces, or of the springs, along these components.
        ahead : tuples like `spin`, one for each field of which the predicted spins are the sum.
        coefficients : for each axis the row of the friction coefficient, and of the viscosity if there is one.
        pulling : two tuples with a pair (axis, row of a contact force) for each spin component. The two forces of a
            component, one in each tuple, are those whose torques change it.
        """
        super().__init__(stencil.block, stencil.periodic)  # `block` is how many sites are worked on together
        slot, axes, self.stencil = first_slots(spec), range(stencil.dimension), stencil
        self.slot, self.corrector, self.order, self.tally = slot, corrector, len(corrector), "work" in slot
        self.force_law, self.own_law = force_law, force_law is not None
        self.spin, derivatives = stencil.spin_rows(slot["gear_0"]), [f"gear_{n}" for n in range(self.order)]
        self.join(self.joined and "predicted" not in slot)  # small lattices stay in the caches anyway
        self.ahead = tuple(
            stencil.spin_rows(slot[name]) for name in (["predicted"] if "predicted" in slot else derivatives)
        )
        self.unstored = int("predicted" not in slot)  # how many numbers of a new motion have no field
        self.force = stencil.force_rows(slot["force"])
        self.holds = "elongation" in slot
        if self.holds:
            self.integral = stencil.spin_rows(slot["integral"])
            self.elongation = stencil.force_rows(slot["elongation"])
        names = [name for name in ("coefficient", "viscosity") if name in slot]
        self.coefficients = tuple(tuple(slot[name] + axis for name in names) for axis in axes)
        moved = [*derivatives, "predicted", "integral"]
        self.moved = tuple(slot[name] for name in moved if name in slot)
        # A spin component makes the contacts along two axes slip, and their forces change it: for each component two
        # pairs (axis, row of that force), then in the other order, the first pair of each component before the second.
        by_component = [
            [(axis, self.force[axis][own.index(c)]) for axis, own in enumerate(stencil.slip_components) if c in own]
            for c in range(stencil.components)
        ]
        self.pulling = tuple(zip(*by_component, strict=True))

    @ti.func
    def predicted_difference(self, values: ti.template(), axis: ti.template(), row, first, side: ti.template()):
        """Return the difference across contacts along an axis, upper less lower sphere, of the spins that are predicted
        for the end of the next step, 1/time: a list with a vector over the sites of a block for each spin component
        that makes these contacts slip.

        values : all fields, flat.
        axis : number of the axis.
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        side : list with the distance in memory to the upper neighbour. On lattices with periodic axes two entries
            follow: the length in memory of a ring along the axis, and the place of the first site in its ring.
        """
        here = load_each(values, places(self.ahead[0][axis], row, first), self.block)
        up = load_neighbours(values, self.ahead[0][axis], row, first, side, 1, self.block)
        for n in ti.static(range(1, len(self.ahead))):  # a Taylor series one step on, added up in its order
            more = load_each(values, places(self.ahead[n][axis], row, first), self.block)
            above = load_neighbours(values, self.ahead[n][axis], row, first, side, 1, self.block)
            for t in ti.static(range(len(here))):
                here[t] += more[t]
                up[t] += above[t]
        return minus(up, here)

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
        """Stretch the springs of the contacts from a block of sites to their upper neighbours along each axis, and
        write their elongations and forces into the fields. Without friction there are no springs: the force is
        coefficient * numbers[2] * D, with D the difference of the spins, upper less lower sphere, or that of a law of
        one's own at this D.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        numbers : radius * time step, stiffness of the spring, damping * radius, kinetic and static friction of a
            contact whose coefficient is 1, and compliance and memory of a spring that slips; others are not used."""
        if ti.static(self.tally):
            self.add_work(values, blocks, row, first, strides)
        for axis in ti.static(self.stencil.slipping_axes):
            coefficients = load_each(values, places(self.coefficients[axis], row, first), self.block)
            force, side = places(self.force[axis], row, first), strides[axis::3]
            speed = self.predicted_difference(values, axis, row, first, side)
            if ti.static(self.holds):  # friction, by springs; else viscosity alone
                elongation = places(self.elongation[axis], row, first)
                moved = load_differences(values, self.integral[axis], row, first, side, self.block)
                before = load_each(values, elongation, self.block)
                new = self.spring(moved, speed, before, coefficients, numbers)
                store_each(values, blocks, elongation + force, self.block, new)
            elif ti.static(self.own_law):
                store_each(values, blocks, force, self.block, self.force_law(speed, coefficients, numbers[2]))
            else:
                damping = numbers[2]
                store_each(values, blocks, force, self.block, [coefficients[0] * damping * d for d in ti.static(speed)])

    @ti.func
    def add_work(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template()):
        """Add to the field `work` of a block of sites what their contacts dissipated at the end of the last step, up to
        a constant factor: force times spin difference, summed over the contacts with the upper neighbours.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        """
        work = in_range(self.slot["work"] * row + first)
        total = load(values, work, self.block)
        for axis in ti.static(self.stencil.slipping_axes):
            force = load_each(values, places(self.force[axis], row, first), self.block)
            speed = load_differences(values, self.spin[axis], row, first, strides[axis::3], self.block)
            for t in ti.static(range(len(force))):
                total += force[t] * speed[t]
        store(values, blocks, work, self.block, total)

    @ti.func
    def sphere_pass(self, values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(), response):
        """Advance the spins of a block of spheres by one time step (Gear's predictor-corrector), under the contact
        forces that pull on them.

        For each spin component the force on a sphere is summed over its contacts (`pulling` names the rows). `motion`
        returns the new spin and its scaled time derivatives; the spin predicted for the end of the next step; and the
        mean spin during the next step. These are written into the rows `moved`; the predicted spin is left out if no
        row is there for it. With an energy balance (`tally`) the forces on driven spheres are added to `impulse`.

        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site; a field has a row for each of its components.
        first : index in a row of the first sphere of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        response : time step * radius / inertia, 1/(force * time), which turns a force into the change of a spin.
        """
        is_free = load(values, in_range(self.slot["is_free"] * row + first), self.block)
        # a loop at run time, so that its body is compiled once
        for c in range(self.stencil.components):
            # the force on each sphere: that of its upper contact less that of its lower one, along each axis
            pull = zero(self.block)
            for of_components in ti.static(self.pulling):
                place = in_range(chosen([force for _, force in ti.static(of_components)], c) * row + first)
                sides = [strides[axis::3] for axis, _ in ti.static(of_components)]
                side = [chosen([of[n] for of in sides], c) for n in ti.static(range(len(sides[0])))]
                pull += load(values, place, self.block) - load_neighbour(values, place, side, -1, self.block)
            at = places(self.moved, row, first + c * row)
            new = self.motion(load_each(values, at[: self.order], self.block), pull, is_free, response)
            store_each(values, blocks, at, self.block, new[: self.order] + new[self.order + self.unstored :])
            if ti.static(self.tally):  # of driven spheres, which do not move
                impulse = in_range((self.slot["impulse"] + c) * row + first)
                self.sum_up(values, blocks, [impulse], [(1.0 - is_free) * pull])

    @ti.func
    def at_sites(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """Do one part of a step for a block of sites: part 0, stretch the springs of the contacts with their upper
        neighbours; part 1, advance the spins of their spheres.

        part : 0 or 1.
        values : all fields, flat.
        blocks : the same memory as vectors, one for each block (group of sites that are worked on together).
        row : length of a row, which has one number of every site.
        first : index in a row of the first site of the block.
        strides : list of the distances in memory from a site to its upper neighbour along x, y and z. On lattices with
            periodic axes two more triples follow: the length in memory of a ring along each axis, and the place of
            `first` in its ring. strides[axis::3] is what belongs to one axis.
        numbers : radius * time step, stiffness of the spring, damping * radius, kinetic and static friction of a
            contact whose coefficient is 1, compliance and memory of a spring that slips, and time step * radius /
            inertia.
        sweep : not used; `at_sites` takes the same arguments in all methods.
        carried : not used."""
        if ti.static(part == 0):
            self.contact_pass(values, blocks, row, first, strides, numbers)
        else:
            self.sphere_pass(values, blocks, row, first, strides, numbers[7])


@ti.func
def chosen(options: ti.template(), number):
    """Return options[number].

    options : list of integers, whose length is known when the kernel is compiled.
    number : index in the list, known only at run time.
    """
    result = options[0]
    for other in ti.static(range(1, len(options))):
        result = ti.select(number == other, options[other], result)
    return result
