"""Figures as a journal prints them: of the size that was asked for, nothing clipped, letters legible; their numbers."""

import io
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.text import Text

import taichi_bearings as tb
from taichi_bearings.analysis.histogram import count_powers, pool
from taichi_bearings.errors import InputError
from taichi_bearings.plots.curves import Curve, Look, draw_overlay, draw_scan
from taichi_bearings.plots.page import Page, View, read_plane, read_view, read_width
from taichi_bearings.plots.spins import draw_spins
from taichi_bearings.plots.style import column_label, label_in_plain_text, mathematics, new_figure, save
from taichi_bearings.runs.figures import FIGURE_KINDS, draw_figure
from taichi_bearings.scene import Solution

INCH = 2.54


@pytest.fixture(scope="module")
def solved() -> Solution:
    found = tb.solve(tb.Scene.random((4, 3, 5), seed=1, spin_bottom=0.1), "gradient-descent", 1e-2, threads=1).solution
    books = {f"{name}_energy": np.array([[sign], [2.0], [30.0]]) for name, sign in BOOKS.items()}
    history = {"iteration": np.arange(3), "time": np.array([1e-3, 1e-1, 1.0]), **books}
    residual = {"energy_residual": np.array([[1e-9], [-1e-8], [1e-9]])}
    powers = {name: np.repeat(found.history[name][-1:], 3, axis=0) for name in ("power", "lower_bound")}
    return replace(found, history=history | residual | powers)


BOOKS = {"injected": 0.01, "dissipated": -0.02, "kinetic": 0.3, "spring": 0.1}


def beyond(figure):
    """Inches by which what is drawn reaches beyond the paper."""
    figure.draw_without_rendering()
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    return max(-box.x0, -box.y0, box.x1 - width, box.y1 - height)


def drawn(axes, kind=LineCollection):
    return [c for c in axes.collections if type(c) is kind]


@pytest.mark.parametrize(
    ("kind", "width"),
    [*((kind, "single") for kind in FIGURE_KINDS), *((kind, "double") for kind in ("spins", "domains", "network"))],
)
def test_every_figure_is_as_wide_as_asked_with_nothing_clipped_and_legible(kind, width, solved):
    wide = read_width(width)
    figure = draw_figure(kind, solved, page=Page(width=wide))
    assert figure.get_figwidth() * INCH <= wide * (1 + 1e-9)
    assert figure.get_figwidth() * INCH > 0.6 * wide
    assert beyond(figure) < 0.01
    written = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    assert min(text.get_fontsize() for text in written) >= 7


def test_letters_are_embedded_as_letters(solved, tmp_path):
    figure = draw_figure("history", solved)
    save(figure, tmp_path / "a.pdf")
    pdf = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf
    save(figure, tmp_path / "a.svg")
    assert re.search(r"<text[^>]*>.*proven lower bound", (tmp_path / "a.svg").read_text(), re.DOTALL)
    own = io.BytesIO()
    figure.savefig(own, format="pdf")  # from a notebook, outside of our files
    assert b"/Type3" not in own.getvalue()


def test_the_planes_and_the_view_that_were_asked_for_are_shown(solved):
    page = Page(planes=(read_plane("z=2"), read_plane("x=0")), view=read_view("-30,40"))
    axes = draw_figure("spins", solved, page=page).axes
    assert [a.get_title() for a in axes[1:3]] == ["$z = 2$", "$x = 0$"]
    assert (axes[1].get_xlabel(), axes[1].get_ylabel()) == ("$x$", "$y$")
    (discs,) = [c for c in axes[1].collections if type(c) is not LineCollection]
    assert len(discs.get_facecolors()) == 4 * 3
    seen = [draw_figure("network", solved, page=Page(view=view)).axes[1] for view in (None, View(60.0, 10.0))]
    first, other = ([line for c in drawn(a) for line in c.get_segments()] for a in seen)
    assert len(first) == len(other)
    assert not np.allclose(first, other)


@pytest.mark.parametrize(
    ("kind", "page", "sentence"),
    [
        ("spins", Page(planes=((0, 4),)), "from 0 to 3"),
        ("history", Page(planes=((0, 1),)), "shows no planes"),
        ("power", Page(view=View()), "nothing in 3D"),
        ("spins", Page(planes=((0, 1),) * 13), "at most 12"),
    ],
)
def test_planes_and_views_that_are_not_there_are_refused(kind, page, sentence, solved):
    with pytest.raises(InputError, match=sentence):
        draw_figure(kind, solved, page=page)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (read_width, "wide"), (read_width, "1"), (read_width, "nan"),
        (read_plane, "5"), (read_plane, "w=1"), (read_plane, "x=-1"), (read_view, "1"), (read_view, "91,0"),
        (read_view, "nan,0"),
    ],
)  # fmt: skip
def test_what_cannot_be_printed_is_refused_in_a_sentence(read, text):
    with pytest.raises(InputError, match=re.escape(repr(text))):
        read(text)


