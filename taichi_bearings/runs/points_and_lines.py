"""One sample of a stored run as points and lines, for the interactive 3D page and for ParaView.

Each sphere is a point and each contact a line. What is known of them are columns: arrays (N, ...) over N spheres and
(E,) over E contacts, with units.
"""

from dataclasses import dataclass, field

import numpy as np

from taichi_bearings.analysis.structure import Structure, structure_of
from taichi_bearings.errors import InputError
from taichi_bearings.files.whole_file import Finding
from taichi_bearings.quantities import CONTACTS, SPHERES, found_in
from taichi_bearings.runs.figures import moment_of
from taichi_bearings.runs.result import Result
from taichi_bearings.runs.run_file import file_of
from taichi_bearings.runs.run_layout import PACKING_ARRAYS
from taichi_bearings.runs.stored_structure import Drawn
from taichi_bearings.scene import Solution
from taichi_bearings.scene.network import Network
from taichi_bearings.stages import stage

DOMAIN_KINDS = "0 bottom, 1 top, 2 both, 3 mixed, 4 partly, 5 neither"


@dataclass(frozen=True)
class Moments:
    """Spins, slips and contact states of a sample at S snapshots of a dynamics; a snapshot at its end is left out.

    time : (snapshots S,), simulated time.
    spin : (S, spheres N, 3), spins, 1/time.
    slip : (S, contacts E), slip speeds, length/time.
    state : (S, E), contact states: slipping where the slip is above `threshold`. Friction would be a better criterion,
        but snapshots do not hold it.
    threshold : slip speed, length/time.
    """

    time: np.ndarray
    spin: np.ndarray
    slip: np.ndarray
    state: np.ndarray
    threshold: float


@dataclass(frozen=True)
class PointsAndLines:
    """The spheres and contacts of one sample as points and lines with columns.

    On lattices spheres are in C order; contacts along x come first, then those along y (and z), each in C order of
    their lower spheres.

    structure : spheres, contacts and answer of the sample. Some of its properties, such as rigid domains, take long to
        compute; `drawn` has those that are known.
    spheres, contacts : columns (N, ...) of the N spheres, and (E,) of the E contacts, by name, with units.
    drawn : what is known of the structure: domains, network, path.
    time : simulated time at the end of a dynamics, else None.
    moments : snapshots of the sample before the end, None if there are none.
    """

    structure: Structure
    spheres: dict[str, Finding] = field(repr=False)
    contacts: dict[str, Finding] = field(repr=False)
    drawn: Drawn = field(repr=False)
    time: float | None
    moments: Moments | None

    @property
    def answer(self) -> Solution:
        """The answer of the sample."""
        return self.structure.answer

    @property
    def network(self) -> Network:
        """The spheres and contacts of the sample; on a lattice the bottom is body 0, and the top is body 1."""
        return self.structure.whole

    @property
    def is_lattice(self) -> bool:
        """True for a lattice, False for other packings."""
        return self.network.lattice is not None


def points_and_lines(run: Result, replica: int = 0, analyse: bool = False) -> PointsAndLines:
    """Return one sample of a run as points and lines.

    run : the run, read from a file or solved just now.
    replica : number of the sample, from 0.
    analyse : True to compute its structure (network, domains, cut); False to take what the file of the run has of it,
        if anything.

    Raises InputError if there is no such sample, or if its spins or slips are not finite.
    """
    answer = run.sample(replica).solution
    if not all(np.isfinite(values).all() for values in (answer.spin, answer.slip)):
        raise InputError("the spins or slips of the run are not finite; there is nothing to draw")
    time = float(answer.history["time"][-1]) if "time" in answer.history else None
    structure = structure_of(answer)
    if analyse:
        with stage("analysing"):
            drawn = Drawn.computed(structure)
    else:
        with stage("reading"):
            number = replica if len(run.solution.state) > 1 else None
            drawn = Drawn() if run.path is None else Drawn.stored(file_of(run.path), structure, number)
    with stage("collecting what is drawn"):
        return _collected(structure, drawn, time, run.asked.slip_threshold)


