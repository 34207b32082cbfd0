"""The contacts' part of a Newton step along the central path: one pass over memory for each of its stages.

Every contact has two interior points of a second-order cone, primal (bound, slip difference) and dual (friction, minus
force), joined by the Nesterov-Todd scaling W with W^-1 primal = W dual (Nesterov & Todd 1997; Vandenberghe, The CVXOPT
linear and quadratic cone program solvers, 2010). A point has a head, its first number, and a tail, the one or two
others. The cone holds the points with head >= |tail|. A contact that is in no cone, called *smooth* here, obeys the law
of friction instead.

Numbers lie in rows, one number of every contact a row, contacts with one slipping component before those with two, each
kind beginning at a multiple of BLOCK. A contact may have numbers of several samples, one after the other. What a pass
takes besides, such as the length of a step, is five times BLOCK numbers at most, one for each place of a block. All is
in double precision, whatever that of the runtime.

Functions that make a pass ("laws") have four arguments: `values`, all rows; `at`, a list: indices of the rows of the
state, of the rows of the step that is read, an object with as many entries as slipping components, and indices of the
rows of the step that is written; `numbers`, what the pass takes besides; and m, the contact within its block. They
return a list: the numbers that the pass writes, then those of which it finds the sum or the least.
"""

from collections.abc import Callable
from dataclasses import dataclass

from taichi_bearings.compiler import ti
from taichi_bearings.kernels.elimination import LANES, NUMBERS, VECTORS
from taichi_bearings.kernels.memory import BLOCKS, INTEGERS, fill, places
from taichi_bearings.kernels.team import LEAST_CHUNK

BLOCK = 16  # contacts that are worked on together
LEAST_DIVISOR = 1e-140  # smallest size by which a slip is divided; its square is still a normal double
ENDLESS_STEP = 1e30  # length of a step that never leaves its cone

# Rows of the iterate: friction limit, bound of the slip, slip, minus friction force; above 0 for a contact in no cone
FRICTION_ROW, BOUND, SLIP, DUAL, SMOOTH = 0, 1, 2, 4, 6
# Rows of what `prepare` makes of it: scaling W = weight * rotation by (head, tail), the scaled point, the inverse of
# block head-head of W^-2 (0 for a contact in no cone), its block head-tail, and the stiffness that is left once the
# head is eliminated
WEIGHT, WEIGHT_HEAD, TAIL, POINT_HEAD, POINT_TAIL, INVERSE, OFF, STIFFNESS = 7, 8, 9, 11, 12, 14, 15, 17
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
    """Return a vector of one contact as a list. It has 1 or 2 components, each in a row of its own.

    values : all numbers, flat, row by row; a row has one number of each contact.
    at : for each row the index in `values` of the number that the first contact of a block has there.
    row : number of the row with the first component; the second component is in the next row.
    like : any list as long as the vector; its entries do not matter.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    return [values[at[row + k] + m] for k in ti.static(range(len(like)))]


@ti.func
def dot(a: ti.template(), b: ti.template()):
    """Return the scalar product of two lists of one or two numbers.

    a, b : the lists.
    """
    result = a[0] * b[0]
    if ti.static(len(a) == 2):
        result = result + a[1] * b[1]
    return result


@ti.func
def size(a: ti.template()):
    """Return the Euclidean length of a list of one or two numbers.

    a : the list.
    """
    result = ti.abs(a[0])
    if ti.static(len(a) == 2):
        result = ti.sqrt(dot(a, a))
    return result


@ti.func
def determinant(head, tail: ti.template()):
    """Return head^2 - |tail|^2 of a point (head, tail), which is above 0 inside the cone head > |tail|. It is computed
    as (head - |tail|) (head + |tail|), which loses fewer digits than the difference of the squares.

    head : a number.
    tail : a list of one or two numbers.
    """
    length = size(tail)
    return (head - length) * (head + length)


@ti.func
def rotated(by_head, by_tail: ti.template(), head, tail: ti.template(), sign: ti.template()):
    """Return the list [head, *tail] of a point after a hyperbolic rotation, which keeps head^2 - |tail|^2. The rotation
    is the one that takes the point (1, 0) to (by_head, by_tail).

    by_head, by_tail : a number, and a list of one or two numbers, with by_head^2 - |by_tail|^2 = 1.
    head, tail : the point, in the same form.
    sign : 1 for the rotation, -1 for its inverse."""
    along, share = dot(by_tail, tail), 1.0 / (1.0 + by_head)
    forth = sign * head + along * share
    return [by_head * head + sign * along] + [tail[k] + by_tail[k] * forth for k in ti.static(range(len(tail)))]


@ti.func
def scaled(values: ti.template(), at: ti.template(), head, tail: ti.template(), m, sign: ti.template()):
    """Return W x or W^-1 x for a point x = (head, tail), as the list [head, *tail]. W is the scaling of Nesterov and
    Todd of a contact: the symmetric matrix with W^-1 (bound of the slip, slip) = W (friction limit, minus force).

    values : numbers of all contacts, flat, row by row (a row has one number of each contact); W stands in some of these
        rows, as a weight and a hyperbolic rotation.
    at : for each row of the iterate the index in `values` of the number that the block's first contact has there.
    head, tail : the point x: a number, and a list of one or two numbers.
    m : number of the contact within its block, 0 to BLOCK - 1.
    sign : 1 for W, -1 for W^-1.
    """
    weight = values[at[WEIGHT] + m]
    if ti.static(sign < 0):
        weight = 1.0 / weight
    found = rotated(values[at[WEIGHT_HEAD] + m], vector(values, at, TAIL, tail, m), head, tail, sign)
    return [weight * x for x in ti.static(found)]


@ti.func
def jordan(a, b: ti.template(), c, e: ti.template()):
    """Return the Jordan product of two points of a cone, (a, b) o (c, e) = (a c + b.e, a e + c b), as the list [head,
    *tail].

    a, c : heads of the two points.
    b, e : their tails, lists of one or two numbers."""
    return [a * c + dot(b, e)] + [a * e[k] + c * b[k] for k in ti.static(range(len(b)))]


@ti.func
def divided(values: ti.template(), at: ti.template(), head, tail: ti.template(), m):
    """Solve p o x = (head, tail) for the point x, where o is the Jordan product, (a, b) o (c, e) = (a c + b.e, a e + c
    b). Return W^-1 x as the list [head, *tail].

    W is the Nesterov-Todd scaling of the contact, a symmetric matrix, and p its scaled point: p = W^-1 (bound of the
    slip, slip) = W (friction limit, minus force).

    values : numbers of all contacts, flat, row by row (a row has one number of each contact); W and p stand in some of
        these rows.
    at : for each row of the iterate the index in `values` of the number that the block's first contact has there.
    head, tail : the right-hand side: a number, and a list of one or two numbers.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    by, by_tail = values[at[POINT_HEAD] + m], vector(values, at, POINT_TAIL, tail, m)
    first, share = (by * head - dot(by_tail, tail)) / determinant(by, by_tail), 1.0 / by
    rest = [(tail[k] - by_tail[k] * first) * share for k in ti.static(range(len(tail)))]
    return scaled(values, at, first, rest, m, -1)


