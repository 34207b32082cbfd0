"""Good files made bad: bytes, and the things that HDF5, npz, TOML and journals hold."""

import contextlib
import io
import json
import random
import warnings
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np

from taichi_bearings.checksums import ATTRIBUTE, seal


def bytes_changed(content: bytes, draw: random.Random) -> bytes:
    """Cut, flipped, zeroed, overwritten, moved or doubled."""
    changed = bytearray(content)
    if not changed:
        return draw.randbytes(100)
    place, size = draw.randrange(len(changed)), int(2 ** draw.uniform(0, 13))
    there = len(changed[place : place + size])
    match draw.randrange(7):
        case 0:
            return content[:place]
        case 1:
            for _ in range(draw.choice([1, 2, 5, 20])):
                changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
        case 2:
            changed[place : place + size] = bytes(there)
        case 3:
            changed[place : place + size // 64 + 1] = draw.randbytes(len(changed[place : place + size // 64 + 1]))
        case 4:
            width = draw.choice([1, 2, 4, 8])
            changed[place : place + width] = draw.choice(
                [b"\xff" * width, (2 ** draw.randrange(8 * width)).to_bytes(width, "little")]
            )
        case 5:
            other = draw.randrange(len(changed))
            changed[other : other + there] = changed[place : place + there]
        case 6:
            changed[place:place] = changed[place : place + there]
    return bytes(changed)


TEXTS = [
    "", "\x00", "é€\U0001f600", "\x1b[31m", "a" * 70_000, "nan", "../../x", "[" * 3000, "coulomb", "certified", "[1, 2",
]  # fmt: skip


def hdf5_changed(path: Path, draw: random.Random, elsewhere: Path) -> None:
    """Change what a file holds, with the means of HDF5. elsewhere : another HDF5 file."""
    with h5py.File(path, "r+") as file:
        for _ in range(draw.choice([1, 1, 1, 2, 5])):
            items = _items(file)
            with contextlib.suppress(
                ValueError, OSError, KeyError, TypeError, RuntimeError
            ):  # HDF5 refuses to write it
                if draw.random() < 0.5:
                    _attribute_changed(file if draw.random() < 0.7 else draw.choice(items), draw)
                else:
                    _thing_changed(file, draw.choice(items[1:] or items), draw, elsewhere)
        items = _items(file)
        match draw.randrange(4):
            case 0 | 1:
                file.attrs.pop(ATTRIBUTE, None)
            case 2:
                try:
                    file.attrs.pop(ATTRIBUTE, None)
                    if not any(isinstance(item, h5py.Dataset) and (item.size or 0) > 10**7 for item in items):
                        seal(file)
                except Exception:  # some of this cannot be summed up
                    file.attrs.pop(ATTRIBUTE, None)


def _items(file: h5py.File) -> list[h5py.HLObject]:
    found: list[h5py.HLObject] = [file]
    file.visititems(lambda _, item: found.append(item))
    return found


def _attribute_changed(item: h5py.HLObject, draw: random.Random) -> None:
    name = draw.choice([*item.attrs, "schema_version", "schema", "shape", "scene", "sha256", "findings", "columns"])
    if draw.random() < 0.2:
        item.attrs.pop(name, None)
        return
    old = item.attrs[name] if name in item.attrs and draw.random() < 0.3 else None
    if isinstance(old, str) and old:
        place = draw.randrange(len(old))
        item.attrs[name] = old[:place] + draw.choice([*TEXTS, "=", "\n", "9", '"']) + old[place + draw.randrange(3) :]
        return
    item.attrs.pop(name, None)
    item.attrs[name] = draw.choice([*STRANGE, item.ref])


STRANGE = [
    *TEXTS[:1], *TEXTS[2:], np.bytes_(b"\xff\xfe"), 0, -1, 2, 10**18, np.nan, np.inf, -1e308, 1e-320, True, 1j,
    np.zeros(0), np.zeros((2, 2)), [3, 4], [3, 4, 5], [10**9] * 3, [-4, 5], [4.5, 5.5], ["a", "b"], np.zeros(2000),
    np.uint64(2**64 - 1), np.array([1, 2], dtype=">i8"), h5py.Empty("f8"), h5py.Empty("S4"),
]  # fmt: skip
VALUES = [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e308, 1e-320, 57, 3.0, 1e18]
KINDS = ["f4", ">f8", "f2", "i8", "u1", ">i4", "c16", "S10", "?", "V8", [("a", "f8"), ("b", "i4")], "u8"]


def _thing_changed(file: h5py.File, item: h5py.HLObject, draw: random.Random, elsewhere: Path) -> None:
    """Another thing in the place of a data set or group."""
    name, parent = item.name, item.parent
    is_read = isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub" and (item.size or 0) < 10**7
    old = item[()] if is_read else np.ones((3, 4))
    shape, choice = old.shape, draw.randrange(17)
    if choice == 0 and old.size:
        changed = np.array(old)
        changed.flat[draw.randrange(old.size)] = 1
        with np.errstate(all="ignore"):
            changed.flat[draw.randrange(old.size)] = np.asarray(draw.choice(VALUES)).astype(old.dtype)
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiub":
            item[...] = changed
        return
    if name == "/":
        return
    del file[name]
    match choice:
        case 1:
            parent.create_group(name)
        case 2:
            parent[name] = h5py.Empty(draw.choice(["f8", "i4", "S3"]))
        case 3:
            parent[name] = draw.choice([1.0, "text", np.int64(3), True])
        case 4 | 5:
            with np.errstate(all="ignore"):
                kind = np.dtype(draw.choice(KINDS))
                parent[name] = np.zeros(shape, dtype=kind) if kind.kind in "VS" else old.astype(kind)
        case 6:
            other = [n + draw.choice([-1, 0, 0, 1, 1]) for n in shape]
            parent[name] = np.resize(
                old, draw.choice([shape[::-1], (1, *shape), shape[1:], (0, *shape[1:]), [max(n, 0) for n in other]])
            )
        case 7:
            parent.create_dataset(
                name,
                shape=tuple(10 ** draw.randrange(3, 7) for _ in shape),
                dtype="f8",
                chunks=tuple(10 for _ in shape),
            )
        case 8:
            parent.create_dataset(name, data=np.zeros(draw.choice([10**5, 10**6])), compression="gzip", chunks=(10**5,))
        case 9:
            parent.create_dataset(name, data=["text"] * max(int(np.prod(shape)), 1), dtype=h5py.string_dtype())
        case 10:
            parent[name] = h5py.SoftLink(draw.choice(["/", name, "/nowhere", "/spin", parent.name]))
        case 11:
            parent[name] = h5py.ExternalLink(str(elsewhere), draw.choice([name, "/"]))
        case 12:
            parent[name] = draw.choice([file, parent])
        case 13:
            parent.create_dataset(name, data=np.array([file.ref], dtype=h5py.ref_dtype))
        case 14:
            parent.create_dataset(name, shape=(64,), dtype="f8", external=[(str(elsewhere), 0, 512)])
        case 15:
            layout = h5py.VirtualLayout(shape=(4, 5), dtype="f8")
            layout[...] = h5py.VirtualSource(str(elsewhere), "spin", shape=(4, 5))
            parent.create_virtual_dataset(name, layout)
        case _:
            pass


def npz_made(draw: random.Random, good: bytes) -> bytes:
    """An npz file: strange arrays under the names that are looked for, or bytes changed."""
    if draw.random() < 0.5:
        return bytes_changed(good, draw)
    whole = io.BytesIO()
    warnings.filterwarnings("ignore", "Duplicate name", UserWarning)
    with zipfile.ZipFile(whole, "w", draw.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])) as file:
        for name, shape in (("x", (3, 5)), ("y", (4, 4)), ("spin", (4, 5))):
            file.writestr(f"{draw.choice([name, name, name, 'X', '../x'])}.npy", npy_made(draw, shape))
    return whole.getvalue()


