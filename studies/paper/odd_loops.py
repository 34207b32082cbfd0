"""Asks how many odd contacts stop a bearing of discs.

Samples are square lattices to which contacts across diagonals are added, and honeycombs to which discs in the hexagons
are added; with all of these a honeycomb is a triangular lattice, so it is one with vacancies on one of three
sublattices. What is added is called an odd contact (of a honeycomb: the six contacts of an added disc), since it closes
loops of an odd number of discs.

Around a loop of an odd number of discs neighbours cannot all rotate in opposite ways, so there discs are at rest, or
contacts slip. Without such loops, the bottom at rest, half of the discs roll with the top on average; the interface is
the layer of slipping contacts between them and the discs at rest. A contact across a diagonal inside the part that
rolls slips by twice the speed of the others, so it costs about twice a mean friction, a disc in a hexagon six times
that, and the interface moves out of their way. Let n be the number of odd contacts, L the size and s the share of discs
that roll.

* Between the top and the interface lie s n odd contacts. The interface wanders by L^(2/3), and interfaces further apart
  than that differ by about L^(1/3) in power, so s ~ L^(1/3) / n for few odd contacts.
* If s L is below L^(2/3), the interface is confined between the top and the odd contacts. It then consists of
  L / (s L)^(3/2) stretches of the length (s L)^(3/2), each of which costs (s L)^(1/2) more, together 1 / s. The sum
  s n + c / s is least at s = (c / n)^(1/2), whatever the size.
* Both cases are described by one law: s n^(1/2) is a function of n / L^(2/3), constant where n / L^(2/3) is large.

In any case a vanishing density stops large bearings. Every sample is solved exactly, by cuts of the double cover. For
comparison the same is done with contacts across the squares of cubic lattices of spheres, whose minima are proven.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from taichi_bearings.conic.contact_system import ContactSystem
from taichi_bearings.errors import InputError
from taichi_bearings.numerics.double_double import exactly
from taichi_bearings.plots.style import BLUE, GREY, in_our_style, new_figure, shades
from taichi_bearings.scene.packing import Packing
from taichi_bearings.solvers.nested_cuts import least_spins
from taichi_bearings.solvers.packings import solve_packing

from .claims import Effort
from .drawing import draw_means, name_sizes
from .fits import Collapse, collapse, line_through
from .samples import StudyResult, Table, drawn

FRICTION = (0.1, 1.0)  # uniform, the paper's
BLOCK = 5  # samples that are drawn together
OF_DISCS = {16: 50.0, 32: 50.0, 64: 10.0, 128: 2.0, 256: 0.5, 512: 0.1, 1000: 0.025}
SIZES = {  # by L, samples for each sample of the effort; sizes that get less than a block are left out
    "square": OF_DISCS,
    "triangular": OF_DISCS,
    "cubic": {4: 2.0, 6: 2.0, 8: 2.0, 12: 0.5, 16: 0.1},
}
QUICK_OF_DISCS = {8: 5.0, 16: 5.0, 32: 2.5}
QUICK_SIZES = {"square": QUICK_OF_DISCS, "triangular": QUICK_OF_DISCS, "cubic": {4: 1.0, 5: 1.0}}
NUMBERS, QUICK_NUMBERS = (0, 1, 2, 4, 8, 16, 32, 64, 128, 256), (0, 2, 8, 32)  # numbers of odd contacts
DENSEST = 0.5  # odd contacts take at most this share of the places
BOTTOMS = (0.0, 0.25, 0.5, 1.0)  # omega_B / omega_T
# L of the lattices of discs whose bottom rotates, and samples of them for each sample of the effort
TURNED, OF_TURNED = 32, 4.0
# exponents a such that s depends on n / L^a, if the power of interfaces decides or the density of odd contacts does
LANDSCAPE = {"square": 1 / 3, "triangular": 1 / 3, "cubic": 0.84}
DIMENSION = {"square": 2, "triangular": 2, "cubic": 3}
WANDERING = 2 / 3  # exponent a such that s n^(1/2) depends on n / L^a
# neither top nor bottom holds an interface with at least so many layers of rolling discs, and at most this share of all
FEWEST_LAYERS, LARGEST_SHARE = 2, 0.25
ENOUGH = 20  # samples that a size in a fit needs: fewer give no reliable error
CROWDED = 2.0  # the interface is confined if n / L^WANDERING is larger
SURE = 1e-6  # relative gap of minima of spheres; spheres with a smaller share of the top's spin count as at rest


def network(lattice: str, size: int, odd: int, bottom: float, seed: int) -> Packing:
    """Return a lattice without loops of an odd number of discs, to which `odd` odd contacts are added at random places.
    These close odd loops: in squares a contact across a diagonal, in hexagons the disc that a triangular lattice has
    there.

    lattice : "square", "triangular" (a honeycomb with added discs) or "cubic".
    size : L, the length of each side in diameters.
    bottom : spin of the bottom; that of the top is 1.
    seed : seed of the places and of the friction.

    Raises InputError if `odd` is more than a share DENSEST of the places.
    """
    rng = np.random.default_rng([seed, size, odd])
    bare, holes, tree, distance = _without_odd_loops(lattice, size, bottom)
    places, most = len(holes), int(DENSEST * len(holes))
    if odd > most:
        raise InputError(
            f"odd, the number of contacts that close odd loops, is {odd}; in this lattice it can be at most {most}, "
            f"since of the {places} places for such contacts not all can be used at once"
        )
    # choose places, and find the discs around each
    hole = rng.permutation(holes)[:odd]
    around = np.array([sorted(discs) for discs in tree.query_ball_point(hole, distance)], dtype=int)
    if lattice != "triangular":  # one of the two diagonals of each square
        center, rising = bare.center, rng.random((odd, 1)) < 0.5
        added = np.where(rising, around.reshape(-1, 4)[:, [0, 3]], around.reshape(-1, 4)[:, [1, 2]])
    else:  # a disc in each hexagon, with contacts to all six around it
        center = np.concatenate([bare.center, hole])
        added = np.stack([around.ravel(), np.repeat(np.arange(bare.spheres, len(center)), 6)], axis=1)
    contact, more = np.concatenate([bare.contact, added]), len(center) - bare.spheres
    step = center[contact[:, 1]] - center[contact[:, 0]]
    return Packing(
        center=center, contact=contact, normal=step / np.linalg.norm(step, axis=1)[:, None],
        driven=np.append(bare.driven, np.full(more, -1)),
        spin=np.concatenate([bare.spin, np.zeros((more, *bare.spin.shape[1:]))]),
        friction=rng.uniform(*FRICTION, len(contact)), schematic=True,  # a diagonal is longer than spheres reach
    )  # fmt: skip


@lru_cache(maxsize=4)
def _without_odd_loops(lattice: str, size: int, bottom: float) -> tuple[Packing, np.ndarray, cKDTree, float]:
    """Return a lattice without loops of an odd number of discs, and where odd contacts, which close such loops, can be
    put into it: a tuple of

    * the lattice;
    * the places (holes, dimensions), the middles of its whole squares or hexagons;
    * a search tree of the centres of its discs or spheres;
    * the distance within which the discs around a place are found: those of its square or hexagon, and no others.

    lattice : "square", "triangular" (which gives a honeycomb, the places being the middles of its hexagons) or "cubic".
    size : length of each side in diameters.
    bottom : spin of the bottom; that of the top is 1.
    """
    # centres of all squares or hexagons; those that reach beyond the lattice are removed below
    if lattice == "triangular":
        bare = Packing.lattice("honeycomb", (round(size / 3**0.5), round(size / 3)), spin_bottom=bottom)
        hole, margin, distance = bare.center[::2] + (0.0, 1.0), np.full(2, 0.75), 1.25
    else:
        bare = Packing.lattice(lattice, (size,) * DIMENSION[lattice], spin_bottom=bottom)
        sides = {"square": np.ones((1, 2)), "cubic": 1 - np.eye(3)}[lattice]  # of a square in each lattice plane
        hole, distance = (bare.center[:, None] + 0.5 * sides).reshape(-1, DIMENSION[lattice]), 0.75
        margin = np.array([-0.25] * (DIMENSION[lattice] - 1) + [0.25])  # no square has driven spheres alone
    whole = (hole > bare.center.min(axis=0) + margin) & (hole < bare.center.max(axis=0) - margin)
    return bare, hole[whole.all(axis=1)], cKDTree(bare.center), distance


def spins_at_minimum(lattice: str, packing: Packing) -> np.ndarray:
    """Return the spins of least power, 1/time: (spheres, 3) as a solver finds them, or exact ones (discs,).

    lattice : its name; "cubic" is a lattice of spheres, any other one of discs.
    packing : the spheres or discs of this lattice, one sample.
    """
    if lattice == "cubic":
        return np.asarray(solve_packing(packing, SURE).spin[0])
    system = ContactSystem.of(packing)
    return packing.spins_of(exactly(system.all_spins(least_spins(system, packing))))[0]


def draw(lattice: str, size: int, odd: int, bottom: float, samples: int, seed: int) -> dict[str, Any]:
    """Return numbers of the minima of some samples: lists with one entry for each sample.

    lattice, size : name of the lattice, and length of each side in diameters.
    odd : number of odd contacts: added ones that close loops of an odd number of discs.
    bottom : spin of the bottom over that of the top.
    samples, seed : number of samples, and the first of their seeds.

    `rolling`: share of the free discs or spheres that rotate faster than half of the top. `resting`: share of those at
    rest. `power_over_rest`: least power over the power if all free discs or spheres were at rest.
    """
    found: dict[str, list[float]] = {"rolling": [], "resting": [], "power_over_rest": []}
    for number in range(seed, seed + samples):
        packing = network(lattice, size, odd, bottom, number)
        spin = spins_at_minimum(lattice, packing)
        # the same driven spins with all others at rest
        at_rest = spin * (packing.driven >= 0).reshape(-1, *[1] * (spin.ndim - 1))
        speed = np.linalg.norm(spin.reshape(len(spin), -1), axis=1)[packing.driven < 0]
        found["rolling"].append(float((speed > 0.5).mean()))
        found["resting"].append(float((speed < SURE).mean()))
        power, power_at_rest = (float(packing.friction @ packing.slip_speeds(of)) for of in (spin, at_rest))
        found["power_over_rest"].append(power / power_at_rest)
    return found


def possible(lattice: str, size: int, numbers: Sequence[int]) -> list[int]:
    """Return those of some numbers of odd contacts for which the lattice has enough places. Odd contacts are added ones
    that close loops of an odd number of discs.

    lattice : "square", "triangular" or "cubic".
    size : length of each side in diameters.
    numbers : the numbers of odd contacts.
    """
    return [n for n in numbers if n <= DENSEST * len(_without_odd_loops(lattice, size, 0.0)[1])]


Curves = Mapping[int, Mapping[int, np.ndarray]]  # by size L and number n of odd contacts: shares (samples,) that roll


def well_sampled(curves: Curves) -> dict[int, Mapping[int, np.ndarray]]:
    """Return those entries of `curves` that can be fitted: of lattice sizes with at least ENOUGH samples for each
    number of odd contacts, without the entries for no odd contact.

    curves : for each size L and number n of odd contacts (which close loops of an odd number of discs), the shares
        (samples,) of discs that roll with the top.
    """
    with_odd = {L: {n: of for n, of in by.items() if n} for L, by in curves.items()}
    return {L: by for L, by in with_odd.items() if min(map(len, by.values()), default=0) >= ENOUGH}


def held_by_odd_contacts(curves: Curves) -> dict[int, dict[int, np.ndarray]]:
    """Return the entries of `curves` in which neither top nor bottom holds the interface, the layer of slipping
    contacts below the discs that roll with the top: more than FEWEST_LAYERS layers of discs roll, and less than
    LARGEST_SHARE of all.

    curves : for each size L and number n of odd contacts (which close loops of an odd number of discs), the shares
        (samples,) of discs that roll. n = 0 is left out.
    """
    return {
        L: {n: of for n, of in by.items() if n and FEWEST_LAYERS / L < of.mean() < LARGEST_SHARE}
        for L, by in curves.items()
    }


def confined(curves: Curves) -> Collapse | None:
    """Return the exponent a for which s n^(1/2) against n / L^a falls onto one curve for all sizes; None if fewer than
    two sizes have three numbers of odd contacts.

    curves : for each size L and number n of odd contacts (which close loops of an odd number of discs), the shares s
        (samples,) of discs that roll with the top.
    """
    held = held_by_odd_contacts(well_sampled(curves))
    scaled = {L: {n: of * n**0.5 for n, of in by.items()} for L, by in held.items() if len(by) > 2}
    return collapse(scaled) if len(scaled) > 1 else None


def fit_of_many(curves: Curves) -> dict[str, Any] | None:
    """Return the fit of s = c n^-x to all sizes together, over the points with many odd contacts: n > CROWDED
    L^(2/3).

    curves : for each size L and number n of odd contacts (which close loops of an odd number of discs), the shares s
        (samples,) of discs that roll with the top.

    returns : by name, x (`value`), its standard `error`, the probability of a misfit as large (`goodness`), and the
        number of `points`; None for fewer than three points, or if all have the same n.
    """
    held = held_by_odd_contacts(well_sampled(curves))
    points = [(n, of) for L, by in held.items() for n, of in by.items() if n > CROWDED * L**WANDERING]
    if len(points) < 3 or len({n for n, _ in points}) < 2:
        return None
    x, mean = np.log([n for n, _ in points]), np.array([of.mean() for _, of in points])
    spread = np.array([of.std(ddof=1) / len(of) ** 0.5 for _, of in points]) / mean
    (_, slope), goodness = line_through(x, spread, np.log(mean))
    weight = spread**-2.0
    error = (weight * (x - np.average(x, weights=weight)) ** 2).sum() ** -0.5
    return {"value": -float(slope), "error": float(error), "goodness": goodness, "points": len(points)}


def study(folder: Path, effort: Effort) -> StudyResult:
    """Find the minima of bearings for several lattices, sizes, numbers of odd contacts and spins of the bottom; return
    table, figure and values for the claims.

    folder : folder where finished samples are kept until the study ends.
    effort : first seed, number of samples, and whether it is the quick form.
    """
    shares, numbers = (QUICK_SIZES, QUICK_NUMBERS) if effort.quick else (SIZES, NUMBERS)
    sizes = {
        lattice: enough
        for lattice, of in shares.items()
        if (enough := [size for size, part in of.items() if part * effort.samples >= BLOCK])
    }
    # points (lattice, L, n, spin of the bottom) with the bottom at rest and, for one size of discs, rotating
    turned, discs = max(sizes["square"]) if effort.quick else TURNED, ("square", "triangular")
    points = [(lattice, L, n, 0.0) for lattice, of in sizes.items() for L in of for n in possible(lattice, L, numbers)]
    wanted = {point: round(effort.samples * shares[point[0]][point[1]]) for point in points}
    turning = [
        (lattice, turned, n, bottom)
        for lattice in discs for bottom in BOTTOMS[1:] for n in possible(lattice, turned, numbers)
    ]  # fmt: skip
    wanted |= dict.fromkeys(turning, round(effort.samples * OF_TURNED))
    found = drawn(draw, wanted, BLOCK, effort.seed, folder / "odd-loops.jsonl")
    # the table: for each point mean and standard error of all numbers
    rows = []
    for (lattice, size, odd, bottom), of in found.items():
        row = {"lattice": lattice, "size": size, "odd": odd, "omega_bottom": bottom, "samples": len(of["rolling"])}
        for name, values in of.items():
            row |= {name: values.mean(), f"{name}_error": values.std(ddof=1) / len(values) ** 0.5}
        rows.append(row)
    # shares that roll with the bottom at rest, and that rest with the bottom rotating
    rolling: dict[str, Any] = {lattice: {L: {} for L in of} for lattice, of in sizes.items()}
    for lattice, L, n, _ in points:
        rolling[lattice][L][n] = found[lattice, L, n, 0.0]["rolling"]
    most = min(max(rolling[lattice][turned]) for lattice in discs)
    resting = {
        lattice: {bottom: found[lattice, turned, most, bottom]["resting"] for bottom in BOTTOMS} for lattice in discs
    }
    # exponents at which the curves of all sizes fall onto one
    known = {lattice: well_sampled(curves) for lattice, curves in rolling.items()}
    ruled = {lattice: collapse(curves) for lattice, curves in known.items() if len(curves) > 1}
    count = {lattice: sum(n for point, n in wanted.items() if point[0] == lattice) for lattice in sizes}
    named = {
        "drawn_samples": count,
        "rolling": {f"{lattice} {size}": of for lattice in discs for size, of in rolling[lattice].items()},
        "courses": rolling, "rest": resting, "ruled": ruled, "few": min(odd for odd in numbers if odd >= 8),
        "most_odd": most, "size": turned, "landscape": LANDSCAPE, "dimension": DIMENSION,
        "wandering": WANDERING, "layers": FEWEST_LAYERS, "largest_share": LARGEST_SHARE, "beyond": CROWDED,
        "fewest_samples": ENOUGH,
        "confined": {lattice: confined(rolling[lattice]) for lattice in discs},
        "crowded": {lattice: fit_of_many(rolling[lattice]) for lattice in discs},
    }  # fmt: skip
    return StudyResult({".csv": Table.of(rows)}, draw_odd_loops, named)


@in_our_style
def draw_odd_loops(named: Any) -> Figure:
    """Draw three panels for each lattice.

    named : the values that :func:`study` names, as attributes. Used are `courses`: by lattice, size L and number n of
        odd contacts (which close loops of an odd number of discs) the shares (samples,) of discs that roll with the
        top; `rest`: for lattices of discs, by spin of the bottom over that of the top, the shares (samples,) at rest;
        `ruled`: by lattice the exponent a of panel (b), with the smallest size that it holds for.

    (a) The share s of discs that roll with the top, against the number n of odd contacts.
    (b) Discs: s n^(1/2) against n / L^(2/3), over the points where odd contacts alone hold the interface. Spheres: s
        against n / L^a, with the exponent a at which the sizes lie closest together, from the smallest size on from
        which three or more do.
    (c) The share of discs at rest, against the spin of the bottom over that of the top, with the largest number of odd
        contacts.
    """
    figure = new_figure(7.1, 2.4 * len(named.courses))
    rows: Any = figure.subplots(len(named.courses), 3, squeeze=False)
    for panels, (lattice, curves) in zip(rows, named.courses.items(), strict=True):
        are_discs, held, ruled = lattice in named.rest, held_by_odd_contacts(curves), named.ruled.get(lattice)
        for (L, by), color in zip(curves.items(), shades(len(curves)), strict=True):
            look = {"color": color, "label": f"L = {L}"}
            with_odd = {n: shares for n, shares in by.items() if n}
            panels[0].axhline(by[0].mean(), color=color, lw=0.6, ls=":")
            draw_means(panels[0], with_odd, **look)
            if are_discs and held[L]:
                scaled = {n / L**WANDERING: shares * n**0.5 for n, shares in held[L].items()}
                draw_means(panels[1], scaled, **look)
            elif not are_discs and ruled and ruled.smallest <= L:
                draw_means(panels[1], {n / L**ruled.value: shares for n, shares in with_odd.items()}, **look)
        name_sizes(panels[0], sorted({n for by in curves.values() for n in by if n}), "odd contacts n")
        panels[0].set(ylabel="share s of discs that roll", ylim=(0, 0.85))
        panels[0].set_title(f"{lattice}; dotted: none")
        panels[0].legend(loc="upper right", ncols=2)
        panels[1].set(xscale="log", ylim=(0, None))
        if are_discs:
            panels[1].set(xlabel="$n / L^{2/3}$", title=r"$s\,n^{1/2}$, confined")
        elif ruled:
            panels[1].set(xlabel=f"$n / L^{{{ruled.value:.2f}}}$", title=f"together from {ruled.smallest} on")
        else:
            panels[1].set_axis_off()
        if lattice not in named.rest:
            panels[2].set_axis_off()
            continue
        means = [values.mean() for values in named.rest[lattice].values()]
        panels[2].plot(list(named.rest[lattice]), means, "o-", color=BLUE, ms=3)
        panels[2].axhline(1.0, color=GREY, lw=0.8)
        panels[2].set(xlabel=r"$\omega_B / \omega_T$", ylabel="share of discs that rest", ylim=(0, 1.05))
        panels[2].set_title("most odd contacts")
    return figure