def test_power_is_in_units_on_its_axis(solved):
    figure = draw_figure("power", solved)
    labels = [a.get_ylabel() for a in figure.axes]
    assert r"$P_{ij}\,/\,(F_n R\,\omega_T)$" in labels
    lines = [c.get_array() for a in figure.axes[:2] for c in drawn(a) if c.get_array() is not None]
    unit = 50.0 * 0.5 * 1.0
    assert np.concatenate(lines).max() <= solved.power_per_contact.max() / unit * (1 + 1e-12)
    assert column_label("power/power_minimum_cut") == r"$\langle P \rangle\,/\,\langle P_\mathrm{cut} \rangle$"
    assert column_label("largest_spread") == "largest spread"
    assert column_label("largest_balance_residual") == "largest balance residual (force · length)"


def test_small_numbers_are_powers_of_ten_within_mathematics():
    assert [mathematics(x) for x in (5e-12, -2.5e20, 0.25, 1234567.0, 0.0)] == [
        r"5\times10^{-12}", r"-2.5\times10^{20}", "0.25", r"1.23457\times10^{6}", "0",
    ]  # fmt: skip


def test_a_logarithmic_axis_names_few_ticks_and_no_line_crosses_an_empty_bin():
    x = np.arange(1.0, 4.0)
    figure = draw_scan([Curve("", x, 20 * x, 19 * x, 21 * x)], Look("x", "P", log="y"))
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in figure.axes[0].get_yticklabels(which="both") if t.get_text()]
    boxes.sort(key=lambda box: box.y0)
    assert 1 < len(boxes) < 8
    assert all(low.y1 < high.y0 for low, high in pairwise(boxes))
    power, state = np.array([[1.0, 1.1, 500.0, 550.0]]), np.ones((1, 4), dtype=int)
    (curve,) = draw_overlay({1: pool(count_powers(power, state), 0.0)}, "seed").axes[0].lines
    gaps = np.isnan(curve.get_ydata())
    assert gaps.any()
    assert not gaps[[0, -1]].any()


def test_every_contact_has_the_colour_of_its_coefficient(solved):
    figure = draw_figure("coefficients", solved, page=Page(planes=((1, 1), (0, 2))))
    x, y, z = map(np.squeeze, solved.scene.coefficients)
    shown = [np.sort(np.concatenate([c.get_array() for c in drawn(axes)])) for axes in figure.axes[:2]]
    expected = [(x[:, 1], z[:, 1]), (y[2], z[2])]
    for found, planes in zip(shown, expected, strict=True):
        np.testing.assert_array_equal(found, np.sort(np.concatenate([plane.ravel() for plane in planes])))
    assert figure.axes[2].get_xlabel() == r"friction coefficient $\mu$"


def test_both_coefficients_of_a_law_with_two_are_drawn_each_with_its_scale():
    scene = tb.Scene.random((4, 5), seed=1, law="coulomb-viscous", viscosity="lognormal:1,3")
    figure = draw_figure("coefficients", tb.solve(scene, tolerance=1e-3, threads=1).solution)
    assert beyond(figure) < 0.01
    of_friction, of_damping = (np.concatenate([c.get_array() for c in drawn(axes)]) for axes in figure.axes[:2])
    for found, arrays in ((of_friction, scene.coefficients), (of_damping, scene.viscosity)):
        np.testing.assert_array_equal(np.sort(found), np.sort(np.concatenate([a.ravel() for a in arrays])))
    assert [axes.get_xlabel().split()[0] for axes in figure.axes[2:]] == ["friction", "damping"]
    assert [axes.get_xscale() for axes in figure.axes[2:]] == ["linear", "log"]


