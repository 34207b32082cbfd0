"""Every input is met by a result or by one clear sentence; with --thorough, 100 000 of them."""

import random
import shutil
import sys

import pytest

from tests.fuzz.kinds import KINDS

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="reads what Linux says of memory, and runs on POSIX")


PLAIN = ("options", "other options", "tiny runs", "scene.toml", "scan.toml", "npz and npy", "journals")
"""Kinds in which HDF5 reads no damaged file: some of those it reads for ever, and only a signal ends that, so the suite
leaves them to --thorough."""


@pytest.mark.filterwarnings("ignore")  # what the program warns of is not met here
@pytest.mark.parametrize(
    "kind", [kind if kind in PLAIN else pytest.param(kind, marks=pytest.mark.thorough) for kind in KINDS]
)
def test_every_input_is_answered(corpus, tmp_path, kind, thorough):
    """Each in an empty folder, drawn from its kind and number alone."""
    meet, share = KINDS[kind]
    for case in range(100 * share if thorough else max(3, share // 12)):
        folder = tmp_path / f"{case}"
        folder.mkdir()
        answer = meet(corpus, folder, random.Random(f"{kind} {case}"))
        assert not answer.fault, f"{kind}, case {case}, {answer.words}:\n{answer.fault}"
        shutil.rmtree(folder)
