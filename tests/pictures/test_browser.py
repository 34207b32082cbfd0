"""The page of `bearings view` in a browser without a window: Chromium or Chrome, where one is installed.

Frame times are of drawing without a graphics card; `pytest -rA` or a JUnit report shows them.
"""

import base64
import os
import re
import shutil
import time

import numpy as np
import pytest

from taichi_bearings.analysis.structure import structure_of
from taichi_bearings.runs.points_and_lines import points_and_lines
from taichi_bearings.runs.run_file import read_run
from taichi_bearings.view.view import view

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")


BARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip("playwright.sync_api", reason="playwright, which steers browsers, is not installed")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        pytest.skip("there is no Chromium or Chrome on this machine; CHROMIUM may name one")
    with driver.sync_playwright() as steering:
        started = steering.chromium.launch(executable_path=found, args=BARE)
        yield started
        started.close()


@pytest.fixture(scope="module")
def tab(browser):
    """The only tab of the browser: in one that is there already a page needs no process of its own."""
    return browser.new_page(viewport={"width": 1100, "height": 390})


class Page:
    """A page in the tab of the browser, what it complained of and what it asked for."""

    def __init__(self, tab, path, part=""):
        self.complaints, self.requests, self.tab = [], [], tab
        self.heard = {
            "console": lambda said: self.complaints.append(f"{said.type}: {said.text}"),
            "pageerror": lambda error: self.complaints.append(str(error)),
            "request": lambda request: self.requests.append(request.url),
        }
        for event, heard in self.heard.items():
            self.tab.on(event, heard)
        began = time.perf_counter()
        self.tab.goto(path.as_uri() + part)
        self.tab.wait_for_function("window.bearings || document.getElementById('message').textContent[0] === 'N'")
        self.seconds = time.perf_counter() - began

    def leave(self):
        """Leave the tab empty, for another page."""
        for event, heard in self.heard.items():
            self.tab.remove_listener(event, heard)
        self.tab.goto("about:blank")

    def ask(self, words):
        return self.tab.evaluate(words)

    def move(self, slider, value):
        """As a hand does it: the slider gets a value and says so."""
        self.tab.locator(f"#{slider}").evaluate(
            "(e, to) => { e.value = to; e.dispatchEvent(new Event('input')); }", value
        )

    def press(self, name):
        self.tab.get_by_role("button", name=name, exact=True).click()

    def pixels(self):
        """Of the picture itself, (height, width, 4), rows from below."""
        words = """(() => { const p = bearings.picture, gl = p.renderer.getContext(); p.draw();
            const { drawingBufferWidth: w, drawingBufferHeight: h } = gl, all = new Uint8Array(4 * w * h);
            gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, all);
            let text = "";
            for (let at = 0; at < all.length; at += 8192) text += String.fromCharCode(...all.subarray(at, at + 8192));
            return [w, h, btoa(text)]; })()"""
        width, height, values = self.ask(words)
        return np.frombuffer(base64.b64decode(values), dtype=np.uint8).reshape(height, width, 4)

    def is_quiet(self):
        """True if it said nothing and asked for nothing but itself."""
        loud = [text for text in self.complaints if "GPU stall" not in text]  # of our reading pixels back
        return not loud and len(self.requests) == 1 and self.requests[0].startswith("file://")


@pytest.fixture
def opened(tab, tmp_path):
    """A function that makes the page of a run and opens it in place of the one before."""
    pages = []

    def show(run, *look):
        if pages:
            pages[-1].leave()
        path = tmp_path / f"page-{len(pages)}.html"
        view(run, path, analyse=True)
        pages.append(Page(tab, path, *look))
        return pages[-1]

    yield show
    for page in pages[-1:]:
        page.leave()


def coloured(pixels):
    return (pixels[..., :3].astype(int).max(axis=2) - pixels[..., :3].min(axis=2) > 40).mean()


@pytest.mark.parametrize("name", ["minimum", "discs"])
def test_a_page_shows_every_view_without_a_word_of_complaint(name, opened, request):
    page = opened(request.getfixturevalue(name))
    spins = page.pixels()
    assert 0.05 < coloured(spins) < 0.9
    for button in ("Network", "Slipping", "Minimum cut", "Domains", "Bottlenecks"):
        if page.tab.get_by_role("button", name=button, exact=True).is_enabled():
            page.press(button)
            assert (page.pixels() != spins).any(axis=2).mean() > 0.002
    page.press("Spins")
    assert (page.pixels() == spins).mean() > 0.999
    assert page.is_quiet(), (page.complaints, page.requests)


