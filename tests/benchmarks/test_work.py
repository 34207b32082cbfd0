"""Work that does not depend on the machine, for every method: kernel launches, passes, factorisations, memory taken."""

import gc
import subprocess
import sys
import tracemalloc
from collections import Counter
from contextlib import contextmanager

import numpy as np
import pytest

from taichi_bearings.compiler import name as compiler_name
from taichi_bearings.compiler import ti
from taichi_bearings.conic import by_numpy, central_path
from taichi_bearings.kernels.elimination import LANES
from taichi_bearings.numerics.cholesky.factor import CalledFactor, DenseFactor, LaunchedFactor
from taichi_bearings.proof import judged_network, listed
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.scene.initial_spins import initial_spin
from taichi_bearings.solvers import METHODS, grid_bundles, grid_cuts, torque_balance
from tests.scenes import make_scene


def begun(name, shape=(6, 7, 8), seeds=(0,), **options):
    """A method at its start, on a scene that it solves."""
    law = "viscous" if name == "linear-solver" else "coulomb"
    driving = {"direction": (1, 0, 0)} if name == "planar-cut" else {}
    scene = make_scene(shape, law, seeds=seeds, **driving)
    method, spin = METHODS[name](**options).build(), initial_spin(scene, "linear")
    method.begin(scene, spin)
    if hasattr(method, "aim_at"):
        method.aim_at(np.inf)
    return method


@contextmanager
def counting(monkeypatch):
    """What is called inside: launches of kernels, and of what they told the arrivals at barriers; factorisations and
    solves with them; products with sines; cuts; Newton steps."""
    seen = Counter()

    def watch(owner, attribute, key):
        true = getattr(owner, attribute)

        def called(*arguments, **others):
            seen[key] += 1
            found = true(*arguments, **others)
            for value in arguments if key == "launches" else ():
                if isinstance(value, np.ndarray) and value.dtype == np.int32 and value.size == 1:
                    seen["arrivals"] += int(value[0])
            return found

        context.setattr(owner, attribute, called)

    with monkeypatch.context() as context:
        if compiler_name() == "taichi":
            watch(ti.lang.kernel_impl.Kernel, "launch_kernel", "launches")
        for kind in (CalledFactor, DenseFactor, LaunchedFactor):
            watch(kind, "factorise", "factorisations")
            watch(kind, "substitute", "solves")
        watch(grid_bundles, "factorised", "factorisations")
        watch(grid_cuts, "minimum_cuts", "cuts")
        watch(torque_balance.TorqueBalance, "_to_modes", "products with sines")
        watch(torque_balance.TorqueBalance, "_from_modes", "products with sines")
        watch(central_path.Path, "step", "Newton steps")
        yield seen


def seen_while(method, steps, monkeypatch):
    """What `steps` iterations call, once others have warmed up."""
    method.advance(2)
    if hasattr(method, "team"):
        method.team.seconds = 1e-9  # quick enough for a single launch, whatever the machine was doing
    with counting(monkeypatch) as seen:
        method.advance(steps)
    return seen


needs_taichi = pytest.mark.skipif(compiler_name() != "taichi", reason="counts launches where Taichi makes them")


@needs_taichi
@pytest.mark.parametrize(("name", "passes"), [("gradient-descent", 1), ("cundall-strack", 2)])
def test_many_iterations_are_one_launch_and_as_few_passes_as_can_be(name, passes, monkeypatch):
    """Threads meet after each pass, so that a single one arrives once a pass."""
    seen = seen_while(begun(name), 20, monkeypatch)
    assert seen == {"launches": 1, "arrivals": 20 * passes}


@needs_taichi
def test_a_splitting_iteration_is_two_launches_and_two_products(monkeypatch):
    seen = seen_while(begun("operator-splitting"), 10, monkeypatch)
    assert seen == {"launches": 20, "arrivals": 20, "products with sines": 20}


def test_a_newton_step_factorises_once(monkeypatch):
    """And solves for the predictor, the corrector, at most three more, and at most four times for what they left."""
    seen = seen_while(begun("interior-point"), 4, monkeypatch)
    assert seen["factorisations"] == 4
    assert 4 * 2 <= seen["solves"] <= 4 * 9


def test_samples_of_a_lattice_are_factorised_together(monkeypatch):
    seen = seen_while(begun("interior-point", seeds=tuple(range(LANES + 1))), 2, monkeypatch)
    assert seen["factorisations"] == 2 * 2


@pytest.mark.parametrize("seeds", [(0,), (0, 1, 2)])
def test_exact_methods_factorise_or_cut_once(seeds, monkeypatch):
    linear, cut = begun("linear-solver", seeds=seeds), begun("planar-cut", seeds=seeds)
    with counting(monkeypatch) as seen:
        linear.advance(len(linear.part.bundles))
        cut.advance(1)
    assert len(linear.part.bundles) == len(linear.spin_axes)  # each component on its own, of all samples together
    assert (seen["factorisations"], seen["cuts"]) == (len(linear.part.bundles), 1)


