"""The contacts' part of a Newton step along the central path: one pass over memory for each of its stages.

Every contact has two interior points of a second-order cone, primal (bound, slip difference) and dual (friction, minus
force), joined by the Nesterov-Todd scaling W with W^-1 primal = W dual (Nesterov & Todd 1997; Vandenberghe, The CVXOPT
linear and quadratic cone program solvers, 2010). A point has a head, its first number, and a tail, the one or two
others. A contact that is in no cone, called *smooth* here, obeys the law of friction instead.

Numbers lie in rows, one number of every contact a row, contacts with one slipping component before those with two, each
kind beginning at a multiple of BLOCK. A contact may have numbers of several samples, one after the other. What a pass
takes besides, such as the length of a step, is four times BLOCK numbers, one for each place of a block. All is in
double precision, whatever that of the runtime.

Functions that make a pass ("laws") have four arguments: `values`, all rows; `at`, places of the state, of the step that
is read, an object with as many entries as slipping components, and places of the step that is written; `numbers`; and
m, the contact within its block. They return the numbers that the pass writes, then those of which it finds the sum.
"""

from collections.abc import Callable

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.elimination import LANES, NUMBERS, VECTORS
from taichi_bearings.kernels.memory import BLOCKS, INTEGERS, fill, places

BLOCK = 16  # contacts that are worked on together
LEAST_DIVISOR = 1e-140  # smallest size by which a slip is divided; its square is still a normal double
ENDLESS_STEP = 1e30  # length of a step that never leaves its cone

# Rows of the iterate, and of what `prepare` makes of it: scaling W = weight * rotation by (head, tail), the scaled
# point, W^-2 in the blocks head-head and head-tail, and the stiffness that is left once the head is eliminated
FRICTION_ROW, BOUND, SLIP, DUAL, SMOOTH = 0, 1, 2, 4, 6
WEIGHT, WEIGHT_HEAD, TAIL, POINT_HEAD, POINT_TAIL, DIAGONAL, OFF, STIFFNESS = 7, 8, 9, 11, 12, 14, 15, 17
# the iterate before, and rows for forces
BOUND_BEFORE, SLIP_BEFORE, DUAL_BEFORE, FORCE = 20, 21, 23, 25
STATE_ROWS = 27
# Rows of a step, of which there are two: right-hand side, pull on the spheres, change of slip, bound and dual
RIGHT_HEAD, RIGHT_TAIL, PULL, CHANGE, BOUND_STEP, DUAL_STEP = 0, 1, 3, 5, 7, 8
STEP_ROWS = 10
ROWS = STATE_ROWS + 2 * STEP_ROWS
# What is found over all contacts. Of a step: the largest lengths that keep all primal and all dual points in the cones
# (REACH, DUAL_REACH); sums over the cones of the product friction * bound + difference . dual, of its derivatives by
# either length, and of the mixed derivative. Of an iterate: the power, which is the sum of friction * slip, and the
# EXCESS of it over the work of the forces
REACH, DUAL_REACH, PRODUCT, BY_REACH, BY_DUAL_REACH, BY_BOTH = 0, 1, 2, 3, 4, 5
POWER_FOUND, EXCESS = 2, 3
LEAST_FOUND, FOUND = 2, 6  # the least is found of the first two numbers, the sum of the others; there are six
GO_ON, AS_READ, AS_WRITTEN = 0.0, 1.0, 2.0  # recentring does its work, or keeps the step that is read, or written


@ti.func
def vector(values: ti.template(), at: ti.template(), row: ti.template(), like: ti.template(), m):
    """Return the numbers in the rows from `row` on, as many as `like` has entries."""
    return [values[at[row + k] + m] for k in ti.static(range(len(like)))]


@ti.func
def dot(a: ti.template(), b: ti.template()):
    """Return the scalar product of vectors of one or two components."""
    result = a[0] * b[0]
    if ti.static(len(a) == 2):
        result = result + a[1] * b[1]
    return result


@ti.func
def size(a: ti.template()):
    """Return the Euclidean length of a vector of one or two components."""
    result = ti.abs(a[0])
    if ti.static(len(a) == 2):
        result = ti.sqrt(dot(a, a))
    return result


