"""Runs of packings: honest ones are never refuted, forged ones are found, and what is proven is true."""

import shutil
from contextlib import suppress
from copy import copy
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import product

import h5py
import numpy as np
import pytest

import taichi_bearings as tb
from taichi_bearings.errors import FileError
from taichi_bearings.proof.judgement import Judgement
from taichi_bearings.runs.verify import verify
from taichi_bearings.scene.generators.lattices import KINDS as LATTICES
from tests.packing.fraction_twin import least_power_of_discs, states_of_discs
from tests.packing.twins import clarabel_least, random_packing
from tests.scenes import some_of

LAWS = ("coulomb", "coulomb-viscous", "viscous")
KINDS = {
    "square": (5, 4), "triangular": (4, 3), "honeycomb": (3, 3), "cubic": (3, 4, 4), "bcc": (3, 3, 3),
    "fcc": (2, 2, 3), "diamond": (2, 2, 2), "hcp": (2, 2, 2),
}  # fmt: skip


def drawn(seed):
    """A random packing; loops odd or even, dangling and floating parts, several bodies, contrasts, ties. For a pair of
    a kind and a number, that lattice; ties for odd numbers."""
    if isinstance(seed, tuple):
        kind, seed = seed
        values = {"distribution": "bimodal:1,2,0.5"} if seed % 2 else {}
        of = {"seed": seed, "law": LAWS[seed % 3], "spin_bottom": 0.25 * (seed % 4)}
        return tb.Packing.lattice(kind, KINDS[kind], **of, **values)
    rng = np.random.default_rng([91, seed])
    return random_packing(rng, 2 + seed // 3 % 2, LAWS[seed % 3], levels=5 if seed % 7 == 0 else None)


def of_every_kind(first):
    """Pairs for `drawn`, three of each kind of lattice that the program has, one for each law; only the first of them
    without `--thorough`."""
    return [pytest.param((kind, first + place + n), id=f"{kind}-{first + place + n}",
                         marks=pytest.mark.thorough if n else ())
            for place, kind in enumerate(LATTICES) for n in range(3)]  # fmt: skip


def write_run(folder, found):
    """run.h5 of a result without its checksums, so that what is forged contradicts itself."""
    path = found.save(folder / "run") / "run.h5"
    with h5py.File(path, "a") as file:
        del file.attrs["sha256"]
    return path


@pytest.mark.parametrize("seed", [*some_of(96, 9), *of_every_kind(4)])
def test_honest_runs_are_not_refuted(seed, tmp_path):
    found = tb.solve(drawn(seed))
    report = verify(write_run(tmp_path, found))
    assert report["contradictions"] == []
    assert (report["lower_bound"], report["gap"]) == (found.lower_bound, found.gap)
    assert sum(report["states_proven"].values()) == (found.state != 3).sum()


@pytest.mark.parametrize("seed", [*some_of(72, 15), *of_every_kind(0)])
def test_samples_judged_together_prove_what_each_proves_alone(seed):
    """Random packings of all laws with three draws of coefficients, the second of them hardly any friction, in spins
    and friction of their minima."""
    packing = drawn(seed)
    draw = np.random.default_rng([5, packing.contacts])
    names = [name for name in ("friction", "viscosity") if getattr(packing, name) is not None]
    samples = [packing]
    for size in (1e-9, 1.0):
        changed = {name: getattr(packing, name) * size * draw.uniform(0.5, 2.0, packing.contacts) for name in names}
        samples.append(packing._with(**changed))
    found = [tb.solve(one).solution for one in samples]
    given = [[getattr(one, name)[0] for one in found] for name in ("spin", "spin_rounding", "friction")]
    together = Judgement(tb.Packing.together(samples), *map(np.stack, given))
    for number, (one, *arrays) in enumerate(zip(samples, *given, strict=True)):
        alone = Judgement(one, *arrays)
        for name in (
            "power",
            "lower_bound",
            "slip",
            "known",
            "largest_torque",
            "proof",
            "can_all_rest",
            "driven_power",
        ):
            assert np.array_equal(getattr(together, name)[number], getattr(alone, name)[0]), name


def small_discs(seed):
    """Whole frictions and driven values, so that all minima can be listed; ties abound."""
    rng = np.random.default_rng([7, seed])
    while True:
        packing = random_packing(rng, 2, spheres=int(rng.integers(5, 9)), levels=1)
        if (packing.driven < 0).sum() <= 6:
            break
    names = ("center", "contact", "driven", "normal")
    arrays = {name: getattr(packing, name) for name in names}
    driven = rng.integers(-1, 2, packing.spheres).astype(float)
    friction = rng.integers(1, 4, packing.contacts).astype(float)
    return tb.Packing(**arrays, spin=driven, radius=1.0, friction=friction, normal_force=1.0, schematic=True)


def all_minima(packing):
    """Slips (minima, E) of all minima whose spins are half differences of values that are imposed, by trying each."""
    held = packing.driven >= 0
    levels = np.unique([*packing.spin[held], *-packing.spin[held], 0.0])
    values = np.unique((levels[:, None] - levels) / 2)
    spins = np.tile(packing.spin, (len(values) ** (~held).sum(), 1))
    spins[:, ~held] = list(product(values, repeat=(~held).sum()))
    slips = spins[:, packing.contact].sum(axis=2)
    acts = (~held)[packing.contact].any(axis=1)
    power = np.abs(slips[:, acts]) @ packing.friction[acts]
    return slips[power == power.min()], power.min()


@pytest.mark.parametrize("seed", some_of(40, 4))
def test_states_of_discs_are_those_of_all_minima(seed):
    packing = small_discs(seed)
    found, (slips, power) = tb.solve(packing), all_minima(packing)
    assert found.lower_bound <= power <= found.power * (1 + 1e-14)
    assert found.power == pytest.approx(power, rel=1e-14)
    least, most = slips.min(axis=0), slips.max(axis=0)
    rests, always = (least == 0) & (most == 0), (least > 0) | (most < 0)
    truth = np.where(found.state == 3, 3, np.where(rests, 0, np.where(always, 1, 4)))
    assert ((found.state == truth) | ~found.proven).all()
    assert found.proven.all()


@pytest.mark.parametrize("seed", [*some_of(19, 3), *of_every_kind(0)])
def test_bounds_of_power_hold_at_another_minimum(seed):
    pytest.importorskip("clarabel")
    packing = drawn(seed if isinstance(seed, tuple) else 3 * seed + 120)
    found, (power, _, status) = tb.solve(packing), clarabel_least(packing)
    if status != "Solved":
        pytest.skip("Clarabel has no minimum of its own")
    unit = sum(values.sum() for values in packing.material) * max(np.abs(packing.driven_speed).max(), 0.01)
    off = 1e-7 * abs(power) + 1e-9 * unit  # what Clarabel reaches
    assert found.lower_bound <= (2 if packing.law.name == "viscous" else 1) * power + off


def with_diagonals(cells, seed):
    """A cubic lattice in which every third square or so has a contact across it: some loops are odd."""
    arrays, cells = tb.Packing.lattice("cubic", cells, seed=seed).arrays(), np.array(cells)
    place, rng = np.indices(cells).reshape(3, -1).T, np.random.default_rng([17, seed])
    pairs = [[begin, begin + step] for step in ([1, 1, 0], [1, 0, 1], [0, 1, 1]) for begin in place
             if (begin + step < cells).all() and rng.random() < 0.3]  # fmt: skip
    pairs = np.ravel_multi_index(np.array(pairs).transpose(2, 0, 1), cells)
    vector = arrays["center"][pairs[:, 1]] - arrays["center"][pairs[:, 0]]
    normal = np.concatenate([arrays["normal"], vector / np.linalg.norm(vector, axis=1)[:, None]])
    friction = np.append(arrays["friction"], rng.uniform(0.1, 1, len(pairs)))
    contact = np.concatenate([arrays["contact"], pairs])
    of = {"contact": contact, "normal": normal, "friction": friction, "normal_force": 50.0, "schematic": True}
    return tb.Packing(**arrays | of)


OBLIQUE = {
    "bcc": lambda: tb.Packing.lattice("bcc", (3, 3, 4), seed=1),
    "slow slips": lambda: tb.Packing.lattice("bcc", (5, 5, 5), seed=35),  # 1e-8 and more
    "slower slips": lambda: tb.Packing.lattice("bcc", (6, 6, 6), seed=0),  # 9e-10 and more
    "contrasts": lambda: tb.Packing.lattice("bcc", (2, 3, 3), seed=1, distribution="lognormal:1,2"),
    "walls": lambda: tb.Packing.lattice("bcc", (3, 2, 2), seed=2, driven="walls", direction=(1, 2, 0), spin_bottom=0.3),
    "diamond": lambda: tb.Packing.lattice("diamond", (2, 2, 2), seed=0),
    "fcc": lambda: tb.Packing.lattice("fcc", (2, 3, 2), seed=1),
    "hcp": lambda: tb.Packing.lattice("hcp", (2, 2, 2), seed=1),
    "diagonals": lambda: with_diagonals((4, 4, 4), seed=0),
    "random": lambda: tb.Packing.random(60, seed=2),
    "damped bcc": lambda: tb.Packing.lattice("bcc", (3, 3, 3), seed=1, law=LAWS[1], viscosity="power-law:1,100,-1"),
    "damped fcc": lambda: tb.Packing.lattice("fcc", (2, 2, 3), seed=2, law=LAWS[1], viscosity="power-law:0.1,10,-1"),
    "damped diamond": lambda: tb.Packing.lattice(
        "diamond", (2, 2, 2), seed=1, law=LAWS[1], viscosity="power-law:10,1000,-1"
    ),
    "damped random": lambda: tb.Packing.random(100, seed=1, law=LAWS[1], viscosity="power-law:0.1,10,-1"),
}


@cache
def minimum_of(kind):
    """The solved packing of that kind."""
    return tb.solve(OBLIQUE[kind]())


def surplus_and_rest(packing, rests):
    """How many conditions more than follow from each other contacts at rest put on the spins, and whether they can
    all be met; by elimination in fractions."""
    free, rows = packing.driven < 0, {}
    number = np.where(free, 3 * np.cumsum(free) - 3, -1)
    u, surplus = packing.spin * np.asarray(packing.radius).reshape(-1, 1), 0
    for contact, normal in zip(packing.contact[rests], packing.normal[rests], strict=True):
        n = [Fraction(value) for value in normal.tolist()]
        n = [value / max(n, key=abs) for value in n]
        k = int(np.argmax(np.abs(normal)))
        for own in {0, 1, 2} - {k}:  # u_own n_k - u_k n_own = 0
            row = {}
            for i in contact:
                for axis, factor in ((own, n[k]), (k, -n[own])):
                    place = int(number[i]) + axis if free[i] else -1
                    by = factor if free[i] else factor * Fraction(float(u[i, axis]))
                    row[place] = row.get(place, 0) + by
            while (row := {place: by for place, by in row.items() if by}) and (first := max(row)) in rows:
                factor, above = row[first], rows[first]
                row = {place: row.get(place, 0) - factor * above.get(place, 0) for place in row.keys() | above.keys()}
            if row and first >= 0:
                rows[first] = {place: by / row[first] for place, by in row.items()}
            elif row:
                return surplus, False
            else:
                surplus += 1
    return surplus, True


@pytest.mark.parametrize("kind", ["walls", "diamond", "diagonals"])
def test_contacts_that_are_proven_to_rest_can_do_so_exactly(kind):
    found = minimum_of(kind)
    surplus, can = surplus_and_rest(found.packing, (found.state == 0) & found.proven)
    assert surplus > 0
    assert can


@pytest.mark.parametrize("kind", ["contrasts", "diamond"])
def test_rest_is_not_proven_where_a_normal_is_off_by_its_last_digit(kind):
    found = minimum_of(kind)
    rests, unproven = np.flatnonzero((found.state == 0) & found.proven), 0
    for contact in rests[:: len(rests) // 8]:
        normal = found.packing.normal.copy()
        normal[contact] = np.nextafter(normal[contact], [1, -1, 1])
        packing = tb.Packing(**found.packing.arrays() | {"normal": normal})
        proven = Judgement(packing, found.spin, found.spin_rounding, found.friction).states[0].known
        assert surplus_and_rest(packing, proven == 0)[1]
        unproven += (proven[rests] == 2).any()
    assert unproven > 0  # loops that cannot roll; not those that stand still


def test_minima_are_not_enclosed_where_normals_are_longer_than_units():
    """Friction on them turns spheres by more than the enclosure counts; no scene has any, a file may."""
    found = minimum_of("bcc")
    packing = found.packing
    network = replace(packing.network, normal=(1 + 1e-7) * packing.network.normal)
    longer = copy(packing)
    vars(longer)["network"] = network
    proven = Judgement(longer, found.spin, found.spin_rounding, found.friction).states[0].known
    assert (proven[(found.state == 0) & (found.force > 0)] == 2).all()


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=pytest.mark.thorough if k == "slower slips" else ()) for k in OBLIQUE]
)
def test_all_states_of_oblique_contacts_are_proven_and_no_false_ones(kind):
    """Of the minimum; and of spins and friction beside it no other states, and none if a contact bears too much."""
    found, rng = minimum_of(kind), np.random.default_rng(3)
    packing = found.packing
    assert found.proven.all()
    free = packing.driven < 0
    proofs = 0
    sizes = 10.0 ** np.arange(-13, 0, 3)
    for size in sizes:
        spin = found.spin + size * free[:, None] * rng.standard_normal(found.spin.shape)
        friction = found.friction * (1 + size * rng.standard_normal(len(found.slip)))[:, None]
        proven = Judgement(packing, spin, np.zeros_like(spin), friction).states[0].known
        acts = found.state != 3
        assert ((proven == found.state) | (proven == 2))[acts].all()
        proofs += not (proven[acts] == 2).any()
    assert proofs < len(sizes)
    rests = np.flatnonzero((found.state == 0) & (found.force > 0.1))
    weak = packing.friction.copy()
    weak[rests[0]] = 0.99 * found.force[rests[0]] / np.broadcast_to(packing.normal_force, weak.shape)[rests[0]]
    weaker = tb.Packing(**packing.arrays() | {"friction": weak}, law=packing.law)
    proven = Judgement(weaker, found.spin, found.spin_rounding, found.friction).states[0].known
    assert proven[rests[0]] == 2


