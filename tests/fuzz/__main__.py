"""Fuzz all inputs: python -m tests.fuzz [--inputs 100000] [--kind NAME] [--case N].

A worker process meets the cases in order and says which one it is at; one that hangs or dies is ended and named, and
the next worker goes on behind it. A case is drawn from its kind and number alone.
"""

import argparse
import json
import random
import select
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from tests.fuzz.answers import Answer
from tests.fuzz.corpus import Corpus, make_corpus
from tests.fuzz.kinds import KINDS

PATIENCE = 60.0  # seconds for one input


def meet(corpus: Corpus, kind: str, number: int, folder: Path) -> Answer:
    """The answer to a case, in an empty folder that is removed afterwards."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        return KINDS[kind][0](corpus, folder, random.Random(f"{kind} {number}"))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def cases_of(inputs: int, kinds: list[str]) -> list[tuple[str, int]]:
    """Kinds and numbers, well mixed, each kind with its share."""
    shares = {kind: KINDS[kind][1] for kind in kinds}
    cases = [(kind, n) for kind in kinds for n in range(round(inputs * shares[kind] / sum(shares.values())))]
    random.Random(0).shuffle(cases)
    return cases


def work(root: Path, cases: list[tuple[str, int]], first: int) -> None:
    """The worker: a line of JSON before each case and one after it."""
    corpus = Corpus(
        root,
        tuple(root / n for n in ("flat", "cubic", "block", "lubricated", "resumable", "springs")),
        root / "resumable",
        root / "scan",
    )
    for place in range(first, len(cases)):
        print(json.dumps({"at": place}), flush=True)
        try:
            answer = meet(corpus, *cases[place], root / "work")
            found = {
                "done": place,
                "code": answer.code,
                "fault": answer.fault,
                "words": answer.words,
                "grown": answer.grown,
            }
        except Exception:
            found = {"done": place, "code": -1, "fault": traceback.format_exc(), "words": [], "grown": 0}
        print(json.dumps(found), flush=True)


def watch(root: Path, options: argparse.Namespace, cases: list[tuple[str, int]]) -> Counter:
    """Start workers until all cases are met; the counts by kind and answer."""
    counts: Counter = Counter()
    first, most, end = options.first, 0, time.monotonic() + 60 * options.minutes
    while first < len(cases):
        command = [sys.executable, "-m", "tests.fuzz", *sys.argv[1:], "--worker", str(root), "--first", str(first)]
        worker = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert worker.stdout is not None
        while True:
            ready, _, _ = select.select([worker.stdout], [], [], PATIENCE)
            line = worker.stdout.readline() if ready else ""
            if not line:
                worker.kill()
                worker.wait()
                if first < len(cases):
                    print(f"{cases[first]}: {'died' if ready else 'hangs'}", flush=True)
                    counts[cases[first][0], "died" if ready else "hang"] += 1
                first += 1
                break
            said = json.loads(line)
            if "done" in said:
                kind, most = cases[said["done"]][0], max(most, said["grown"])
                counts[kind, "fault" if said["fault"] else said["code"]] += 1
                if said["fault"]:
                    print(
                        f"{cases[said['done']]}: {' '.join(said['words'])[:300]!r}\n{said['fault'][-options.show :]}",
                        flush=True,
                    )
                first = said["done"] + 1
                if first % 1000 == 0:
                    print(f"{first:,} met", flush=True)
                if first == len(cases) or time.monotonic() > end:
                    worker.kill()
                    worker.wait()
                    first = len(cases)
                    break
    print(f"most memory: {most:,} bytes")
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--inputs", type=int, default=100_000)
    parser.add_argument("--minutes", type=float, default=1e6, help="stop then, with what is met")
    parser.add_argument("--kind", choices=KINDS, action="append")
    parser.add_argument("--case", type=int)
    parser.add_argument("--show", type=int, default=1500, help="letters of a fault that are shown")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--corpus", type=Path, help="folder of a corpus, made there if it is empty")
    parser.add_argument("--worker", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    kinds = options.kind or list(KINDS)
    cases = cases_of(options.inputs, kinds) if options.case is None else [(kinds[0], options.case)]
    if options.worker:
        work(options.worker, cases, options.first)
        return
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        root = options.corpus or Path(folder)
        if not (root / "scan").is_dir():
            root.mkdir(parents=True, exist_ok=True)
            make_corpus(root)
        began = time.monotonic()
        counts = watch(root, options, cases)
        seconds = time.monotonic() - began
    for kind in kinds:
        found = {key[1]: number for key, number in sorted(counts.items(), key=str) if key[0] == kind}
        print(
            f"{kind:24} {sum(found.values()):7,} inputs: "
            + ", ".join(f"{number:,} {key}" for key, number in found.items())
        )
    bad = sum(number for (_, how), number in counts.items() if how in ("fault", "hang", "died"))
    print(f"{sum(counts.values()):,} inputs in {seconds:.0f} s, {bad} without a clear answer")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
