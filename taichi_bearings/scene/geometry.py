"""Checks whether centres, radii, contacts and normals of a packing agree, as they partly say the same.

The centres of a contact that crosses no periodic side differ by the sum of the radii along its normal. A contact that
crosses a periodic side joins its first sphere to an *image* of its second one, a copy shifted by periods of the box.
The normal says where this image is. Then

* no other sphere is at that place,
* all such shifts are sums of a few periods, and no period is shorter than a sphere, and
* no sphere of the packing, shifted by a period, lies on another one.

Shuffled normals, contacts that count from 1, diameters given as radii and other units violate one of these.

Letters: N spheres, E contacts, D = 2 or 3 dimensions, X contacts across periodic sides, k periods.
"""

from collections.abc import Iterator

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.scene.checks import GAP, OVERLAP, misfit
from taichi_bearings.scene.periods import reduced
from taichi_bearings.scene.touching import near_pairs

SAME_LINE = 0.01  # largest distance of a normal from the unit vector along the centres; printing loses far less
EXACT = 1e-12  # normals whose lengths are wrong by no more than this are taken as they are
PRINTED = 30.0  # a printed normal may differ from the centres by so many times the error of the lengths
SAME_PLACE = 0.5  # spheres nearer than this part of the sum of their radii are at the same place
LEAST_SPREAD = 0.02  # overlaps of contacts may differ by this at least, relative to the sum of the radii
MOST_TRIED_PERIODS = 64  # shifts that are tried as periods: each makes a period shorter, or is one more period
ROUNDING = 1e-9  # rounding error of a shift relative to its length
OTHER_UNIT = 1.5  # distances and radii whose ratio is off by this factor or more have different units
NEAR = 0.1  # largest relative difference of a ratio from the 1/2 or 2 of diameters given for radii or the reverse


def agreed(center: np.ndarray, contact: np.ndarray, radius: np.ndarray, normal: np.ndarray, error: float) -> np.ndarray:
    """Return the normals (contacts E, dimensions D), with those that were printed with few digits replaced by
    directions of the centres.

    center : (spheres N, D), length.
    contact : (E, 2) numbers of the first and second sphere.
    radius : (N,), length.
    normal : (E, D), unit vectors from the first to the second sphere.
    error : the largest error that the length of a normal had as it was given.

    A normal is replaced only where it agrees with the centres to the digits that it has.

    Raises InputError, one sentence that names a contact and the likely remedy, where the arrays contradict each other.
    """
    if not len(contact):
        return normal
    found = _Contacts(center, contact, radius, normal)
    if not found.is_direct.all():
        found.refuse_mistakes()
        found.refuse_strange_images()
    if error <= EXACT:
        return normal
    known = found.is_direct & (found.off <= PRINTED * error)
    return np.where(known[:, None], found.along, normal)


