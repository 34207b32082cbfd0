"""Cundall–Strack steps of a top plane that is one rigid body under a torque: it turns as a(t) times a bearing state."""

from taichi_bearings.compiler import ti
from taichi_bearings.fields import FieldSpec, first_slots
from taichi_bearings.kernels.cundall_strack import CundallStrackSteps
from taichi_bearings.kernels.memory import places
from taichi_bearings.kernels.stencil import Stencil

BODY_NUMBERS = ("steps", "angle", "work", "start", "limit", "creep")


@ti.data_oriented
class RigidTopSteps(CundallStrackSteps):
    """A third pass has the top turn as a body, with more fields: `state`, its bearing state of strength 1; `first`, 1
    at the first sphere of each replica, and there `body`: the derivatives of the strength a, like those of a spin, and
    BODY_NUMBERS. These are the steps made, the angle a has turned by and the work of the torque, and the steps after
    which a was last no faster than `creep` before the angle was beyond `limit`; both signs are those of the torque.

    More constants: height and columns of the lattice, the time step over the inertia of the body, torque / radius at
    the start, what it grows by in a step, and the direction of the torque, 1 or -1.
    """

    parts, numbers = 3, 14

    def __init__(self, spec: FieldSpec, stencil: Stencil, corrector: tuple[float, ...]):
        super().__init__(spec, stencil, corrector)
        slot = first_slots(spec)
        self.body = tuple(range(slot["body"], slot["body"] + self.order + len(BODY_NUMBERS)))
        self.moved = self.gear + self.ahead
        # components, and the rows of the forces of the contacts along the height that feel them
        self.below = tuple(zip(stencil.kept[stencil.height], self.force[stencil.height], strict=True))

    @ti.func
    def walk(
        self, part: ti.template(), values: ti.template(), blocks: ti.template(), row, first, strides: ti.template(),
        numbers: ti.template(), sweep, carried: ti.template(),
    ):  # fmt: skip
        """The contacts above a block of sites, then its spheres, then the bodies that are kept in it."""
        if ti.static(part == 0):
            self.contact_pass(values, blocks, row, first, strides, numbers)
        elif ti.static(part == 1):
            self.sphere_pass(values, blocks, row, first, strides, numbers[7])
        else:
            for m in range(self.block):
                if values[self.slot["first"] * row + first + m] > 0.0:
                    self.turn(values, row, first + m, numbers)

    @ti.func
    def turn(self, values: ti.template(), row, origin, numbers: ti.template()):
        """One step of the body of the replica whose first sphere is `origin`."""
        height, columns = ti.cast(numbers[8], ti.i32), ti.cast(numbers[9], ti.i32)
        response, way = numbers[10], numbers[13]
        old = [values[place] for place in places(self.body, row, origin)]
        steps, angle, work, start, limit, creep = old[self.order :]
        pull = 0.0
        for column in range(columns):
            top = origin + column * height + height - 1
            for c, force in ti.static(self.below):
                pull -= values[(self.slot["state"] + c) * row + top] * values[force * row + top - 1]
        before = numbers[11] + numbers[12] * steps
        torque = before + numbers[12]
        new = self.motion(old, pull + torque, 1.0, response)
        for column in range(columns):
            top = origin + column * height + height - 1
            for c in ti.static(range(self.stencil.components)):
                strength = values[(self.slot["state"] + c) * row + top]
                for n in ti.static(range(len(self.moved))):
                    values[(self.moved[n] + c) * row + top] = strength * new[n]
        turned = angle + way * (old[0] + new[0]) / 2.0
        worked = work + (before * old[0] + torque * new[0]) / 2.0
        started = ti.select(angle <= limit and way * new[0] <= creep, steps + 1.0, start)
        after = new[: self.order] + [steps + 1.0, turned, worked, started]
        for n in ti.static(range(len(after))):
            values[self.body[n] * row + origin] = after[n]