def test_a_large_lattice_shows_the_mean_coefficient_of_each_disc(monkeypatch):
    monkeypatch.setattr("taichi_bearings.plots.bearing.MOST_LINES", 20)
    answer = tb.solve(tb.Scene.random((4, 5), seed=1), threads=1)
    figure = draw_figure("coefficients", answer.solution)
    x, y = map(np.squeeze, answer.scene.coefficients)
    mean = np.zeros((4, 5))
    number = np.zeros((4, 5))
    for at, values in (((slice(1, None), slice(None)), x), ((slice(-1), slice(None)), x),
                       ((slice(None), slice(1, None)), y), ((slice(None), slice(-1)), y)):  # fmt: skip
        mean[at] += values
        number[at] += 1
    (discs,) = [c for c in figure.axes[0].collections if type(c) is not LineCollection]
    (bar,) = figure.axes[0].figure.axes[1:]
    colours = discs.get_facecolors()[:, :3]
    low, high = min(x.min(), y.min()), max(x.max(), y.max())
    np.testing.assert_allclose(
        colours, colormaps["viridis"]((mean / number - low) / (high - low)).reshape(-1, 4)[:, :3]
    )
    assert bar.get_xlabel().startswith("mean over the contacts of a disc")


def test_ticks_have_few_digits_and_sizes_are_whole_numbers():
    x = np.array([1e3, 10**3.5, 1e4])
    figure = draw_scan([Curve("", x, x, x, x)], Look("x", "P", log="x"))
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["1000", "3160", "10000"]
    x = np.array([4.0, 5.0, 6.0])
    figure = draw_scan([Curve("", x, x, x, x)], Look("L", "P"))
    assert all(tick == round(tick) for tick in figure.axes[0].get_xticks())
    x = np.array([10.0])
    figure = draw_scan([Curve("", x, x, x, x)], Look("L", "P"))
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["10"]


@pytest.mark.parametrize(
    ("limits", "labels"),
    [
        ((0.5, 8.0), ["0.6", "1", "2", "3", "4", "6"]),
        ((0.02, 20.0), ["10⁻¹", "10⁰", "10¹"]),
        ((2e-7, 4e-6), ["2·10⁻⁷", "3·10⁻⁷", "4·10⁻⁷", "6·10⁻⁷", "10⁻⁶", "2·10⁻⁶", "3·10⁻⁶", "4·10⁻⁶"]),
        ((8.0, 150.0), ["10", "100"]),
    ],
    ids=str,
)
def test_a_logarithmic_axis_has_powers_of_ten_or_numbers_in_full_but_not_both(limits, labels):
    figure = new_figure()
    axes = figure.add_subplot()
    axes.set(yscale="log", ylim=limits)
    label_in_plain_text(axes.yaxis)
    figure.draw_without_rendering()
    ticks = [*axes.yaxis.get_major_ticks(), *axes.yaxis.get_minor_ticks()]
    shown = {tick.get_loc(): tick.label1.get_text() for tick in ticks if limits[0] <= tick.get_loc() <= limits[1]}
    assert [label for _, label in sorted(shown.items()) if label] == labels


@pytest.mark.parametrize(
    ("driving", "symbol"),
    [
        ({}, r"\omega_T$"),
        ({"spin_top": 0.5, "spin_bottom": -2.0}, r"\omega_B$"),
        ({"top": (1.0, 0.0, 0.0, 0.3)}, r"\omega_{T,\mathrm{max}}$"),
        ({"top": (1.0, 0.0, 0.0, 0.3), "bottom": (0.0, 9.0, 0.0, 0.3)}, r"\omega_{B,\mathrm{max}}$"),
        ({"top": (1.0, 0.0, 0.0), "bottom": (0.0, 0.1, 0.0, 0.1)}, r"\omega_T$"),
    ],
    ids=str,
)
def test_the_unit_of_spins_is_named_after_the_plane_that_has_it(driving, symbol):
    structure = tb.analyse(tb.solve(tb.Scene.random((3, 3, 3), seed=1, **driving), threads=1)).structure
    figure = draw_spins(structure)
    assert figure.axes[-1].get_ylabel().endswith(rf"|\omega|\,/\,{symbol}")
    speed = np.linalg.norm(structure.spin[..., 0 if "_B" in symbol or "{B" in symbol else -1, :], axis=-1)
    assert speed.max() == pytest.approx(max(map(abs, structure.scene.imposed)))
    assert (speed.max() > speed.min() * 1.01) == ("max" in symbol)


@pytest.mark.parametrize("last", [0.004, 0.05, 3.0])
def test_the_times_on_the_axis_of_energies_do_not_overlap(last, solved):
    times = {"time": np.array([0.002, 0.003, last])}
    axes = draw_figure("energy", replace(solved, history=solved.history | times)).axes[-1]
    axes.figure.draw_without_rendering()
    texts = [text for text in axes.get_xticklabels(which="both") if text.get_text()]
    low, high = axes.get_xlim()
    boxes = [text.get_window_extent() for text in texts if low <= text.get_position()[0] <= high]
    assert len(boxes) > 1
    assert all(left.x1 < right.x0 for left, right in pairwise(sorted(boxes, key=lambda box: box.x0)))
