"""Random packings of two sizes of spheres or discs that touch exactly, deposited one by one.

After Bennett, J. Appl. Phys. 43, 2727 (1972): on a floor of spheres at random places each next one, its size drawn,
goes into the lowest pocket where it touches D others and overlaps none. So there are E = D (N - F) contacts of N
spheres, F of them on the floor: just as many as hold every sphere in place (isostatic). No sphere is loose. Sides are
periodic.

pocket : a place where a new sphere would touch D others. D is the dimension, 2 or 3. Lengths are in radii of the small
spheres.
"""

from functools import lru_cache
from heapq import heappop, heappush
from itertools import product
from math import floor, pi

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.options import finite_number, whole
from taichi_bearings.scene.generators.lattices import Built
from taichi_bearings.words import shown

MOST_DEPOSITED = 200_000
FILLED = {2: 0.78, 3: 0.57}  # fraction of the box that spheres fill; with it a box is made about as wide as high
NARROWEST = 4.0  # least width in diameters of large spheres, so that two spheres do not touch around both sides
FLOOR_TRIES = 60  # places tried for each sphere that the floor could hold
# least squared distance of a pocket from the line or plane of the spheres that it touches: rounding stays small
FLATTEST = 1e-3
CLAIMED_OVERLAP = 1e-12  # overlap that may be rounding, relative to the sum of the radii
# how spheres nearby are found, on which no result depends: length of a cell over the largest diameter; part of a
# squared distance that exceeds its rounding
CELL_SPARE, ROUGHLY = 1.01, 1e-9
MOST_COMPARED = 200  # with no more spheres, all are compared with a place by arrays

Pocket = tuple[float, int, np.ndarray, tuple[int, ...], int]
"""A pocket: its height, its number, its place (D,), the numbers of the spheres that it touches, and how many spheres
were placed when it was found."""