@ti.func
def determinant(head, tail: ti.template()):
    """Return head^2 - |tail|^2 without cancellation beyond that of head - |tail|."""
    length = size(tail)
    return (head - length) * (head + length)


@ti.func
def rotated(by_head, by_tail: ti.template(), head, tail: ti.template(), sign: ti.template()):
    """Return a point after the hyperbolic rotation (by_head, by_tail), or its inverse for sign -1: head first."""
    along, share = dot(by_tail, tail), 1.0 / (1.0 + by_head)
    forth = sign * head + along * share
    return [by_head * head + sign * along] + [tail[k] + by_tail[k] * forth for k in ti.static(range(len(tail)))]


@ti.func
def scaled(values: ti.template(), at: ti.template(), head, tail: ti.template(), m, sign: ti.template()):
    """Return W times a point, or for sign -1 W^-1 times it: head first."""
    weight = values[at[WEIGHT] + m]
    if ti.static(sign < 0):
        weight = 1.0 / weight
    found = rotated(values[at[WEIGHT_HEAD] + m], vector(values, at, TAIL, tail, m), head, tail, sign)
    return [weight * x for x in ti.static(found)]


@ti.func
def jordan(a, b: ti.template(), c, d: ti.template()):
    """Return the Jordan product (a, b) o (c, d) = (a c + b.d, a d + c b): head first."""
    return [a * c + dot(b, d)] + [a * d[k] + c * b[k] for k in ti.static(range(len(b)))]


@ti.func
def divided(values: ti.template(), at: ti.template(), head, tail: ti.template(), m):
    """Return W^-1 x for the x with (scaled point) o x = (head, tail): head first."""
    by, by_tail = values[at[POINT_HEAD] + m], vector(values, at, POINT_TAIL, tail, m)
    first, share = (by * head - dot(by_tail, tail)) / determinant(by, by_tail), 1.0 / by
    rest = [(tail[k] - by_tail[k] * first) * share for k in ti.static(range(len(tail)))]
    return scaled(values, at, first, rest, m, -1)


@ti.func
def aimed(values: ti.template(), at: ti.template(), head, tail: ti.template(), m):
    """Return a right-hand side with this head and tail, and the pull of the contact that follows from it."""
    dual = vector(values, at, DUAL, tail, m)
    off = vector(values, at, OFF, tail, m)
    smooth, share = values[at[SMOOTH] + m] > 0.0, head / values[at[DIAGONAL] + m]
    pull = [ti.select(smooth, dual[k], dual[k] + (tail[k] - off[k] * share)) for k in ti.static(range(len(tail)))]
    return [head] + tail + pull


@ti.func
def reach(head, tail: ti.template(), head_step, tail_step: ti.template()):
    """Return the largest a for which (head, tail) + a * (head_step, tail_step) stays in the cone."""
    # a is the smallest positive root of quadratic * a^2 + 2 linear * a + constant = 0
    quadratic = head_step * head_step - dot(tail_step, tail_step)
    linear = head * head_step - dot(tail, tail_step)
    constant = determinant(head, tail)
    square = linear * linear - quadratic * constant
    away = ti.sqrt(ti.max(square, 0.0)) - linear
    # inside the cone constant > 0: a positive root exists if the quadratic is negative or (linear < 0 and real roots)
    leaves = (quadratic < 0.0) | ((linear < 0.0) & (square >= 0.0))
    return ti.select(leaves, constant / away, ti.cast(ENDLESS_STEP, ti.f64))


