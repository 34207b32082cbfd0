"""The figures of the slipless network and of the rigid domains show what they say."""

import io
import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgba
from taichi_bearings_studies.paper.figure_3 import draw_plane_cuts

import taichi_bearings as tb
from taichi_bearings.analysis.histogram import count_powers, pool
from taichi_bearings.analysis.slipless_network import SliplessNetwork
from taichi_bearings.analysis.structure import Structure
from taichi_bearings.lattice import Lattice
from taichi_bearings.plots import style
from taichi_bearings.plots.bearing import SPIN_COLOURS, Sheet
from taichi_bearings.plots.curves import draw_histogram
from taichi_bearings.plots.page import VIEW
from taichi_bearings.plots.structure import REACHED_COLOURS, contact_colours, draw_domains, draw_network
from taichi_bearings.plots.style import GREY, describe
from taichi_bearings.proof.contact_state import ContactState
from taichi_bearings.runs.run import run
from taichi_bearings.runs.settings import RunSettings
from taichi_bearings.scans.histogram import histogram
from taichi_bearings.scene.network import Network
from taichi_bearings.scene.packing import Packing
from tests.scenes import make_scene

BOTTOM, TOP = colormaps[SPIN_COLOURS](0.0), colormaps[SPIN_COLOURS](1.0)


