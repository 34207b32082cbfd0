"""The answer to a scene, from what solves it to its file and to users: scene, settings, and all that was found.

What a method has found lies in `Result.solution`, once, with an axis R of samples, (R, E) on contacts. The attributes
of a `Result` show it in the shapes that users know; its numbers are the rows of :mod:`taichi_bearings.quantities`.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from taichi_bearings.errors import FileError, InputError
from taichi_bearings.plain_files import Json
from taichi_bearings.proof.contact_state import Separation, separate
from taichi_bearings.quantities import CONTACTS, FINDINGS, SAMPLES, SPHERES, Quantity, numbers_of
from taichi_bearings.read_only import read_only
from taichi_bearings.runs.caveats import caveats
from taichi_bearings.runs.run_directory import run_directory
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.runs.writing import draw_figures, publish
from taichi_bearings.scene import Bearing, Snapshots, Solution, Status
from taichi_bearings.scene.initial_spins import STARTS, initial_spin
from taichi_bearings.solvers.stopping import reported_status
from taichi_bearings.version import VERSION
from taichi_bearings.words import counted, html_table, listed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taichi_bearings.analysis.histogram import PowerHistogram
    from taichi_bearings.plots.page import Page

OfSamples = Any
"""A number or word; with several samples an array or a list of R of them."""
OfContacts = Any
"""On a lattice a tuple of arrays, one for each axis, of the shapes of `Scene.coefficients`; in a packing one array (E,)
over its E contacts. With several samples each array has a leading axis R."""


TABLED = (
    "seed", "status", "proof", "power", "lower_bound", "gap", "slipping", "slipless", "tied", "undecided",
    "driven_power",
)  # fmt: skip
"""Columns of the table that notebooks show, as far as an answer has them."""


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """An answer: what was solved, how it ended, and spins, slips and forces with what is proven of them.

    It is the same whether it was solved just now or read from a file. Arrays are read-only.

    With a single sample arrays have no axis of samples. With R samples each number is an array (R,), and each array
    begins with an axis R; `result[0]` is one sample alone, and `for one in result` goes through all.

    N is the lattice, such as (nx, ny, nz), or the number of spheres of a packing. What lies on contacts is a tuple with
    one array for each axis, x, y(, z), of the shapes of `scene.coefficients`; for packings of E contacts it is one
    array (E,). Contacts between driven spheres and absent ones are left out of `power`.

    Attributes
    ----------
    asked : RunSettings
        All that was asked for, as `bearings run` has it.
    solution : Solution
        What was found of all R samples: arrays with a leading axis R, and (R, E) on the E contacts.
    started_from : numpy.ndarray or None
        Laboratory spins, 1/time, that were given as an array to start from; None where they were given by name, such as
        "linear", or are stored in the directory of the run.
    path : pathlib.Path or None
        Directory or file of the run; None if it is in none.
    command : str
        The command line that made it; empty if there is none.
    interrupted : bool
        Whether Ctrl-C or SIGTERM was heard.
    attributes : Mapping
        Attributes of the file that it was read from.

    Examples
    --------
    >>> import taichi_bearings as tb
    >>> best = tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)
    >>> best.status, best.spin.shape, [slip.shape for slip in best.slip]
    ('certified', (4, 5), [(3, 5), (4, 4)])
    """

    asked: RunSettings
    solution: Solution
    started_from: np.ndarray | None = None
    path: Path | None = None
    command: str = ""
    interrupted: bool = False
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> Bearing:
        """The :class:`Scene` or :class:`Packing` that was solved, with all samples."""
        return self.solution.scene

    @property
    def version(self) -> str:
        """The version of the program that solved it: for a run that was read, the one that its file names."""
        return str(self.attributes.get("version", VERSION))

    @property
    def packing(self) -> Bearing | None:
        """The :class:`Packing` that was solved; if there are several samples, the first of them; None for lattices."""
        return self.scene.sample(0) if self.scene.network.lattice is None else None

    @property
    def settings(self) -> Json:
        """Options that differ from their defaults, by name as in `bearings run`: with these the scene can be solved
        again.
        """
        return self.asked.given

    method: ClassVar[str]
    status: ClassVar[OfSamples]
    power: ClassVar[OfSamples]
    lower_bound: ClassVar[OfSamples]
    gap: ClassVar[OfSamples]
    contacts: ClassVar[OfSamples]
    slipping: ClassVar[OfSamples]
    slipless: ClassVar[OfSamples]
    tied: ClassVar[OfSamples]
    undecided: ClassVar[OfSamples]
    unproven: ClassVar[OfSamples]
    minimum_is_unique: ClassVar[OfSamples]
    states_proven: ClassVar[OfSamples]
    slip_threshold: ClassVar[float]
    largest_balance_residual: ClassVar[OfSamples]
    iterations: ClassVar[int]
    seconds: ClassVar[float]
    seconds_compile: ClassVar[float]
    spin: ClassVar[np.ndarray]
    spin_rounding: ClassVar[np.ndarray]
    slip: ClassVar[OfContacts]
    power_per_contact: ClassVar[OfContacts]
    force: ClassVar[OfContacts]
    state: ClassVar[OfContacts]
    proof: ClassVar[OfSamples]
    driven_power: ClassVar[OfSamples]
    slipless_motions: ClassVar[OfSamples]
    time: ClassVar[OfSamples]

    @property
    def ended(self) -> list[Status]:
        """How each sample ended, as a list of members of the enumeration `Status`; the attribute `status` has the same
        in words.

        A sample is certified if its own gap is within the tolerance, however the run ended; restricted, if its lower
        bound is not proven of all spins. The exception is a dynamics that ended before the simulated time that was
        asked for.
        """
        own, asked = self.solution.own.get("status", [self.solution.status] * len(self)), self.asked
        restricted, has_duration = self.solution.is_restricted.tolist(), asked.duration is not None
        return [
            reported_status(status, gap, is_restricted, asked.tolerance, has_duration)
            for status, gap, is_restricted in zip(own, self.solution.gap, restricted, strict=True)
        ]

    @cached_property
    def separation(self) -> Separation:
        """The largest slip of a slipless contact and the smallest slip of a slipping contact, length/time, with the
        powers of ten between them: arrays (samples R,)."""
        return separate(self.scene, self.solution.slip, self.solution.state)

    @property
    def reached(self) -> bool:
        """True if all samples reached what was asked for: the tolerance, rest, or the simulated time."""
        return all(status.reached for status in self.ended)

    @property
    def potential(self) -> OfSamples:
        """What the stationary state minimises, energy/time: the power, or for the law coulomb-viscous the dissipation
        potential. With several samples an array (samples R,)."""
        return self._of_samples(self.solution.objective)

    @property
    def findings(self) -> dict[str, OfSamples]:
        """Other numbers and words that the method has found, by name; with several samples arrays (samples R,)."""
        return {name: self._of_samples(values) for name, values in self.solution.findings.items()}

    @cached_property
    def numbers(self) -> Json:
        """The numbers and words of all samples in the table of quantities, by name, and the warnings."""
        return numbers_of(self) | {"warnings": caveats(self.solution, self.asked)}

    @property
    def warnings(self) -> list[str]:
        """Sentences, each with a number, that say where the answer could be misread; often an empty list."""
        return list(self.numbers["warnings"])

    @property
    def summary(self) -> Json:
        """All numbers by name, as `bearings run --json` prints them: `numbers`, how the network is driven, the name of
        the coefficients and the directory of the run; for lattices also `arch`, `precision` and `threads`. If there are
        several samples, numbers in which they may differ are lists.
        """
        where = {
            "coefficients": self.asked.coefficients,
            "run": None if self.path is None else str(self.path),
        }
        if self.scene.network.lattice is not None:
            where |= {name: getattr(self.solution.running, name) for name in ("arch", "precision", "threads")}
        return self.numbers | self.asked.driving | where

    @property
    def friction(self) -> OfContacts:
        """Friction on the upper sphere of each contact, force. For each axis of a lattice it is an array (*contacts,
        3), or in 2D (*contacts), the component along z x n with the normal n. For packings it is the force on the
        second sphere, one array (contacts E, 3), or (E,) for discs. The lower bound follows from these forces.
        """
        return read_only(self.scene.network.friction_as_given(self._of_samples(self.solution.friction)))

    @property
    def history(self) -> dict[str, np.ndarray]:
        """The course of the solve: columns (checks,) by name; with several samples (samples R, checks), except for
        iteration, seconds and time, which samples that are solved together share.

        iteration : iterations done.
        seconds : wall time, s.
        time : simulated time of a dynamics.
        power, lower_bound : power, and the best bound on the least power proven so far, energy/time.
        largest_balance_residual : largest torque left on a free sphere, force * length.
        slipping : number of contacts that slip.
        kinetic_energy, spring_energy, injected_energy, dissipated_energy : energies of a dynamics that keeps a balance.
        energy_residual : relative error of that balance.
        """
        columns = self.solution.history.items()
        return {name: values if values.ndim == 1 else self._of_samples(values.T) for name, values in columns}

    @property
    def snapshots(self) -> Snapshots | None:
        """Spins of a dynamics at the S times that were asked for; None if no times were asked for.

        time : (snapshots S,); with several samples (samples R, S) unless all have the same times.
        spin : (S, spheres *N), in 3D (S, *N, 3), 1/time; with several samples (R, S, ...).
        """
        kept = self.solution.snapshots
        return None if kept is None else Snapshots(kept.time.T, self._of_samples(np.moveaxis(kept.spin, 1, 0)))

    def _of_samples(self, values: object) -> Any:
        """Return values of all samples as users see them: without the axis of samples if there is a single one.

        values : an array or list whose first axis has the R samples; anything else is the same for all samples and
            returned as it is.
        """
        if len(self) > 1 or not isinstance(values, (np.ndarray, list)):
            return values
        return values.item() if isinstance(values, np.ndarray) and values.ndim == 1 else values[0]

    def sample(self, number: int) -> "Result":
        """Return the result of one sample as if it had been solved alone.

        Parameters
        ----------
        number : int
            Which sample, counted from 0.

        Returns
        -------
        Result
            The result of that sample; its arrays have no axis of samples.

        Raises
        ------
        InputError
            If there is no sample of this number.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> both = tb.solve(tb.Scene.random((4, 5), seed=3, replicas=2), threads=1)
        >>> both.power.shape, both.sample(1).status
        ((2,), 'certified')
        """
        if not 0 <= number < len(self):
            raise InputError(f"replica is {number}; the run has {counted(len(self), 'replica')}, numbered from 0")
        solution, spin = self.solution.sample(number), self.started_from
        asked = self.asked.of_replica(solution.scene.seeds[0])
        one = None if spin is None else spin[[number]]
        return replace(self, asked=asked, solution=solution, started_from=one)

    def start(self) -> np.ndarray:
        """Return the spins from which the solve started.

        Returns
        -------
        array
            Laboratory spins, 1/time: (R, *N) of discs or (R, *N, 3) of spheres, for R samples of a lattice of shape *N
            or of N spheres. The direct methods for minima of packings do not use them.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> tb.solve(tb.Scene.random((4, 5), seed=3), start="zero", threads=1).start().shape
        (1, 4, 5)
        """
        named, path = self.asked.initial, self.path
        if self.started_from is not None:
            return self.started_from
        beside = named if named in STARTS or path is None else str((path if path.is_dir() else path.parent) / named)
        return initial_spin(self.scene, beside)

    @property
    def given_start(self) -> np.ndarray | None:
        """The spins from which the solve started, as :meth:`start` returns them, if a file or an array gave them; None
        if they have a name, such as "linear".
        """
        return None if self.asked.initial in STARTS else self.start()

    @cached_property
    def histogram(self) -> "PowerHistogram":
        """Histogram of the slipping contacts of all samples by the power that they dissipate."""
        from taichi_bearings.analysis.histogram import count_powers, pool

        found = self.solution
        return pool(count_powers(found.power_per_contact, found.state), found.slip_threshold)

    def __len__(self) -> int:
        """Return the number R of samples."""
        return self.scene.replicas

    def __getitem__(self, number: int) -> "Result":
        """Return the result of sample `number` as if it had been solved alone; negative numbers count from the end."""
        samples = len(self)
        if not -samples <= number < samples:
            raise IndexError(f"there is no sample {number}; the result has {samples}, numbered from 0")
        return self if samples == 1 else self.sample(number % samples)

    def __iter__(self) -> Iterator["Result"]:
        """Yield the result of each sample alone, in their order."""
        return (self[number] for number in range(len(self)))

    def __repr__(self) -> str:
        """Return what was solved, by which method and how well, in one line."""
        what = self.packing or f"{'x'.join(map(str, self.scene.network.shape))} {self.scene.law}"
        words = f"<Result {what}, {self.method}"
        if len(self) > 1:
            done = sum(status.reached for status in self.ended)
            return f"{words}: {len(self)} samples, {done} reached, gap at most {self.gap.max():.1e}>"
        return f"{words}: {self.status}, P = {self.power:.12g}, gap {self.gap:.1e}, {self.seconds:.2g} s>"

    def _repr_html_(self) -> str:
        """Return a table for notebooks with one row for each sample."""
        columns = {name: listed(found) for name in TABLED if (found := self.summary.get(name)) is not None}
        return html_table(repr(self), zip(*columns.values(), strict=True), list(columns))

    def plot(
        self, kind: str = "spins", sample: int = 0, time: float | None = None, page: "Page | None" = None
    ) -> "Figure":
        """Draw a figure, which notebooks show and `.savefig("a.pdf")` writes; no setting of matplotlib is changed.

        Parameters
        ----------
        kind : str
            "spins", "power", "coefficients", "history", "energy", or one of `bearings analyse`: "domains",
            "network".
        sample : int
            Which one of several samples is drawn.
        time : float, optional
            Simulated time of the snapshot whose spins are drawn.
        page : taichi_bearings.plots.page.Page, optional
            How it is printed: width, planes and view.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        InputError
            For a figure or a sample that there is not, or where there is nothing to show.

        Examples
        --------
        >>> import taichi_bearings as tb
        >>> best = tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)
        >>> len(best.plot("spins").axes)
        2
        """
        from taichi_bearings.plots.page import PAGE
        from taichi_bearings.runs.figures import draw_figure  # and with it matplotlib, which nothing else needs

        return draw_figure(kind, self.solution, sample, time, self.asked.slip_threshold, page or PAGE)

    def save(self, path: str | Path, force: bool = False) -> Path:
        """Write what `bearings run` writes into a new directory; :func:`load` reads it.

        Parameters
        ----------
        path : str or Path
            The directory.
        force : bool
            Replace a run directory that stands there.

        Returns
        -------
        Path
            The directory, which is `path` of this result from now on.

        Raises
        ------
        FileError
            If something stands there, or if it cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import taichi_bearings as tb
        >>> best = tb.solve(tb.Scene.random((4, 5), seed=3), threads=1)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     tb.load(best.save(folder + "/mine")).power == best.power
        True
        """
        if not force and os.path.lexists(path):
            raise FileError(f"{path} already exists; save into another directory, or with force=True")
        with run_directory(Path(path), force) as directory:
            stored = publish(directory, replace(self, started_from=self.given_start))
            vars(self).update(path=stored.path, started_from=stored.started_from)
            draw_figures(self)
        return directory.path


def _described(row: Quantity) -> str:
    """Return the docstring of a quantity: its text and its unit.

    row : the row of the quantity in the table of quantities.
    """
    unit = "" if row.unit == "1" else f", {row.unit}"
    return f"{row.text[0].upper()}{row.text[1:]}{unit}."


def _of_samples(row: Quantity) -> property:
    """Return a property of `Result` that shows a quantity with one number or word for each sample.

    row : the row of the quantity in the table of quantities.
    """
    return property(lambda result: result._of_samples(row.of(result)), doc=_described(row))


def _of_contacts(row: Quantity) -> property:
    """Return a property of `Result` that shows a quantity of the contacts. Its value is a tuple with an array for each
    axis on a lattice, one array in a packing, and an empty tuple where nothing is known.

    row : the row of the quantity in the table of quantities.
    """

    def found(result: Result) -> OfContacts:
        """Return the values of the quantity on the contacts of a result."""
        values = row.of(result.solution)
        if values is None:
            return ()
        return result.scene.network.as_given(result._of_samples(values))

    return property(found, doc=f"{_described(row)[:-1]}; on lattices one array for each axis.")


def _of_findings(row: Quantity) -> property:
    """Return a property of `Result` that shows a number or word that the method has found for each sample; None if
    there is none.

    row : the row of the quantity in the table of quantities.
    """
    return property(lambda result: result.findings.get(row.name), doc=_described(row))


for _name in Result.__annotations__.keys() & SAMPLES.keys():
    setattr(Result, _name, _of_samples(SAMPLES[_name]))
for _name in Result.__annotations__.keys() & FINDINGS.keys():
    setattr(Result, _name, _of_findings(FINDINGS[_name]))
for _name, _row in SPHERES.items():  # shape N, or (*N, 3); also arrays of zeros, which files leave out
    _found = partial(lambda name, result: result._of_samples(getattr(result.solution, name)), _name)
    setattr(Result, _name, property(_found, doc=_described(_row)))
for _name, _row in CONTACTS.items():
    setattr(Result, "power_per_contact" if _name == "power" else _name, _of_contacts(_row))


def together(ones: Sequence[Mapping[str, object]]) -> Json:
    """Return the numbers of all samples by name. With one sample they are its numbers as they are, with several samples
    lists with an entry for each.

    ones : for each sample its numbers, by name.
    """
    return dict(ones[0]) if len(ones) == 1 else {key: [one[key] for one in ones] for key in ones[0]}
