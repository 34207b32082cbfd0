"""Random packings of two sizes of spheres or discs that touch exactly, deposited one by one.

After Bennett, J. Appl. Phys. 43, 2727 (1972): on a floor of spheres at random places each next one, its size drawn,
goes into the lowest pocket where it touches D others and overlaps none. So there are E = D (N - F) contacts of N
spheres, F of them on the floor: just as many as hold every sphere in place (isostatic). No sphere is loose. Sides are
periodic.

pocket : a place where a new sphere would touch D others. D is the dimension, 2 or 3. Lengths are in radii of the small
spheres.
"""

from heapq import heappop, heappush
from math import pi

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.options import finite_number, whole
from taichi_bearings.scene.generators.lattices import Built
from taichi_bearings.words import shown

MOST_DEPOSITED = 200_000
FILLED = {2: 0.78, 3: 0.57}  # fraction of the box that spheres fill; with it a box is made about as wide as high
NARROWEST = 4.0  # least width in diameters of large spheres, so that two spheres do not touch around both sides
FLOOR_TRIES = 60  # places tried for each sphere that the floor could hold
FLATTEST = (
    1e-3  # square of the height of a pocket above those that form it, over that of a radius: rounding stays small
)
CLAIMED_OVERLAP = 1e-12  # overlap that may be rounding, relative to the sum of the radii

Pocket = tuple[float, int, np.ndarray, tuple[int, ...], int]
"""A pocket: its height, its number, its place (D,), the numbers of the spheres that form it, and how many spheres stood
when it was found."""


class _Heap:
    """The spheres placed so far, and the pockets (places for a further sphere that touches D others), lowest first.

    place : (spheres N, D), centres.
    radius : (N,). Lengths are in radii of the small spheres.
    sides : (D,), lengths of the periodic sides, infinite along the height.
    sizes : the two radii.
    count : number of spheres placed so far.
    made : number of pockets made so far.
    pockets : for each radius of the sphere to come a heap of pockets: height, number, place, numbers of the D spheres
        that form it, and number of spheres when it was made.
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

    def away(self, place: np.ndarray, since: int = 0) -> np.ndarray:
        """Return vectors (n, dimensions D) from a place (D,) to the nearest images of the spheres with numbers from
        `since` on.
        """
        vector = self.place[since : self.count] - place
        vector[:, :-1] -= self.sides[:-1] * np.round(vector[:, :-1] / self.sides[:-1])
        found: np.ndarray = vector
        return found

    def is_free(self, place: np.ndarray, size: float, since: int = 0) -> bool:
        """Return True if a sphere of radius `size` at a place (dimensions D,) overlaps none of the spheres from number
        `since` on.
        """
        reach = (self.radius[since : self.count] + size) * (1 - CLAIMED_OVERLAP)
        return bool(((self.away(place, since) ** 2).sum(axis=1) >= reach**2).all())

    def put(self, place: np.ndarray, size: float) -> None:
        """Add a sphere of radius `size` at a place (D,), and find the pockets that it forms with others: the places
        where a further sphere would touch it and D - 1 others, and overlap none.
        """
        vector = self.away(place)
        close = (vector**2).sum(axis=1) < (size + self.radius[: self.count] + 2 * self.sizes[1]) ** 2
        near, vector = np.flatnonzero(close), vector[close]
        own = self.count
        self.place[own, :-1], self.place[own, -1] = np.mod(place[:-1], self.sides[:-1]), place[-1]
        self.radius[own], self.count = size, own + 1
        for new, pockets in self.pockets.items():
            reach = self.radius[near] + new
            middle, held = _touching(vector, size + new, reach)
            free = ((middle[:, None] - vector) ** 2).sum(axis=2) >= (reach * (1 - CLAIMED_OVERLAP)) ** 2
            free = free.all(axis=1) & (place[-1] + middle[:, -1] > 0)
            for offset, others in zip(middle[free], held[free], strict=True):
                self.made += 1
                there = place + offset
                heappush(pockets, (float(there[-1]), self.made, there, (own, *near[others].tolist()), self.count))

    def fill(self, size: float) -> tuple[int, ...] | None:
        """Put a sphere of radius `size` into the lowest pocket, a place where it touches D spheres and overlaps none;
        return the numbers of these D spheres.

        None if no pocket is left.
        """
        while self.pockets[size]:
            _, _, place, held, since = heappop(self.pockets[size])
            if self.is_free(place, size, since):
                self.put(place, size)
                return held
        return None


def _touching(vector: np.ndarray, first: float, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return places (P, dimensions D) where a new sphere touches a sphere at 0 and D - 1 others, and the numbers (P, D
    - 1) of these others.

    vector : (n, D), centres of the others.
    first : distance of the new centre from 0, a sum of two radii.
    reach : (n,), its distances from the centres of the others. Lengths are in radii of the small spheres.
    """
    count, dimension = vector.shape
    others = np.arange(count)[:, None] if dimension == 2 else np.column_stack(np.triu_indices(count, 1))
    size = np.linalg.norm(vector, axis=1)
    # the new centre lies on a sphere of radius `first` about 0 and in a plane across each vector: at `along` on it
    along = (first**2 - reach**2 + size**2) / (2 * size)
    unit = vector / size[:, None]
    if dimension == 2:
        foot, left, across = along[:, None] * unit, first**2 - along**2, unit[:, ::-1] * [-1.0, 1.0]
    else:
        one, two = others.T
        cosine = (unit[one] * unit[two]).sum(axis=1)
        sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
        sine[sine == 0] = np.inf  # in line with the first
        side = (unit[two] - cosine[:, None] * unit[one]) / sine[:, None]
        beside = (along[two] - cosine * along[one]) / sine
        foot = along[one, None] * unit[one] + beside[:, None] * side
        left, across = first**2 - along[one] ** 2 - beside**2, np.cross(unit[one], side)
        left[np.isinf(sine) | (sine**2 < FLATTEST)] = -1.0
    # `left` is the squared distance from the foot to both solutions, which lie at right angles to the vectors
    real = left > FLATTEST
    foot, height, others = foot[real], np.sqrt(left[real])[:, None] * across[real], others[real]
    return np.concatenate([foot + height, foot - height]), np.concatenate([others, others])


def built(
    spheres: int, dimension: int, ratio: float, large: float, width: float | None, rng: np.random.Generator
) -> tuple[np.ndarray, Built]:
    """Return radii (spheres N,) and a tuple with places (N, D), contacts (contacts E, 2), normals (E, D), signs (N,),
    which are all 1, and driven bodies (N,): 0 for the floor, 1 for spheres at the surface, -1 for others.

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
        held = heap.fill(wanted) or heap.fill(1.0 if wanted == ratio else ratio)
        if held is None:
            raise InputError(f"no free place is left after {own:,} spheres; take another seed or a wider box")
        contact += [(other, own) for other in held]
    pairs, place = np.array(contact, dtype=np.int64).reshape(-1, 2), heap.place
    vector = place[pairs[:, 1]] - place[pairs[:, 0]]
    vector[:, :-1] -= side * np.round(vector[:, :-1] / side)
    normal = vector / np.linalg.norm(vector, axis=1)[:, None]
    top = place[:, -1] > place[:, -1].max() - 2 * ratio
    body = np.where(np.arange(spheres) < floor, 0, np.where(top, 1, -1))
    return heap.radius, (place, pairs, normal, np.ones(spheres), body)
