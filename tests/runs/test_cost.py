"""What runs are told to take: memory against what is allocated, numbers of factors against those of their layouts."""

import json
import tracemalloc
from math import prod

import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings import memory
from taichi_bearings.conic.cones import isotropic
from taichi_bearings.conic.contact_system import lattice_system
from taichi_bearings.conic.newton_matrix import NewtonMatrix
from taichi_bearings.lattice import Lattice
from taichi_bearings.memory import NotEnoughMemory
from taichi_bearings.numerics.cholesky import dissect, factor
from taichi_bearings.numerics.cholesky.size import factor_numbers
from taichi_bearings.runs.cost import PROCESS_BYTES, bytes_of_lattice, refuse_too_large
from taichi_bearings.runs.run import prepare, run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.solvers.table import InteriorPoint
from tests.cli.commands import bearings
from tests.scenes import make_scene


@pytest.mark.parametrize(
    ("shape", "periodic", "within"),
    [((20, 20, 20), (), 1.15), ((30, 30, 10), (), 1.15), ((12, 12, 40), (), 1.15), ((16, 16, 16), (0, 1), 1.15)],
    ids=str,
)
@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
def test_numbers_of_a_factor_are_those_of_its_layout(shape, periodic, within, monkeypatch):
    made = []

    class Kept(factor.Layout):
        def __init__(self, *words, **more):
            super().__init__(*words, **more)
            made.append(self.size)

    monkeypatch.setattr(factor, "Layout", Kept)
    lattice, axes = Lattice(shape, periodic=periodic), (0, 1)
    system = lattice_system(lattice, axes, np.ones((2, *shape[:-1])))
    NewtonMatrix(system, dissect(lattice, axes)).factorise(isotropic(system.offset, np.ones(len(system.contact))))
    told = factor_numbers(lattice, axes)
    assert max(told / max(made), max(made) / told) < within


@pytest.mark.parametrize(
    "words",
    [
        {"shape": (24, 24, 24), "method": "operator-splitting", "tolerance": 1e-2},
        {"shape": (24, 24, 24), "law": "viscous"},
        {"shape": (24, 24, 24), "method": "cundall-strack", "iterations": 10},
        {"shape": (24, 24, 24), "method": "gradient-descent", "iterations": 10},
        {"shape": (150, 150)},
        {"shape": (20, 20, 20)},
    ],
    ids=lambda words: f"{words.get('method', words.get('law', 'auto'))}-{len(words['shape'])}",
)
@pytest.mark.usefixtures("taichi_runtime", "needs_f64")
def test_memory_is_told_within_a_factor_of_1_3_of_what_is_allocated(words, tmp_path):
    settings = RunSettings(**words, threads=1, figures="none")
    small = RunSettings(**{**words, "shape": (4,) * len(settings.shape)}, threads=1, figures="none")
    run(small, tmp_path / "first")  # loads and compiles
    told = prepare(settings).cost.bytes - PROCESS_BYTES
    tracemalloc.start()
    try:
        run(settings, tmp_path / "run")
        taken = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert max(told / taken, taken / told) < 1.3, (told / prod(settings.shape), taken / prod(settings.shape))


@pytest.mark.parametrize(
    ("shape", "method", "words"),
    [
        ((96, 96, 96), "interior-point", "interior-point of 884,736 spheres needs some"),
        ((128, 128, 128), "interior-point", "interior-point of 2,097,152 spheres is too large"),
        ((2000, 2000), "auto", "a run of 4,000,000 spheres needs some"),
        ((10_000, 10_000, 10), "auto", "a run of 1,000,000,000 spheres needs some"),
    ],
    ids=str,
)
@pytest.mark.usefixtures("taichi_runtime")
def test_what_does_not_fit_is_refused_before_it_is_begun(shape, method, words, monkeypatch):
    room = {"auto": 3e9}.get(method, 18e9)
    monkeypatch.setattr(memory, "free_bytes", lambda: 23e9 if prod(shape) > 1e8 else room)
    with pytest.raises(NotEnoughMemory, match=words):
        prepare(RunSettings(shape=shape, method=method))