class _Heap:
    """The spheres placed so far, in D dimensions, and the pockets (places for a further sphere that touches D others),
    lowest first.

    All lengths are in radii of the small spheres.

    place, radius : (spheres N, D) and (N,), centres and radii of the spheres; only the first `count` are placed.
    sides : (D,), lengths of the periodic sides, infinite along the height.
    sizes : the two radii.
    count, made : numbers of spheres placed, and of pockets made, so far.
    pockets : for each of the two radii a heap (of `heapq`) of the pockets for a sphere of this radius. A pocket is a
        tuple: height, number of the pocket, place, numbers of the D spheres that form it, and `count` when it was made.
    across : (D,), lengths of the cells of a grid: spheres that touch are in one cell or in neighbouring ones.
    cells : D - 1 numbers of cells along the periodic sides.
    inside : numbers of the spheres in each cell, by the D indices of the cell, in ascending order.
    spots, radii : the contents of `place` and `radius` as lists, which are read faster one by one.
    """

    def __init__(self, count: int, width: float, ratio: float, dimension: int) -> None:
        """Begin without spheres.

        count : number of spheres to come.
        width : length of each periodic side, in radii of the small spheres.
        ratio : radius of the large spheres over that of the small ones.
        dimension : D, 2 or 3.
        """
        self.place, self.radius = np.empty((count, dimension)), np.empty(count)
        self.sides = np.append(np.full(dimension - 1, width), np.inf)
        self.sizes = (1.0, ratio)
        self.count, self.made = 0, 0
        self.pockets: dict[float, list[Pocket]] = {size: [] for size in self.sizes}
        reach = 2 * ratio * CELL_SPARE
        self.cells = (max(1, int(width / reach)),) * (dimension - 1)
        self.across = np.append(width / np.array(self.cells), reach)
        self.inside: dict[tuple[int, ...], list[int]] = {}
        self.spots, self.radii = list[list[float]](), list[float]()

    def _numbers_in_cells(self, place: np.ndarray, away: int) -> list[list[int]]:
        """Return the numbers of the spheres near a place: for each cell of the grid that is not empty and at most
        `away` cells from that of the place, a list in ascending order.

        place : (dimensions D,), coordinates.
        away : number of cells. With 1 all spheres are found that can touch a sphere at the place; with 2 also all that
            can touch one of those.
        """
        *own, height = self._cell(place)
        steps = range(-away, away + 1)
        ways = [{(at + step) % cells for step in steps} for at, cells in zip(own, self.cells, strict=True)]
        there = map(self.inside.get, product(*ways, range(height - away, height + away + 1)))
        return [numbers for numbers in there if numbers]

    def near(self, place: np.ndarray, away: int) -> np.ndarray:
        """Return the numbers (n,) of the n spheres near a place, in ascending order.

        place : (dimensions D,), coordinates.
        away : spheres are taken from all cells of the grid that are at most so many cells from that of the place.
        """
        found = [number for numbers in self._numbers_in_cells(place, away) for number in numbers]
        return np.sort(np.array(found, dtype=np.int64))

    def _cell(self, place: np.ndarray) -> tuple[int, ...]:
        """Return the D indices of the cell in which a place (D,) lies, or its image between the periodic sides."""
        *own, height = map(floor, (place / self.across).tolist())
        return *(at % cells for at, cells in zip(own, self.cells, strict=True)), height

    def vectors_from(self, place: np.ndarray, others: slice | np.ndarray) -> np.ndarray:
        """Return vectors (n, dimensions D) from a place (D,) to the nearest images of n spheres.

        place : coordinates, in radii of the small spheres.
        others : numbers of the n spheres, or a slice of all.
        """
        vector: np.ndarray = self.place[others] - place
        vector[:, :-1] -= self.sides[:-1] * np.rint(vector[:, :-1] / self.sides[:-1])
        return vector

    def is_free(self, place: np.ndarray, size: float, since: int = 0) -> bool:
        """Return True if a sphere of radius `size` at a place (dimensions D,) overlaps none of the spheres from number
        `since` on.

        place : coordinates of the centre, in radii of the small spheres.
        size : radius of the new sphere, in radii of the small spheres.
        since : number of the first sphere that is looked at.
        """
        others: slice | np.ndarray = slice(since, self.count)
        if self.count - since > MOST_COMPARED:
            if self._clearly_overlaps(place, size, since):
                return False
            others = self.near(place, 1)
            others = others[others >= since]
        reach = (self.radius[others] + size) * (1 - CLAIMED_OVERLAP)
        return bool(((self.vectors_from(place, others) ** 2).sum(axis=1) >= reach**2).all())

    def _clearly_overlaps(self, place: np.ndarray, size: float, since: int) -> bool:
        """Return True if a sphere of radius `size` at a place (dimensions D,) surely overlaps one of the spheres from
        number `since` on, by more than rounding. False says nothing. Spheres are looked at one by one, which takes less
        time than arrays where there are few."""
        here, width = place.tolist(), float(self.sides[0])
        for numbers in self._numbers_in_cells(place, 1):
            for number in reversed(numbers):
                if number < since:
                    break
                *other, height = self.spots[number]
                square = (height - here[-1]) ** 2
                for a, b in zip(here, other, strict=False):
                    square += (a - b - width * round((a - b) / width)) ** 2
                if square < (self.radii[number] + size) ** 2 * (1 - ROUGHLY):
                    return True
        return False

    def put(self, place: np.ndarray, size: float) -> None:
        """Add a sphere of radius `size` at a place (D,), and find the pockets that it forms with others: the places
        where a further sphere would touch it and D - 1 others, and overlap none.
        """
        # neighbours near enough to touch a further sphere that touches the new one
        near = self.near(place, 2)
        vector = self.vectors_from(place, near)
        close = (vector**2).sum(axis=1) < (size + self.radius[near] + 2 * self.sizes[1]) ** 2
        near, vector = near[close], vector[close]
        # store the new sphere
        number = self.count
        self.place[number, :-1], self.place[number, -1] = np.mod(place[:-1], self.sides[:-1]), place[-1]
        self.radius[number], self.count = size, number + 1
        self.inside.setdefault(self._cell(self.place[number]), []).append(number)
        self.spots.append(self.place[number].tolist())
        self.radii.append(size)
        # new pockets, for a further sphere of either size, whose centre must be above height 0
        pairs = _Pairs(vector)
        for new, pockets in self.pockets.items():
            reach = self.radius[near] + new
            middle, touched = pairs.touching(size + new, reach)
            above = place[-1] + middle[:, -1] > 0
            middle, touched = middle[above], touched[above]
            free = _overlap_nothing(middle, vector, reach * (1 - CLAIMED_OVERLAP))
            for offset, others in zip(middle[free], touched[free], strict=True):
                self.made += 1
                there = place + offset
                heappush(pockets, (float(there[-1]), self.made, there, (number, *near[others].tolist()), self.count))

    def fill(self, size: float) -> tuple[int, ...] | None:
        """Put a sphere of radius `size` into the lowest pocket, a place where it touches D spheres and overlaps none;
        return the numbers of these D spheres.

        None if no pocket is left.
        """
        while self.pockets[size]:
            _, _, place, touched, since = heappop(self.pockets[size])
            if self.is_free(place, size, since):
                self.put(place, size)
                return touched
        return None