@ti.func
def prepared(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return all that the steps from an iterate share, and the aim of the predictor: all products zero."""
    state, like = at[0], at[2]
    friction, bound = values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    axes = ti.static(range(len(like)))
    smooth = values[state[SMOOTH] + m] > 0.0
    one, other = ti.sqrt(determinant(bound, slip)), ti.sqrt(determinant(friction, dual))
    head, dual_head = bound / one, friction / other
    tail = [slip[k] / one for k in axes]
    dual_tail = [dual[k] / other for k in axes]
    half = ti.sqrt((1.0 + head * dual_head + dot(tail, dual_tail)) / 2.0)
    weight, by = ti.sqrt(one / other), (head + dual_head) / (2.0 * half)
    by_tail = [(tail[k] - dual_tail[k]) / (2.0 * half) for k in axes]
    point = [weight * x for x in ti.static(rotated(by, by_tail, friction, dual, 1))]
    strength, core = 1.0 / (weight * weight), 2.0 * by * by - 1.0
    diagonal = strength * core
    off = [-2.0 * strength * by * by_tail[k] for k in axes]
    # the slip of a contact in no cone gives its direction; of one in a cone whose tail vanishes any will do
    slip_size, turn = ti.max(size(slip), LEAST_DIVISOR), size(by_tail)
    known = (turn > 0.0) | smooth
    length = ti.select(known, ti.select(smooth, slip_size, turn), 1.0)
    unit = [ti.select(smooth, slip[k], ti.select(known, by_tail[k], 1.0 - k)) / length for k in axes]
    last = ti.static(len(like) - 1)
    along = ti.select(smooth, numbers[m] / (slip_size * slip_size), strength / core)
    across = ti.select(smooth, friction / slip_size, strength)
    stiffness = (
        [
            along * unit[0] * unit[0] + across * unit[last] * unit[last],
            along * unit[0] * unit[last] - across * unit[0] * unit[last],
            along * unit[last] * unit[last] + across * unit[0] * unit[0],
        ]
        if ti.static(len(like) == 2)
        else [along * unit[0] * unit[0]]
    )
    share = friction / diagonal
    right = [-friction] + [-dual[k] for k in axes] + [ti.select(smooth, dual[k], off[k] * share) for k in axes]
    return [weight, by] + by_tail + point + [diagonal] + off + stiffness + right


@ti.func
def expanded(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return the steps of bound and dual that belong to the change of the slip, how far they may go, and their
    products.
    """
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    smooth = values[state[SMOOTH] + m] > 0.0
    friction, bound = values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    pull = vector(values, step, PULL, like, m)
    mixed = values[state[STIFFNESS + 1] + m]
    last = ti.static(len(like) - 1)
    resisted = (
        [
            values[state[STIFFNESS] + m] * change[0] + mixed * change[last],
            mixed * change[0] + values[state[STIFFNESS + 2] + m] * change[last],
        ]
        if ti.static(len(like) == 2)
        else [values[state[STIFFNESS] + m] * change[0]]
    )
    dual_step = [pull[k] - resisted[k] - dual[k] for k in axes]
    off = dot(vector(values, state, OFF, like, m), change)
    bound_step = (values[step[RIGHT_HEAD] + m] - off) / values[state[DIAGONAL] + m]
    # a law is far from linear once a slip changes by as much as itself
    moved, never = size(change), ti.cast(ENDLESS_STEP, ti.f64)
    half = ti.select(moved > 0.0, 0.5 * size(slip) / moved, never)
    along = ti.select(smooth, half, reach(bound, slip, bound_step, change))
    dual_along = ti.select(smooth, never, reach(friction, dual, ti.cast(0.0, ti.f64), dual_step))
    products = [
        friction * bound + dot(slip, dual),
        friction * bound_step + dot(change, dual),
        dot(slip, dual_step),
        dot(change, dual_step),
    ]
    counted = [ti.select(smooth, 0.0, x) for x in ti.static([bound_step] + products)]
    return [counted[0]] + dual_step + [along, dual_along] + counted[1:]


@ti.func
def corrected(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return the corrector's right-hand side: aims at a given product, less the predictor's second-order error
    (Mehrotra 1992).
    """
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    zero = ti.cast(0.0, ti.f64)
    one = scaled(values, state, zero, vector(values, step, DUAL_STEP, like, m), m, 1)
    other = scaled(values, state, values[step[BOUND_STEP] + m], vector(values, step, CHANGE, like, m), m, -1)
    found = jordan(one[0], one[1:], other[0], other[1:])
    mend = divided(values, state, found[0] - numbers[m], found[1:], m)
    dual = vector(values, state, DUAL, like, m)
    return aimed(values, state, -values[state[FRICTION_ROW] + m] - mend[0], [-dual[k] - mend[1 + k] for k in axes], m)


@ti.func
def recentred(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return a right-hand side that brings products outside given limits closer to them (Gondzio 1996).

    Products are those after steps of two given lengths; none is lowered by more than the upper limit. Where a step is
    good enough already, its right-hand side is kept.
    """
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    along, dual_along, low, high = numbers[m], numbers[BLOCK + m], numbers[2 * BLOCK + m], numbers[3 * BLOCK + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    dual_step = vector(values, step, DUAL_STEP, like, m)
    after = [slip[k] + along * change[k] for k in axes]
    dual_after = [dual[k] + dual_along * dual_step[k] for k in axes]
    bound = values[state[BOUND] + m] + along * values[step[BOUND_STEP] + m]
    one = scaled(values, state, values[state[FRICTION_ROW] + m], dual_after, m, 1)
    other = scaled(values, state, bound, after, m, -1)
    found = jordan(one[0], one[1:], other[0], other[1:])
    tail = found[1:]
    length = size(tail)
    below, above = found[0] - length, found[0] + length  # the eigenvalues
    raised = ti.max(ti.min(ti.max(below, low), high) - below, -high)
    lowered = ti.max(ti.min(ti.max(above, low), high) - above, -high)
    share = ti.select(length > 0.0, (lowered - raised) * 0.5 / length, 0.0)
    mend = divided(values, state, (raised + lowered) * 0.5, [share * tail[k] for k in axes], m)
    choice, written = numbers[4 * BLOCK + m], at[3]
    right = [values[step[RIGHT_HEAD + k] + m] for k in ti.static(range(1 + len(like)))]
    kept = [values[written[RIGHT_HEAD + k] + m] for k in ti.static(range(1 + len(like)))]
    aim = [
        ti.select(choice == AS_WRITTEN, kept[k], ti.select(choice == AS_READ, right[k], right[k] + mend[k]))
        for k in ti.static(range(1 + len(like)))
    ]
    return aimed(values, state, aim[0], aim[1:], m)


@ti.func
def taken(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return the iterate after steps of two given lengths, the iterate before, and power and excess of the new one."""
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    smooth, friction, bound = values[state[SMOOTH] + m] > 0.0, values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    along, dual_along = numbers[m], numbers[BLOCK + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    dual_step = vector(values, step, DUAL_STEP, like, m)
    after = [slip[k] + along * change[k] for k in axes]
    length = size(after)
    dual_after = [
        ti.select(smooth, -friction * after[k] / ti.max(length, LEAST_DIVISOR), dual[k] + dual_along * dual_step[k])
        for k in axes
    ]
    bound_after = ti.select(smooth, length, bound + along * values[step[BOUND_STEP] + m])
    power = friction * length
    return [bound_after] + after + dual_after + [bound] + slip + dual + [power, power + dot(after, dual_after)]


def _numbered(*rows: tuple[int, tuple[int, int]]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the rows that contacts with one and with two components write.

    rows : for each quantity the first row, and how many rows either kind of contact has.
    """
    one, two = (tuple(first + k for first, counts in rows for k in range(counts[kind])) for kind in (0, 1))
    return one, two


SCALAR, VECTOR = (1, 1), (1, 2)
AIM = _numbered((RIGHT_HEAD, SCALAR), (RIGHT_TAIL, VECTOR), (PULL, VECTOR))
MADE = _numbered(
    (WEIGHT, SCALAR), (WEIGHT_HEAD, SCALAR), (TAIL, VECTOR), (POINT_HEAD, SCALAR), (POINT_TAIL, VECTOR),
    (DIAGONAL, SCALAR), (OFF, VECTOR), (STIFFNESS, (1, 3)),
)  # fmt: skip
EXTENT = _numbered((BOUND_STEP, SCALAR), (DUAL_STEP, VECTOR))
TAKEN = _numbered(
    (BOUND, SCALAR), (SLIP, VECTOR), (DUAL, VECTOR),
    (BOUND_BEFORE, SCALAR), (SLIP_BEFORE, VECTOR), (DUAL_BEFORE, VECTOR),
)  # fmt: skip
NO_NUMBERS = ((), ())


@ti.func
def walk(
    values: ti.template(), blocks: ti.template(), found: ti.template(), law: ti.template(), length, block,
    slots: ti.template(), writes: ti.template(), finds: ti.template(), like: ti.template(), numbers: ti.template(),
):  # fmt: skip
    """Apply a law to a block of contacts.

    slots : of the step that is read, and of the step that is written.
    writes : rows of the iterate, and of the step, that the law writes.
    finds : numbers, after those that are written, of which the least or the sum is found, in the same order whatever
        the samples.
    like : an object with as many entries as slipping components.
    """
    first = block * BLOCK
    state = places(ti.static(tuple(range(STATE_ROWS))), length, first)
    step = ti.static(tuple(range(STEP_ROWS)))
    old = places(step, length, first + (STATE_ROWS + slots[0] * STEP_ROWS) * length)
    new = places(step, length, first + (STATE_ROWS + slots[1] * STEP_ROWS) * length)
    to = places(ti.static(writes[0]), length, first) + [new[k] for k in ti.static(writes[1])]
    rows = [ti.Vector.zero(ti.f64, BLOCK) for _ in ti.static(range(len(to) + len(finds)))]
    fill(rows, values, BLOCK, law, [state, old, like, new], numbers)
    for k in ti.static(range(len(to))):
        blocks[to[k] // BLOCK] = rows[k]
    turns = found.shape[0] // FOUND
    for k in ti.static(range(len(finds))):
        at, more = finds[k] * turns + block % turns, rows[ti.static(len(to) + k)]
        if ti.static(finds[k] < LEAST_FOUND):
            found[at] = ti.min(found[at], more)
        else:
            found[at] = found[at] + more


def _pass(
    law: Callable, iterate: tuple = NO_NUMBERS, step: tuple = NO_NUMBERS, finds: tuple = ()
) -> tuple[Callable, Callable]:
    """Return kernels that walk a law over contacts with one slipping component, and with two.

    Each is compiled only where there are such contacts.

    iterate, step : rows that the law writes, of contacts with one and with two components.
    finds : see :func:`walk`.
    """
    return _walked(law, (iterate[0], step[0]), finds, (0,)), _walked(law, (iterate[1], step[1]), finds, (0, 1))


def _walked(law: Callable, writes: tuple, finds: tuple, like: tuple) -> Callable:
    """Return a kernel that applies a law to blocks of contacts. For the arguments see :func:`walk`."""

    @ti.kernel
    def run(
        values: NUMBERS, blocks: BLOCKS, found: BLOCKS, numbers: NUMBERS, length: int, first: int, end: int,
        read_slot: int, write_slot: int,
    ):  # fmt: skip
        """Apply the law to the blocks first ... end-1. length : of a row. read_slot, write_slot : steps that are
        read and written.
        """
        ti.loop_config(serialize=True)
        for block in range(first, end):
            walk(
                values, blocks, found, law, length, block, [read_slot, write_slot], ti.static(writes), ti.static(finds),
                ti.static(like), numbers,
            )  # fmt: skip

    return run


prepare = _pass(prepared, MADE, AIM)
expand = _pass(expanded, step=EXTENT, finds=(REACH, DUAL_REACH, PRODUCT, BY_REACH, BY_DUAL_REACH, BY_BOTH))
correct = _pass(corrected, step=AIM)
recentre = _pass(recentred, step=AIM)
take = _pass(taken, TAKEN, finds=(POWER_FOUND, EXCESS))


@ti.func
def nothing(together: ti.template()):
    """Return zero: a vector for several samples together, else a number."""
    if ti.static(together):
        return ti.Vector.zero(ti.f64, LANES)
    return ti.cast(0.0, ti.f64)


def _sums(together: bool) -> Callable:
    """Return a kernel that adds numbers up, those of LANES samples together or of a sample alone."""
    kind = VECTORS if together else NUMBERS

    @ti.kernel
    def run(begins: INTEGERS, places: INTEGERS, values: kind, found: kind, first: int, to: int):
        """Set found[to + i] to the sum of values[first + places[k]] over k from begins[i] on; ~place : subtracted."""
        ti.loop_config(serialize=True)
        for i in range(begins.shape[0] - 1):
            total = nothing(together)
            for k in range(begins[i], begins[i + 1]):
                off = places[k] >> 31  # -1 for what is taken off, 0 for the rest
                total = total + ti.cast(1 | off, ti.f64) * values[first + (places[k] ^ off)]
            found[to + i] = total

    return run


add_up, add_up_alone = _sums(True), _sums(False)