@pytest.mark.usefixtures("taichi_runtime")
def test_coefficients_in_memory_are_not_counted_again(monkeypatch):
    scene = make_scene((400, 300), law="coulomb-viscous")
    needed = bytes_of_lattice(InteriorPoint, (400, 300)) - PROCESS_BYTES
    contacts = 399 * 300 + 400 * 299
    room = (needed - 2 * 8 * contacts) * memory.ESTIMATE_MARGIN  # two coefficients of 8 bytes a contact
    monkeypatch.setattr(memory, "free_bytes", lambda: 1.0001 * room)
    refuse_too_large(InteriorPoint, scene)
    monkeypatch.setattr(memory, "free_bytes", lambda: 0.9999 * room)
    with pytest.raises(NotEnoughMemory, match="of 120,000 spheres needs some"):
        refuse_too_large(InteriorPoint, scene)


def test_a_dry_run_says_method_time_and_memory_and_writes_nothing(tmp_path):
    done = bearings("run", "--shape", "8,8,8", "--dry-run", "--out", tmp_path / "a", "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["method"] == "interior-point"
    assert report["seconds"] > 0
    assert PROCESS_BYTES < report["bytes"] < 1e9
    assert not (tmp_path / "a").exists()
    words = ("--method", "cundall-strack", "--duration", "1", "--time-step", "1e-3")
    told = bearings("run", "--shape", "8,8,8", *words, "--dry-run")
    assert "s a step, about" in told.stdout
    assert "for 1,000 steps" in told.stdout
    told = bearings("run", "--shape", "8,8,8", "--method", "cundall-strack", "--dry-run")
    assert "not known in advance" in told.stdout
    assert "method: cundall-strack\n" in told.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--shape", "8,8"), "planar-cut (fastest, and exact)"),
        (("--shape", "8,8,8"), "interior-point (fastest that can prove which contacts slip)"),
        (("--shape", "8,8,8", "--tolerance", "1e-2"), "operator-splitting (fastest to this tolerance and size)"),
        (("--shape", "8,8,8", "--law", "viscous"), "linear-solver (fastest, and exact but for rounding)"),
    ],
    ids=str,
)
def test_a_dry_run_says_why_auto_takes_a_method(words, said):
    assert bearings("run", *words, "--dry-run").stdout.startswith(f"method: {said}\n")


@pytest.mark.parametrize(
    ("kind", "law", "said"),
    [
        ("triangular", "coulomb", "planar-cut (fastest, and exact)"),
        ("bcc", "coulomb", "interior-point (fastest that can prove which contacts slip)"),
        ("bcc", "viscous", "linear-solver (fastest, and exact but for rounding)"),
    ],
    ids=str,
)
def test_a_dry_run_says_why_auto_takes_a_method_for_a_packing(kind, law, said, tmp_path):
    cells = (3,) * (2 if kind == "triangular" else 3)
    tb.Packing.lattice(kind, cells, seed=1, law=law).save(tmp_path / "packing.npz")
    words = ("run", "--packing", tmp_path / "packing.npz", "--law", law)
    told = bearings(*words, "--dry-run")
    assert told.stdout.startswith(f"method: {said}\ntime: about "), told.stdout
    assert "\nmemory: about 0." in told.stdout
    assert json.loads(bearings(*words, "--dry-run", "--json").stdout)["method"] == said.split(" (")[0]


@pytest.mark.usefixtures("taichi_runtime")
@pytest.mark.parametrize("words", [{"shape": (40, 40, 40)}, {"packing": "bcc.npz"}], ids=["lattice", "packing"])
def test_states_that_are_not_asked_for_cost_no_time(words, tmp_path, monkeypatch):
    """Of bcc, 12^3 cells, 1.9 of 3.2 s and 113 of 160 MB were left; of 32^3 two thirds of the time."""
    monkeypatch.chdir(tmp_path)
    tb.Packing.lattice("bcc", (9, 9, 9), seed=1).save("bcc.npz")
    whole, less = (prepare(RunSettings(**words, **of)).cost for of in ({}, {"settle": False}))
    assert 0.4 < (less.seconds - 2) / (whole.seconds - 2) < 0.8
    assert (less.bytes < whole.bytes) == ("packing" in words)


def test_steps_of_a_dynamics_are_told_as_they_are_made(tmp_path):
    settings = RunSettings(shape=(4, 4, 5), method="cundall-strack", duration=0.01, threads=1, figures="none")
    assert prepare(settings).cost.steps == run(settings, tmp_path / "a").solution.iterations