class _Pairs:
    """Geometry of a sphere at 0 and n neighbours in D dimensions, from which follow the places where a new sphere of
    either size touches the one at 0 and D - 1 of the neighbours.

    vector, size, unit : (n, D), (n,) and (n, D), centres of the neighbours, their distances from 0 and directions.
    others : (choices, D - 1), numbers of the neighbours that the new sphere is to touch: each one, or in 3D each pair.
    cosine, sine : (pairs,) in 3D, of the angle between both neighbours of a pair; a sine of 0 is stored as infinite.
    flat : (pairs,) mask in 3D, True for pairs that are too nearly in line with 0.
    """

    def __init__(self, vector: np.ndarray) -> None:
        """Compute what does not depend on the size of the new sphere.

        vector : (n neighbours, D dimensions), centres of the neighbours, in radii of the small spheres.
        """
        self.vector, self.size = vector, np.linalg.norm(vector, axis=1)
        self.unit = vector / self.size[:, None]
        if vector.shape[1] == 3:
            self.others = _all_pairs(len(vector))
            one, two = self.others.T
            self.cosine = (self.unit[one] * self.unit[two]).sum(axis=1)
            self.sine = np.sqrt(np.maximum(1 - self.cosine**2, 0.0))
            self.sine[self.sine == 0] = np.inf
            self.flat = np.isinf(self.sine) | (self.sine**2 < FLATTEST)
        else:
            self.others = np.arange(len(vector))[:, None]

    def touching(self, first: float, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return places (places, dimensions D) where a new sphere touches the sphere at 0 and D - 1 neighbours, and the
        numbers (places, D - 1) of these neighbours.

        first : distance of the new centre from 0, a sum of two radii.
        reach : (neighbours,), its distances from the centres of the neighbours, sums of two radii. Lengths are in radii
            of the small spheres.
        """
        # the distances give the component of the new centre along the unit vector to each neighbour
        along, unit = (first**2 - reach**2 + self.size**2) / (2 * self.size), self.unit
        # they make up the `foot`; both solutions are at the squared distance `left` from it, along `across`
        if self.vector.shape[1] == 2:
            left = first**2 - along**2
            real = left > FLATTEST
            foot, across = along[real, None] * unit[real], unit[real][:, ::-1] * [-1.0, 1.0]
        else:
            # two neighbours: `side` is the unit vector across the first one in the plane of both
            one, two = self.others.T
            beside = (along[two] - self.cosine * along[one]) / self.sine
            left = first**2 - along[one] ** 2 - beside**2
            left[self.flat] = -1.0
            real = left > FLATTEST
            one, two = one[real], two[real]
            side = (unit[two] - self.cosine[real, None] * unit[one]) / self.sine[real, None]
            foot = along[one, None] * unit[one] + beside[real, None] * side
            across = _cross(unit[one], side)
        height, others = np.sqrt(left[real])[:, None] * across, self.others[real]
        return np.concatenate([foot + height, foot - height]), np.concatenate([others, others])


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the cross products of vectors, as `numpy.cross` does, in a third of the time.

    first, second : (vectors, 3), as is the result.
    """
    (x, y, z), (a, b, c) = first.T, second.T
    return np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)


@lru_cache
def _all_pairs(count: int) -> np.ndarray:
    """Return all pairs of numbers below `count`, (pairs, 2), the smaller one first."""
    return np.column_stack(np.triu_indices(count, 1))