@ti.func
def right_side_and_pull(values: ti.template(), at: ti.template(), head, tail: ti.template(), m):
    """Return the list [head, *tail, *pull] of one contact: the given right-hand side (head, tail) of a Newton step, and
    the pull on its two spheres that follows, the force by which the contact enters their torque balance.

    Beside its slip a contact has the bound of the slip as an unknown. Once its change is eliminated, the pull is dual +
    tail - off * inverse * head, where the dual is minus the friction force, and `inverse` and `off` are the numbers in
    rows INVERSE and OFF. A contact in no cone (`inverse` is 0) has no such unknown; its pull is the dual.

    values : numbers of all contacts, flat, row by row; a row has one number of each contact.
    at : for each row of the iterate the index in `values` of the number that the block's first contact has there.
    head, tail : the right-hand side: a number, and a list with one number for each slipping component, 1 or 2.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    dual = vector(values, at, DUAL, tail, m)
    off = vector(values, at, OFF, tail, m)
    inverse = values[at[INVERSE] + m]
    smooth, share = inverse == 0.0, head * inverse
    pull = [ti.select(smooth, dual[k], dual[k] + (tail[k] - off[k] * share)) for k in ti.static(range(len(tail)))]
    return [head] + tail + pull


@ti.func
def step_to_boundary(head, tail: ti.template(), head_step, tail_step: ti.template()):
    """Return the largest a for which (head, tail) + a * (head_step, tail_step) stays in the cone head >= |tail|;
    ENDLESS_STEP if the cone is never left.

    head, tail : a point inside the cone: a number, and a list of one or two numbers.
    head_step, tail_step : direction of the step, in the same form.
    """
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
def reaches(values: ti.template(), at: ti.template(), bound_step, change: ti.template(), dual_step: ti.template(), m):
    """Return for one contact a list of two numbers: the largest factors of a step that keep its primal point (bound of
    the slip, slip) and its dual point (friction limit, dual) in their cones. For a contact in no cone (its number in
    row INVERSE is 0) the slip may change by half, and the dual step has no end (ENDLESS_STEP).

    values : numbers of all contacts, flat, row by row; a row has one number of each contact.
    at : for each row of the iterate the index in `values` of the number that the block's first contact has there.
    bound_step : step of the bound of the slip.
    change : step of the slip, a list with one number for each slipping component, 1 or 2.
    dual_step : step of the dual, which is minus the force, such a list.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    smooth = values[at[INVERSE] + m] == 0.0
    friction, bound = values[at[FRICTION_ROW] + m], values[at[BOUND] + m]
    slip = vector(values, at, SLIP, change, m)
    dual = vector(values, at, DUAL, change, m)
    # a law is far from linear once a slip changes by as much as itself
    moved, never = size(change), ti.cast(ENDLESS_STEP, ti.f64)
    half = ti.select(moved > 0.0, 0.5 * size(slip) / moved, never)
    along = ti.select(smooth, half, step_to_boundary(bound, slip, bound_step, change))
    dual_along = ti.select(smooth, never, step_to_boundary(friction, dual, ti.cast(0.0, ti.f64), dual_step))
    return [along, dual_along]