def test_a_step_of_the_rigid_limit_factorises_once_a_newton_step(monkeypatch):
    """And at most twice more a step: where it begins, and for the forces that are left."""
    seen = seen_while(begun("rigid-limit"), 2, monkeypatch)
    assert 2 <= seen["Newton steps"] <= seen["factorisations"] <= seen["Newton steps"] + 2 * 2


# bytes that iterations take beside what is there, of a lattice of any size and a sphere; in a kernel nothing is taken
TAKEN = {
    "gradient-descent": (16e3, 0), "cundall-strack": (16e3, 0), "operator-splitting": (250e3, 0),
    "interior-point": (100e3, 400), "rigid-limit": (100e3, 800), 
    "linear-solver": (100e3, 800), "planar-cut": (100e3, 200),
}  # fmt: skip


@pytest.mark.parametrize("name", METHODS)
def test_iterations_take_no_more_memory_than_they_need(name, monkeypatch):
    # passes by NumPy, over the first small samples of a process, take arrays that kernels do without
    monkeypatch.setattr(by_numpy.SPENT, "contacts", by_numpy.WORTH_LOADING)
    fixed, each = TAKEN[name]
    shape = (8, 9, 10) if each else (16, 18, 20)
    begun(name, shape).advance(4)  # what is loaded and kept once is not counted
    method = begun(name, shape)
    method.advance(2)
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        method.advance(2)
        taken = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert taken <= fixed + each * np.prod(shape)


# bytes that a judgement of a whole lattice takes at once: parts in the cache, and arrays over its spheres
JUDGED = 4e6, 540


@pytest.mark.parametrize("periodic", [(), ("x", "y")])
def test_a_whole_lattice_is_judged_by_slices_without_lists_of_contacts_or_searches_of_graphs(periodic, monkeypatch):
    scene, searches = make_scene((24, 26, 25), "coulomb", periodic=periodic), Counter()
    rng = np.random.default_rng(0)
    spin, friction = rng.random((1, *scene.lattice.shape, 3)), rng.random((1, scene.lattice.all_contacts, 3))
    for module in (judged_network, listed):
        monkeypatch.setattr(module, "pieces", lambda *_: searches.update(["searches"]))
    gc.collect()
    tracemalloc.start()
    try:
        judgement = Judgement.of(scene, spin, np.zeros_like(spin), friction)
        before = tracemalloc.get_traced_memory()[0]
        assert (judgement.power > 0).all()
        assert (judgement.lower_bound == 0).all()
        assert (judgement.gap >= 1).all()
        taken = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert not searches
    assert not {"contact", "normal", "place", "friction"} & set(vars(judgement.network.graph))
    assert taken <= JUDGED[0] + JUDGED[1] * scene.lattice.sites


FREED_AGAIN = """
import resource, sys
import numpy as np
from taichi_bearings.memory import keep_freed
if sys.argv[1] == "kept":
    keep_freed()
def used():
    return [np.full(500_000, 1.0) for _ in range(8)] and resource.getrusage(resource.RUSAGE_SELF).ru_minflt
used()
first = used()
for _ in range(10):
    last = used()
print(last - first)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts pages that Linux gives")
def test_freed_memory_is_kept_for_what_follows():
    """Ten times 32 MB are 78 000 pages of 4 kB."""
    kept, given = (
        int(subprocess.run([sys.executable, "-c", FREED_AGAIN, how], capture_output=True, check=True).stdout)
        for how in ("kept", "given back")
    )
    assert kept < 100
    assert given >= kept


def test_a_run_loads_nothing_that_only_other_work_needs(tmp_path):
    """Each of these takes from a hundredth to a third of a second, which is most of what a small run takes."""
    arguments = ["bearings", "run", "--shape", "5,5", "--figures", "none", "--out", str(tmp_path / "run")]
    told = f"""
import atexit, sys
atexit.register(lambda: print(*sys.modules, file=sys.stderr))
sys.argv = {arguments}
from taichi_bearings_cli.main import main
main()
"""
    loaded = subprocess.run([sys.executable, "-c", told], capture_output=True, check=True, text=True).stderr.split()
    assert {"taichi_bearings.runs.run", "taichi_bearings.proof.states"} <= set(loaded)
    assert not {
        "scipy.spatial", "scipy.optimize", "matplotlib", "networkx", "html",
        "taichi", "quadrants", "taichi_bearings.scene.packing", "taichi_bearings.analysis.topology",
        "taichi_bearings.proof.oblique", "taichi_bearings.proof.centre", "taichi_bearings.proof.exact_motions",
    } & set(loaded)  # fmt: skip


def test_a_block_of_small_samples_compiles_nothing_for_a_lone_one():
    """Each kernel costs every worker of a scan tens of milliseconds."""
    asks = (
        "import taichi_bearings as tb; from taichi_bearings.kernels import elimination, substitution\n"
        "tb.solve(tb.Scene.random((10, 10, 10), seed=1, replicas=16))\n"
        "kernels = elimination.eliminate, elimination.eliminate_alone, substitution.substitute_alone\n"
        "print([len(of._primal.compiled_kernels) for of in kernels])"
    )
    if compiler_name() != "taichi":
        pytest.skip("its kernels keep what is compiled under another name")
    found = subprocess.run([sys.executable, "-c", asks], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "[1, 0, 0]"