def npy_made(draw: random.Random, shape: tuple[int, ...]) -> bytes:
    """An array as npy: a good one, one of another kind, a header that lies, or a bomb."""
    whole = io.BytesIO()
    match draw.randrange(7):
        case 0:
            np.save(whole, np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
        case 1:
            np.save(whole, np.zeros(shape, dtype=draw.choice(KINDS)))
        case 2:
            np.save(whole, np.asfortranarray(np.full(shape, 0.5)))
        case 3:
            claim = {
                "descr": draw.choice(["<f8", "|O", "<f8, <f8", "|V0", "|S1000000"]),
                "fortran_order": False,
                "shape": draw.choice([(10**12,), (10**6, 10**6), (-4, 5), (), (2**63,), (4, 5)]),
            }
            np.lib.format.write_array_header_1_0(whole, claim)
        case 4:
            text = draw.choice(
                [b"{" * 5000, b"[" * 9000, b"__import__('os').abort()", b"\x00" * 50, b"{'shape': (1,)}"]
            )
            whole.write(
                b"\x93NUMPY"
                + draw.choice([b"\x01\x00", b"\x02\x00", b"\x03\x00"])
                + len(text).to_bytes(2, "little")
                + text
            )
        case 5:
            np.save(whole, np.zeros(draw.choice([10, 10**6])))
        case 6:
            np.save(whole, np.full(shape, draw.choice([0.5, 0.0, np.nan, -1.0, 1e300])))
    return whole.getvalue()


TOML = [
    "nan", "inf", "-inf", "1e400", "-0.0", "0", "-1", "2", "true", "[]", "{}", "[[]]", "[1, [2]]", "{ a = 1 }", '""',
    '"\\u0000"', '"a\\nb"', "'''x'''", "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "9" * 30, "9" * 5000,
    "0x" + "f" * 5000, "0xffffffffffffffff", "[" * 3000, "[" * 90 + "]" * 90, "{ start = 0, stop = 3 }",
    "{ start = 0, stop = 1e308 }", "{ start = 0, stop = 9223372036854775807 }",
    "{ start = -1e308, stop = 1e308, step = 1e-308 }", "{ start = 0, stop = 3, step = 0 }",
    "{ start = 1, stop = 2, number = 5000001 }", "{ start = 1, stop = 2, number = 3, spacing = 'log' }",
    "{ start = nan, stop = 1 }", "{ start = 0, stop = 3, number = 0x7fffffffffffffff }", "[1, 2, 3]", "[1, 1]",
    "['a', 'b']", "[1, 'a', true]", '"random"', '"coulomb"', '"nowhere.npz"', '"/dev/zero"', '"/"',
    '"../../etc/passwd"', '"' + "x" * 300 + '"', "[3, 4]", "[100000, 100000, 100000]", '"uniform:0.1,1.0"',
    '"uniform:nan,inf"',
    '"constant:1e999"', '"bimodal:1,2,0.5,6"', '"log:1e-4,10,50"', '"linear:0,1,1e18"', "1e-300", "3.5",
]  # fmt: skip


LINES = [
    "[scan]", "[[scan.zip]]", "[a.b.c]", "scan = 3", "[scan.zip]", "a.b.c = 1", "out = 3", "force = true",
]  # fmt: skip


def toml_changed(text: str, keys: list[str], draw: random.Random) -> str:
    """Lines with other values, other keys, or other letters."""
    lines = text.splitlines()
    for _ in range(draw.choice([1, 1, 2, 3, 6])):
        place = draw.randrange(len(lines) + 1)
        match draw.randrange(6):
            case 0 | 1:
                lines.insert(place, f"{draw.choice(keys)} = {draw.choice(TOML)}")
            case 2 if place < len(lines):
                lines[place] = f"{lines[place].partition('=')[0]} = {draw.choice(TOML)}"
            case 3 if place < len(lines):
                at, letter = draw.randrange(len(lines[place]) + 1), draw.choice("\"[]{}=\n\x00\x07\x1b.,#\\é9e-_'")
                lines[place] = lines[place][:at] + letter + lines[place][at + draw.randrange(2) :]
            case 4:
                lines.insert(place, draw.choice(LINES))
            case 5 if place < len(lines):
                del lines[place]
    return "\n".join(lines)


def line_of(text: bytes) -> bytes:
    """A line of a journal whose checksum is right."""
    return b'{"crc32": "%08x", "sample": ' % zlib.crc32(text) + text + b"}\n"


def journal_changed(content: bytes, draw: random.Random) -> bytes:
    """Torn and changed lines, and lines whose checksum is right but whose content is not."""
    if draw.random() < 0.4:
        return bytes_changed(content, draw)
    lines = content.splitlines(keepends=True)
    for _ in range(draw.choice([1, 2])):
        place = draw.randrange(len(lines))
        try:
            record = json.loads(lines[place])["sample"]
            record["scalars"], record["bins"]
        except (ValueError, KeyError, TypeError, RecursionError):  # it is changed already
            continue
        part = draw.choice([part for part in (record, record["scalars"], record["bins"]) if isinstance(part, dict)])
        part[draw.choice([*part, "0", "key", "status"])] = draw.choice(
            [None, 3, -1, 2**70, 1e308, True, "text", "\x1b\n", [], {}, {"a": {}}, "x" * 100_000, "failed", "certified"]
        )
        if draw.random() < 0.2 and isinstance(record["bins"], dict):
            record["bins"][draw.choice(["1000000000000", "-99999", "a", "1.5", ""])] = 1
        text = json.dumps(record).encode()
        if draw.random() < 0.1:
            text = draw.choice([b"[" * 5000, b"9" * 5000, b"null", b"NaN", b"[]", b'"key"', text + b" " * 10**6])
        lines[place] = line_of(text)
    return b"".join(lines)


def claiming(file: Path, kind: str, shape: tuple[int, ...]) -> Path:
    """A file of an array, npy or npz as it is named, that is nothing but its header."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": kind, "fortran_order": False, "shape": shape})
    if file.suffix == ".npy":
        file.write_bytes(header.getvalue())
    else:
        with zipfile.ZipFile(file, "w") as stored:
            stored.writestr("spin.npy", header.getvalue())
    return file