@ti.func
def prepared(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact a list: numbers that all Newton steps from an iterate share, and the aim of the first one.

    A contact has two points: primal (bound of the slip, slip) and dual (friction limit, minus force). Each has a head,
    one number, and a tail, one number for each slipping component (1 or 2). A symmetric matrix W scales both to one
    point p = W^-1 primal = W dual. The list has, in this order:

    * the weight of W, and the head and tail of its rotation; the head and tail of p;
    * of W^-2 the inverse of entry head-head (0 in no cone: row SMOOTH above 0), and the entries head-tail;
    * the stiffness left of W^-2 once the head is eliminated (in no cone that of the friction law): xx, or xx, xy, yy;
    * right-hand side (head, tail) that aims at a product 0 of both points, as at the minimum, and pull on the spheres.

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : lists. at[0] has for each row of the iterate the index in `values` of the number of the block's first contact;
        at[2] is as long as the contact has slipping components, 1 or 2. The others are not used here.
    numbers : numbers[m] is a small work: a contact in no cone gets the stiffness work / slip^2 along its slip.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    state, like = at[0], at[2]
    friction, bound = values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    axes = ti.static(range(len(like)))
    smooth = values[state[SMOOTH] + m] > 0.0
    # both points divided by the roots of their determinants; half-way between them lies the rotation of W
    norm, dual_norm = ti.sqrt(determinant(bound, slip)), ti.sqrt(determinant(friction, dual))
    inverse_norm, inverse_dual_norm = 1.0 / norm, 1.0 / dual_norm  # as few divisions as can be: they take long
    head, dual_head = bound * inverse_norm, friction * inverse_dual_norm
    tail = [slip[k] * inverse_norm for k in axes]
    dual_tail = [dual[k] * inverse_dual_norm for k in axes]
    mean = 0.5 / ti.sqrt((1.0 + head * dual_head + dot(tail, dual_tail)) * 0.5)
    square, by = norm * inverse_dual_norm, (head + dual_head) * mean
    weight = ti.sqrt(square)
    by_tail = [(tail[k] - dual_tail[k]) * mean for k in axes]
    # the scaled point W dual, and W^-2
    point = [weight * x for x in ti.static(rotated(by, by_tail, friction, dual, 1))]
    strength, inverse_core = dual_norm * inverse_norm, 1.0 / (2.0 * by * by - 1.0)
    inverse = ti.select(smooth, 0.0, square * inverse_core)
    off = [-2.0 * strength * by * by_tail[k] for k in axes]
    # stiffness along a direction and across it: of the slip in no cone, else of the rotation; any if that has none
    slip_size, turn = ti.max(size(slip), LEAST_DIVISOR), size(by_tail)
    known = (turn > 0.0) | smooth
    inverse_length = 1.0 / ti.select(known, ti.select(smooth, slip_size, turn), 1.0)
    unit = [ti.select(smooth, slip[k], ti.select(known, by_tail[k], 1.0 - k)) * inverse_length for k in axes]
    last = ti.static(len(like) - 1)
    along = ti.select(smooth, numbers[m] * inverse_length * inverse_length, strength * inverse_core)
    across = ti.select(smooth, friction * inverse_length, strength)
    stiffness = (
        [
            along * unit[0] * unit[0] + across * unit[last] * unit[last],
            along * unit[0] * unit[last] - across * unit[0] * unit[last],
            along * unit[last] * unit[last] + across * unit[0] * unit[0],
        ]
        if ti.static(len(like) == 2)
        else [along * unit[0] * unit[0]]
    )
    # the predictor aims at products of zero: minus the dual point
    share = friction * inverse
    right = [-friction] + [-dual[k] for k in axes] + [ti.select(smooth, dual[k], off[k] * share) for k in axes]
    return [weight, by] + by_tail + point + [inverse] + off + stiffness + right


@ti.func
def expanded(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact, in one list, the steps of its bound and its dual that follow from the change of its slip,
    how far the Newton step may go, and how the product of its two points then changes.

    The points are primal (bound of the slip, slip) and dual (friction limit, dual), where the dual is minus the force.
    Both must stay in the cone: the first number is at least the length of the rest. The list has, in this order:

    * the step of the bound, one number, and the step of the dual, 1 or 2 numbers;
    * the largest factors of the primal step (of bound and slip) and of the dual step that keep the points in the cone;
    * the product friction limit * bound + slip . dual, its derivatives by the two factors, and the mixed derivative.

    For a contact in no cone (INVERSE is 0) the step of the bound and the last four numbers are 0, its slip may change
    by half, and its dual step has no end (ENDLESS_STEP).

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : four lists. at[0] has, for each row of the iterate, the index in `values` of the number of the block's first
        contact; so have at[1] for the rows of the step that is read, and at[3] for those of the step that is written.
        at[2] has one entry for each slipping component, 1 or 2: only its length matters, as the length of vectors.
    numbers : not used; all functions of a pass over the contacts take the same arguments.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    inverse = values[state[INVERSE] + m]
    smooth = inverse == 0.0
    friction, bound = values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    pull = vector(values, step, PULL, like, m)
    # what the stiffness resists to the change of the slip, and by it the steps of dual and bound
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
    bound_step = (values[step[RIGHT_HEAD] + m] - off) * inverse
    along, dual_along = reaches(values, state, bound_step, change, dual_step, m)
    # PRODUCT, its derivatives by the primal and by the dual length, and the mixed one
    products = [
        friction * bound + dot(slip, dual),
        friction * bound_step + dot(change, dual),
        dot(slip, dual_step),
        dot(change, dual_step),
    ]
    counted = [ti.select(smooth, 0.0, x) for x in ti.static([bound_step] + products)]
    return [counted[0]] + dual_step + [along, dual_along] + counted[1:]


@ti.func
def between(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact two numbers: the largest factors of a mixed step that keep its primal and its dual point
    in their cones (see `reaches`). The mixed step is first + share * (second - first), of two steps in memory.

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : four lists. at[0] has, for each row of the iterate, the index in `values` of the number of the block's first
        contact; so have at[1] for the rows of the first step, and at[3] for those of the second step. at[2] has one
        entry for each slipping component, 1 or 2: only its length matters, as the length of vectors.
    numbers : numbers[m] is the share.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    state, step, like, other = at[0], at[1], at[2], at[3]
    axes = ti.static(range(len(like)))
    share = numbers[m]
    change, dual_step = vector(values, step, CHANGE, like, m), vector(values, step, DUAL_STEP, like, m)
    to, dual_to = vector(values, other, CHANGE, like, m), vector(values, other, DUAL_STEP, like, m)
    bound_step = values[step[BOUND_STEP] + m]
    bound_mixed = bound_step + share * (values[other[BOUND_STEP] + m] - bound_step)
    mixed = [change[k] + share * (to[k] - change[k]) for k in axes]
    dual_mixed = [dual_step[k] + share * (dual_to[k] - dual_step[k]) for k in axes]
    return reaches(values, state, bound_mixed, mixed, dual_mixed, m)


@ti.func
def corrected(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact the aim of the corrector (the second solve of a Newton step), as the list [head, *tail,
    *pull]: the right-hand side, a number and a vector, and the pull on the contact's spheres that follows from it, a
    vector. Vectors have one number for each slipping component, 1 or 2.

    A contact has a primal point (bound of the slip, slip) and a dual point (friction limit, minus force). The corrector
    aims at a given value of their product, friction limit * bound - force . slip, and makes up for the second-order
    error of the predictor, the first solve (Mehrotra 1992). That error is the Jordan product of the predictor's steps
    of both points, each scaled: (a, b) o (c, e) = (a c + b.e, a e + c b), with heads a, c and tails b, e.

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : four lists. at[0] has, for each row of the iterate, the index in `values` of the number of the block's first
        contact; so have at[1] for the rows of the step that is read, and at[3] for those of the step that is written.
        at[2] has one entry for each slipping component, 1 or 2: only its length matters, as the length of vectors.
    numbers : numbers[m] is the value that is aimed at.
    m : number of the contact within its block, 0 to BLOCK - 1.
    """
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    zero = ti.cast(0.0, ti.f64)
    # the second-order error: the Jordan product of the predictor's scaled dual and primal steps
    dual_part = scaled(values, state, zero, vector(values, step, DUAL_STEP, like, m), m, 1)
    primal_part = scaled(values, state, values[step[BOUND_STEP] + m], vector(values, step, CHANGE, like, m), m, -1)
    found = jordan(dual_part[0], dual_part[1:], primal_part[0], primal_part[1:])
    mend = divided(values, state, found[0] - numbers[m], found[1:], m)
    dual = vector(values, state, DUAL, like, m)
    head = -values[state[FRICTION_ROW] + m] - mend[0]
    return right_side_and_pull(values, state, head, [-dual[k] - mend[1 + k] for k in axes], m)


@ti.func
def recentred(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact the aim of a further corrector (Gondzio 1996), as the list [head, *tail, *pull]: the
    right-hand side, a number and a vector, and the pull on the contact's spheres that follows from it, a vector.
    Vectors have one number for each slipping component, 1 or 2.

    A contact has a primal point (bound of the slip, slip) and a dual point (friction limit, minus force). After steps
    of given lengths the Jordan product of both, scaled, is a point (head, tail) with the eigenvalues head - |tail| and
    head + |tail|. The corrector moves each eigenvalue below the lower limit up to it, and each above the upper limit
    down to it, but by no more than the upper limit.

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : four lists. at[0] has, for each row of the iterate, the index in `values` of the number of the block's first
        contact; so have at[1] for the rows of the step that is read, and at[3] for those of the step that is written.
        at[2] has one entry for each slipping component, 1 or 2: only its length matters, as the length of vectors.
    numbers : (5 * BLOCK,), of which this contact has those at m, m + BLOCK, ...: length of the primal step, length of
        the dual step, lower limit, upper limit, and a choice: GO_ON to compute the aim; AS_READ or AS_WRITTEN, in a
        sample that needs no further corrector, to take the right-hand side of the step that is read or written.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    along, dual_along, low, high = numbers[m], numbers[BLOCK + m], numbers[2 * BLOCK + m], numbers[3 * BLOCK + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    dual_step = vector(values, step, DUAL_STEP, like, m)
    # the Jordan product of the scaled points after the steps, and its two eigenvalues
    after = [slip[k] + along * change[k] for k in axes]
    dual_after = [dual[k] + dual_along * dual_step[k] for k in axes]
    bound = values[state[BOUND] + m] + along * values[step[BOUND_STEP] + m]
    dual_part = scaled(values, state, values[state[FRICTION_ROW] + m], dual_after, m, 1)
    primal_part = scaled(values, state, bound, after, m, -1)
    found = jordan(dual_part[0], dual_part[1:], primal_part[0], primal_part[1:])
    tail = found[1:]
    length = size(tail)
    smaller, larger = found[0] - length, found[0] + length
    # what each eigenvalue lacks to be within the limits, and the point that has these eigenvalues along the same tail
    change_of_smaller = ti.max(ti.min(ti.max(smaller, low), high) - smaller, -high)
    change_of_larger = ti.max(ti.min(ti.max(larger, low), high) - larger, -high)
    share = ti.select(length > 0.0, (change_of_larger - change_of_smaller) * 0.5 / length, 0.0)
    mend = divided(values, state, (change_of_smaller + change_of_larger) * 0.5, [share * tail[k] for k in axes], m)
    choice, written = numbers[4 * BLOCK + m], at[3]
    right = [values[step[RIGHT_HEAD + k] + m] for k in ti.static(range(1 + len(like)))]
    kept = [values[written[RIGHT_HEAD + k] + m] for k in ti.static(range(1 + len(like)))]
    aim = [
        ti.select(choice == AS_WRITTEN, kept[k], ti.select(choice == AS_READ, right[k], right[k] + mend[k]))
        for k in ti.static(range(1 + len(like)))
    ]
    return right_side_and_pull(values, state, aim[0], aim[1:], m)


@ti.func
def taken(values: ti.template(), at: ti.template(), numbers: ti.template(), m):
    """Return for one contact its numbers after a step, those before, and its share of two sums after the step.

    The list has, where vectors have one number for each slipping component, 1 or 2:

    * bound of the slip, slip (vector), and dual, which is minus the force (vector), after the step;
    * the same three before the step;
    * friction limit * |slip|, of which the sum over the contacts is the power;
    * friction limit * |slip| + slip . dual, of which the sum is the excess of the power over the work of the forces.

    After the step a contact in no cone (row SMOOTH above 0) has the bound |slip|, and minus the friction along the slip
    as its dual.

    values : numbers of all contacts, flat, row by row (a row has one number of each): the iterate and two steps.
    at : four lists. at[0] has, for each row of the iterate, the index in `values` of the number of the block's first
        contact; so have at[1] for the rows of the step that is read, and at[3] for those of the step that is written.
        at[2] has one entry for each slipping component, 1 or 2: only its length matters, as the length of vectors.
    numbers : numbers[m] is the length of the primal step (of bound and slip), numbers[BLOCK + m] that of the dual step.
    m : number of the contact within its block, 0 to BLOCK - 1."""
    state, step, like = at[0], at[1], at[2]
    axes = ti.static(range(len(like)))
    smooth, friction, bound = values[state[SMOOTH] + m] > 0.0, values[state[FRICTION_ROW] + m], values[state[BOUND] + m]
    along, dual_along = numbers[m], numbers[BLOCK + m]
    slip = vector(values, state, SLIP, like, m)
    dual = vector(values, state, DUAL, like, m)
    change = vector(values, step, CHANGE, like, m)
    dual_step = vector(values, step, DUAL_STEP, like, m)
    # where the steps lead; a contact in no cone has its dual and its bound by the law of friction
    after = [slip[k] + along * change[k] for k in axes]
    length = size(after)
    dual_after = [
        ti.select(smooth, -friction * after[k] / ti.max(length, LEAST_DIVISOR), dual[k] + dual_along * dual_step[k])
        for k in axes
    ]
    bound_after = ti.select(smooth, length, bound + along * values[step[BOUND_STEP] + m])
    power = friction * length
    return [bound_after] + after + dual_after + [bound] + slip + dual + [power, power + dot(after, dual_after)]


def _row_numbers(*rows: tuple[int, tuple[int, int]]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the numbers of all rows in which some quantities stand, as two tuples: for contacts with one slipping
    component, and for contacts with two, whose vectors take more rows. A row of memory has one number of each contact.

    rows : for each quantity a pair: the number of its first row; and how many rows it has, itself a pair, for contacts
        with one component and with two.

    A scalar in row 1 and a vector from row 2 on, (1, (1, 1)) and (2, (1, 2)), give ((1, 2), (1, 2, 3)).
    """
    one, two = (tuple(first + k for first, counts in rows for k in range(counts[kind])) for kind in (0, 1))
    return one, two


SCALAR, VECTOR = (1, 1), (1, 2)
AIM = _row_numbers((RIGHT_HEAD, SCALAR), (RIGHT_TAIL, VECTOR), (PULL, VECTOR))
MADE = _row_numbers(
    (WEIGHT, SCALAR), (WEIGHT_HEAD, SCALAR), (TAIL, VECTOR), (POINT_HEAD, SCALAR), (POINT_TAIL, VECTOR),
    (INVERSE, SCALAR), (OFF, VECTOR), (STIFFNESS, (1, 3)),
)  # fmt: skip
EXTENT = _row_numbers((BOUND_STEP, SCALAR), (DUAL_STEP, VECTOR))
TAKEN = _row_numbers(
    (BOUND, SCALAR), (SLIP, VECTOR), (DUAL, VECTOR),
    (BOUND_BEFORE, SCALAR), (SLIP_BEFORE, VECTOR), (DUAL_BEFORE, VECTOR),
)  # fmt: skip
NO_NUMBERS = ((), ())


@ti.func
def apply_to_block(
    values: ti.template(), blocks: ti.template(), found: ti.template(), law: ti.template(), length, block, span,
    slots: ti.template(), writes: ti.template(), finds: ti.template(), like: ti.template(), numbers: ti.template(),
):  # fmt: skip
    """Call `law` for every contact of one block (BLOCK contacts with neighbouring numbers). Of the list of numbers that
    it returns the first are written into rows; each of the others is added to a sum, or kept if it is the least so far.

    values : numbers of the iterate and of two steps, flat, row by row; a row has one number of each contact.
    blocks : the same memory as vectors of BLOCK numbers.
    found : flat array of FOUND * n vectors of BLOCK numbers, changed in place. Result k of block b goes to the vector
        k * n + b // span % n, place by place: n parts of the contacts, or n samples, have sums of their own.
    law : function law(values, [state, old, like, new], numbers, m) of contact m of the block. Three lists say where its
        numbers stand: in rows of the iterate, of the step that is read, and of the step that is written. It returns a
        list: as many numbers as `writes` has rows, then as many as `finds` has entries.
    length : length of a row.
    block : number of the block.
    span : how many successive blocks add to the same sums.
    slots : two numbers, 0 or 1: which of the two steps is read, and which is written.
    writes : two tuples: rows of the iterate, and rows of the step that is written, for the first numbers of the list.
    finds : for each further number of the list its k, 0 to FOUND - 1; below LEAST_FOUND the least number is kept, else
        the sum.
    like : tuple with one entry for each slipping component of these contacts, 1 or 2; only its length matters.
    numbers : what the law takes besides, such as the length of a step: BLOCK numbers of each kind.
    """
    # where the numbers of the block's first contact stand, in the rows of the iterate and of the two steps
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
    # in each of these sums numbers are added up in the order of the blocks
    turns = found.shape[0] // FOUND
    for k in ti.static(range(len(finds))):
        at, more = finds[k] * turns + block // span % turns, rows[ti.static(len(to) + k)]
        if ti.static(finds[k] < LEAST_FOUND):
            found[at] = ti.min(found[at], more)
        else:
            found[at] = found[at] + more


@dataclass(frozen=True, eq=False)
class Passes:
    """A pass over the contacts, as four kernels. Only those that are used are compiled; the third takes less time to
    compile than the first two together.

    one, two, both : kernels for contacts with one slipping component, for those with two, and for both kinds.
    shared : kernel for both kinds whose work threads share; its results have the same bits.
    law : name of the function of one contact that is called for every contact.
    iterate, step : rows into which the first numbers of the law's list are written: of the iterate, and of a step. Each
        is two tuples, for contacts with one slipping component and with two. A row has one number of each contact.
    finds : for each further number of the list the index of its result over all contacts, 0 to FOUND - 1: the least
        number for indices below LEAST_FOUND, else the sum.
    """

    one: Callable
    two: Callable
    both: Callable
    shared: Callable
    law: str
    iterate: tuple
    step: tuple
    finds: tuple


def _kernels_over_contacts(
    law: Callable, iterate: tuple = NO_NUMBERS, step: tuple = NO_NUMBERS, finds: tuple = ()
) -> Passes:
    """Return the kernels, made by `_kernel_over_contacts`, that call `law` for every contact.

    law : function of one contact, such as `prepared`. It returns a list of numbers: first those that are written into
        rows (a row has one number for each contact), then those of which the sum or the least over all contacts is
        wanted.
    iterate : rows of the iterate that the law writes, as two tuples: for contacts with one slipping component, and for
        contacts with two, whose vectors take more rows.
    step : rows of the step that the law writes, as two such tuples; their values follow those of `iterate` in the list.
    finds : for each remaining number of the list, the index (0 to FOUND - 1) of its result; below LEAST_FOUND the least
        number over all contacts is found, else the sum."""
    of_one, of_two = (iterate[0], step[0]), (iterate[1], step[1])
    one, two = _kernel_over_contacts(law, of_one, None, finds), _kernel_over_contacts(law, None, of_two, finds)
    both = _kernel_over_contacts(law, of_one, of_two, finds)
    shared = _shared_kernel_over_contacts(law, of_one, of_two, finds)
    return Passes(one, two, both, shared, law.__name__, iterate, step, finds)


def _kernel_over_contacts(law: Callable, of_one: tuple | None, of_two: tuple | None, finds: tuple) -> Callable:
    """Return a kernel that calls `law` for every contact of some blocks, BLOCK contacts each. The list of numbers that
    the law returns is used in order: first new numbers of the iterate, then of the step; of each of the others the sum
    or the least over all contacts is found.

    law : function of one contact that returns a list of numbers, such as `prepared`.
    of_one, of_two : for contacts with one and with two slipping components, the rows that these numbers go to, as two
        tuples: rows of the iterate, and rows of the step; a row has one number of each contact. None to leave out these
        contacts.
    finds : for each remaining number, the index (0 to FOUND - 1) of its result; below LEAST_FOUND it is the least
        number over all contacts, else the sum.
    """
    has_one, has_two = of_one is not None, of_two is not None

    @ti.kernel
    def run(
        values: NUMBERS, blocks: BLOCKS, found: BLOCKS, numbers: NUMBERS, length: int, first_two: int, end: int,
        span: int, read_slot: int, write_slot: int,
    ):  # fmt: skip
        """Call `law`, the function of one contact for which this kernel is made, for all contacts. Write what it
        returns into rows, and into sums and least numbers.

        values : numbers of the iterate and of two steps, flat, row by row; a row has one number of each contact.
        blocks : the same memory as vectors of BLOCK numbers, one for each contact of a block.
        found : flat array of FOUND * n vectors of BLOCK numbers: sums and least numbers, changed in place. Result k of
            block b goes to the vector k * n + b // span % n, place by place.
        numbers : what the law takes besides, such as the length of a step: BLOCK numbers of each kind.
        length : length of a row.
        first_two : number of the first block of contacts with two slipping components; those with one stand before it.
        end : number of all blocks.
        span : how many successive blocks add to the same sums.
        read_slot, write_slot : which of the two steps in memory is read, and which is written, 0 or 1.
        """
        if ti.static(has_one):
            ti.loop_config(serialize=True)
            for block in range(first_two):
                apply_to_block(
                    values, blocks, found, law, length, block, span, [read_slot, write_slot], ti.static(of_one),
                    ti.static(finds), ti.static((0,)), numbers,
                )  # fmt: skip
        if ti.static(has_two):
            ti.loop_config(serialize=True)
            for block in range(first_two, end):
                apply_to_block(
                    values, blocks, found, law, length, block, span, [read_slot, write_slot], ti.static(of_two),
                    ti.static(finds), ti.static((0, 1)), numbers,
                )  # fmt: skip

    return run


def _shared_kernel_over_contacts(law: Callable, of_one: tuple, of_two: tuple, finds: tuple) -> Callable:
    """Return a kernel that calls `law` for every contact of one sample, on several threads.

    law, of_one, of_two, finds : as in :func:`_kernel_over_contacts`, which makes the kernel for one thread.
    """

    @ti.kernel
    def run(
        values: NUMBERS, blocks: BLOCKS, found: BLOCKS, numbers: NUMBERS, length: int, first_two: int, end: int,
        span: int, read_slot: int, write_slot: int,
    ):  # fmt: skip
        """Call `law`, the function of one contact for which this kernel is made, for all contacts of a sample. The
        contacts are divided into n parts, each with sums of its own; several threads take one part after the other.

        values, blocks, numbers, length, first_two, end, read_slot, write_slot : as in the kernel for one thread.
        found : flat array of FOUND * n vectors of BLOCK numbers; vector k * n + j has result k (see FOUND) of part j.
        span : number of blocks of each part; the last parts may have fewer, or none."""
        for item in range(found.shape[0] // FOUND * LEAST_CHUNK):
            if item % LEAST_CHUNK == 0:
                begin = item // LEAST_CHUNK * span
                stop = ti.min(begin + span, end)
                for block in range(begin, ti.min(stop, first_two)):
                    apply_to_block(
                        values, blocks, found, law, length, block, span, [read_slot, write_slot], ti.static(of_one),
                        ti.static(finds), ti.static((0,)), numbers,
                    )  # fmt: skip
                for block in range(ti.max(begin, first_two), stop):
                    apply_to_block(
                        values, blocks, found, law, length, block, span, [read_slot, write_slot], ti.static(of_two),
                        ti.static(finds), ti.static((0, 1)), numbers,
                    )  # fmt: skip

    return run


prepare = _kernels_over_contacts(prepared, MADE, AIM)
expand = _kernels_over_contacts(
    expanded, step=EXTENT, finds=(REACH, DUAL_REACH, PRODUCT, BY_REACH, BY_DUAL_REACH, BY_BOTH)
)
between_steps = _kernels_over_contacts(between, finds=(REACH, DUAL_REACH))
correct = _kernels_over_contacts(corrected, step=AIM)
recentre = _kernels_over_contacts(recentred, step=AIM)
take = _kernels_over_contacts(taken, TAKEN, finds=(POWER_FOUND, EXCESS))


@ti.func
def zero_of(together: ti.template()):
    """Return zero in double precision: one number, or, if `together` is True, a vector of LANES zeros, one for each of
    the samples that are worked on together."""
    if ti.static(together):
        return ti.Vector.zero(ti.f64, LANES)
    return ti.cast(0.0, ti.f64)


def _sums(together: bool, shared: bool = False) -> Callable:
    """Return a kernel that computes sums of numbers of an array, each over a list of places in it.

    together : True for LANES samples at a time, whose numbers form vectors; False for one sample.
    shared : True if threads share the sums.
    """
    kind = VECTORS if together else NUMBERS

    @ti.kernel
    def run(begins: INTEGERS, places: INTEGERS, values: kind, found: kind, first: int, to: int):
        """Set found[to + i], for every i, to a sum of numbers of `values`: of values[first + p] for each p in
        places[begins[i] : begins[i + 1]]. A place that is stored as ~p, a negative number, is subtracted instead of
        added.

        begins : where each list of places begins in `places`; one entry more than there are lists.
        places : all lists of places, one after the other; a place is an index counted from `first`.
        values, found : flat arrays, of which the second is written; vectors of LANES samples if several are worked on
            together.
        first, to : index in `values` of place 0, and in `found` of the first sum.
        """
        if ti.static(not shared):
            ti.loop_config(serialize=True)
        for i in range(begins.shape[0] - 1):
            total = zero_of(together)
            for k in range(begins[i], begins[i + 1]):
                minus = places[k] >> 31  # -1 for what is subtracted, 0 for the rest
                total = total + ti.cast(1 | minus, ti.f64) * values[first + (places[k] ^ minus)]
            found[to + i] = total

    return run


add_up, add_up_alone, add_up_shared = _sums(True), _sums(False), _sums(False, shared=True)
