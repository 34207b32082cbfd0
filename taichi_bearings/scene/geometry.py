"""Whether centres, radii, contacts and normals of a packing agree: what is there twice is held against each other.

A contact that crosses no periodic side lies along its normal, at the sum of the radii. One that crosses some joins an
image of its second sphere, which stands beside the first one where the normal says, so

* no other sphere is there,
* all such shifts are sums of a few periods, and no period is shorter than a sphere, and
* a period shifts the whole packing between its own spheres.

Shuffled normals, contacts that count from 1, diameters as radii and other units break one of these.
"""

from collections.abc import Iterator

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.scene.checks import GAP, OVERLAP, misfit
from taichi_bearings.scene.periods import reduced
from taichi_bearings.scene.touching import near_pairs

SAME_LINE = 0.01  # distance of the unit vectors of a normal and of the centres: printed numbers are far nearer
EXACT = 1e-12  # error of the length of normals, up to which they are taken as they are
PRINTED = 30.0  # times the error of the lengths of normals, by which printed ones may differ from the centres
SAME_PLACE = 0.5  # times the sum of the radii: spheres nearer than that are at one place
LEAST_SPREAD = 0.02  # of the sum of the radii: contacts are pressed unequally by so much at least
MOST_TRIED_PERIODS = 64  # shifts that are tried as periods: each shortens them, or is one more
ROUNDING = 1e-9  # of the length of a shift
OTHER_UNIT = 1.5  # ratio of distances and radii, from which on they are of different units
NEAR = 0.1  # relative distance of a ratio from the one that tells diameters from radii


