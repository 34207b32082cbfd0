"""Verdicts: none from too few samples, and shares judged by their errors. The report as one HTML file: well formed,
nothing to load from elsewhere, and all that report.json says."""

from html.parser import HTMLParser

import pytest
from scipy import stats
from taichi_bearings_studies.paper import reproduce
from taichi_bearings_studies.paper.claims import VERDICTS, Claim, Effort, Share
from taichi_bearings_studies.paper.page import page, typeset


def test_too_few_samples_give_no_verdict_whatever_they_show():
    for confirmed in (True, False):
        claim = Claim("All swans are white.", "Those seen are.", confirmed, samples=2, samples_needed=5)
        assert claim.verdict == "too few samples"
        assert claim.as_dict()["finding"] == "Those seen are. No verdict: this needs 5 such samples and has 2."
    assert Claim("All swans are white.", "They are.", True, samples=5, samples_needed=5).verdict == "confirmed"
    assert Claim("All swans are white.", "One is black.", False, samples=5, samples_needed=5).verdict == "refuted"


@pytest.mark.parametrize(("hits", "samples"), [(0, 5), (5, 5), (116, 200), (23, 1000), (1, 1)])
def test_the_interval_of_a_share_is_the_exact_one(hits, samples):
    """At its ends a share would show as many hits, or as few, once in twenty times."""
    found = Share(hits, samples)
    if hits:
        assert stats.binom.sf(hits - 1, samples, found.least) == pytest.approx(0.05)
    if hits < samples:
        assert stats.binom.cdf(hits, samples, found.most) == pytest.approx(0.05)
    assert 0 <= found.least <= hits / samples <= found.most <= 1


def test_a_share_is_judged_by_its_errors():
    def verdict(hits, samples, limit=0.5):
        share = Share(hits, samples)
        needed = share.needed_for(limit)
        return Claim("Most are.", "", share.least > limit, samples=samples, samples_needed=needed).verdict

    assert [verdict(n, n) for n in (1, 4, 5)] == ["too few samples", "too few samples", "confirmed"]
    assert verdict(3, 5) == "too few samples"
    assert verdict(116, 200) == "confirmed"
    assert verdict(100, 200) == "too few samples"
    assert verdict(0, 4) == "too few samples"
    assert verdict(0, 5) == "refuted"
    assert verdict(0, 0) == "too few samples"


def test_the_number_needed_is_one_that_tells_at_that_share():
    for hits, samples, limit in ((1, 12, 0.05), (3, 5, 0.5), (0, 2, 0.1), (0, 0, 0.5)):
        needed = Share(hits, samples).needed_for(limit)
        assert needed > samples
        then = Share(round(hits / max(samples, 1) * needed), needed)
        assert then.least > limit or then.most <= limit
    assert Share(5, 5).needed_for(0.5) == 5


EMPTY = {"meta", "img", "br"}
LOADS = {"src", "href", "srcset", "data", "poster", "action"}


class Reader(HTMLParser):
    """Checks that elements are closed in order; keeps texts, identifiers and what would be loaded."""

    def __init__(self, text):
        super().__init__()
        self.open, self.words, self.ids, self.loaded = [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in EMPTY:
            self.open.append(tag)
        named = dict(attrs)
        self.ids += [named["id"]] if "id" in named else []
        self.loaded += [value for name, value in attrs if name in LOADS]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self):
        return "".join(self.words)


CLAIMS = [
    Claim("P < P_cut & more.", "So <b>it</b> is.", True, samples=1200, paper="< 1", ours="0.97", uncertainty="0.01"),
    Claim("It is level.", "Nearly.", True, refined=True, kind="theorem"),
    Claim("Water runs uphill.", "It runs downhill.", False, chosen_after_the_data="what counts as uphill"),
    Claim("Swans are white.", "Two are.", True, samples=2, samples_needed=5),
]


@pytest.fixture
def report(tmp_path):
    done = {
        name: {
            "title": f"Of {name} <1>",
            "shown": "All.",
            "claims": [c.as_dict() for c in CLAIMS],
            "seconds": 3.2,
            "seconds_processor": 2,
        }
        for name in ("fig1", "supplement")
    }
    return reproduce.describe(tmp_path, Effort(7, 20, quick=True), done, ["fig2"])


def test_the_page_is_whole_and_loads_nothing(report):
    text = page(report, {"fig1": b"\x89PNG not really"})
    read = Reader(text)
    inside = [value for value in read.loaded if value.startswith("data:image/png;base64,")]
    assert len(inside) == 1
    assert {value for value in read.loaded if value not in inside} <= {f"#{name}" for name in read.ids}
    assert not any(word in text for word in ("http:", "https:", "url(", "@import", "<script", "<link"))
    assert len(set(read.ids)) == len(read.ids)


def test_every_claim_is_there_with_all_that_it_has(report):
    read = Reader(page(report, {}))
    assert [claim["verdict"] for claim in report["figures"]["fig1"]["claims"]] == [
        "confirmed", "refined", "refuted", "too few samples",
    ]  # fmt: skip
    for name, figure in report["figures"].items():
        assert typeset(figure["title"]) in read.text
        for number, claim in enumerate(figure["claims"], start=1):
            for key in ("claim", "finding", "paper", "ours", "uncertainty", "chosen_after_the_data", "verdict"):
                assert typeset(claim[key]) in read.text
            assert {f"{name}-{number}"} <= set(read.ids)
            assert f"#{name}-{number}" in read.loaded
    assert [read.words.count(cell) for cell in ("< 1", "0.97", "1,200")] == [4, 4, 2]  # in the table and below it
    assert all(f"{report[verdict.replace(' ', '_')]} {verdict}" in read.text for verdict in VERDICTS)