def test_states_are_those_of_the_run_first_and_by_the_threshold_of_the_slider_then(minimum, opened):
    page, solution = opened(minimum), read_run(minimum).solution
    structure = structure_of(solution)
    assert page.ask("bearings.sample.counts.slipless") == structure.contacts_in(0)
    assert page.ask("bearings.sample.counts.spans") is structure.network.spans is True
    assert page.ask("bearings.sample.counts.reached") == pytest.approx(structure.network.reached_fraction)
    assert page.tab.locator("#threshold-text").inner_text() == "those of the run (proven)"
    assert page.ask("bearings.sample.piece.filter((kind) => kind === 0).length") == structure.network.spanning.sum()
    page.press("Network")
    before = page.pixels()
    for step in (112, 114, 116, 118):
        page.move("threshold", step)
        slip = page.ask("bearings.choices.slip")
        assert slip == pytest.approx(0.5 * 0.9 * 10 ** (-12 + 12 * (step - 1) / 119))
        coarse = structure_of(solution, threshold=slip).network
        assert page.ask("bearings.sample.counts.slipless") == len(coarse.axis) > structure.contacts_in(0)
        assert page.ask("bearings.sample.counts.reached") == pytest.approx(coarse.reached_fraction)
        assert page.ask("bearings.sample.piece.filter((kind) => kind === 0).length") == coarse.spanning.sum()
        assert "proven" not in page.tab.locator("#threshold-text").inner_text()
    assert (page.pixels() != before).any(axis=2).mean() > 1e-3


def test_sliders_of_power_and_slice_leave_what_they_say(minimum, opened):
    page, solution = opened(minimum), read_run(minimum).solution
    page.press("Slipping")
    shown = "bearings.picture.layers.slipping.count"
    slipping = solution.power_per_contact[solution.state == 1]
    assert page.ask(shown) == len(slipping)
    page.move("power", 80)
    least = page.ask("weakest(bearings.choices)")
    assert 0 < page.ask(shown) == (slipping >= least).sum() < len(slipping)
    page.press("Spins")
    page.move("slice-y-from", 3)
    assert page.ask("bearings.picture.shown.reduce((a, b) => a + b)") == 5 * 2 * 5


AIM = """([layer, number]) => { const { picture } = bearings, id = picture.layers[layer].ids[number];
    picture.mark(layer === "spheres" ? { sphere: id } : { contact: id });
    const place = picture.marker.position.clone().project(picture.camera);
    const box = picture.canvas.getBoundingClientRect();
    const x = (place.x + 1) / 2 * box.width, y = (1 - place.y) / 2 * box.height;
    return [id, picture.pick(x, y), x + box.left, y + box.top]; }"""


