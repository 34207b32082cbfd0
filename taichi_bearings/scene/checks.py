"""Checks of the arrays that users give as a packing: each failure is an InputError of one sentence with the value.

Letters: N spheres, E contacts, D = 2 or 3 dimensions. A driven body is a set of driven spheres with a number, from 0.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from taichi_bearings.errors import InputError, warn
from taichi_bearings.scene.array_files import own_array
from taichi_bearings.words import shown

if TYPE_CHECKING:
    from taichi_bearings.scene.packing import Packing

MOST_SPHERES, MOST_CONTACTS = 20_000_000, 100_000_000
MOST_INTEGER = 2**53  # the largest number up to which floats hold every whole number
# the largest gap between the surfaces of a contact, and its largest overlap, relative to the sum of the radii
GAP, OVERLAP = 0.05, 0.2
UNIT_ERROR = 1e-3  # largest error of the length of a normal: that of one printed with three decimals
SAME_NORMAL = 1e-6  # least distance of the normals of two contacts between the same two spheres
TURNED = ", as MATLAB and Fortran write arrays: turn center, contact, normal and spin"
LEAST_SIZE, MOST_SIZE = 1e-15, 1e15  # limits of coefficients, forces and radii; the upper one also of other sizes


def _refuse(bad: np.ndarray | np.bool, sentence: Callable[[int], str]) -> None:
    """Raise InputError if any entry of the mask `bad` is True.

    bad : mask of the entries that are refused.
    sentence : function that returns the message about entry number i.
    """
    if bad.any():
        raise InputError(sentence(int(np.argmax(bad))))


def places(values: ArrayLike) -> np.ndarray:
    """Return the checked centres of the spheres, (spheres N, dimensions D), length; raise InputError if they are no
    such array of finite numbers, or if two are the same.

    values : centres of the user.
    """
    center = own_array("centres", values)
    if center.ndim != 2 or center.shape[1] not in (2, 3) or not 1 <= len(center) <= MOST_SPHERES:
        is_turned = center.ndim == 2 and len(center) in (2, 3) and center.shape[1] > 3
        hint = f"; it looks transposed{TURNED}" if is_turned else ""
        raise InputError(
            f"center has shape {center.shape}; it must be (N, 2) or (N, 3), one row of coordinates for each of N "
            f"spheres, with N from 1 to {MOST_SPHERES:,}{hint}"
        )
    _refuse_not_finite("center", center, "sphere")
    order = np.lexsort(center.T)
    twice = (center[order[1:]] == center[order[:-1]]).all(axis=1)
    if twice.any():
        pair = sorted(order[np.argmax(twice) :][:2].tolist())
        raise InputError(f"spheres {pair[0]} and {pair[1]} have the same centre; each sphere must be there once")
    return center


def _array(name: str, values: ArrayLike) -> np.ndarray:
    """Return the values as an array; raise InputError where they make none, as lists of unequal lengths do.

    name : name of the argument, for messages.
    """
    try:
        return np.asanyarray(values)
    except (ValueError, OverflowError, TypeError):
        raise InputError(f"{name} is {shown(values)}; it must be an array of whole numbers") from None


def _integers(name: str, values: ArrayLike) -> np.ndarray:
    """Return a read-only copy of the values in int64, of their shape. Arrays of floats are taken if each is a whole
    number of at most MOST_INTEGER.

    name : what the values are called, for messages.

    Raises InputError for anything else, also for masked arrays.
    """
    if isinstance(values, np.ma.MaskedArray):
        raise InputError(f"{name} is a masked array; it must be a plain array of whole numbers")
    array = _array(name, values)
    if array.dtype.kind == "f" and array.ndim:
        with np.errstate(invalid="ignore"):
            is_whole = (np.abs(array) <= MOST_INTEGER) & (array == np.round(array))
        if not is_whole.all():
            raise InputError(f"{name} holds {array[~is_whole][0]}; it must hold whole numbers")
        array = array.astype(np.int64)
    if array.dtype.kind not in "iu":
        raise InputError(f"{name} is of type {array.dtype}; it must hold whole numbers")
    if array.size and array.dtype.kind == "u" and array.max() > np.iinfo(np.int64).max:
        raise InputError(f"{name} holds {array.max()}; at most {np.iinfo(np.int64).max} is allowed")
    copy = np.array(array, dtype=np.int64, order="C", subok=False)
    copy.setflags(write=False)
    return copy


def pairs(values: ArrayLike, spheres: int) -> np.ndarray:
    """Return the numbers (contacts E, 2) of the first and the second sphere of each contact; raise InputError if they
    are no such array of numbers of two different spheres.

    values : what the user has passed.
    spheres : number N of spheres.
    """
    contact = _integers("contact", values)
    contact = contact.reshape(0, 2) if contact.size == 0 else contact
    if contact.ndim != 2 or contact.shape[1] != 2 or len(contact) > MOST_CONTACTS:
        hint = f"; it looks transposed{TURNED}" if contact.ndim == 2 and len(contact) == 2 else ""
        raise InputError(
            f"contact has shape {contact.shape}; it must be (E, 2), the two spheres of each of E contacts, with E up "
            f"to {MOST_CONTACTS:,}{hint}"
        )
    outside = ((contact < 0) | (contact >= spheres)).any(axis=1)
    hint = "; contacts seem to count from 1" if len(contact) and (contact.min(), contact.max()) == (1, spheres) else ""
    _refuse(
        outside,
        lambda e: f"contact {e} is between {contact[e].tolist()}; spheres are numbered 0 to {spheres - 1}{hint}",
    )
    _refuse(contact[:, 0] == contact[:, 1], lambda e: f"contact {e} is of sphere {contact[e, 0]} with itself")
    return contact


def bodies(values: ArrayLike, spheres: int) -> np.ndarray:
    """Return the number (N,) of the driven body of each sphere, -1 for free spheres.

    values : such numbers, or a mask of the driven spheres, which then are body 0.
    spheres : their number N.
    """
    array = _array("driven", values)
    is_mask = array.dtype.kind == "b" and not np.ma.is_masked(array)
    driven = _integers("driven", np.where(array, 0, -1) if is_mask else values)
    if driven.shape != (spheres,):
        raise InputError(f"driven has shape {driven.shape}; it must be ({spheres},), one number a sphere")
    strange, allowed = (driven < -1) | (driven >= spheres), f"-1 (free), or the number of a body, 0 to {spheres - 1}"
    _refuse(strange, lambda i: f"driven of sphere {i} is {driven[i]}; it must be {allowed}")
    return driven


def columns_as_vectors(found: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the arrays of a file of a packing by name, with columns (N, 1) or (E, 1) reshaped to (N,) or (E,).

    found : the arrays by name; `center` and `contact` say how many spheres N and contacts E there are.
    """
    places, pairs = np.shape(found["center"]), np.shape(found["contact"])
    counts = {places[0] if places else 0, pairs[0] if pairs else 0}
    vectors = {"driven", "radius", "friction", "viscosity", "normal_force", *(["spin"] if places[-1:] == (2,) else [])}
    is_column = {n: n in vectors and np.ndim(v) == 2 and v.shape[1] == 1 and len(v) in counts for n, v in found.items()}
    return {name: values[:, 0] if is_column[name] else values for name, values in found.items()}