class Case:
    """A scene, staggered spins that take a few values at random, and the contacts that do not slip with them.

    levels : places of the values between the spin of the bottom (0) and that of the top (1). parted : the two layers
        at half the height take 0 and 1, so that every contact between them slips.
    """

    def __init__(self, shape, levels=(0.0, 0.5, 1.0), seed=2357, parted=False, **driving):
        self.scene = scene = make_scene(shape, **driving)
        axes = scene.minimum_spin_axes
        top = scene.top_spin(axes)[:, None, ..., None]
        place = np.random.default_rng(seed).choice(levels, (len(axes), 1, *shape))
        if parted:
            place[..., : shape[-1] // 2], place[..., shape[-1] // 2 :] = 0.0, 1.0
        self.staggered = scene.impose_driving(top * place, axes)
        slips, free = scene.slips(self.staggered, axes)[0] > 1e-12, ~scene.lattice.between_driven
        self.slips = scene.lattice.by_axis(slips & free)
        self.network = SliplessNetwork(Network.of(scene.lattice), ~slips & free)
        self.spin = scene.laboratory_spin(self.staggered, axes)[0]
        nothing = np.zeros(len(self.network.slipless))
        state = np.where(free, np.where(slips, ContactState.SLIPPING, ContactState.SLIPLESS), ContactState.DRIVEN)
        self.structure = Structure(SimpleNamespace(scene=scene), self.spin, nothing, state, nothing, nothing, 0.0, 0.0)

    def figures(self):
        found = [draw_domains(self.structure), draw_network(self.structure)]
        cuts = [draw_plane_cuts(self.structure)] if self.spin.ndim > 2 else []
        return [*found, *cuts]


def rendered(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=40)
    return buffer.getvalue()


def collections(axes, kind, colour=None):
    found = [c for c in axes.collections if type(c) is kind]
    if colour is None:
        return found
    return [c for c in found if np.allclose(c.get_colors()[:1], to_rgba(colour))]


def titles(figure):
    parts = [figure, *figure.subfigs]
    return " ".join(axes.get_title() for part in parts for axes in part.axes)


@pytest.mark.parametrize(
    ("shape", "setting"),
    [
        ((2, 3), {}),
        ((3, 30), {"parted": True}),
        ((5, 9, 14), {}),
        ((2, 7, 3), {}),
        ((2, 2, 3), {"parted": True}),
        ((3, 4, 5), {"direction": (1.0, 0.0, 0.0)}),
        ((3, 2, 4), {"spin_top": 0.0}),
        ((2, 5), {"periodic": ("x",)}),
        ((4, 3, 6), {"periodic": ("x",), "parted": True}),
        ((2, 4, 5), {"periodic": ("x", "y")}),
    ],
    ids=str,
)
def test_every_figure_draws_any_lattice(shape, setting):
    case = Case(shape, **setting)
    assert not (case.network.spans and setting.get("parted"))
    for figure in case.figures():
        assert rendered(figure)


def test_the_plane_of_the_domain_figure_is_coloured_and_parted_by_domain():
    case = Case((7, 4), parted=True)
    plane = draw_domains(case.structure).axes[0]
    (discs,) = collections(plane, EllipseCollection)
    expected = np.where(np.arange(4)[None, :, None] < 2, BOTTOM, TOP) * np.ones((7, 1, 1))
    assert np.allclose(discs.get_facecolors().reshape(7, 4, 4), expected)
    (walls,) = collections(plane, LineCollection, "black")
    assert sorted(sorted(line.tolist()) for line in walls.get_segments()) == [
        [[x - 0.5, 1.5], [x + 0.5, 1.5]] for x in range(7)
    ]


@pytest.mark.parametrize("shape", [(7, 4), (5, 9, 14)], ids=str)
def test_the_network_figure_has_a_segment_for_each_slipless_contact_and_the_path_in_green(shape):
    network = (case := Case(shape, levels=(0.0, 1.0))).network
    flat = len(shape) == 2
    if flat:  # discs that all turn alike
        case = Case(shape, spin_bottom=1.0)
        network = case.network
    assert network.spans
    left, right = draw_network(case.structure).axes[0 if flat else 1 :][:2]
    (grey,) = [c for c in left.collections if c.get_label() == "slipless contacts"]
    ends = np.stack(np.unravel_index(network.ends, shape), axis=-1).swapaxes(0, 1)
    expected = ends if flat else VIEW.seen(ends)[..., :2]
    drawn = np.array(grey.get_segments())
    assert drawn.shape == (network.ends.shape[1], 2, 2)
    key = lambda lines: sorted(map(tuple, np.round(lines.reshape(-1, 4), 9) + 0.0))  # noqa: E731
    assert np.allclose(key(drawn), key(expected))
    (green,) = [c for c in left.collections if c.get_label() == "path"]
    path = network.shortest_path
    places = path if flat else VIEW.seen(path)[:, :2]
    lines = [sorted(map(tuple, line)) for line in np.round([*itertools.pairwise(places), *green.get_segments()], 9)]
    assert np.allclose(key(np.array(lines[: len(path) - 1])), key(np.array(lines[len(path) - 1 :])))
    (ends,) = [line for line in left.lines if line.get_marker() == "o"]
    assert np.allclose(ends.get_xydata(), places[[0, -1]])
    if not flat:
        (arrows,) = [c for c in right.collections if hasattr(c, "XY")]
        order = np.argsort(VIEW.seen(path)[:, 2])
        assert np.allclose(arrows.XY, VIEW.seen(path)[order, :2])
        spins = case.spin[tuple(path[order].T)] / case.scene.spin_top
        assert np.allclose(np.column_stack([arrows.U, arrows.V]), 1.6 * VIEW.seen(spins)[:, :2])


def test_without_a_path_the_figures_say_so_and_the_pieces_have_colours():
    case = Case((3, 4, 6), parted=True)
    figure = draw_network(case.structure)
    assert "no path from bottom to top" in figure.get_suptitle()
    (legend,) = figure.legends
    named = dict(zip(("bottom", "top"), legend.get_lines(), strict=True))
    assert [text.get_text() for text in legend.get_texts()] == list(named)
    assert all(np.allclose(named[end].get_color(), colour) for end, colour in REACHED_COLOURS.items())
    between = draw_network(Case((3, 8), levels=(0.5,)).structure).legends[0]
    assert [text.get_text() for text in between.get_texts()] == ["neither"]
    assert between.get_lines()[0].get_color() == to_rgba(GREY)
    assert len(figure.axes) == 3  # the spheres, the contacts, a colour bar
    assert "no path" in titles(draw_plane_cuts(case.structure))
    height = case.network.contact[:, 2]
    colour = contact_colours(case.network)
    assert np.allclose(colour[height < 3], REACHED_COLOURS["bottom"])
    assert np.allclose(colour[height >= 3], REACHED_COLOURS["top"])
    spanning = Case((5, 9, 14), levels=(0.0, 1.0)).network
    assert np.allclose(contact_colours(spanning), to_rgba(GREY))


@pytest.mark.parametrize(("shape", "sides"), [((4, 6), ("x",)), ((2, 7), ("x",)), ((4, 3, 6), ("x",))], ids=str)
def test_contacts_across_periodic_sides_are_drawn_half_at_one_side_and_half_at_the_other(shape, sides):
    case = Case(shape, levels=(0.0, 1.0), seed=5, periodic=sides)
    lattice, slipless = case.scene.lattice, case.network.slipless
    plane = None if len(shape) == 2 else (1, 1)
    sheet = Sheet.of_lattice(lattice, plane)
    inside = slipless[sheet.contact]
    low, high = np.array(np.unravel_index(lattice.ends[:, sheet.contact[inside]], shape))[[0, -1]].swapaxes(0, 1)
    over = (low > high).any(axis=0)
    assert over.any()
    lines, which = sheet.lines(slipless)
    assert np.array_equal(np.bincount(which, minlength=len(inside))[inside], 1 + over)
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum() == inside.sum()
    assert (lines >= -0.5).all()
    assert (lines <= np.array(shape)[[0, -1]] - 0.5).all()


def along(path, shape, periodic=()):
    """The network of the contacts along a path alone."""
    lattice = Lattice(shape, periodic=periodic)
    spheres = np.ravel_multi_index(path.T, shape)
    steps = {frozenset(pair) for pair in itertools.pairwise(spheres.tolist())}
    return SliplessNetwork(
        Network.of(lattice), np.array([frozenset(pair) in steps for pair in lattice.ends.T.tolist()])
    )


def test_contacts_of_packings_are_drawn_as_those_of_lattices_are():
    """Along and across, over a periodic side too, in diameters."""
    packing, lattice = Packing.lattice("square", (4, 5), periodic=("x",), seed=1), Lattice((4, 5), periodic=(0,))
    own, theirs = Sheet.of_network(packing.network), Sheet.of_lattice(lattice)
    middle = [sheet.lines(np.ones(len(sheet.contact), dtype=bool))[0].mean(axis=1) for sheet in (own, theirs)]
    apart = [np.ptp(places, axis=0) for places in middle]
    assert apart[0] / own.pitch == pytest.approx(apart[1])


def test_titles_say_where_the_coefficients_come_from(tmp_path):
    """A seed where they were drawn from it, the file that they were read from, whose name is no mathematics."""
    drawn = tb.Scene.random((4, 5), seed=3)
    assert describe(drawn).endswith("seed 3")
    assert describe(tb.Scene.random((4, 5), seed=3, replicas=3), None).endswith("seeds 3 to 5")
    assert describe(tb.Scene(drawn.coefficients)).endswith("coefficients given")
    np.savez(tmp_path / "my$x.npz", **dict(zip("xy", drawn.coefficients, strict=True)))
    settings = RunSettings(shape=(4, 5), coefficients=str(tmp_path / "my$x.npz"), figures="none", threads=1)
    found = run(settings, tmp_path / "run")
    for scene in (found.solution.scene, tb.load(tmp_path / "run").scene):
        assert describe(scene).endswith(r"coefficients of my\$x.npz")
        assert "seed" not in describe(scene)


def test_the_histogram_of_a_run_says_what_was_solved(tmp_path, monkeypatch):
    titles = {}
    monkeypatch.setattr(style, "save", lambda figure, path: titles.update({path.stem: figure.get_suptitle()}))
    run(RunSettings(shape=(4, 5), seed=3, threads=1), tmp_path / "run")
    assert titles["power_histogram"].startswith("4×5 Coulomb, seed 3\n")
    titles.clear()
    histogram([tmp_path / "run"], tmp_path / "h")
    assert titles["power_histogram"].startswith("4×5 Coulomb, seed 3\n")


def test_figures_without_lines_or_bins_say_nothing_of_tied_contacts():
    """Two columns of three discs apart from each other, with equal friction above and below: both contacts of a column
    are tied. So none is slipless, and none is sure to slip."""
    scene = tb.Scene(coefficients=(np.zeros((1, 3)), np.full((2, 2), 0.5)))
    best = tb.solve(scene, threads=1)
    assert (best.tied, best.slipping, best.slipless) == (4, 0, 0)
    network = draw_network(tb.analyse(best).structure)
    assert "no contact is slipless" in [text.get_text() for axes in network.axes for text in axes.texts]
    solution = best.solution
    histogram = draw_histogram(pool(count_powers(solution.power_per_contact, solution.state), slip_threshold=0.0))
    assert "no slipping contacts" in [text.get_text() for axes in histogram.axes for text in axes.texts]
