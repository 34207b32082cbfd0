"""Decides where the updates of fronts are stored, so that little memory is enough for all that are needed at one time.

A *front* is a dense block of the factorisation: unknowns that are eliminated together. Its *update* is the matrix that
the elimination adds to that of later unknowns; it has to be stored until the front above has read it.

Memory is allotted backwards in time, from the last front to the first: an update takes the first free stretch at the
time when it is read, and gives it back at the time when it is made. So the updates that the last fronts read are one
after the other at the start of the memory; at that time the columns of the factor leave the least memory free.
"""

from bisect import bisect_left

import numpy as np

ENDLESS = 2**62  # end of the free memory


class Stretches:
    """The free stretches of an endless memory, in the order in which they lie; no two of them touch."""

    def __init__(self) -> None:
        """Begin with all memory free."""
        self._begins, self._ends = [0], [ENDLESS]

    @property
    def extent(self) -> int:
        """Number of doubles from the start of the memory to the end of the last one in use."""
        return self._begins[-1]

    def take(self, length: int) -> int:
        """Return the begin of the first free stretch of `length` doubles, which are then in use."""
        which = next(n for n, begin in enumerate(self._begins) if self._ends[n] - begin >= length)
        begin = self._begins[which]
        if length:
            self._begins[which] += length
            if self._begins[which] == self._ends[which]:
                del self._begins[which], self._ends[which]
        return begin

    def give(self, begin: int, length: int) -> None:
        """Make the `length` doubles from `begin` on free again."""
        if not length:
            return
        which, end = bisect_left(self._begins, begin), begin + length
        if self._begins[which] == end:
            end = self._ends[which]
            del self._begins[which], self._ends[which]
        if which and self._ends[which - 1] == begin:
            self._ends[which - 1] = end
        else:
            self._begins.insert(which, begin)
            self._ends.insert(which, end)


def branch_of(fronts: int, branches: np.ndarray) -> np.ndarray:
    """Return (fronts,) the index of the branch that each front is in, -1 for a front in no branch.

    fronts : number of fronts, the dense blocks of a factorisation.
    branches : (n, 2), index of the first front of each branch (a subtree of fronts with neighbouring indices), and of
        the front after its last.
    """
    found = np.full(fronts, -1)
    for number, (first, end) in enumerate(branches.tolist()):
        found[first:end] = number
    return found


def places_of_updates(
    parent: np.ndarray, size: np.ndarray, batches: list[np.ndarray], branches: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the update of each front is stored, and how much of the memory for updates each batch needs.

    parent : (fronts,) index of the front above each, or -1.
    size : (fronts,) doubles of each update, the matrix that a front adds to that of later unknowns.
    batches : for each batch the indices of its fronts, which are worked on at once; children come first.
    branches : (n, 2), first front and end of each subtree whose fronts are worked on one after the other, while other
        branches of its batch are worked on as well. Only the update of its last front outlasts the batch.
    returns : (fronts,) begin of each update, and (batches,) end of what is in use while each batch is worked on; both
        in doubles from the start of the memory for updates.
    """
    members = [of.tolist() for of in batches]
    if not len(branches):
        return _places(parent, size, members, [0] * len(batches))[:2]
    # Updates inside a branch are placed within a stretch of their own, `scratch`, that is free again after its batch.
    lasting, inside, scratch = size.copy(), np.zeros_like(size), np.zeros(len(branches), dtype=np.int64)
    known = dict[bytes, tuple[np.ndarray, int]]()  # branches of a lattice are often alike
    for number, (first, end) in enumerate(branches.tolist()):
        lasting[first : end - 1] = 0
        above, short = parent[first : end - 1] - first, size[first : end - 1]
        above[above == end - 1 - first] = -1
        alike = above.tobytes() + short.tobytes()
        if alike not in known:
            # each front is a batch; updates that the last front of the branch reads stay to the end
            alone = [[n] for n in range(end - 1 - first)]
            places, within, _ = _places(above, short, alone, [0] * len(alone))
            known[alike] = places, int(within.max(initial=0))
        inside[first : end - 1], scratch[number] = known[alike]
    of_branch = branch_of(len(size), branches)
    of_batch = [np.unique(of_branch[of]) if of_branch[of[0]] >= 0 else branches[:0, 0] for of in batches]
    lengths = [int(scratch[own].sum()) for own in of_batch]
    places, extents, starts = _places(parent, lasting, members, lengths)
    for start, own in zip(starts, of_batch, strict=True):
        for number, begin in zip(own.tolist(), (start + np.cumsum(scratch[own]) - scratch[own]).tolist(), strict=True):
            first, end = branches[number]
            places[first : end - 1] = begin + inside[first : end - 1]
    return places, extents


def _places(
    parent: np.ndarray, size: np.ndarray, batches: list[list[int]], scratch: list[int]
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """Return where updates are stored, how much memory each batch needs, and where the scratch memory of each batch is.

    parent : (fronts,) index of the front above each, or -1 if no front reads its update: then it stays.
    size : (fronts,) doubles of each update, the matrix that a front adds to that of later unknowns.
    batches : for each batch the indices of its fronts, which are worked on at once; children come first.
    scratch : doubles that each batch needs besides, while it is worked on.
    returns : (fronts,) begin of each update; (batches,) end of what is in use while each batch is worked on; begin of
        the scratch memory of each batch. All are in doubles from the start of the memory for updates.
    """
    free, places, doubles, number = Stretches(), [0] * len(size), size.tolist(), len(batches)
    extents, starts, batch = [0] * number, [0] * number, [number] * (len(size) + 1)  # the last one is that of no parent
    taken = [list[int]() for _ in range(number + 1)]  # for each batch the fronts whose updates it reads
    for number, members in enumerate(batches):
        for front in members:
            batch[front] = number
    for front, above in enumerate(parent.tolist()):
        taken[batch[above]].append(front)
    # backwards in time: each batch allots memory to the updates that it reads, and frees that of those it makes
    for number in range(len(batches), -1, -1):
        # the largest first, as they fit into the fewest stretches
        for front in sorted(taken[number], key=doubles.__getitem__, reverse=True):
            places[front] = free.take(doubles[front])
        if number == len(batches):
            continue
        starts[number] = free.take(scratch[number])
        extents[number] = free.extent
        free.give(starts[number], scratch[number])
        for front in batches[number]:
            free.give(places[front], doubles[front])
    return np.array(places), np.array(extents), starts