def spins(values: ArrayLike, spheres: int, dimension: int, held: np.ndarray) -> np.ndarray:
    """Return the imposed spins, (N, 3) of spheres or (N,) of discs, 1/time, with 0 for free spheres.

    values : spins of the user.
    spheres : number N of spheres.
    dimension : 2 or 3.
    held : (N,) mask of the driven spheres.
    """
    spin = own_array("spins", values)
    shape = (spheres, 3) if dimension == 3 else (spheres,)
    if spin.shape != shape:
        raise InputError(f"spin has shape {spin.shape}; it must be {shape}")
    spin = np.where(held.reshape(held.shape + (1,) * (spin.ndim - 1)), spin, 0.0)
    _refuse_not_finite("spin", spin, "sphere")
    spin.setflags(write=False)
    return spin


def sizes(name: str, values: ArrayLike, count: int, what: str, may_vanish: bool = False) -> np.ndarray:
    """Return positive numbers, (count,), one for each sphere or contact. A single number is repeated.

    name : name of the argument, for messages.
    values : one number, or (count,).
    what : "sphere" or "contact".
    may_vanish : True to allow 0 as well.
    """
    array = own_array(f"values of {name}", values)
    if array.ndim == 0:
        array = np.full(count, array)
    if array.shape != (count,):
        raise InputError(f"{name} has shape {array.shape}; it must be ({count},), one number a {what}")
    fine = (array >= LEAST_SIZE) & (array <= MOST_SIZE) | (may_vanish & (array == 0))
    allowed = f"{'0, or ' if may_vanish else ''}from {LEAST_SIZE:g} to {MOST_SIZE:g}"
    _refuse(~fine, lambda i: f"{name} of {what} {i} is {array[i]}; it must be {allowed}")
    array.setflags(write=False)
    return array


