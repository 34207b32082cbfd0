"""Verdicts: none from too few samples, and shares judged by their errors."""

import pytest
from scipy import stats
from taichi_bearings_studies.paper.claims import Claim, Share


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
