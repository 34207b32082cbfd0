"""What runs of lattices and runs of packings have in common: a job that is ready to be solved, and a kind of runs.

A kind of runs reads what settings describe. There are two: `runs/lattice_run.py` for lattices between two planes, and
`runs/packing_run.py` for packings. Later code asks a job or a scene, never which kind it is.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.runs.cost import Cost
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scene import Bearing
from taichi_bearings.solvers.table import MethodOptions

if TYPE_CHECKING:
    from taichi_bearings.solvers.drive import Checkpoints, Monitor


@dataclass(frozen=True)
class Job(ABC):
    """A run whose input has been checked and that is ready to be solved.

    settings : what was asked for.
    scene : what is solved, with all samples.
    spin : initial spins, (samples R, spheres *N) or (R, *N, 3), 1/time; None where only their name is known.
    """

    settings: RunSettings
    scene: Bearing
    spin: np.ndarray | None

    @abstractmethod
    def solve(
        self, monitors: "Sequence[Monitor]" = (), checkpoints: "Checkpoints | None" = None, **others: object
    ) -> Result:
        """Solve the run on the device that the settings name, and return its result.

        monitors : functions that are called at each check.
        checkpoints : where and how often checkpoints are written, for methods that can go on from one.
        others : arguments for packings alone, such as `density`.
        """

    @property
    @abstractmethod
    def cost(self) -> Cost:
        """The estimated cost of the run: seconds, steps and bytes."""


class RunKind(ABC):
    """A kind of runs. From settings alone, before a scene is made, it finds which method solves a run, what the run
    costs, and which samples are solved together; and it makes the job that solves the run.
    """

    what: str
    """The kind of scene in words, in the plural: "lattices" or "packings"."""

    @abstractmethod
    def row(self, settings: RunSettings) -> type[MethodOptions]:
        """Return the class, in the table of methods, of the method that solves a run with these settings.

        Raises InputError for a method that cannot solve it.
        """

    @abstractmethod
    def job(self, settings: RunSettings, strict: bool = True) -> Job:
        """Return the job that the settings describe; every input error is raised here, before anything is computed.

        settings : settings of the run.
        strict : True to raise InputError for options that neither the method nor the law uses; False to ignore them.
        """

    @abstractmethod
    def job_of_seeds(self, settings: RunSettings, seeds: Sequence[int]) -> Job:
        """Return the job that solves several samples at once, which differ in their seeds alone.

        settings : settings of any of them; options that are not used are ignored.
        seeds : the seed of each sample.
        """

    @abstractmethod
    def refuse(self, settings: RunSettings, has_seeds: bool) -> None:
        """Raise InputError for settings that describe nothing that can be solved.

        settings : settings of one sample of a scan.
        has_seeds : True if the scan asks for several seeds; something must then be drawn from them.
        """

    @abstractmethod
    def are_solved_together(self, settings: RunSettings, spheres: int) -> bool:
        """Return True if samples that differ in their seeds alone can be solved at once, each with the same bits as
        alone. False if one of them could end before the others, or if a file gives what would be drawn from the seeds.

        settings : settings of any of them.
        spheres : number of spheres of a sample.
        """

    @abstractmethod
    def samples_at_a_time(self, settings: RunSettings, spheres: int) -> int:
        """Return how many samples that differ in their seeds alone a worker should get at a time, as they are solved
        faster together; 1 if they are not.

        settings : settings of any of them.
        spheres : number of spheres of a sample.
        """

    @abstractmethod
    def seconds(self, settings: RunSettings) -> float | None:
        """Return the estimated seconds to solve one sample with these settings; None where they are not known."""

    @abstractmethod
    def worker_bytes(self, settings: RunSettings, spheres: int, most: int) -> float:
        """Return the estimated memory, bytes, of a worker that solves samples with these settings.

        spheres : number of spheres of a sample.
        most : number of samples that it gets at a time, at most.
        """

    def complete_file(self, settings: RunSettings) -> str | None:
        """Return the name of the file that has all coefficients of a run with these settings; None if some of them are
        drawn.
        """
        return settings.coefficients

    def idle_seed(self, settings: RunSettings) -> list[str]:
        """Return a list with one sentence if nothing is drawn from the seed of the settings, since a file has all
        coefficients and the initial spins are not random; else an empty list.
        """
        file = None if settings.initial == "random" else self.complete_file(settings)
        told = f"seed is {settings.seed}, but {file} holds all coefficients, so nothing is drawn from it"
        return [] if file is None else [told]

    def refuse_idle_seeds(self, settings: RunSettings) -> None:
        """Raise InputError if nothing is drawn from the seeds of a scan, since all its samples would be the same.

        settings : settings of one of the samples.
        """
        if self.idle_seed(settings):
            drawn = "coefficients" if settings.packing is None else "friction from the file"
            raise InputError(
                f"seed is scanned, but {self.complete_file(settings)} holds all coefficients, so nothing is drawn; "
                f"leave out seed, or {drawn}"
            )
