"""Minimum cuts of planar grids, exactly: a cut between bottom and top is a path from left to right of the dual graph.

The faces of a grid, together with the outside on its left and the outside on its right, are the nodes of the dual
graph; each contact is an edge between the two faces beside it. The contacts that a path from the left to the right
outside crosses separate bottom from top, so the lightest cut is the shortest path (Hu, Integer Programming and Network
Flows, 1969; Reif, SIAM J. Comput. 12, 1983). The distances from the left, cut off at the least weight, are the
potential of a largest flow: across each contact they differ by no more than its weight.

Weights are rounded down to multiples of a unit, 2^-50 to 2^-52 of the least weight, so that every distance in use is an
integer below 2^52. So flows balance without any rounding and are admissible, however many decades the weights span, and
the least weight is wrong by less than a unit for each contact of the cut. So a path of n contacts is proven to be the
only lightest one if the next one is n units longer. If it is not, the exact weights decide (ties.py).

Letters: B grids, w columns, h rows. `inner` are the sideways weights without those of the end rows, (B, w - 1, h - 2).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from taichi_bearings.numerics.planar.paths import ShortestPaths, grids, shortest_paths
from taichi_bearings.numerics.planar.ties import equal_paths

BUNDLE_FACES = 2_000_000  # faces that one graph holds: about 0.4 GB


@dataclass(frozen=True)
class MinimumCuts:
    """Minimum cuts of B grids of w columns and h rows, and largest flows, which have the same weight.

    above : (B, w, h) True for spheres on the top side of a lightest cut. The contacts with weight between both sides
        are the cut.
    sideways_flow, upward_flow : (B, w - 1, h) and (B, w, h - 1), flow across each contact along rows and between rows,
        positive towards the higher index; balanced but in the end rows.
    sideways_tied, upward_tied : of the same shapes, True for contacts with weight that are in some but not in all
        minimum cuts.
    weight : (B,) size of the flow. It is the weight of the cut after that of each contact was rounded down to whole
        units of about 2^-50 of the sum; 0 where contacts with weight do not join bottom and top.
    next_weight : (B,) weight of the lightest other cut that leaves the spheres of either side connected, rounded
        likewise: equal to `weight` for ties, else larger; NaN where contacts without weight hide it.
    """

    above: np.ndarray
    sideways_flow: np.ndarray
    upward_flow: np.ndarray
    sideways_tied: np.ndarray
    upward_tied: np.ndarray
    weight: np.ndarray
    next_weight: np.ndarray

    @property
    def tied(self) -> np.ndarray:
        """(grids B,) number of contacts that are in some but not in all minimum cuts of a grid."""
        return np.asarray(sum(np.count_nonzero(tied, axis=(1, 2)) for tied in (self.sideways_tied, self.upward_tied)))

    @property
    def unique(self) -> np.ndarray:
        """(grids B,) True for the grids of which every other cut is heavier than the one found."""
        found: np.ndarray = self.tied == 0
        return found


def minimum_cuts(sideways: np.ndarray, upward: np.ndarray) -> Iterator[tuple[slice, MinimumCuts]]:
    """Yield the cuts of least weight between the bottom row and the top row of each grid, some grids at a time.

    sideways : weights (B, w - 1, h) of contacts along the rows of B grids of w columns and h rows, none negative; those
        of the bottom and the top row take no part.
    upward : weights (B, w, h - 1) of contacts between the rows.
    yields : pairs: the range of some of the B grids, as a slice, and the cuts of these grids.
    """
    batch, columns, rows = upward.shape
    step = max(1, BUNDLE_FACES // ((columns - 1) * rows))
    for start in range(0, batch, step):
        part = slice(start, min(start + step, batch))
        yield part, _cuts_of(sideways[part, :, 1:-1], upward[part])


def _cuts_of(inner: np.ndarray, upward: np.ndarray) -> MinimumCuts:
    """Return the minimum cuts of B grids of w columns and h rows.

    inner : (B, w - 1, h - 2) weights along rows, without those of the end rows.
    upward : (B, w, h - 1) weights between rows.
    """
    unit, path = _fine_paths(inner, upward)
    batch, columns, gaps = upward.shape
    sideways_flow, sideways_tied = (np.zeros((batch, columns - 1, gaps + 1), dtype) for dtype in (float, bool))
    upward_tied, crossed = np.zeros(upward.shape, dtype=bool), path.upward
    weight, next_weight = path.length * unit, np.maximum(path.next_length, path.length) * unit
    # Rounding down takes less than a unit from each contact; so a path is surely heavier if it is longer than the
    # shortest one by a unit for each contact of that. Other grids are examined with exact weights.
    unsure = np.flatnonzero(path.next_length < path.length + path.contacts)
    if len(unsure):
        crossed[unsure], sideways_tied[unsure, :, 1:-1], upward_tied[unsure] = equal_paths(
            inner[unsure], upward[unsure], unit[unsure], path.pick(unsure)
        )
        tied = _any_in_grid(sideways_tied[unsure]) | _any_in_grid(upward_tied[unsure])
        beyond = np.maximum(next_weight[unsure], np.nextafter(weight[unsure], np.inf))
        # paths across absent contacts may hide the next one
        beyond[_any_in_grid(inner[unsure] == 0) | _any_in_grid(upward[unsure] == 0)] = np.nan
        next_weight[unsure] = np.where(tied, weight[unsure], beyond)
    above = np.zeros((batch, columns, gaps + 1), dtype=bool)
    np.logical_xor.accumulate(crossed, axis=2, out=above[..., 1:])  # each crossing of the path changes the side
    potential = np.minimum(path.from_left, grids(path.length)) * grids(unit)
    sideways_flow[..., 1:-1] = -np.diff(potential[:, 1:-1], axis=2)
    return MinimumCuts(
        above=above,
        sideways_flow=sideways_flow,
        upward_flow=np.diff(potential, axis=1),
        sideways_tied=sideways_tied,
        upward_tied=upward_tied,
        weight=weight,
        next_weight=next_weight,
    )


def _any_in_grid(values: np.ndarray) -> np.ndarray:
    """Return (grids,) True for the grids in which some of the values (grids, columns, rows) are true."""
    return np.asarray(values.any(axis=(1, 2)))


def _fine_paths(inner: np.ndarray, upward: np.ndarray) -> tuple[np.ndarray, ShortestPaths]:
    """Return for each of B grids a unit of weight (B,), and the shortest path through its faces from left to right.
    Crossing a contact costs its weight in whole units, rounded down; the contacts that are crossed are a cut between
    bottom and top.

    inner, upward : weights of the contacts of grids of w columns and h rows: (B, w - 1, h - 2) along rows, without the
        end rows, and (B, w, h - 1) between rows.

    Units are powers of two, so fine that a path is 2^50 to 2^52 units long and doubles add its lengths exactly. A path
    has the length 0 where the least weight of a cut is 0.
    """
    at_most = upward.sum(axis=1).min(axis=1)  # the weight of a straight cut
    lightest = np.minimum(*(np.min(of, axis=(1, 2), where=of > 0, initial=np.inf) for of in (inner, upward)))
    lightest[np.isinf(lightest)] = 1.0
    while True:
        # where a cut of no weight is known, the lightest contact is at least one unit long
        unit = np.ldexp(1.0, np.where(at_most > 0, np.frexp(at_most)[1] - 52, np.frexp(lightest)[1] - 1))
        path = shortest_paths(np.floor(inner / grids(unit)), np.floor(upward / grids(unit)))
        found = np.sum(inner, axis=(1, 2), where=path.inner) + np.sum(upward, axis=(1, 2), where=path.upward)
        coarse = (path.length < 2.0**50) & (found > 0) & (at_most > 0)
        if not coarse.any():
            return unit, path
        at_most = np.where(coarse | (found == 0), found, at_most)


__all__ = ["MinimumCuts", "minimum_cuts"]
