"""What holds only among slow spins is not called certified, and no spins go farther than is proven.

Spheres whose normals are rounded may roll but for their last digits. Then spins of 1e16 lower the power of the stored
numbers, as exact fractions show, and no bound on slower spins is one on the least power.
"""

import json
from fractions import Fraction

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.checksums import seal
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.proof.springs import Springs
from taichi_bearings.runs.verify import verify
from tests.cli.commands import bearings
from tests.packing.twins import laboratory_slips
from tests.proof.test_packings import drawn, write_run

# packings of tests.proof.test_packings: a few spheres, viscous; motions that rounding hides, or none
HIDDEN, FIRM = (65, 71, 185), (41, 131, 173, 197)
ROLLS_BUT_FOR_ROUNDING = 87  # with friction; the least power of all spins is 5.3149, as eighty digits show


def exact_rows(packing):
    """Slips A omega + c by component, in fractions: a dictionary by unknown for each, -1 for c; and the viscosities."""
    free = np.flatnonzero(packing.driven < 0)
    number = {int(sphere): 3 * place for place, sphere in enumerate(free)}
    (viscosity,) = packing.named_coefficients.values()
    for contact, normal, slope in zip(packing.contact.tolist(), packing.normal, viscosity[0], strict=True):
        n = [Fraction(value) for value in normal.tolist()]
        if not number.keys() & set(contact):
            continue
        for a, b in ((1, 2), (2, 0), (0, 1)):
            row = {-1: Fraction(0)}
            for sphere in contact:
                radius = Fraction(float(packing.radius[sphere]))
                for own, factor in ((a, n[b]), (b, -n[a])):
                    if sphere in number:
                        place = number[sphere] + own
                        row[place] = row.get(place, Fraction(0)) + radius * factor
                    else:
                        row[-1] += radius * factor * Fraction(float(packing.spin[sphere, own]))
            yield row, Fraction(float(slope))


def least_viscous_power(packing):
    """The least sum of eta |slip|^2 over all spins, from the normal equations in fractions."""
    matrix, constant = {}, Fraction(0)
    for row, slope in exact_rows(packing):
        constant += slope * row[-1] ** 2
        for i, first in row.items():
            for j, second in row.items():
                if i >= 0:
                    matrix.setdefault(i, {})
                    matrix[i][j] = matrix[i].get(j, Fraction(0)) + slope * first * second
    least = constant
    for pivot in sorted(matrix):  # eliminate; what each step takes from the constant is the power that it saves
        own = matrix.pop(pivot)
        if not own.get(pivot):
            assert not any(own.values())
            continue
        for row in matrix.values():
            factor = row.pop(pivot, Fraction(0)) / own[pivot]
            for place, value in own.items():
                if factor and place != pivot:
                    row[place] = row.get(place, Fraction(0)) - factor * value
        least -= own.get(-1, Fraction(0)) ** 2 / own[pivot]
    return least


@pytest.mark.parametrize("seed", [*HIDDEN, *FIRM])
def test_certified_means_that_no_spins_whatever_have_less_power(seed):
    packing = drawn(seed)
    found, least = tb.solve(packing), least_viscous_power(packing)
    assert packing.dimension == 3
    assert least <= Fraction(found.power) * (1 + Fraction(2) ** -51)
    if seed in FIRM:
        assert (found.status, found.proof) == ("certified", "proven")
        assert Fraction(found.lower_bound) <= least
    else:
        assert least < Fraction(found.lower_bound) * (1 - Fraction(found.gap) * 1000)
        assert found.status == "restricted"
        assert "only among" in found.proof


CONTRASTS = {
    "bcc": lambda: tb.Packing.lattice("bcc", (3, 3, 3), seed=1, distribution="power-law:1e-6,1e6,-1"),
    "diamond": lambda: tb.Packing.lattice("diamond", (2, 2, 2), seed=1, distribution="power-law:1e-6,1e6,-1"),
    "two frictions": lambda: tb.Packing.lattice("diamond", (2, 2, 2), seed=1, distribution="bimodal:1e-12,1,0.5"),
}


@pytest.mark.parametrize("kind", CONTRASTS)
def test_contrasts_of_twelve_decades_hide_no_spins(kind):
    found = tb.solve(CONTRASTS[kind]())
    assert (found.status, found.proof) == ("certified", "proven")
    if kind != "two frictions":
        assert found.proven.all()


