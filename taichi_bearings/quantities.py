"""The one table of quantities: name, unit and description of each number of an answer, and how it is computed.

Run files, summaries, columns of scans, the Python results, ParaView files and axes of figures are loops over its rows.
A new quantity needs a row here, its formula in tests/properties/formulas.py and, if it is to be an attribute of
`Result` as well, a line in runs/result.py.

There is a table for each place where quantities belong: `SPHERES`; `CONTACTS`; `CHECK_ROWS`, columns of the history,
with one value for each check during a solve; `SAMPLES`, with one value for each sample, or one for all; `FINDINGS`, of
particular methods; and `STRUCTURE`, of what the contacts of one sample form.

Letters: R samples, *N the shape of arrays over the spheres, E contacts. In the functions of the rows s is a solution or
a structure, and a is an answer.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from taichi_bearings.plain_files import Json
from taichi_bearings.proof.contact_state import ContactState, Separation
from taichi_bearings.scene import Solution, Status


class Asked(Protocol):
    """The settings of a solve that quantities of its answer depend on."""

    @property
    def tolerance(self) -> float:
        """Relative gap at which a sample is certified."""

    @property
    def duration(self) -> float | None:
        """Simulated time that a dynamics was asked for, else None."""


class Answer(Protocol):
    """The part of a `Result` from which the table computes the quantities of its samples."""

    @property
    def solution(self) -> Solution:
        """The solution, with all samples."""

    @property
    def asked(self) -> Asked:
        """The settings of the solve."""

    @property
    def ended(self) -> list[Status]:
        """How each of the R samples ended, such as certified or interrupted."""

    @property
    def version(self) -> str:
        """The version of the program that solved the samples."""

    @property
    def separation(self) -> Separation:
        """The largest slip of slipless contacts and the smallest of slipping ones, for each sample."""


@dataclass(frozen=True)
class Quantity:
    """A row of the table of quantities: one number or word of an answer.

    name : name in files, summaries, tables and Python.
    unit : unit of the value; "1" for pure numbers.
    text : what the quantity is, in words.
    of : function that takes an answer, or a solution or structure, and returns the value; for a quantity of samples an
        array or a list with one value for each sample, or one value for all of them. None where there is no such value.
    symbol : symbol in LaTeX, for axes of figures; "" for none.
    """

    name: str
    unit: str
    text: str
    of: Callable[[Any], Any] = lambda _: None
    symbol: str = ""


def _fact(name: str) -> Callable[[Answer], object]:
    """Return a function of an answer that looks up one number of its scene, such as the radius of the spheres; that
    function returns None where the scene has no such number.

    name : name of the number in `Bearing.facts`, such as "spin_top".
    """
    return lambda answer: answer.solution.scene.facts.get(name)


def _of_unique_slips(value_of: Callable[[Answer], object]) -> Callable[[Answer], object]:
    """Return a function of an answer that returns None for packings and what `value_of` returns for lattices. There a
    contact that slips at every minimum has the same slip at all of them.

    value_of : function of an answer.
    """
    return lambda answer: value_of(answer) if answer.solution.scene.driving.slips_are_unique else None


def _shape(answer: Answer) -> object:
    """Return the number of spheres along each axis of the lattice of an answer; None for other packings.

    answer : a result of one or several samples.
    """
    shape = answer.solution.scene.facts.get("shape")
    return None if shape is None else Whole(shape)


def _iterations(answer: Answer) -> object:
    """Return the iterations of the method that found an answer: one number if all samples were stepped together, else
    one for each sample.

    answer : a result of one or several samples.
    """
    solution = answer.solution
    if solution.scene.driving.samples_step_together:
        return solution.iterations
    return solution.own.get("iterations", solution.iterations)


def _contacts(solution: Solution) -> int | np.ndarray:
    """Return the number of contacts of a solution that are present and have a free sphere: one number if all samples
    have the same, else (samples R,).
    """
    found = (solution.state != ContactState.DRIVEN).sum(axis=1)
    return int(found[0]) if (found == found[0]).all() else found


def _decades(answer: Answer) -> np.ndarray:
    """Return the decades (samples R,) between the largest slip of slipless contacts and the smallest of slipping ones.

    They are not-a-number for samples whose gap is above the tolerance, as they mean nothing there.

    answer : a result of one or several samples.
    """
    return np.where(answer.solution.gap <= answer.asked.tolerance, answer.separation.decades, np.nan)


def _normalised(answer: Answer) -> np.ndarray | None:
    """Return the power (samples R,) divided by F_n R |omega_T|: normal force, radius and spin of the top.

    It is None where that unit is 0 or unknown, as for packings, and for laws in which the force depends on the speed.

    answer : a result of one or several samples.
    """
    facts, solution = answer.solution.scene.facts, answer.solution
    unit = facts["normal_force"] * facts["radius"] * abs(facts["spin_top"]) if "spin_top" in facts else 0.0
    return solution.power / unit if solution.scene.law.is_rate_independent and unit > 0 else None


def _at_end(column: str) -> Callable[[Answer], object]:
    """Return a function that gives the last value of one column of an answer's history, or None without that column.

    column : name of the column.
    """

    def found(answer: Answer) -> object:
        """Return the last value of the column `column` in the history of an answer; None if there is no such column."""
        values = answer.solution.history.get(column)
        return None if values is None else values[-1]

    return found


def _named(rows: Iterable[Quantity]) -> dict[str, Quantity]:
    """Return the rows of the table in a dict, by name."""
    return {row.name: row for row in rows}


STATE_CODES = (
    "0 slipless: slips at no minimum, 1 slipping: at every one, 4 tied: at some, 2 undecided, 3 between driven spheres "
    "or absent"
)
PROVEN_CODES = "1 where the state is proven, else 0; contacts of state 3 count as proven"
FRICTION_QUANTITIES = {
    2: "friction on the upper disc, component along z x n: upwards at x-contacts, to the left at y-contacts",
    3: "friction on the upper sphere, laboratory frame",
}
"""Descriptions of the friction on lattices, by dimension. These forces prove the lower bound: none exceeds
the friction limit, and torques that they leave over are paid for."""
ENERGY_RESIDUAL = (
    "error of the energy balance, divided by the energy put in (with that at the start) or by the energy dissipated, "
    "whichever is larger"
)

# fmt: off
SPHERES = _named(
    [
        Quantity("spin", "1/time", "angular velocity of each sphere in the laboratory frame", lambda s: s.spin),
        Quantity("spin_rounding", "1/time",
                 "remainder of the spins beyond double precision: the spins are `spin` plus this",
                 lambda s: s.spin_rounding if s.spin_rounding.any() else None),
    ]
)
"""Quantities of the spheres in a Solution: (R, *N) in 2D, (R, *N, 3) in 3D."""

CONTACTS = _named(
    [
        Quantity("slip", "length/time", "slip speed |v|", lambda s: s.slip),
        Quantity("power", "energy/time", "power dissipated at the contact", lambda s: s.power_per_contact),
        Quantity("force", "force", "magnitude of the tangential contact force", lambda s: s.force),
        Quantity("state", "1", STATE_CODES, lambda s: s.state),
        Quantity("proven", "1", PROVEN_CODES, lambda s: s.proven),
    ]
)
"""Quantities of the contacts in a Solution: (R, E)."""

CHECK_ROWS = _named(
    [
        Quantity("iteration", "1", "number of iterations done"),
        Quantity("seconds", "s", "wall time of the solve, without compilation"),
        Quantity("time", "time", "simulated time"),
        Quantity("power", "energy/time", "power dissipated at all contacts, with the spins at that time"),
        Quantity("potential", "energy/time",
                 "dissipation potential of the spins; lower_bound is a bound on its least value"),
        Quantity("lower_bound", "energy/time", "best lower bound on the least power (or potential) proven so far"),
        Quantity("slipping", "1", "number of contacts that slip at the time of the check"),
        Quantity("kinetic_energy", "energy", "kinetic energy of the free spheres"),
        Quantity("spring_energy", "energy", "energy stored in the springs of the contacts"),
        Quantity("injected_energy", "energy", "work of the driven spheres since the start"),
        Quantity("dissipated_energy", "energy", "work done on the contacts since the start, minus the energy in their"
                 " springs"),
        Quantity("energy_residual", "1", ENERGY_RESIDUAL),
        Quantity("largest_balance_residual", "force*length",
                 "largest net torque on a free sphere, 0 where all torques balance"),
    ]
)
"""Columns of the history, with one value for each check during a solve."""

SAMPLES = _named(
    [
        Quantity("power", "energy/time",
                 "power dissipated at all contacts with these spins, an upper bound on the least power",
                 lambda a: a.solution.power, "P"),
        Quantity("potential", "energy/time",
                 "dissipation potential, which is least in the stationary state under this law; lower_bound and gap "
                 "belong to it, not to the power",
                 lambda a: None if a.solution.scene.law.minimises == "power" else a.solution.objective),
        Quantity("lower_bound", "energy/time", "proven lower bound on the least power, or on the least potential; in "
                 "packings only among the spins that `proof` names",
                 lambda a: a.solution.lower_bound, r"P_\mathrm{low}"),
        Quantity("gap", "1", "(power - lower_bound) / power, or with the potential instead of the power; 0 where"
                 " a state without any slip is proven to exist",
                 lambda a: a.solution.gap, r"(P - P_\mathrm{low})\,/\,P"),
        Quantity("status", "1", "how the solve ended: certified (the gap is within the tolerance); restricted (it is"
                 " too, but the lower bound is proven only among the spins that `proof` names); stationary (a"
                 " dynamics came to rest); finished (a dynamics reached its duration); stalled (the method got no"
                 " closer); step-limit, time-limit, interrupted, not-finite (numbers overflowed); in scans also failed",
                 lambda a: [status.value for status in a.ended]),
        Quantity("method", "1", "method that solved the sample", lambda a: a.solution.method),
        Quantity("law", "1", "contact law", lambda a: a.solution.scene.law.name),
        Quantity("shape", "1", "number of spheres along each axis, height last",
                 _shape),
        Quantity("spheres", "1", "number of spheres of a packing", _fact("spheres")),
        Quantity("driven_spheres", "1", "number of driven spheres of a packing",
                 _fact("driven_spheres")),
        Quantity("seed", "1", "seed from which the friction or viscosity of each contact is drawn",
                 lambda a: list(a.solution.scene.seeds)),
        Quantity("iterations", "1", "number of iterations of the method",
                 _iterations),
        Quantity("seconds", "s", "wall time of the solve, without compilation; an equal share for seeds solved"
                 " together",
                 lambda a: a.solution.seconds, r"t_\mathrm{solve}"),
        Quantity("seconds_compile", "s", "wall time to load and compile the numerical kernels",
                 lambda a: a.solution.seconds_compile),
        Quantity("contacts", "1", "number of contacts, without absent ones and those between driven spheres: the sum of"
                 " slipping, slipless, tied and undecided",
                 lambda a: _contacts(a.solution), r"N_\mathrm{contacts}"),
        Quantity("slipping", "1", "number of slipping contacts; proven ones slip in every state of least power (or"
                 " potential)",
                 lambda a: a.solution.counts[:, ContactState.SLIPPING], r"N_\mathrm{slipping}"),
        Quantity("slipless", "1", "number of contacts that do not slip; proven ones slip in no state of least power"
                 " (or potential)",
                 lambda a: a.solution.counts[:, ContactState.SLIPLESS], r"N_\mathrm{slipless}"),
        Quantity("tied", "1", "number of contacts that are proven to slip in some states of least power and not in"
                 " others",
                 lambda a: a.solution.counts[:, ContactState.TIED]),
        Quantity("undecided", "1", "number of contacts of which nothing is proven and whose slip and force disagree,"
                 " as they slip below the friction limit or rest at it",
                 lambda a: a.solution.counts[:, ContactState.UNDECIDED]),
        Quantity("states_proven", "1", "whether it is proven of every contact that it slips, does not slip or is tied",
                 lambda a: a.solution.states_proven),
        Quantity("unproven", "1", "number of contacts of which it is not proven whether they slip",
                 lambda a: a.solution.unproven),
        Quantity("largest_slipless_slip", "length/time",
                 "largest slip speed of a contact that counts as slipless (lattices only)",
                 _of_unique_slips(lambda a: a.separation.largest_slipless)),
        Quantity("smallest_slipping_slip", "length/time",
                 "smallest slip speed of a contact that counts as slipping (lattices only)",
                 _of_unique_slips(lambda a: a.separation.smallest_slipping)),
        Quantity("separation_decades", "1", "log10 of the ratio of two slip speeds, the smallest of a slipping contact"
                 " and the largest of a slipless one; the rounding of the imposed spins replaces the latter if it is"
                 " larger (lattices only)",
                 _of_unique_slips(_decades)),
        Quantity("slip_threshold", "length/time", "slip speed up to which a contact counts as slipless; if the user"
                 " gives none, the method chooses one, which decides only where no proof does",
                 lambda a: a.solution.slip_threshold, r"v_\mathrm{slip}"),
        Quantity("largest_balance_residual", "force*length", "largest component of the net torque on a free"
                 " sphere, 0 where all torques balance; for packings divided by the radius of the sphere",
                 lambda a: a.solution.largest_balance_residual),
        Quantity("spin_top", "1/time", "imposed spin of the top plane, the largest where it varies",
                 _fact("spin_top"), r"\omega_T"),
        Quantity("spin_bottom", "1/time", "imposed spin of the bottom plane, the largest where it varies",
                 _fact("spin_bottom"), r"\omega_B"),
        Quantity("normal_force", "force", "normal force at every contact",
                 _fact("normal_force"), "F_n"),
        Quantity("radius", "length", "radius of the spheres", _fact("radius"), "R"),
        Quantity("version", "1", "version of the program that solved the sample", lambda a: a.version),
        Quantity("power_normalised", "1", "power / (normal_force * radius * |spin_top|)",
                 _normalised, r"P\,/\,(F_n R\,\omega_T)"),
        Quantity("minimum_is_unique", "1",
                 "whether all states of least power (or potential) have the same slips; true or false only if that is"
                 " proven",
                 lambda a: a.solution.minimum_is_unique),
        Quantity("time", "time", "simulated time that the dynamics has reached", _at_end("time")),
        Quantity("duration", "time", "simulated time at which the dynamics was asked to end",
                 lambda a: a.asked.duration if "time" in a.solution.history else None),
        Quantity("energy_residual", "1", ENERGY_RESIDUAL,
                 _at_end("energy_residual")),
    ]
)
"""Numbers and words of an answer, as in summaries, attributes of run files, and scans."""

SAID_OF_PACKINGS = ("proof", "driven_power", "slipless_motions")  # findings of every packing
FINDINGS = _named(
    [
        Quantity("proof", "1", "for which spins the lower bound of a packing holds: `proven` for all of them, else in"
                 " words"),
        Quantity("driven_power", "energy/time",
                 "power dissipated by contacts between two driven spheres, not part of the power"),
        Quantity("slipless_motions", "1", "number of independent motions without slip that the free spheres have"
                 " while the driven ones rest; spheres that are not connected to a driven one do not count"),
        Quantity("cut_is_unique", "1",
                 "whether every other cut (interface between spheres that turn with the bottom and with the top) has "
                 "more power than the minimum cut"),
        Quantity("next_cut_over_minimum", "1",
                 "power of the second weakest cut, divided by that of the weakest; a cut separates two connected"
                 " groups of spheres, of which one turns with the bottom and one with the top"),
        Quantity("step_error", "1", "estimated error of the spins due to the time step, divided by the largest spin"),
        Quantity("accurate_time_step", "time",
                 "time step with which step_error, the relative error of the spins, is below 0.01"),
        Quantity("elastic_share", "1",
                 "largest elongation of a contact's spring, divided by the distance that the driven planes slid past "
                 "each other"),
        Quantity("rest_time", "time", "simulated time at which the motion came to rest"),
        Quantity("yields", "1", "whether the torque is more than friction can withstand, so that the top moves in its"
                 " direction"),
        Quantity("yield_torque", "force*length", "torque above which the top is proven to move"),
        Quantity("yield_torque_lower_bound", "force*length", "torque up to which friction is proven to hold the top"
                 " at rest; if the bottom turns, to keep the top from turning in the direction of the torque"),
        Quantity("amplitude", "1", "spin of the top under the torque, divided by its imposed spin; 0 where friction"
                 " holds the top at rest"),
        Quantity("newton_steps", "1", "number of matrix factorisations made by the method rigid-limit"),
    ]
)
"""Further numbers and words of samples, which some methods find (`Solution.findings`)."""

STRUCTURE = {
    "minimum cut": [
        Quantity("power_minimum_cut", "energy/time", "power of the minimum cut, the state of least power (or"
                 " potential) if every sphere turns with the bottom or with the top",
                 lambda s: s.interface and s.interface.power, r"P_\mathrm{cut}"),
        Quantity("power_over_cut", "1", "power / power_minimum_cut",
                 lambda s: s.interface and _ratio(s.power, s.interface.power), r"P\,/\,P_\mathrm{cut}"),
        Quantity("cut_is_unique", "1", "whether every other cut is proven to have more power (or potential) than the"
                 " minimum cut",
                 lambda s: s.interface and s.interface.unique),
        Quantity("next_cut_over_cut", "1", "power (or potential) of the second weakest cut,"
                 " divided by that of the minimum cut; a cut separates two connected groups of spheres, of which one"
                 " turns with the bottom and one with the top",
                 lambda s: s.interface and s.interface.next_over,
                 r"P_\mathrm{cut,2}\,/\,P_\mathrm{cut}"),
        Quantity("cut_contacts", "1", "number of contacts that the minimum cut crosses",
                 lambda s: s.interface and s.interface.contacts.sum(), r"N_\mathrm{cut}"),
        Quantity("slipping_contacts_are_the_cut", "1", "whether exactly the contacts of the minimum cut slip",
                 lambda s: s.interface and np.array_equal(s.state == ContactState.SLIPPING, s.interface.contacts)),
    ],
    "slipless network": [
        Quantity("slipless_fraction", "1", "share of the contacts that do not slip",
                 lambda s: s.contacts_in(ContactState.SLIPLESS) / s.movable if s.movable else None,
                 r"N_\mathrm{slipless}\,/\,N_\mathrm{contacts}"),
        Quantity("components", "1", "number of connected pieces of the network of slipless contacts, without single"
                 " spheres",
                 lambda s: s.network.components),
        Quantity("spans", "1", "whether slipless contacts join bottom and top", lambda s: s.network.spans),
        Quantity("reached_fraction", "1", "share of the free spheres that touch a slipless contact",
                 lambda s: s.network.reached_fraction),
        Quantity("spanning_fraction", "1", "share of the free spheres in the piece of the network that joins bottom and"
                 " top",
                 lambda s: s.network.spanning_fraction),
        Quantity("shortest_path", "contacts", "number of contacts on a shortest slipless path from bottom to top",
                 lambda s: len(s.network.path) - 1 if len(s.network.path) else np.nan, r"\ell_\mathrm{min}"),
        Quantity("planes_crossed", "1", "number of lattice planes normal to x (and to y) that the shortest slipless"
                 " path from bottom to top visits",
                 lambda s: (planes := s.network.path_planes) and (planes if len(s.network.path) else np.nan)),
        Quantity("disjoint_paths", "1", "largest number of slipless paths from bottom to top that share no contact",
                 lambda s: s.network.disjoint_paths, r"N_\mathrm{paths}"),
        Quantity("winds_x", "1", "whether slipless contacts form a loop around the periodic lattice along x",
                 lambda s: s.network.winds_around(0)),
        Quantity("winds_y", "1", "whether slipless contacts form a loop around the periodic lattice along y",
                 lambda s: s.network.winds_around(1)),
        Quantity("spanning_winds_x", "1",
                 "whether a network of slipless contacts that joins bottom and top has a loop around the lattice"
                 " along x",
                 lambda s: s.network.winds_around(0, spanning=True)),
        Quantity("spanning_winds_y", "1",
                 "whether a network of slipless contacts that joins bottom and top has a loop around the lattice"
                 " along y",
                 lambda s: s.network.winds_around(1, spanning=True)),
    ],
    "rigid domains": [
        Quantity("domains", "1", "number of rigid domains, sets of spheres that turn as one",
                 lambda s: s.rigid_domains.number, r"N_\mathrm{domains}"),
        Quantity("domains_locked_to", "1", "number of rigid domains that turn with each driven plane; mixed: with"
                 " different planes in different spin components; partly: with one in some components only",
                 lambda s: s.rigid_domains.domains_of_kind()),
        Quantity("free_spheres_locked_to", "1", "number of free spheres in the rigid domains of each kind"
                 " in domains_locked_to",
                 lambda s: s.rigid_domains.spheres_of_kind(s.network.free)),
        Quantity("largest_intermediate_domain", "1",
                 "number of spheres of the largest rigid domain that does not turn with one driven plane in all spin"
                 " components",
                 lambda s: s.rigid_domains.largest_intermediate),
        Quantity("largest_domain", "1", "largest number of free spheres in one rigid domain",
                 lambda s: np.bincount(s.rigid_domains.domain[s.network.free]).max(initial=0)),
        Quantity("largest_spread_in_a_domain", "1/time", "largest difference of a spin from the mean of its rigid"
                 " domain, or from the spin of the top if the domain is locked to it",
                 lambda s: s.rigid_domains.spread),
    ],
    "bottlenecks": [
        Quantity("connected_pairs", "1", "number of pairs of a bottom and a top sphere that a slipless path over"
                 " free spheres joins",
                 lambda s: s.bottlenecks.betweenness.pairs),
        Quantity("mean_distance", "contacts", "mean number of contacts on a shortest slipless path from a sphere of the"
                 " bottom to one of the top",
                 lambda s: _if_spans(s, s.bottlenecks.betweenness.mean_distance), r"\langle \ell \rangle"),
        Quantity("betweenness_is_exact", "1", "whether shortest slipless paths were counted from all driven spheres,"
                 " not from a random sample of them",
                 lambda s: s.bottlenecks.betweenness.is_exact),
        Quantity("busiest_link_share", "1", "share of the shortest slipless paths from bottom to top that run"
                 " through the busiest contact",
                 lambda s: _if_spans(s, s.bottlenecks.share.max(initial=0.0))),
        Quantity("backbone_links", "1", "number of contacts that lie on some slipless path from bottom to top",
                 lambda s: s.bottlenecks.backbone.sum()),
        Quantity("parting_links", "1", "number of contacts each of which, if removed, leaves no slipless path from"
                 " bottom to top (or between two driven bodies)",
                 lambda s: s.bottlenecks.parting.sum()),
        Quantity("effective_links", "1", "effective number of contacts that the shortest slipless paths from bottom to"
                 " top run through, (sum s)^2 / sum s^2 with the share s of these paths through each contact",
                 lambda s: s.bottlenecks.effective_links),
        Quantity("most_loaded", "1", "the contacts that most shortest slipless paths from bottom to top run through,"
                 " each named by its lower sphere and its axis (0 x, 1 y, 2 z), in packings by its number and spheres",
                 lambda s: s.bottlenecks.most_loaded()),
    ],
    "forces": [
        Quantity("self_stress_states", "1", "number of independent sets of forces on slipless contacts that balance"
                 " without driving, on lattices in the spin components that the driving needs; 0 if these"
                 " forces are unique",
                 lambda s: s.self_stress),
        Quantity("driving_torque", "force*length", "torque that the top passes to the bottom, for each spin component",
                 lambda s: None if (total := s.torque_flow.total) is None else total.tolist()),
        Quantity("slipless_share_of_torque", "1",
                 "share of the torque between neighbouring layers that slipless contacts carry",
                 lambda s: s.torque_flow.slipless_share),
        Quantity("mean_saturation", "1", "mean of friction force / friction limit over the slipless contacts",
                 lambda s: s.mean_saturation),
    ],
}
"""The numbers of `bearings analyse`, by the title of their section; the functions take a Structure."""
ANALYSED = _named(row for rows in STRUCTURE.values() for row in rows)  # the same rows by name

OF_SCANS = _named(
    [
        Quantity("L", "1", "number of spheres along the height", symbol="L"),
        Quantity("stiffness", "force/length", "tangential stiffness of the springs at the contacts", symbol="K_t"),
        Quantity("damping", "force*time/length", "damping of the springs at the contacts", symbol="A_t"),
        Quantity("warnings", "1", "warnings: sentences that say how the result could be misread"),
        Quantity("sample", "1", "name of the sample; equal settings give equal names"),
        Quantity("error", "1", "why the sample has no result"),
    ]
)
"""Columns that only scans have."""

# fmt: on
COLUMNS = SAMPLES | FINDINGS | ANALYSED | OF_SCANS
"""All columns that a scan can have, except its settings."""


def found_in(answer: object, rows: Mapping[str, Quantity]) -> Iterator[tuple[Quantity, Any]]:
    """Yield the rows of which an answer has a value, each with the value.

    answer : what the functions of the rows take.
    rows : the rows by name.
    """
    found = ((row, row.of(answer)) for row in rows.values())
    return ((row, value) for row, value in found if value is not None)


def _ratio(value: float, unit: float) -> float:
    """Return value / unit, or not-a-number where the unit is 0.

    value, unit : two numbers.
    """
    return value / unit if unit > 0 else np.nan


def _if_spans(structure: Any, value: float) -> float:
    """Return `value` where slipless contacts join bottom and top, else not-a-number.

    structure : what the contacts of a sample form.
    value : number that has a meaning only where they do.
    """
    return value if structure.network.spans else np.nan


class Whole(list[Any]):
    """A list that is one value for all samples, such as a shape; a plain list has an entry for each sample."""


def numbers_of(answer: Answer) -> Json:
    """Return all quantities of the samples of an answer by name: single values, or with several samples lists where
    they may differ.

    Numbers that are not finite become None, so that JSON can hold them.
    """
    several = answer.solution.scene.replicas > 1
    found = {row.name: _reported(value, several) for row, value in found_in(answer, SAMPLES)}
    found["shape"] = found.get("shape")  # packings have none
    return found | {name: _reported(values, several) for name, values in answer.solution.findings.items()}


def _reported(value: object, several: bool) -> Any:
    """Return a value of the table as JSON can hold it.

    value : one value for all samples, or an array or list with one for each.
    several : True if there are several samples: then all entries are returned, else the only one.
    """
    if isinstance(value, Whole):
        return list(value)
    if isinstance(value, (np.ndarray, list)):
        values = [plain(v) for v in value]
        return values if several else values[0]
    return plain(value)


def plain(value: object) -> Any:
    """Return a value of Python or NumPy as a Python number or text; None for a number that is not finite."""
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value