def test_contacts_across_periodic_sides_are_halves_at_both_sides_and_can_be_pointed_at(periodic, opened):
    page, rows = opened(periodic), points_and_lines(read_run(periodic))
    page.move("time", 3)  # the end
    lattice = rows.answer.scene.lattice
    low, high = (page.ask(f"Array.from(bearings.sample.{end})") for end in ("first", "second"))
    assert np.array_equal(np.column_stack([low, high]), rows.network.contact.T)
    network = structure_of(read_run(periodic).solution).network
    assert page.ask("bearings.sample.counts.spans") == network.spans
    assert page.ask("bearings.sample.counts.reached") == pytest.approx(network.reached_fraction)
    page.press("Network")
    over = rows.network.contact.T[:, 1] < rows.network.contact.T[:, 0]
    layer = "bearings.picture.layers.network"
    count = page.ask(f"{layer}.count")
    slipless = rows.contacts["state"].values == 0
    assert (slipless & over).any()
    ids = np.array(page.ask(f"Array.from({layer}.ids)"))[:count]
    assert sorted(ids) == sorted(np.repeat(np.arange(lattice.all_contacts), slipless * (1 + over)))
    middle = np.array(page.ask(f"Array.from({layer}.place)")).reshape(-1, 4, 3)[:count, 0]
    axis = np.array([0, 1, 2] if lattice.dimension == 3 else [0, 2])[lattice.axis[ids]]
    along = np.abs(np.take_along_axis(middle, axis[:, None], axis=1)[:, 0])
    side = np.array(lattice.shape)[lattice.axis[ids]] / 2
    assert along[over[ids]] == pytest.approx(side[over[ids]] - 0.25)  # half rods, up to the side
    assert (along[~over[ids]] <= side[~over[ids]] - 1).all()
    found = page.tab.evaluate(
        """(contact) => { const { picture } = bearings;
        picture.camera.position.set(0, -picture.extent * 2, 0); picture.controls.update(); picture.mark({ contact });
        const place = picture.marker.position.clone().project(picture.camera);
        const box = picture.canvas.getBoundingClientRect();
        return picture.pick((place.x + 1) / 2 * box.width, (1 - place.y) / 2 * box.height); }""",
        int(
            np.flatnonzero(
                slipless & over & (lattice.axis == 0) & (rows.network.contact.T[:, 0] % lattice.shape[-1] > 0)
            )[0]
        ),
    )
    assert over[found["contact"]]
    assert page.is_quiet(), (page.complaints, page.requests)


