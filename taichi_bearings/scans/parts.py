"""Parts of a scan for job arrays: which samples each has, the journals that they leave in one folder, what is missing.

Parts run at the same time on machines that share nothing but the folder, so no part writes what another one writes:
each has a lock and a journal of its own, and the table is made of all journals afterwards.
"""

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from taichi_bearings.errors import InputError
from taichi_bearings.files.scan_file import FAILED
from taichi_bearings.files.scan_journal import JOURNAL_NAME, is_sample, read_journal
from taichi_bearings.plain_files import Json
from taichi_bearings.scans.plan import ScanPlan, groups_of, spheres_of

JOURNAL = re.compile(r"part-[1-9][0-9]{0,5}-of-([1-9][0-9]{0,5})\.jsonl")
MOST_PARTS_OF_SCAN = 100_000


@dataclass(frozen=True)
class Part:
    """One of the parts into which a scan is divided for jobs on different machines.

    of : number of parts.
    number : number of this part, from 1.
    """

    of: int
    number: int

    @staticmethod
    def parse(text: str) -> "Part":
        """Return the part that a text such as "2/5" names; raise InputError if it names none."""
        found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text)
        if found is None or not 1 <= int(found[1]) <= int(found[2]) <= MOST_PARTS_OF_SCAN:
            raise InputError(
                f"--part is {text!r}; it must be i/n with whole numbers 1 <= i <= n <= {MOST_PARTS_OF_SCAN:,}"
            )
        return Part(int(found[2]), int(found[1]))

    def __str__(self) -> str:
        """Return the part as users write it, such as "2/5"."""
        return f"{self.number}/{self.of}"

    @property
    def name(self) -> str:
        """Name of the part in its files, such as "part-2-of-5"."""
        return f"part-{self.number}-of-{self.of}"


def part_numbers(plan: ScanPlan, parts: int) -> dict[str, int]:
    """Return the number of the part to which each sample belongs, by the key of the sample.

    plan : all samples of the scan with their settings.
    parts : number of parts.

    Samples that differ in the seed only are divided evenly among the parts; successive seeds stay together, as they can
    be solved as one block. What cannot be divided evenly goes to the parts in turn, large lattices first, so that all
    parts have similar amounts of work. The order of other entries in the scan file does not matter.
    """
    groups = sorted(groups_of(plan.samples), key=lambda group: (-spheres_of(group[0].settings), group[0].key))
    numbers: dict[str, int] = {}
    for group in groups:
        first = len(numbers)
        for place, indices in enumerate(np.array_split(np.arange(len(group)), min(parts, len(group)))):
            number = (first + place) % parts + 1  # go on with the part after the one that got the last sample
            numbers.update((group[index].key, number) for index in indices)
    return numbers


def part_of(plan: ScanPlan, part: Part | None) -> ScanPlan:
    """Return the plan of one part, with its samples in the order of the plan; the whole plan if `part` is None."""
    if part is None:
        return plan
    numbers = part_numbers(plan, part.of)
    return replace(plan, samples=tuple(sample for sample in plan.samples if numbers[sample.key] == part.number))


def journals_in(folder: Path) -> list[Path]:
    """Return the paths of the journals in the folder of a scan, those of parts before that of the scan itself."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(file for file in files if file.name == JOURNAL_NAME or JOURNAL.fullmatch(file.name))


def journal_bytes(folder: Path) -> int | None:
    """Return the size of all journals in a folder, which only ever grows, in bytes; None if it has no journal."""
    sizes = [file.stat().st_size for file in journals_in(folder) if file.is_file()]
    return sum(sizes) if sizes else None


def read_journals(folder: Path) -> dict[str, Json]:
    """Return the records in all journals of a folder by the key of the sample.

    Of several records of one sample a result is preferred to a failure, then the record with most numbers, then the
    later one.
    """
    records: dict[str, Json] = {}
    for file in journals_in(folder):
        for key, record in read_journal(file, is_sample).items():
            earlier = records.get(key, record)
            # max takes the first of equals: the later record
            records[key] = max(record, earlier, key=lambda one: (not is_failed(one), len(one["scalars"])))
    return records


def is_failed(record: Json) -> bool:
    """Return True if a record says that its sample has no result."""
    found: bool = record["scalars"]["status"] == FAILED
    return found


def is_analysed(record: Json) -> bool:
    """Return True if a record has the numbers of `bearings analyse`."""
    return "power_minimum_cut" in record["scalars"]


def incomplete_parts(plan: ScanPlan, folder: Path, records: Mapping[str, Json]) -> list[Json]:
    """Return the parts that lack samples: for each a dictionary with `part`, as "i/n", and `missing`, how many of its
    samples have no result.

    plan : all samples of the scan.
    folder : folder of the scan; names of its journals say into how many parts the scan is divided. If there are several
        such numbers, the parts of each are looked at.
    records : results of the samples, by key.
    """
    found = []
    for of in sorted({int(match[1]) for file in journals_in(folder) if (match := JOURNAL.fullmatch(file.name))}):
        numbers = part_numbers(plan, of)
        lacking = Counter(number for key, number in numbers.items() if key not in records or is_failed(records[key]))
        found += [{"part": str(Part(of, number)), "missing": many} for number, many in sorted(lacking.items())]
    return found