@pytest.mark.parametrize("kind", ["bcc", "diamond"])
def test_a_network_in_which_nothing_has_to_slip_is_at_rest_everywhere(kind):
    packing = tb.Packing.lattice(kind, (2, 2, 2), seed=0)
    kept = np.random.default_rng(0).random(packing.contacts) < 0.3
    arrays = {name: values[kept] if len(values) == len(kept) else values for name, values in packing.arrays().items()}
    found = tb.solve(tb.Packing(**arrays))
    assert found.power < 1e-15
    assert found.proven.all()
    assert np.isin(found.state, (0, 3)).all()


def test_spheres_that_can_only_roll_prove_that_they_do():
    """A loop of four hangs on one contact of a driven pair; nothing in it slips, whatever rounding does to normals."""
    center = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.7, 0.51], [1.2, 1.1, 1.3], [0.1, 1.6, 0.9], [0.7, 2.0, 1.8]])
    contact = [[0, 2], [1, 2], [2, 3], [2, 4], [3, 5], [4, 5]]
    pair = np.array([[a, b] for a, b in contact])
    normal = center[pair[:, 1]] - center[pair[:, 0]]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    spin = np.array([[1.0, 0.3, 0.2], [-0.4, 0.8, 0.1], *[[0.0] * 3] * 4])
    of = {"normal": normal, "friction": np.ones(6), "schematic": True}
    found = tb.solve(tb.Packing(center, pair, [0, 1, -1, -1, -1, -1], spin, **of))
    assert found.proof == "proven"
    assert found.state[2:].tolist() == [0] * 4
    assert found.proven[2:].all()
    assert found.power > 0