def _collected(structure: Structure, drawn: Drawn, time: float | None, slip_threshold: float | None) -> PointsAndLines:
    """Return a sample as points and lines with all columns that are known.

    structure : the sample.
    drawn : known columns of its structure.
    time : simulated time at the end of a dynamics, else None.
    slip_threshold : slip speed, length/time, up to which contacts of a snapshot count as slipless; None if the run was
        not given one.
    """
    answer, moments = structure.answer, _moments(structure, time, slip_threshold)
    spheres, contacts, network, row = dict(drawn.spheres), dict(drawn.contacts), structure.whole, SPHERES["spin"]
    # columns of every sample, then those of lattices or of other packings
    spheres["spin"] = Finding(_in_space(structure.spin[None], network.dimension)[0], row.unit, row.text)
    contacts |= _of_contacts(answer)
    bearing = structure.scene
    for quantity, (name, values) in zip(bearing.law.quantities, bearing.named_coefficients.items(), strict=True):
        contacts[name] = Finding(values[0], quantity.unit, f"{quantity.name} coefficient")
    if (lattice := network.lattice) is not None:
        if (domains := drawn.domains) is not None:
            kind = domains.kind[domains.domain.ravel()].astype(np.uint8)
            spheres["domain_kind"] = Finding(
                kind, "1", f"driven plane with which its rigid domain turns: {DOMAIN_KINDS}"
            )
        spheres["driven"] = Finding(lattice.is_driven.ravel(), "1", "spin is imposed")
        contacts["axis"] = Finding(lattice.axis.astype(np.uint8), "1", "0 along x, 1 along y, 2 along z")
    else:
        spheres["radius"] = Finding(network.radius, *PACKING_ARRAYS["radius"])
        spheres["driven"] = Finding(network.body, *PACKING_ARRAYS["driven"])
        contacts["normal_force"] = Finding(np.asarray(bearing.normal_force), *PACKING_ARRAYS["normal_force"])
    return PointsAndLines(structure, spheres, contacts, drawn, time, moments)


def _of_contacts(answer: Solution) -> dict[str, Finding]:
    """Return columns (contacts E,) of the answer to one sample by name, such as slip, power and state, with units."""
    return {row.name: Finding(v[0], row.unit, row.text) for row, v in found_in(answer, CONTACTS)}


def _in_space(spin: np.ndarray, dimension: int) -> np.ndarray:
    """Return spins as vectors, (snapshots S, spheres N, 3).

    spin : (S, ..., 3) of spheres, or (S, ...) of discs, whose spins point along z.
    dimension : 2 for discs, or 3.
    """
    if dimension == 3:
        return spin.reshape(len(spin), -1, 3)
    rows = np.zeros((len(spin), spin[0].size, 3))
    rows[..., 2] = spin.reshape(len(spin), -1)
    return rows


def _moments(structure: Structure, end: float | None, slip_threshold: float | None) -> Moments | None:
    """Return the snapshots of a dynamics before its end, which the answer itself shows; None if there are none.

    structure : the sample.
    end : simulated time at the end, None for other methods.
    slip_threshold : slip speed, length/time, up to which contacts of a snapshot count as slipless; None if the run was
        not given one.
    """
    kept = structure.answer.snapshots
    if kept is None or end is None or not (early := np.flatnonzero(kept.time < end)).size:
        return None
    spins = structure.snapshots[early]
    found = [moment_of(structure, spin, slip_threshold) for spin in spins]
    slip, state = np.stack([one.slip for one in found]), np.stack([one.state for one in found])
    threshold = float(found[0].threshold or 0.0)
    return Moments(kept.time[early], _in_space(spins, structure.whole.dimension), slip, state, threshold)
