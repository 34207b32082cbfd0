"""A share of `python -m tests.fuzz`: every input is met by a result or by one clear sentence."""

import sys

import pytest

from tests.fuzz.__main__ import meet
from tests.fuzz.kinds import KINDS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="reads what Linux says of memory, and runs on POSIX")


@pytest.mark.filterwarnings("ignore")  # what the program warns of is not met here
@pytest.mark.parametrize("kind", KINDS)
def test_every_input_is_answered(corpus, tmp_path, kind, thorough):
    number = max(3, KINDS[kind][1] // 12) * (30 if thorough else 1)
    for case in range(number):
        answer = meet(corpus, kind, case, tmp_path / "work")
        assert not answer.fault, f"{kind}, case {case}, {answer.words}:\n{answer.fault}"