@pytest.mark.parametrize("slow", [1e-30, 1e-199, 1e-201, 1e-300, 5e-324])
@pytest.mark.parametrize("radius", [1.0, [1.0, 0.3, 0.7, 0.3, 0.1]])
def test_nothing_false_is_proven_beside_a_disc_that_hardly_turns(slow, radius):
    """A row of discs that ends at one of slow spin, across which a still one is touched: that contact slips, too."""
    center = [[0, 0], [1, 0], [2, 0], [3, 0], [2, 1]]
    of = {"normal": [[1, 0], [1, 0], [1, 0], [0, 1]], "normal_force": 1.0, "schematic": True, "radius": radius}
    pairs, spin = [[0, 1], [1, 2], [2, 3], [2, 4]], [1.0, 0, 0, slow, 0]
    packing = tb.Packing(center, pairs, [0, -1, -1, 1, 2], spin, friction=[1.0, 2, 3, 0.5], **of)
    found, truth = tb.solve(packing), np.array(states_of_discs(packing))
    assert truth.tolist() == [1, 0, 0, 1]
    assert (~found.proven | (found.state == truth)).all()
    assert found.proven.all() == (slow > 1e-200)
    assert (
        Fraction(found.lower_bound) <= least_power_of_discs(packing) <= Fraction(found.power) * (1 + Fraction(1, 2**51))
    )


