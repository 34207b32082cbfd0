"""The group /analysis: the structure of a run, in its run.h5 or in a file of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from taichi_bearings.files.whole_file import put, put_attributes, replace_group, write_hdf5

GROUP = "analysis"
FILL = {"b": 0, "i": -1, "u": 255, "f": np.nan}
"""What pads arrays of samples that have not the same length, by kind of number."""


@dataclass(frozen=True)
class Finding:
    """An array of one sample with its unit and what it is."""

    values: np.ndarray
    units: str
    description: str


def write_analysis(
    path: Path, samples: Sequence[Mapping[str, Finding]], attributes: Mapping[str, Any], into_run: bool
) -> None:
    """Write the findings of all samples into the run file `path`, or into a new file that holds nothing else.

    With several samples every array has a leading replica axis, padded where their lengths differ. Attributes that are
    no numbers, texts or lists of these are left out.
    """

    def fill(group: h5py.Group) -> None:
        listed = {key: value if isinstance(value, list) else [value] for key, value in attributes.items()}
        nested = {key for key, parts in listed.items() if any(isinstance(part, (dict, list)) for part in parts)}
        put_attributes(group, {key: value for key, value in attributes.items() if key not in nested})
        for name, finding in samples[0].items():
            values = [sample[name].values for sample in samples]
            together = values[0]
            if len(values) > 1:
                longest = tuple(max(sizes) for sizes in zip(*(array.shape for array in values), strict=True))
                together = np.full((len(values), *longest), FILL[together.dtype.kind], dtype=together.dtype)
                for place, array in zip(together, values, strict=True):
                    place[tuple(slice(0, size) for size in array.shape)] = array
            packed = {"compression": "gzip", "shuffle": True} if together.dtype.kind in "biu" and together.size else {}
            put(group, name, together, finding.units, finding.description, **packed)

    if into_run:
        replace_group(path, GROUP, fill)
    else:
        write_hdf5(path, lambda file: fill(file.create_group(GROUP)))
