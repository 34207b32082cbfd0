"""Dumps and tables torn, shuffled and garbled: each is read as the arrays say, or as the timestep before with a word of
that, or refused in one sentence. None is silently wrong."""

import bz2
import gzip
import lzma
import re

import numpy as np
import pytest

import taichi_bearings as tb
from tests.scenes import some_of

COLUMNS = ("c_pair[1]", "c_pair[2]", "c_force")
PACK = {"": lambda content: content, ".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}


def block(rng):
    """A pressed cubic block: centres, contacts, forces and types, 2 at the bottom and 3 on top."""
    grid = np.stack(np.meshgrid(*map(np.arange, (3, 2, 4)), indexing="ij"), -1).reshape(-1, 3).astype(float)
    center = grid * 0.998 + rng.uniform(-1e-3, 1e-3, grid.shape)
    pairs = [(i, j) for i in range(24) for j in range(i + 1, 24) if abs(np.abs(grid[i] - grid[j]).sum() - 1) < 1e-9]
    kind = np.where(grid[:, 2] == 0, 2, np.where(grid[:, 2] == 3, 3, 1))
    return center, np.array(pairs), kind


def shuffled(rng, rows, names):
    """Lines of a table with its rows and columns in any order, and the header."""
    order, columns = rng.permutation(len(rows)), rng.permutation(len(names))
    return [" ".join(rows[i][k] for k in columns) for i in order], " ".join(names[k] for k in columns)


def dumps(rng, frames):
    """Texts of both dumps. frames : (step, centres, contacts, forces, types) of each."""
    texts = ["", ""]
    form = rng.choice(["{!r}", "{:.15e}", "{:.15E}"])
    printed = lambda value: form.format(float(value))  # noqa: E731
    if rng.random() < 0.3:  # as Fortran does
        printed = lambda value: f"{float(value):.16e}".replace("e", "D")  # noqa: E731
    ids = rng.choice(10**6, 24, replace=False) + 1
    for step, center, pairs, force, kind in frames:
        low, high = center.min(axis=0) - 1, center.max(axis=0) + 1
        place, names = center, ["x", "y", "z"]
        if rng.random() < 0.3:
            place, names = (center - low) / (high - low), ["xs", "ys", "zs"]
        box = "ITEM: BOX BOUNDS ff ff ff\n" + "".join(
            f"{a!r} {b!r}\n" for a, b in zip(low.tolist(), high.tolist(), strict=True)
        )
        head = f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF {{}}\n{{}}\n{box}ITEM: {{}} "
        rows = [[str(i), str(k), *map(printed, c), "0.5"] for i, k, c in zip(ids, kind, place, strict=True)]
        lines, header = shuffled(rng, rows, ["id", "type", *names, "radius"])
        texts[0] += head.format("ATOMS", len(rows), "ATOMS") + header + "\n" + "\n".join(lines) + "\n"
        rows = [[str(ids[i]), str(ids[j]), printed(f)] for (i, j), f in zip(pairs, force, strict=True)]
        lines, header = shuffled(rng, rows, list(COLUMNS))
        texts[1] += head.format("ENTRIES", len(rows), "ENTRIES") + header + "\n" + "\n".join(lines) + "\n"
    return texts, ids


def garbled(rng, text):
    """A text that has suffered, and what it was."""
    kind = rng.choice(["whole", "cut", "cut", "cut", "line end", "byte", "row lost", "number", "nan", "huge id"])
    lines = text.splitlines(keepends=True)
    own = int(rng.integers(len(lines)))
    if kind == "cut":
        return text[: int(rng.integers(len(text)))], kind
    if kind == "line end":
        return text[:-1], kind
    if kind == "row lost":
        return "".join(lines[:own] + lines[own + 1 :]), kind
    word = {"byte": "~", "number": "1.2.3", "nan": rng.choice(["nan", "inf", "-inf"]), "huge id": "1" + "0" * 30}.get(
        kind
    )
    if word is None:
        return text, kind
    parts = re.split(r"(\s+)", lines[own])
    parts[2 * int(rng.integers(len(parts) // 2))] = word
    return "".join([*lines[:own], "".join(parts), *lines[own + 1 :]]), kind


def written(rng, folder, name, text):
    """The path of a file of this text, perhaps packed, with other ends of lines, or with a mark of the byte order."""
    content = text.replace("\n", "\r\n") if rng.random() < 0.2 else text
    content = b"\xef\xbb\xbf" * (rng.random() < 0.2) + content.encode()
    ending = rng.choice(["", "", *PACK])
    content = PACK[ending](content)
    if ending and rng.random() < 0.3:
        content = content[: int(rng.integers(1, len(content)))]
    path = folder / f"{name}{ending}"
    path.write_bytes(content)
    return path


def as_known(packing, center, pairs, force, order):
    """Whether a packing is what the arrays say. order : number of each sphere of the arrays in the packing."""
    place = np.argsort(order)
    if packing.spheres != len(center) or not np.allclose(packing.center, center[place], rtol=0, atol=1e-12):
        return False
    known = {tuple(sorted((order[i], order[j]))): f for (i, j), f in zip(pairs.tolist(), force.tolist(), strict=True)}
    found = {tuple(sorted(c)): f for c, f in zip(packing.contact.tolist(), packing.normal_force.tolist(), strict=True)}
    return found.keys() == known.keys() and all(abs(found[c] / known[c] - 1) < 1e-12 for c in known)


def read_or_refused(read, may_fail):
    """The packing; None if it is refused in one sentence, which a whole file must not be."""
    try:
        return read()
    except tb.InputError as error:
        words = str(error)
    assert words
    assert "\n" not in words
    assert may_fail, words
    return None


@pytest.mark.parametrize("seed", some_of(500, 8))
def test_torn_dumps_are_read_rightly_or_as_the_frame_before_or_refused(seed, tmp_path, caplog):
    rng = np.random.default_rng([50, seed])
    frames = []
    for step in (1000, 2000):
        center, pairs, kind = block(rng)
        frames.append((step, center, pairs, rng.uniform(0.2, 3, len(pairs)), kind))
    texts, ids = dumps(rng, frames)
    own, order = int(rng.integers(2)), np.argsort(np.argsort(ids))
    texts[own], how = garbled(rng, texts[own])
    paths = [written(rng, tmp_path, name, text) for name, text in zip(("atoms", "contacts"), texts, strict=True)]
    spin = {0: (0, 0, 0), 1: (0.3, 1, 0)}
    may_fail = how != "whole" or any(path.suffix for path in paths)
    read = lambda: tb.Packing.from_lammps(*paths, COLUMNS, driven_types={2: 0, 3: 1}, spin=spin)  # noqa: E731
    packing = read_or_refused(read, may_fail)
    if packing is None:
        return
    first, last = (as_known(packing, *frame[1:4], order) for frame in frames)
    assert last or (first and "1000 is read instead" in caplog.text), how


def table(rng, rows, names):
    """Lines of a table with its rows as they are and its columns in any order."""
    columns, mark = rng.permutation(len(names)), rng.choice([",", ", ", ";", "\t"])
    lines = [mark.join(row[k] for k in columns) for row in [names, *rows]]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("seed", some_of(500, 8))
def test_torn_tables_are_read_rightly_or_refused(seed, tmp_path):
    rng = np.random.default_rng([51, seed])
    center, pairs, kind = block(rng)
    order = rng.permutation(len(center))
    center, kind, number = center[order], kind[order], np.argsort(order)
    body = np.where(kind == 2, 0, np.where(kind == 3, 1, -1))
    rows = [[repr(x) for x in c] + ["0.5", str(b)] for c, b in zip(center.tolist(), body, strict=True)]
    text, how = garbled(rng, table(rng, rows, ["x", "y", "z", rng.choice(["radius", "r"]), "driven"]))
    path = written(rng, tmp_path, "centres.csv", text)
    packing = read_or_refused(lambda: tb.Packing.load(path, tolerance=0.01), how != "whole" or path.suffix != ".csv")
    if packing is None:
        return
    kept = packing.spheres == len(center)
    if not kept:  # no table says how many rows it has, so one that lacks whole rows is another table
        assert how == "row lost" or (how == "cut" and text.endswith("\n"))
        assert packing.spheres == len(text.splitlines()) - 1
    if kept:
        assert np.array_equal(packing.center, center)
        assert {tuple(sorted(c)) for c in packing.contact.tolist()} == {tuple(sorted(number[c])) for c in pairs}
        assert np.array_equal(packing.driven, body)