def forge(name, change):
    def forgery(file):
        if name.startswith("@"):
            file.attrs[name[1:]] = change(file.attrs[name[1:]])
        else:
            file[name][...] = change(file[name][()])

    return forgery


def first(value):
    def change(values):
        values = values.copy()
        values.flat[0] = value
        return values

    return change


def shifted(values):
    return np.roll(values, 1, axis=0)


FORGERIES = {
    **{f"@{name}": lambda value: value * (1 + 1e-9) for name in ("power", "lower_bound", "driven_power")},
    **{f"@{name}": lambda value: value + 1 for name in (
        "slipping", "slipless", "undecided", "tied", "contacts", "spheres", "driven_spheres")},
    "@gap": lambda value: value + 1e-9, "@largest_balance_residual": lambda value: value * 2 + 1,
    "@status": lambda _: "stalled", "@proof": lambda _: "proven beyond doubt",
    "@law": lambda _: "viscous", "@scene": lambda text: text + "tolerance = 1e-30\n",
    "spin": shifted, "contact/friction": shifted, "contact/slip": shifted, "contact/power": shifted,
    "contact/state": lambda state: 1 - np.minimum(state, 1),
    "contact/proven": lambda proven: 1 - proven,
    "packing/friction": shifted, "packing/normal_force": lambda values: values * (1 + 1e-9),
    "packing/radius": lambda values: values * 1.5, "packing/normal": lambda values: values * 1.1,
    "packing/contact": shifted, "packing/driven": lambda values: np.where(values >= 0, -1, values),
    "packing/spin": lambda values: values * 2,
}  # fmt: skip


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    packing = tb.Packing.lattice("fcc", KINDS["fcc"], seed=3, spin_bottom=0.5)
    path = write_run(tmp_path_factory.mktemp("honest"), tb.solve(packing))
    assert verify(path)["verified"]
    return path