@pytest.mark.parametrize("seed", range(6))
def test_spins_reach_no_farther_than_is_proven(seed):
    """Along the softest motions, but for spheres that turn freely, scaled until slips are as large as they may be."""
    of = {"seed": seed, "distribution": "lognormal:1,3"}
    packing = tb.Packing.lattice("diamond", (2, 2, 2), **of) if seed % 2 else tb.Packing.random(60, **of)
    found = tb.solve(packing)
    network = Judgement(packing, found.spin, found.spin_rounding, found.friction).bounds.network
    springs = Springs.of(network, network.dissipated(0.5).upper())
    (matrix, constant), free, acts = laboratory_slips(packing), packing.driven < 0, network.counts
    slips = (matrix.toarray() / np.repeat(packing.radius[free], 3))[:, springs.number[free].ravel() >= 0]
    slips, still = slips.reshape(-1, 3, slips.shape[1])[acts], constant[acts] / network.speed_unit
    for reach, weight in ((springs.even_reach, np.ones(acts.sum())), (springs.reach, springs.weight[acts] ** 0.5)):
        weighted = (weight[:, None, None] * slips).reshape(-1, slips.shape[2])
        _, size, directions = np.linalg.svd(weighted, full_matrices=False)
        moved = np.linalg.norm(slips @ directions[-1], axis=1)
        if (weight == 1).all():
            limit = np.linalg.norm(springs.fastest)
            most = np.min((springs.fastest[acts] - np.linalg.norm(still, axis=1)) / np.maximum(moved, 1e-30))
        else:
            limit = 1.0
            most = (1 - np.linalg.norm(weight[:, None] * still)) / np.linalg.norm(weight * moved)
        assert most * np.abs(directions[-1]).max() <= reach[0]
        assert reach[0] < 1e5 * (limit + np.linalg.norm(weight[:, None] * still)) / size[-1]


@pytest.fixture(scope="module")
def rolling(tmp_path_factory):
    place = tmp_path_factory.mktemp("rolling")
    drawn(ROLLS_BUT_FOR_ROUNDING).save(place / "rolling.npz")
    return place


def test_a_run_says_so_and_does_not_count_as_reached(rolling):
    done = bearings("run", "--packing", "rolling.npz", "--figures", "none", "--out", "run", "--json", cwd=rolling)
    told = json.loads(done.stdout)
    assert done.returncode == 1
    assert told["status"] == "restricted"
    assert told["gap"] < 1e-8
    assert any("much faster spins may dissipate less" in sentence for sentence in told["warnings"])
    done = bearings("verify", "run", "--json", cwd=rolling)
    verdict = json.loads(done.stdout)
    assert (done.returncode, verdict["status"], verdict["proof"]) == (0, "restricted", told["proof"])
    words = " ".join(bearings("verify", "run", cwd=rolling).stdout.split())
    assert "its lower bound 5.59" in words
    assert "is proven only among surface speeds up to 1e+06 times the fastest imposed" in words
    assert "<= least power" not in words
    assert "1 sample (restricted)" in " ".join(bearings("analyse", "run", cwd=rolling).stdout.split())


def test_a_scan_says_so_and_does_not_count_as_reached(rolling):
    text = 'packing = "rolling.npz"\n[scan]\ntolerance = [1e-5, 1e-8]\n'
    (rolling / "scan.toml").write_text(text)
    done = bearings("scan", "scan.toml", "--out", "scan", "--workers", "1", cwd=rolling)
    assert done.returncode == 1
    assert "2 samples stopped short of what was asked for: see the column status" in done.stdout
    assert (rolling / "scan" / "scan.csv").read_text().count(",restricted,") == 2


def test_a_file_that_calls_it_certified_is_refuted(rolling, tmp_path):
    path = write_run(tmp_path, tb.solve(drawn(ROLLS_BUT_FOR_ROUNDING)))
    assert verify(path)["verified"]
    with h5py.File(path, "a") as file:
        file.attrs["status"] = "certified"
        seal(file)
    assert any("status" in sentence for sentence in verify(path)["contradictions"])


def test_no_torque_is_proven_to_be_held_by_it(rolling):
    """A torque of half the least power that slow spins have."""
    packing = drawn(ROLLS_BUT_FOR_ROUNDING)
    least = tb.solve(packing)
    bodies = np.unique(packing.driven[packing.driven >= 0])
    spin = np.where((packing.driven == bodies[-1])[:, None], packing.spin, 0.0)
    arrays = packing.arrays() | {"spin": spin}
    found = tb.solve(tb.Packing(**arrays), torque=0.1 * float(least.power))
    assert found.status == "restricted"
    assert found.findings["yield_torque_lower_bound"] == 0
    assert np.isnan(found.findings["amplitude"])
