"""Finds the contacts that are in some but not in all minimum cuts of a planar grid: exactly, whatever the weights.

Rounding weights down to whole units changes the length of a path of n contacts by less than n units. So a lightest path
crosses only contacts that lie on some path longer than the shortest one by less than that; there are seldom many. Among
these the search is repeated with exact weights, as whole numbers of Python.

Mark on a line from 0 to the least weight the interval of each contact of lightest paths: from the distance of the face
on its near side to that of the face on its far side. The intervals of one path cover the line exactly once. Contacts
without weight cover nothing; which of them a path crosses makes no difference. So a contact of one lightest path is in
all of them unless another contact of lightest paths covers a part of its interval.

Letters: B grids, w columns, h rows; weights `inner` (B, w - 1, h - 2) and `upward` (B, w, h - 1) as in paths.py.
"""

from bisect import bisect_left, bisect_right
from collections import defaultdict
from heapq import heappop, heappush
from itertools import accumulate

import numpy as np

from taichi_bearings.numerics.planar.paths import ShortestPaths, grids, through

Step = tuple[int, int, int]  # face that is left, face that is entered, weight of the contact between them


def equal_paths(
    inner: np.ndarray, upward: np.ndarray, unit: np.ndarray, path: ShortestPaths
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find a lightest path of each grid, and the contacts that are in some but not in all lightest paths.

    A path leads from the left to the right outside of a grid of w columns and h rows, from face to face across
    contacts; these are a cut of the grid between bottom and top.

    inner, upward : weights of the contacts of B grids: along rows without the end rows, (B, w - 1, h - 2), and between
        rows, (B, w, h - 1).
    unit : (B,) unit of weight in each grid.
    path : shortest paths of the same grids, by weights that were rounded down to multiples of the unit.
    returns : mask of the upward contacts of a lightest path; masks of the inner and of the upward contacts with weight
        that are in some but not in all lightest paths.
    """
    contact, ends, weight, shares = _steps_in_doubt(inner, upward, unit, path)
    crossed, tied = np.zeros((2, upward.size + inner.size), dtype=bool)
    faces = path.from_left[0].size
    for grid, share in enumerate(shares):
        part, exponent = np.frexp(weight[share])
        parts, shifts = np.ldexp(part, 53).astype(np.int64).tolist(), (exponent - exponent.min()).tolist()
        whole = [number << shift for number, shift in zip(parts, shifts, strict=True)]  # of one unit, exactly
        steps = list(zip(*ends[:, share].tolist(), whole, strict=True))
        left = grid * faces
        own, unshared = _lightest(steps, left, left + faces - path.from_left.shape[2])
        crossed[contact[share[own]]], tied[contact[share[unshared]]] = True, True
    upward_tied, inner_tied = np.split(tied, [upward.size])
    return (
        crossed[: upward.size].reshape(upward.shape),
        inner_tied.reshape(inner.shape),
        upward_tied.reshape(upward.shape),
    )


def _steps_in_doubt(
    inner: np.ndarray, upward: np.ndarray, unit: np.ndarray, path: ShortestPaths
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[np.ndarray]]:
    """Return the steps (crossings of one contact in one direction) that may lie on a lightest path by exact weights.

    Rounding weights down to multiples of a unit makes a path of n contacts shorter by less than n units. So if the
    shortest path by rounded weights has n contacts, a path that is lightest by exact weights is, by rounded ones,
    longer than it by less than n units. The steps of all paths that are no longer than that are returned.

    inner, upward : weights of the contacts of B grids of w columns and h rows: along rows, without the end rows, (B, w
        - 1, h - 2); between rows, (B, w, h - 1).
    unit : (B,) unit of weight in each grid.
    path : shortest paths of the same grids, by weights that were rounded down to multiples of the unit.
    returns : contact (steps,), its index among all of `upward`, followed by all of `inner`; faces (2, steps), the one
        that is left and the one that is entered; weight (steps,), not rounded; and for each grid the indices of its
        steps. Each outside is one face: the first one of the first, or last, column.
    """
    units = np.floor(inner / grids(unit)), np.floor(upward / grids(unit))
    face = np.arange(path.from_left.size).reshape(path.from_left.shape)
    face[:, 0], face[:, -1] = face[:, 0, :1], face[:, -1, :1]  # each outside is one
    rightward, leftward, climbing, falling = through(*units, path.from_left, path.from_right)
    beside, within = (face[:, :-1], face[:, 1:]), face[:, 1:-1]
    limit, found = grids(path.length + path.contacts), []
    # the last number is the index of the first contact of the kind
    for length, tail, head, weight, first in (
        (rightward, *beside, upward, 0),
        (leftward, *beside[::-1], upward, 0),
        (climbing, within[..., :-1], within[..., 1:], inner, upward.size),
        (falling, within[..., 1:], within[..., :-1], inner, upward.size),
    ):
        near = np.nonzero(length < limit)
        found.append((near[0], first + np.ravel_multi_index(near, length.shape), tail[near], head[near], weight[near]))
    grid, contact, tails, heads, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    shares = np.split(np.argsort(grid, kind="stable"), np.cumsum(np.bincount(grid))[:-1])
    return contact, np.stack([tails, heads]), weights, shares


def _lightest(steps: list[Step], left: int, right: int) -> tuple[list[int], list[int]]:
    """Return the numbers of the steps of a lightest path, and of steps that are in some but not in all lightest paths.

    A step crosses one contact from a face of a grid to a neighbouring face.

    steps : of each step the number of the face it leaves, that of the face it enters, and its weight, a whole number.
    left, right : numbers of the faces where paths begin and end.
    """
    from_left, before = _distances(steps, left)
    from_right, _ = _distances([(head, tail, weight) for tail, head, weight in steps], right)
    own, face = list[int](), right
    while face != left:
        own.append(before[face])
        face = steps[own[-1]][0]
    own.reverse()
    # The contacts of the path divide the line of distances at `spots`. `change` has, for each of these intervals, how
    # many other contacts of lightest paths begin to overlap it, less how many overlapped the one before but not it.
    spots = [0, *(from_left[steps[number][1]] for number in own)]
    unshared, change, of_path = list[int](), [0] * (len(own) + 1), set(own)
    for number, (tail, head, weight) in enumerate(steps):
        if number not in of_path and weight and from_left[tail] + weight + from_right[head] == spots[-1]:
            unshared.append(number)
            first, end = bisect_right(spots, from_left[tail]) - 1, bisect_left(spots, from_left[head])
            if first < end:
                change[first] += 1
                change[end] -= 1
    covered = accumulate(change[:-1])
    return own, unshared + [n for n, others in zip(own, covered, strict=True) if others and steps[n][2]]


def _distances(steps: list[Step], start: int) -> tuple[dict[int, int], dict[int, int]]:
    """Return the distance of each face that can be reached from the face `start`, by Dijkstra's method, and the number
    of the last step on the way there, -1 for `start` itself.

    steps : of each step the face it leaves, the face it enters, and its length, a whole number.
    """
    onward = defaultdict[int, list[int]](list)
    for number, (tail, _, _) in enumerate(steps):
        onward[tail].append(number)
    distance, before, waiting = dict[int, int](), dict[int, int](), [(0, start, -1)]
    while waiting:
        length, face, step = heappop(waiting)
        if face not in distance:
            distance[face], before[face] = length, step
            for number in onward[face]:
                heappush(waiting, (length + steps[number][2], steps[number][1], number))
    return distance, before


__all__ = ["equal_paths"]