def test_a_packing_is_shown_as_it_is(packed, opened):
    page, solution = opened(packed), read_run(packed).solution
    packing, structure = solution.scene, structure_of(solution)
    flat, radius, (first, second) = packing.dimension == 2, np.asarray(packing.radius), packing.contact.T
    place, way = (np.array(page.ask(f"Array.from(bearings.sample.{name})")).reshape(-1, 3) for name in ("place", "way"))
    unit, axes = 2 * np.sort(radius)[len(radius) // 2], [0, 2] if flat else [0, 1, 2]
    assert np.diff(place[:, axes], axis=0) * unit == pytest.approx(np.diff(packing.center, axis=0), abs=1e-5)
    assert way[:, axes] * unit == pytest.approx(packing.normal * (radius[first] + radius[second])[:, None], abs=1e-5)
    apart = np.linalg.norm(packing.center[second] - packing.center[first], axis=1)
    over = apart > 1.01 * (radius[first] + radius[second])
    assert page.ask("Array.from(bearings.sample.over)") == over.tolist()
    for key, count in (("slipless", structure.slipless.sum()), ("slipping", (structure.state == 1).sum())):
        assert page.ask(f"bearings.sample.counts.{key}") == count
    assert page.ask("bearings.sample.counts.spans") is structure.numbers["spans"]
    reached = structure.network.touched[packing.driven < 0].mean()
    assert page.ask("bearings.sample.counts.reached") == pytest.approx(reached)
    joined = np.array(page.ask("Array.from(bearings.sample.piece)"))
    assert ((joined == 0) == structure.network.spanning).all()
    has_bottlenecks = structure.bottlenecks and structure.bottlenecks.share.any()
    for preset, has in (("Bottlenecks", has_bottlenecks), ("Minimum cut", structure.interface is not None)):
        assert page.tab.get_by_role("button", name=preset, exact=True).is_enabled() == has
    assert page.tab.locator("#colour option[value=kind]").is_disabled()
    words = page.tab.locator("body").inner_text()
    assert "driven bodies" in words
    assert "bottom" not in words
    wide = np.array(page.ask("Array.from(bearings.picture.layers.spheres.wide)")).reshape(-1, 4)[:, 0]
    assert wide * unit == pytest.approx(2 * radius)
    for sphere in (0, packing.spheres // 2, packing.spheres - 1):
        _, found, x, y = page.tab.evaluate(AIM, ["spheres", sphere])
        if flat or found == {"sphere": sphere}:
            page.tab.mouse.move(x, y)
            page.tab.wait_for_function(f"document.getElementById('numbers').innerText.includes('sphere {sphere} at (')")
            text = page.tab.locator("#numbers").inner_text()
            shown = re.search(r"at \((.*?)\)", text)[1]
            assert np.array(shown.split(", "), dtype=float) == pytest.approx(packing.center[sphere], rel=6e-6, abs=1e-5)
            assert (f"driven with body {packing.driven[sphere]}" in text) == (packing.driven[sphere] >= 0)
    page.press("Network")
    ids = np.array(page.ask("Array.from(bearings.picture.layers.network.ids)"))
    count = page.ask("bearings.picture.layers.network.count")
    assert sorted(ids[:count]) == sorted(np.repeat(np.arange(packing.contacts), structure.slipless * (1 + over)))
    asked = 0
    for number in range(0, count, 5):
        contact, found, x, y = page.tab.evaluate(AIM, ["network", number])
        if found == {"contact": contact}:  # others may lie before it
            page.tab.mouse.move(x, y)
            name = f"contact {contact} of spheres {first[contact]} and {second[contact]}"
            page.tab.wait_for_function(f"document.getElementById('numbers').innerText.includes('{name}')")
            shown = re.search(r"force \|f\|\s+(\S+) force", page.tab.locator("#numbers").inner_text())[1]
            assert float(shown) == pytest.approx(solution.force[0, contact], rel=6e-6)
            asked += 1
    assert asked >= 3
    page.press("Domains")
    page.tab.locator("#colour").select_option("body")
    page.move("slice-x-to", 20)
    left = packing.center[:, 0] <= packing.center[:, 0].min() + 20.5 / 40 * np.ptp(packing.center[:, 0])
    assert page.ask("bearings.picture.layers.spheres.count") == left.sum()
    assert page.is_quiet(), (page.complaints, page.requests)


def test_snapshots_play_in_time(dynamics, opened):
    page = opened(dynamics)
    assert page.ask("document.title").endswith("seed 5")
    assert page.ask("bearings.choices.time") == 0  # it opens at the first snapshot
    assert page.tab.locator("#title").inner_text().endswith("t = 0")
    page.move("time", 3)
    assert page.tab.locator("#title").inner_text().endswith(page.tab.locator("#time-text").inner_text().split(",")[0])
    end = page.pixels()
    drawn = points_and_lines(read_run(dynamics))
    rows, shape = drawn.moments, drawn.structure.spin.shape
    page.move("time", 1)
    shown = drawn.structure.scene.driving.shown(rows.spin[1].reshape(shape))
    assert np.array(page.ask("Array.from(bearings.sample.spinNow)")) == pytest.approx(shown.ravel(), rel=1e-6)
    assert page.ask("bearings.sample.counts.slipping") == (rows.state[1] == 1).sum()
    page.move("time", 0)
    assert page.tab.locator("#title").inner_text().endswith("t = 0")
    assert (page.pixels() != end).any(axis=2).mean() > 0.05
    page.press("Play the snapshots")
    page.tab.wait_for_function("bearings.choices.time === 3")
    assert (page.pixels() == end).mean() > 0.999
    assert page.is_quiet(), (page.complaints, page.requests)


def test_the_address_keeps_the_view_and_a_wrong_one_does_no_harm(minimum, opened):
    page = opened(minimum)
    page.press("Network")
    page.move("slice-y-from", 2)
    page.move("threshold", 114)
    page.tab.locator("#canvas").press("ArrowLeft")
    page.tab.wait_for_function("location.hash.includes('low=0,2,0') && location.hash.includes('threshold=114')")
    page.tab.wait_for_timeout(400)  # of the last key
    chosen = "(({ preset, ...others }) => JSON.stringify(others, Object.keys(others).sort()))(bearings.choices)"
    kept, choices, shown = page.ask("location.hash"), page.ask(chosen), page.pixels()
    assert page.is_quiet(), (page.complaints, page.requests)
    again = opened(minimum, kept)
    assert again.ask(chosen) == choices
    assert (np.abs(again.pixels().astype(int) - shown) > 8).any(axis=2).mean() < 0.01
    wrong = "#camera=0,NaN,1&low=9,-4,x&high=99,1,1&layers=none,cut&colour=constructor&power=1e9&time=4e9&kinds=2"
    page = opened(minimum, wrong)
    assert page.ask("[bearings.choices.power, bearings.choices.time, bearings.choices.colour]") == [100, 0, "spin"]
    assert page.ask("[bearings.choices.low, bearings.choices.high]") == [[0, 0, 0], [4, 1, 1]]
    assert page.is_quiet(), (page.complaints, page.requests)
    assert kept != wrong