def from_places(center: np.ndarray, contact: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return normals (contacts E, dimensions D), unit vectors from the centre of the first to that of the second sphere
    of each contact.

    center : (spheres N, D), length.
    contact : (E, 2) numbers of spheres.
    radius : (N,), length.

    Raises InputError, with the likely remedy, if the spheres of a contact do not touch.
    """
    if not len(contact):
        return np.zeros((0, center.shape[1]))
    found = _Contacts(center, contact, radius, None)
    if not found.touches.all():
        own = int(np.argmin(found.touches))
        is_far = found.size[own] > found.reach[own]
        hint = found.remedy() or ("; across a periodic side it needs a normal" if is_far else "")
        first, second = contact[own].tolist()
        fault = "does not touch" if is_far else "is pressed too far"
        distance_and_radii = misfit(found.size[own], found.reach[own])
        raise InputError(f"contact {own} {fault}: spheres {first} and {second} {distance_and_radii}{hint}")
    result: np.ndarray = found.along
    return result


class _Contacts:
    """Contacts of a packing, and how far they agree with the centres of their spheres.

    center : (spheres N, dimensions D), length.
    contact : (contacts E, 2), numbers of the first and second sphere.
    radius : (N,), length.
    given : normals (E, D) of the user, or None.
    normal : (E, D), `given`, or `along` if no normals are given.
    vector : (E, D), length, from the centre of the first to that of the second sphere.
    size : (E,), length of `vector`.
    along : (E, D), direction of `vector`, a unit vector.
    reach : (E,), length, sum of the two radii.
    off : (E,), distance between the unit vectors `along` and `normal`.
    touches : (E,) mask, True if `size` is the sum of the radii but for a small gap or overlap.
    is_direct : (E,) mask, True if the spheres touch and the normal is along the centres, so that no periodic side is
        crossed.
    """

    def __init__(self, center: np.ndarray, contact: np.ndarray, radius: np.ndarray, normal: np.ndarray | None) -> None:
        """Compute distances, directions and masks. `normal` has the unit vectors (E, D) of the user, or is None."""
        self.center, self.contact, self.radius, self.given = center, contact, radius, normal
        self.vector = center[contact[:, 1]] - center[contact[:, 0]]
        self.size, self.reach = np.linalg.norm(self.vector, axis=1), radius[contact].sum(axis=1)
        self.along = self.vector / self.size[:, None]
        self.normal = self.along if normal is None else normal
        self.off = np.linalg.norm(self.along - self.normal, axis=1)
        self.touches = (self.size <= (1 + GAP) * self.reach) & (self.size >= (1 - OVERLAP) * self.reach)
        self.is_direct = self.touches & (self.off <= SAME_LINE)

    def remedy(self) -> str:
        """Return words for the mistake of the user, such as diameters given as radii, that best explains the contacts
        which do not fit: the one whose correction makes most contacts direct. The text is empty if no correction makes
        more contacts direct than already are. A contact is direct if its spheres touch and its normal is along their
        centres.
        """
        # three kinds of mistake, each with the number of contacts that would be direct without it
        turned = self.touches & (np.linalg.norm(self.along + self.normal, axis=1) <= SAME_LINE)
        found = [(int(turned.sum()), "normals seem to point from the second sphere to the first, so turn their signs")]
        if self.contact.min() > 0:
            other = _Contacts(self.center, self.contact - 1, self.radius, self.given)
            found.append((int(other.is_direct.sum()), "contacts seem to count from 1, so take 1 away"))
        lines = (self.off <= SAME_LINE) & ~self.touches
        if lines.any():
            ratio = self.size[lines] / self.reach[lines]
            usual = float(np.median(ratio))
            if abs(usual / 0.5 - 1) < NEAR:
                units = "radii look like diameters"
            elif abs(usual / 2.0 - 1) < NEAR:
                units = "radii look like halves of radii"
            else:
                units = "centres and radii seem to be in different units: "
                units += f"distances are {usual:.3g} times those of contacts"
            if abs(np.log(usual)) > np.log(OTHER_UNIT):
                found.append((int((np.abs(ratio / usual - 1) < OVERLAP).sum()), units))
        explained, words = max(found)
        return f"; {words}" if explained > self.is_direct.sum() else ""

    def refuse_mistakes(self) -> None:
        """Raise InputError for a known mistake, such as diameters given as radii, and for touching spheres whose normal
        is not along their centres.

        Two spheres with several contacts are not judged here, as one of these may cross a periodic side.
        """
        if words := self.remedy():
            raise InputError(f"{self._contact_does_not_fit(self._first())}{words}")
        pair = np.sort(self.contact, axis=1) @ np.array([len(self.center), 1])
        _, group, count = np.unique(pair, return_inverse=True, return_counts=True)
        strange = self.touches & ~self.is_direct & (count[group] == 1)
        if strange.any():
            own = int(np.argmax(strange))
            raise InputError(
                f"{self._contact_does_not_fit(own)}; the normal must point from the first centre to the second: check "
                "that normals are in the order of the contacts"
            )

    def refuse_strange_images(self) -> None:
        """Raise InputError if the contacts that are not direct cannot all be contacts across periodic sides of
        one box. A contact is direct if its spheres touch and its normal is along their centres.
        """
        # where the image of the other sphere is, from either end of the contact: no sphere may be there already
        across = np.flatnonzero(~self.is_direct)
        first, second = self.contact[across].T
        ratio = self.size[self.is_direct] / self.reach[self.is_direct]
        usual = float(np.median(ratio)) if len(ratio) else 1.0
        spread = min(OVERLAP, 2 * float(np.abs(ratio / usual - 1).max(initial=0.0)) + LEAST_SPREAD)
        step = usual * self.reach[across, None] * self.normal[across]
        for here, own, beside in ((first, second, step), (second, first, -step)):
            place = self.center[here] + beside
            for row, other in near_pairs(place, self.radius[own], self.center, self.radius, SAME_PLACE):
                if len(row):
                    e = int(across[row[0]])
                    raise InputError(
                        f"{self._contact_does_not_fit(e)}; its normal {_short(self.normal[e])} leads to sphere "
                        f"{other[0]} instead; correct the contact or its normal"
                    )
        # shifts (X, D) from an image to its sphere are sums of periods, none much shorter than the largest diameter
        shift, least = self.vector[across] - step, 2 * (1 - OVERLAP / 2) * self.radius.max()
        periods, wrong = _periods(shift, spread * self.reach[across], least)
        if wrong is not None:
            raise InputError(
                f"{self._contact_does_not_fit(int(across[wrong]))}; nor do its centres fit its normal across a "
                "periodic side, with the periods that follow from the other contacts; correct its normal or the centres"
            )
        # no period may put a sphere where another one is
        for period in periods:
            for low, high in self._laid_over(period):
                if len(low):
                    e = int(across[np.argmin(np.linalg.norm(shift - period, axis=1))])
                    raise InputError(
                        f"{self._contact_does_not_fit(e)}; across the periodic side that its normal crosses, sphere "
                        f"{low[0]} would lie on sphere {high[0]}; check the normal and its sign"
                    )

    def _laid_over(self, period: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield pairs of spheres such that the first one, shifted by a period, would be at the place of the second: two
        arrays (pairs,), numbers of the first and of the second spheres.

        period : (dimensions D,), length.
        """
        moved = self.center + period
        low, high = self.center.min(axis=0), self.center.max(axis=0)
        inside = np.flatnonzero(((moved >= low) & (moved <= high)).all(axis=1))
        for first, second in near_pairs(moved[inside], self.radius[inside], self.center, self.radius, SAME_PLACE):
            yield inside[first], second

    def _first(self) -> int:
        """Return the number of the first contact that is not direct."""
        return int(np.argmin(self.is_direct))

    def _pair(self, number: int) -> str:
        """Return the two spheres of a contact, given its number, in words such as "3 and 7", for messages."""
        return " and ".join(map(str, self.contact[number].tolist()))

    def _contact_does_not_fit(self, number: int) -> str:
        """Return the beginning of a message: how a contact, given its number, disagrees with its centres."""
        what = f"contact {number} does not fit: spheres {self._pair(number)}"
        if self.touches[number]:
            return f"{what} touch along {_short(self.along[number])} and its normal is {_short(self.normal[number])}"
        return f"{what} {misfit(self.size[number], self.reach[number])}"


def _periods(shift: np.ndarray, slack: np.ndarray, least: float) -> tuple[np.ndarray, int | None]:
    """Return periods of a box, (k, dimensions D), length, of which every shift is a sum, and None. If a box has no such
    periods, return those found so far, and instead of None the number of a shift that is no sum of them.

    The shortest shift that is no sum becomes a further period, until all shifts are sums, there are more than D
    periods, or one is too short.

    shift : (X, D), length, shifts of the X contacts across periodic sides.
    slack : (X,), length, by which each shift may miss a sum of periods.
    least : the shortest length that a period may have.
    """
    periods, own = np.zeros((0, shift.shape[1])), 0
    order = np.argsort(np.linalg.norm(shift, axis=1), kind="stable")
    for _ in range(MOST_TRIED_PERIODS):
        # the sum of periods nearest to each shift, and what is missing
        times = np.round(shift @ np.linalg.pinv(periods)) if len(periods) else np.zeros((len(shift), 0))
        rest = shift - times @ periods
        is_no_sum = np.linalg.norm(rest, axis=1) > slack + ROUNDING * np.linalg.norm(shift, axis=1)
        if not is_no_sum.any():
            return periods, None
        # what is missing of the shortest shift that is no sum makes a further period
        own = int(order[np.argmax(is_no_sum[order])])
        periods = _shortest_generators(periods, rest[own], float(slack[own]))
        if len(periods) > shift.shape[1] or np.linalg.norm(periods, axis=1).min(initial=np.inf) < least:
            break
    return periods, own


def _shortest_generators(periods: np.ndarray, more: np.ndarray, slack: float) -> np.ndarray:
    """Return the shortest vectors (k, dimensions D), length, whose sums are the same points as the sums of some periods
    and one more vector.

    periods : (k, D), length.
    more : (D,), length, the further vector.
    slack : length up to which a vector counts as 0 and is left out. If more than D vectors are returned, the sums are
        no lattice of points.
    """
    found = reduced(np.vstack([periods, more]))
    while len(kept := found[np.linalg.norm(found, axis=1) > slack]) < len(found):
        found = reduced(kept)
    result: np.ndarray = kept
    return result


def _short(vector: np.ndarray) -> str:
    """Return a vector with four digits of each component, for messages."""
    return "(" + ", ".join(f"{value:.4g}" for value in vector.tolist()) + ")"