def pressing(values: ArrayLike, contacts: int) -> np.ndarray:
    """Return the normal forces (contacts E,), force, checked, with 0 in place of negative ones. A warning tells of
    these: such contacts pull and bear no friction.

    values : values that the user gave, (E,), or one number for all contacts.
    contacts : their number E.
    """
    array = own_array("values of normal_force", values)
    if array.shape == (contacts,) and (pulling := array < 0).any():
        warn(f"{pulling.sum()} of {contacts} normal forces are negative; these contacts pull and do not act")
        values = np.where(pulling, 0.0, array)
    return sizes("normal_force", values, contacts, "contact", may_vanish=array.ndim > 0)


def _refuse_not_finite(name: str, values: np.ndarray, what: str) -> None:
    """Raise InputError if a row of the values is not finite, or too large.

    name : name of the values, for messages.
    values : (rows, ...), one row for each sphere or contact.
    what : "sphere" or "contact".
    """
    bad = ~(np.abs(values) <= MOST_SIZE).all(axis=tuple(range(1, values.ndim)))
    _refuse(bad, lambda i: f"{name} of {what} {i} is {shown(values[i])}; it must be finite and at most {MOST_SIZE:g}")


def misfit(size: float, reach: float) -> str:
    """Return words for what is wrong with a contact whose spheres do not touch: how far apart they are, or by how much
    they overlap.

    size : distance of its centres, length.
    reach : sum of its radii, length.
    """
    apart = f"are {size:.6g} apart and their radii add up to {reach:.6g}"
    if size > reach:
        return apart
    return f"{apart}: they overlap by {1 - size / reach:.0%} of that, and at most {OVERLAP:.0%} is taken"


def normals(values: ArrayLike, packing: "Packing") -> tuple[np.ndarray, float]:
    """Return the normals (contacts E, dimensions D) of the contacts, scaled to unit length, and the largest error that
    their lengths had before.

    values : normals of the user.
    packing : the packing; its centres and contacts, which say D and E, are checked already.
    """
    normal, shape = own_array("normals", values), (packing.contacts, packing.dimension)
    normal = normal.reshape(shape) if normal.size == 0 == packing.contacts else normal
    if normal.shape != shape:
        raise InputError(f"normal has shape {normal.shape}; it must be {shape}{transposed(normal, shape)}")
    _refuse_not_finite("normal", normal, "contact")
    size = np.linalg.norm(normal, axis=1)
    bad = ~(np.abs(size - 1) <= UNIT_ERROR)
    _refuse(
        bad, lambda e: f"normal of contact {e} has length {size[e]:.9g}; the length must be 1, within {UNIT_ERROR:g}"
    )
    off = np.abs(size - 1) > 4 * np.finfo(np.float64).eps  # others stay as they are, bit by bit
    normal = np.where(off[:, None], normal / np.where(off, size, 1.0)[:, None], normal)
    return normal, float(np.abs(size - 1).max(initial=0.0))


def transposed(array: np.ndarray, shape: tuple[int, ...]) -> str:
    """Return "; it looks transposed", the end of a message, if the array has this shape with its two axes exchanged;
    else an empty text."""
    return "; it looks transposed" if array.ndim == 2 and array.T.shape == shape else ""


def refuse_repeated(packing: "Packing") -> None:
    """Raise InputError if two contacts join the same two spheres, unless their given normals differ.

    packing : the packing, with its contacts and normals.

    Around a periodic box of two spheres' length the same two touch twice, in two directions.
    """
    first, second = packing.contact.T
    low, high = np.minimum(first, second), np.maximum(first, second)
    key = low * packing.spheres + high
    _, count = np.unique(key, return_counts=True)
    if not (count > 1).any():
        return
    order = np.argsort(key, kind="stable")
    ends = np.cumsum(count)
    assert packing.normal is not None
    outward = packing.normal * np.where(first < second, 1, -1)[:, None]  # from the sphere of the lower number
    for group in np.flatnonzero(count > 1):
        same = order[ends[group] - count[group] : ends[group]]  # the contacts of one pair of spheres
        apart = np.linalg.norm(outward[same][:, None] - outward[same][None], axis=2)
        apart += 2 * np.eye(len(same))  # the largest distance of unit vectors: a contact is not compared with itself
        if not packing.normals_given or (apart < SAME_NORMAL).any():
            i, j = low[same[0]], high[same[0]]
            raise InputError(
                f"contacts {same[0]} and {same[1]} both join spheres {i} and {j}; two spheres can have a second "
                "contact only across a periodic side, and then all normals must be given and differ"
            )