def _overlap_nothing(middle: np.ndarray, vector: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return a mask (places,) of the places where a new sphere overlaps no other one.

    middle : (places, dimensions D), the places.
    vector : (spheres, D), centres of the others.
    reach : (spheres,), the least distance that the new centre must have from each of these.

    Matrix products first leave out most of the places, those that are clearly too close to some other sphere; ROUGHLY
    covers their rounding.
    """
    squares = (middle**2).sum(axis=1)[:, None] + (vector**2).sum(axis=1) - 2 * (middle @ vector.T)
    found: np.ndarray = (squares > reach**2 * (1 - ROUGHLY)).all(axis=1)
    some = np.flatnonzero(found)
    exact = ((middle[some, None] - vector) ** 2).sum(axis=2)
    found[some] = (exact >= reach**2).all(axis=1)
    return found


def built(
    spheres: int, dimension: int, ratio: float, large: float, width: float | None, rng: np.random.Generator
) -> tuple[np.ndarray, Built]:
    """Return radii (spheres N,) and a tuple with places (N, dimensions D), contacts (contacts E, 2), normals (E, D),
    signs (N,), which are all 1, and driven bodies (N,): 0 for the floor, 1 for spheres at the surface, -1 for others.

    Lengths are in radii of the small spheres, but for `width`.

    spheres : number N.
    dimension : D, 2 or 3.
    ratio : radius of the large spheres over that of the small ones.
    large : fraction of the spheres that are large.
    width : width of the box in diameters of small spheres; None for about its height.
    rng : generator of the random numbers.

    Raises InputError for arguments that are not allowed, or if no pocket is left for a sphere.
    """
    spheres = whole(10, MOST_DEPOSITED).named("spheres", spheres)
    if dimension not in (2, 3):
        raise InputError(f"dimension is {shown(dimension)}; it must be 2 or 3")
    ratio, large = finite_number("ratio", ratio), finite_number("large", large)
    if not (1 <= ratio <= 5 and 0 <= large <= 1):
        raise InputError(
            f"ratio (of the two radii) is {ratio:g} and large (the share of large spheres) is {large:g}; ratio must "
            "be from 1 to 5, large from 0 to 1"
        )
    volume = spheres * (pi if dimension == 2 else 4 * pi / 3) * (1 - large + large * ratio**dimension)
    usual = (volume / FILLED[dimension]) ** (1 / dimension)
    side = max(usual, 2 * NARROWEST * ratio) if width is None else 2 * finite_number("width", width)
    if side < 2 * NARROWEST * ratio or side ** (dimension - 1) > spheres * pi ** (dimension - 1):
        allowed = (
            f"at least {NARROWEST * ratio:g}, and so small that the {spheres:,} spheres do more than cover the floor"
        )
        raise InputError(f"width is {side / 2:g}; it must be {allowed}")
    heap = _Heap(spheres, side, ratio, dimension)
    sizes = np.where(rng.random(spheres) < large, ratio, 1.0)
    # the floor: spheres at random places of height 0 that overlap no other
    for _ in range(int(FLOOR_TRIES * (side / 2) ** (dimension - 1))):
        spot = np.append(rng.random(dimension - 1) * side, 0.0)
        if heap.count < spheres and heap.is_free(spot, sizes[heap.count]):
            heap.put(spot, sizes[heap.count])
    # then each sphere goes into the lowest pocket for its size, or one of the other size if none is left
    floor, contact = heap.count, []
    while heap.count < spheres:
        own, wanted = heap.count, sizes[heap.count]
        touched = heap.fill(wanted) or heap.fill(1.0 if wanted == ratio else ratio)
        if touched is None:
            raise InputError(f"no free place is left after {own:,} spheres; take another seed or a wider box")
        contact += [(other, own) for other in touched]
    pairs, place = np.array(contact, dtype=np.int64).reshape(-1, 2), heap.place
    vector = place[pairs[:, 1]] - place[pairs[:, 0]]
    vector[:, :-1] -= side * np.round(vector[:, :-1] / side)
    normal = vector / np.linalg.norm(vector, axis=1)[:, None]
    top = place[:, -1] > place[:, -1].max() - 2 * ratio
    body = np.where(np.arange(spheres) < floor, 0, np.where(top, 1, -1))
    return heap.radius, (place, pairs, normal, np.ones(spheres), body)
