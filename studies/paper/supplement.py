"""The supplement's distribution of power over the contacts of 32x32x32 spheres: the certified one beside the descent's.

At the minimum a contact slips or rests, and which does is proven. A descent that has not ended lets all of them slip a
little, so its histogram has decades that are not there at the minimum. Here the states of the minimum tell how many of
the contacts in each decade of the descent really slip. The range of the minimum itself is proven, too: every slip is
enclosed (verifier/curvature.py), so the smallest and the largest power are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings import runtime
from taichi_bearings.files.whole_file import read_hdf5, write_csv, write_hdf5
from taichi_bearings.lattice.grid import friction_by_axis
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.scene import Scene, Solution
from taichi_bearings.solvers import GradientDescent, InteriorPoint
from taichi_bearings.solvers.stopping import StopRule
from taichi_bearings.stages import alike, each, stage
from taichi_bearings.verifier.curvature import Slipping, nearest_minimum
from taichi_bearings.verifier.network import Network
from taichi_bearings.verifier.samples import Samples

from ..plots.decades import draw_decades
from .claims import Claim, Effort, Share, judge
from .samples import save_both, solved

SHAPE, SPIN_BOTTOM = (32, 32, 32), 0.1
SHARE_OF_SAMPLES = 0.04
PAPER_DECADES, PAPER_ITERATIONS = 11, 1_000_000
ITERATIONS, QUICK_ITERATIONS = (10_000, 100_000, PAPER_ITERATIONS), (10_000, 100_000)
BUDGET, QUICK_BUDGET = 1500.0, 90.0  # seconds of a descent
BINS_PER_DECADE = 5
SCHEMA = "taichi_bearings.supplement"
NONE_PROVEN = "no sample with proven slips"


@dataclass(frozen=True)
class Ending:
    """Where a method has ended in one sample, of the n contacts that can slip.

    power : (n,), over F_n R omega_T. slips : (n,), whether it does at the minimum (certified) or moves at all
    (descent). excess : of the total power over the proven bound, relative. iterations : done. slip_error : share by
    which any slip differs from that of the minimum at most, proven; NaN where that is not known.
    """

    power: np.ndarray
    slips: np.ndarray
    total: float
    excess: float
    iterations: int
    slip_error: float

    @property
    def decades(self) -> float:
        """Orders of magnitude from the smallest to the largest power of the contacts that slip."""
        found = self.power[self.slips]
        return float(np.log10(found.max() / found.min()))

    @property
    def central_decades(self) -> float:
        """The same without the lowest and the highest twentieth of them."""
        low, high = np.quantile(np.log10(self.power[self.slips]), (0.05, 0.95))
        return float(high - low)


def reproduce(folder: Path, effort: Effort) -> list[Claim]:
    """Write supplement.png, supplement.pdf and supplement.csv into `folder`; returns the claims with their verdicts."""
    runtime.start("cpu", "f64")
    seeds = range(effort.seed, effort.seed + max(1, int(SHARE_OF_SAMPLES * effort.samples)))
    lengths, budget = (QUICK_ITERATIONS, QUICK_BUDGET) if effort.quick else (ITERATIONS, BUDGET)
    descents = []
    for length in each(lengths, "descent", float):
        path = folder / f"supplement-descent-{length}.kept.h5"
        descents.append(kept(path, partial(descended, scene_of(effort.seed), length, budget)))
    minima = []
    for seed in each(seeds, "minimum", alike):
        minima.append(kept(folder / f"supplement-minimum-{seed}.kept.h5", partial(minimum, scene_of(seed))))
    decades = by_decade(descents[-1], minima[0])
    write_decades(folder / "supplement.csv", minima[0], descents)
    with stage("drawing"):
        named = {f"descent, {ending.iterations:,}": ending.power for ending in descents}
        figure = draw_decades(minima[0].power, minima[0].slips, named, BINS_PER_DECADE)
        save_both(figure, folder, "supplement")
    for path in folder.glob("supplement-*.kept.h5"):
        path.unlink()
    return [_range(minima), _broad(minima), _real(descents, minima[0], decades)]


def scene_of(seed: int) -> Scene:
    return Scene.random(SHAPE, seed, spin_bottom=SPIN_BOTTOM)


def kept(path: Path, compute: Callable[[], Ending]) -> Ending:
    """What an interrupted reproduction has kept, else computed and kept."""
    if path.exists():
        with read_hdf5(path, SCHEMA, 1, "a kept part of the supplement") as file:
            found = {item.name: file[item.name][()] for item in fields(Ending)}
            return Ending(**{name: value if np.ndim(value) else value.item() for name, value in found.items()})
    ending = compute()

    def fill(file: h5py.File) -> None:
        file.attrs["schema"], file.attrs["schema_version"] = SCHEMA, 1
        for item in fields(Ending):
            file.create_dataset(item.name, data=getattr(ending, item.name))

    write_hdf5(path, fill)
    return ending


def descended(scene: Scene, iterations: int, seconds: float) -> Ending:
    """The paper's method: descent without momentum, from random spins, for so many iterations or so long."""
    ended = solved(scene, GradientDescent(momentum=False), StopRule(1e-12, iterations, seconds), "random")
    return _ending(ended, lambda power, _: power > 0, np.nan)


def minimum(scene: Scene) -> Ending:
    """The certified minimum, with the states of its contacts."""
    solution = solved(scene, InteriorPoint(), StopRule(1e-9))
    return _ending(solution, lambda _, state: state == ContactState.SLIPPING, largest_slip_error(solution))