def agreed(center: np.ndarray, contact: np.ndarray, radius: np.ndarray, normal: np.ndarray, error: float) -> np.ndarray:
    """Normals (E, D), of which those that are printed with few digits are taken from the centres where both agree.

    center : (N, D), length. contact : (E, 2). radius : (N,), length. normal : (E, D), unit vectors from the first to
    the second sphere. error : by which the length of one of them was wrong at most.

    Raises InputError, one sentence that names a contact and the likely remedy, where they contradict each other.
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
    """Normals (E, D) along the centres; InputError for spheres that do not touch, with the likely remedy."""
    if not len(contact):
        return np.zeros((0, center.shape[1]))
    found = _Contacts(center, contact, radius, None)
    if not found.touches.all():
        own = int(np.argmin(found.touches))
        is_far = found.size[own] > found.reach[own]
        hint = found.remedy() or ("; across a periodic side it needs a normal" if is_far else "")
        first, second = contact[own].tolist()
        raise InputError(
            f"contact {own} {'does not touch' if is_far else 'is pressed too far'}: spheres {first} and {second} "
            f"{misfit(found.size[own], found.reach[own])}{hint}"
        )
    return found.along


class _Contacts:
    """Contacts with what their centres say of them. given : normals (E, D), or None: those along the centres.

    vector : (E, D) between the centres, size (E,) its length, along (E, D) its direction. reach : (E,), sum of the
    radii. off : (E,), distance of normal and direction. is_direct : (E,), true where both agree, and the distance too.
    """

    def __init__(self, center: np.ndarray, contact: np.ndarray, radius: np.ndarray, normal: np.ndarray | None) -> None:
        self.center, self.contact, self.radius, self.given = center, contact, radius, normal
        self.vector = center[contact[:, 1]] - center[contact[:, 0]]
        self.size, self.reach = np.linalg.norm(self.vector, axis=1), radius[contact].sum(axis=1)
        self.along = self.vector / self.size[:, None]
        self.normal = self.along if normal is None else normal
        self.off = np.linalg.norm(self.along - self.normal, axis=1)
        self.touches = (self.size <= (1 + GAP) * self.reach) & (self.size >= (1 - OVERLAP) * self.reach)
        self.is_direct = self.touches & (self.off <= SAME_LINE)

    def remedy(self) -> str:
        """The mistake that explains more of the contacts than are right without it, and most of all; or nothing."""
        turned = self.touches & (np.linalg.norm(self.along + self.normal, axis=1) <= SAME_LINE)
        found = [(int(turned.sum()), "normals seem to point from the second sphere to the first, so turn their signs")]
        if self.contact.min() > 0:
            other = _Contacts(self.center, self.contact - 1, self.radius, self.given)
            found.append((int(other.is_direct.sum()), "contacts seem to count from 1, so take 1 away"))
        lines = (self.off <= SAME_LINE) & ~self.touches
        if lines.any():
            ratio = self.size[lines] / self.reach[lines]
            usual = float(np.median(ratio))
            words = (
                f"centres and radii seem to be in different units: distances are {usual:.3g} times those of contacts"
            )
            words = "radii look like diameters" if abs(usual / 0.5 - 1) < NEAR else words
            words = "radii look like halves of radii" if abs(usual / 2.0 - 1) < NEAR else words
            if abs(np.log(usual)) > np.log(OTHER_UNIT):
                found.append((int((np.abs(ratio / usual - 1) < OVERLAP).sum()), words))
        explained, words = max(found)
        return f"; {words}" if explained > self.is_direct.sum() else ""

    def refuse_mistakes(self) -> None:
        """InputError for what another reading of the same arrays explains better, and for touching spheres whose normal
        is another one."""
        if words := self.remedy():
            raise InputError(f"{self._told(self._first())}{words}")
        pair = np.sort(self.contact, axis=1) @ np.array([len(self.center), 1])
        _, group, count = np.unique(pair, return_inverse=True, return_counts=True)
        strange = self.touches & ~self.is_direct & (count[group] == 1)
        if strange.any():
            own = int(np.argmax(strange))
            raise InputError(f"{self._told(own)}; are normals in the order of the contacts?")

    def refuse_strange_images(self) -> None:
        """InputError for contacts of images that fit no periodic side. shift : (X, D), from the image to its sphere."""
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
                    raise InputError(f"{self._told(e)}; its normal {_short(self.normal[e])} leads to sphere {other[0]}")
        shift, least = self.vector[across] - step, 2 * (1 - OVERLAP / 2) * self.radius.max()
        periods, wrong = _periods(shift, spread * self.reach[across], least)
        if wrong is not None:
            raise InputError(f"{self._told(int(across[wrong]))}; its normal fits no periodic side that the others have")
        for period in periods:
            for low, high in self._laid_over(period):
                if len(low):
                    e = int(across[np.argmin(np.linalg.norm(shift - period, axis=1))])
                    raise InputError(
                        f"{self._told(e)}; a periodic side that its normal fits would put sphere {low[0]} where sphere "
                        f"{high[0]} is"
                    )

    def _laid_over(self, period: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of spheres, of which a period puts the first one where the second is."""
        moved = self.center + period
        low, high = self.center.min(axis=0), self.center.max(axis=0)
        inside = np.flatnonzero(((moved >= low) & (moved <= high)).all(axis=1))
        for first, second in near_pairs(moved[inside], self.radius[inside], self.center, self.radius, SAME_PLACE):
            yield inside[first], second

    def _first(self) -> int:
        return int(np.argmin(self.is_direct))

    def _pair(self, e: int) -> str:
        return " and ".join(map(str, self.contact[e].tolist()))

    def _told(self, e: int) -> str:
        what = f"contact {e} does not fit: spheres {self._pair(e)}"
        if self.touches[e]:
            return f"{what} touch along {_short(self.along[e])} and its normal is {_short(self.normal[e])}"
        return f"{what} {misfit(self.size[e], self.reach[e])}"


def _periods(shift: np.ndarray, slack: np.ndarray, least: float) -> tuple[np.ndarray, int | None]:
    """Periods (k, D) of which all shifts (X, D) are sums, to within `slack` (X,), length, none shorter than `least`;
    and the first shift for which there are none."""
    periods, own = np.zeros((0, shift.shape[1])), 0
    order = np.argsort(np.linalg.norm(shift, axis=1), kind="stable")
    for _ in range(MOST_TRIED_PERIODS):
        whole = np.round(shift @ np.linalg.pinv(periods)) if len(periods) else np.zeros((len(shift), 0))
        rest = shift - whole @ periods
        over = np.linalg.norm(rest, axis=1) > slack + ROUNDING * np.linalg.norm(shift, axis=1)
        if not over.any():
            return periods, None
        own = int(order[np.argmax(over[order])])
        periods = _with(periods, rest[own], float(slack[own]))
        if len(periods) > shift.shape[1] or np.linalg.norm(periods, axis=1).min(initial=np.inf) < least:
            break
    return periods, own


def _with(periods: np.ndarray, more: np.ndarray, slack: float) -> np.ndarray:
    """The shortest vectors of the lattice that periods (k, D) and one more make; those within the slack are none. More
    than D are of no lattice."""
    found = reduced(np.vstack([periods, more]))
    while len(kept := found[np.linalg.norm(found, axis=1) > slack]) < len(found):
        found = reduced(kept)
    return kept


def _short(vector: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in vector.tolist()) + ")"