@pytest.mark.parametrize("name", FORGERIES)
def test_forgeries_are_found(name, honest, tmp_path):
    path = tmp_path / "run.h5"
    shutil.copy(honest, path)
    with h5py.File(path, "a") as file:
        forge(name, FORGERIES[name])(file)
    with suppress(FileError):  # what is no packing cannot be read
        assert not verify(path)["verified"]


HOSTILE = {
    "packing/contact": (first(10**9), "contact 0 is between"), "packing/driven": (first(-2), "was changed: driven"),
    "packing/radius": (first(0.0), "was changed: radius"), "packing/friction": (first(-1.0), "was changed: friction"),
    "packing/center": (first(np.nan), "was changed: center"), "packing/normal": (first(np.inf), "was changed: normal"),
    "@power": (lambda _: np.ones(7), "for each of the 1 samples"),
    "@scene": (lambda _: "= =", "the scene"), "@schema_version": (lambda _: 9, "layout version"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_sentence(name, honest, tmp_path):
    change, words = HOSTILE[name]
    path = tmp_path / "run.h5"
    shutil.copy(honest, path)
    with h5py.File(path, "a") as file:
        forge(name, change)(file)
    with pytest.raises(FileError, match=words) as refusal:
        verify(path)
    assert "\n" not in str(refusal.value)


def test_a_file_without_an_array_or_of_another_shape_is_refused(tmp_path):
    path = write_run(tmp_path, tb.solve(tb.Packing.lattice("square", (3, 3), seed=3)))
    with h5py.File(path, "a") as file:
        values = file["spin"][:-1]
        del file["spin"]
        file["spin"] = values
    with pytest.raises(FileError, match=r"spin in .* is damaged: it has float64 of shape \(8,\)"):
        verify(path)
    with h5py.File(path, "a") as file:
        del file["packing/contact"]
    with pytest.raises(FileError):
        verify(path)


def test_a_number_that_is_none_is_damage(tmp_path):
    path = write_run(tmp_path, tb.solve(tb.Packing.lattice("square", (3, 3), seed=3)))
    with h5py.File(path, "a") as file:
        file["spin"][4] = np.nan
    with pytest.raises(FileError, match=r"spin in .* is damaged: it must hold finite numbers"):
        verify(path)


def test_friction_out_of_balance_is_paid_for():
    packing = tb.Packing.lattice("fcc", KINDS["fcc"], seed=2)
    found = tb.solve(packing)
    wrong = found.friction * np.random.default_rng(0).uniform(0.9, 1.1, (packing.contacts, 1))
    bounds = Judgement(packing, found.spin, found.spin_rounding, wrong)
    assert 0 <= bounds.lower_bound <= found.power
    assert bounds.gap > 1e-3


def poorer(found, rng):
    """Spins and friction near those of a minimum: noise that has to be balanced and paid for."""
    packing, size = found.packing, 10.0 ** rng.uniform(-9, -3)
    spin = found.spin + size * rng.standard_normal(found.spin.shape) * np.abs(found.spin).max()
    scale = found.friction.reshape(packing.contacts, found.spin.size // packing.spheres)
    noise = size * rng.standard_normal(scale.shape) * np.abs(scale).max(axis=1, keepdims=True)
    if packing.dimension == 3:
        noise -= packing.normal * (noise * packing.normal).sum(axis=1, keepdims=True)
    friction = (scale * (1 - size * rng.integers(0, 2)) + noise).reshape(found.friction.shape)
    return Judgement(packing, spin, np.zeros_like(spin), friction)


@pytest.mark.parametrize("seed", [*some_of(29, 5), *of_every_kind(1)])
def test_what_poor_answers_prove_is_true_of_a_good_one(seed):
    packing = drawn(seed)
    found = tb.solve(packing)
    judged = poorer(found, np.random.default_rng(packing.contacts))
    unit = np.abs(packing.driven_speed).max()
    assert judged.lower_bound <= found.potential * (1 + 1e-12)
    assert judged.upper_bound >= found.lower_bound
    acts, known = found.state != 3, judged.states[0].known
    assert (found.slip[acts & (known == 0)] <= 1e-12 * unit).all()
    assert (found.slip[acts & (known == 1)] > 0).all()
    assert not ((known == 1) & (found.state == 0) & found.proven).any()
    assert not ((known == 0) & (found.state == 1) & found.proven).any()