def _ending(solution: Solution, slips: Callable[[np.ndarray, np.ndarray], np.ndarray], slip_error: float) -> Ending:
    scene = solution.scene
    free = ~scene.lattice.between_driven
    power, state = solution.power_per_contact[0, free], solution.state[0, free]
    unit = scene.normal_force * scene.lattice.radius * abs(scene.spin_top)
    total, bound = float(solution.power[0]), float(solution.lower_bound[0])
    return Ending(power / unit, slips(power, state), total / unit, total / bound - 1, solution.iterations, slip_error)


def largest_slip_error(solution: Solution) -> float:
    """Share by which any slip differs from that of every minimum at most; NaN where the states are not proven."""
    if not solution.states_proven.all():
        return float("nan")
    scene = solution.scene
    samples = Samples(
        scene.lattice.shape, scene.law.name, scene.lattice.by_axis(scene.coefficient), scene.spin_top,
        scene.spin_bottom, scene.direction, scene.normal_force, scene.lattice.radius, solution.spin,
        solution.spin_rounding, friction_by_axis(solution.friction, scene.lattice),
    )  # fmt: skip
    contacts = Slipping.of(Network.of_lattice(samples).motion)
    near = nearest_minimum(contacts)
    if near is None:
        return float("nan")
    improved, turn = near
    moved = np.abs(improved.size.value / contacts.size.value - 1)  # by Newton's method, before it was enclosed
    return float((moved + turn * (1 + moved)).max(initial=0.0))


@dataclass(frozen=True)
class Decade:
    """Contacts of a descent with powers in [10^exponent, 10^(exponent + 1)), and how many of them slip at the minimum;
    at_minimum : contacts that slip there with such powers."""

    exponent: int
    contacts: int
    slipping: int
    at_minimum: int

    @property
    def is_real(self) -> bool:
        """Do most of them slip at the minimum?"""
        return 2 * self.slipping > self.contacts


def by_decade(descent: Ending, minimum: Ending) -> list[Decade]:
    """From the lowest to the highest decade of the descent."""
    of_contact, of_minimum = _exponents(descent.power, descent.slips), _exponents(minimum.power, minimum.slips)
    used = of_contact[descent.slips]
    return [
        Decade(
            exponent,
            int((of_contact == exponent).sum()),
            int(((of_contact == exponent) & minimum.slips).sum()),
            int((of_minimum == exponent).sum()),
        )
        for exponent in range(used.min(), used.max() + 1)
    ]


def _exponents(power: np.ndarray, slips: np.ndarray) -> np.ndarray:
    """Decade of each contact; a number below all others where it does not slip."""
    return np.floor(np.log10(power, out=np.full(len(power), -9999.0), where=slips)).astype(int)


def write_decades(path: Path, minimum: Ending, descents: Sequence[Ending]) -> None:
    """Decade by decade of each descent: contacts, those of them that slip at the minimum, and those that the minimum
    has in that decade."""
    rows = [
        [ending.iterations, 10.0**d.exponent, 10.0 ** (d.exponent + 1), d.contacts, d.slipping, d.at_minimum]
        for ending in descents
        for d in by_decade(ending, minimum)
    ]
    names = ["iterations", "power_low", "power_high", "contacts", "of_these_slipping_at_minimum", "at_minimum"]
    write_csv(path, names, rows, ["powers over F_n R omega_T"])


def _proven(minima: Sequence[Ending]) -> list[Ending]:
    """Those of which every slip is enclosed. Of others the smallest slips may be the method's."""
    return [ending for ending in minima if np.isfinite(ending.slip_error)]


def _range(minima: Sequence[Ending]) -> Claim:
    proven = _proven(minima)
    decades, errors = [ending.decades for ending in proven], [ending.slip_error for ending in proven]
    return judge(
        "supplement.range",
        {"decades": decades, "slip_error": errors},
        shown=", ".join(f"{value:.2f}" for value in decades),
        proven=len(proven),
        minima=len(minima),
        worst=max(errors, default=np.nan),
        wide=Share.of(np.round(decades) >= PAPER_DECADES),
        resting=", ".join(f"{int((~ending.slips).sum()):,}" for ending in proven),
        contacts=len(minima[0].power),
        from_to=f"{min(decades):.1f} to {max(decades):.1f} decades" if proven else NONE_PROVEN,
    )


def _broad(minima: Sequence[Ending]) -> Claim:
    central = [ending.central_decades for ending in _proven(minima)]
    in_mean = f"{np.mean(central):.2f} decades for 90 % of them" if central else NONE_PROVEN
    shown = ", ".join(f"{value:.2f}" for value in central)
    return judge("supplement.broad", {"central_decades": central}, shown=shown, in_mean=in_mean)


def _real(descents: Sequence[Ending], minimum: Ending, decades: Sequence[Decade]) -> Claim:
    descent = descents[-1]
    held = [decade for decade in decades if decade.contacts]
    numbers = {
        "iterations": descent.iterations,
        "excess": descent.total / minimum.total - 1,
        "by_decade": list(map(vars, decades)),
    }
    return judge(
        "supplement.real",
        numbers,
        moving=int(descent.slips.sum()),
        decades=descent.decades,
        resting=int(descent.slips.sum() - (descent.slips & minimum.slips).sum()),
        words="; ".join(f"10^{d.exponent}: {d.slipping:,} of {d.contacts:,}" for d in held),
        real=sum(decade.is_real for decade in held),
        held=len(held),
        shown=", ".join(f"{ending.decades:.1f} after {ending.iterations:,} iterations" for ending in descents),
        whole=descent.iterations >= PAPER_ITERATIONS,
        known=bool(np.isfinite(minimum.slip_error)),
    )
