"""Ways to damage a file: each takes a generator of random numbers and the folder of a whole one."""

import gzip
import io
import json
import os
import re
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

LIES = [-1, 0, 1, 2, 255, 256, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 10**5, 10**9]
LIES += [2**62, 2**63 - 1, 2**63, 2**64 - 1, 10**30]
WORDS = ["", "nan", "-nan", "inf", "1e999", "-1", "-0.0", "0x10", "1_000", "9" * 5000, "None"]
WORDS += ["../../etc/passwd", "/etc/passwd", "/dev/zero", "..", "C:\\x", "LIST", "%s", "\0", "é"]
WORDS += ["<", "&lol;", "True", "false", "object", ">f8", "O", "complex128", "[]", "{}", "..." * 99]
PLAIN = [None, True, -1, 0, 0.5, 1e308, 10**40, "", "x", "../x", [], {}, [[]], {"x": None}]
PLAIN += [float("nan"), float("inf"), [1e308] * 3, [-1, 2, 3], [10**6] * 3, ["zyx"], "9" * 5000]
DEEP = 100_000

Damage = Callable[[np.random.Generator, Path], Path]


def deep(rng: np.random.Generator) -> str:
    """Return JSON nested beyond any parser's patience."""
    return rng.choice(["[" * DEEP, "[" * DEEP + "]" * DEEP, '{"a":' * DEEP, "(" * DEEP])


# --- bytes -------------------------------------------------------------------------------------


def _place(rng: np.random.Generator, size: int) -> int:
    """Choose a byte: half of them in the header, some at the end."""
    if size == 0:
        return 0
    where = rng.random()
    if where < 0.5:
        return int(rng.integers(min(size, 512)))
    return int(rng.integers(max(0, size - 256), size) if where > 0.85 else rng.integers(size))


def truncate(rng: np.random.Generator, data: bytes) -> bytes:
    """Cut the end off."""
    return data[: _place(rng, len(data))]


def flip(rng: np.random.Generator, data: bytes) -> bytes:
    """Flip 1 to 16 bits."""
    changed = bytearray(data)
    for _ in range(int(2 ** rng.integers(0, 5)) if changed else 0):
        changed[_place(rng, len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def overwrite(rng: np.random.Generator, data: bytes) -> bytes:
    """Write zeros, ones or noise over a run of bytes."""
    at, length = _place(rng, len(data)), int(2 ** rng.integers(0, 8))
    fill = [b"\0" * length, b"\xff" * length, rng.bytes(length)][int(rng.integers(3))]
    return data[:at] + fill + data[at + length :]


def shift(rng: np.random.Generator, data: bytes) -> bytes:
    """Remove, insert or repeat a run of bytes."""
    at, length = _place(rng, len(data)), int(2 ** rng.integers(0, 8))
    way = int(rng.integers(3))
    middle = [b"", rng.bytes(length) + data[at:], data[at : at + length] + data[at:]][way]
    return data[:at] + (data[at + length :] if way == 0 else middle)


def number(rng: np.random.Generator, data: bytes) -> bytes:
    """Let a binary number of the header lie."""
    kind = rng.choice(["<H", ">H", "<I", ">I", "<Q", ">Q"])
    width = struct.calcsize(kind)
    at = int(rng.integers(0, max(1, min(len(data), 600) - width) // 2 + 1)) * 2
    value = LIES[int(rng.integers(len(LIES)))] % 2 ** (8 * width)
    return data[:at] + struct.pack(kind, value) + data[at + width :]


def turn(rng: np.random.Generator, data: bytes) -> bytes:
    """Turn a number, or what says so, into the other byte order."""
    pairs = [(b"II", b"MM"), (b"MM", b"II"), (b"'<", b"'>"), (b"'>", b"'<"), (b"False", b"True")]
    pairs += [(b"little", b"big"), (b"big", b"little"), (b"Little", b"Big"), (b"Big", b"Little")]
    there = [pair for pair in pairs if pair[0] in data]
    if there and rng.random() < 0.5:
        return data.replace(*there[int(rng.integers(len(there)))], 1)
    width, at = int(2 ** rng.integers(1, 4)), _place(rng, len(data)) // 4 * 4
    return data[:at] + data[at : at + width][::-1] + data[at + width :]


def nan(rng: np.random.Generator, data: bytes) -> bytes:
    """Write a number that is none, or is beyond any, over the voxels or the text."""
    kind = rng.choice(["<f", ">f", "<d", ">d"])
    value = float(rng.choice([np.nan, np.inf, -np.inf, 1e38, 1e-40]))
    at = int(rng.integers(max(1, len(data)))) // 4 * 4
    packed = struct.pack(kind, value)
    return data[:at] + packed + data[at + len(packed) :]


def digits(rng: np.random.Generator, data: bytes) -> bytes:
    """Let a number in text lie."""
    value = str(LIES[int(rng.integers(len(LIES)))]) if rng.random() < 0.6 else None
    return _replace(rng, data, rb"-?\d+(?:\.\d+)?", value)


def words(rng: np.random.Generator, data: bytes) -> bytes:
    """Put another word in the place of one."""
    return _replace(rng, data, rb"[A-Za-z_./-]{2,}", None)


def _replace(rng: np.random.Generator, data: bytes, pattern: bytes, text: str | None) -> bytes:
    """Replace a match near the start; by one as long as it, half of the time."""
    found = list(re.finditer(pattern, data[:20_000]))
    if not found:
        return overwrite(rng, data)
    match = found[int(len(found) * rng.random() ** 2)]
    new = (WORDS[int(rng.integers(len(WORDS)))] if text is None else text).encode()
    if rng.random() < 0.5:
        new = new[: len(match[0])].ljust(len(match[0]))
    return data[: match.start()] + new + data[match.end() :]


def lines(rng: np.random.Generator, data: bytes) -> bytes:
    """Remove, repeat or exchange lines."""
    parts = data.split(b"\n")
    a, b = (int(len(parts) * rng.random() ** 2) for _ in range(2))
    way = int(rng.integers(3))
    if way == 0:
        del parts[a]
    elif way == 1:
        parts[a:a] = [parts[b]] * int(rng.choice([1, 3, 1000]))
    else:
        parts[a], parts[b] = parts[b], parts[a]
    return b"\n".join(parts)


def plain_json(rng: np.random.Generator, data: bytes) -> bytes:
    """Change a value of the JSON in a file, wherever it is."""
    start = data.find(b'{"')
    start = data.find(b"{") if start < 0 else start
    try:
        text = data[start:].decode("latin-1")
        whole, length = json.JSONDecoder().raw_decode(text)
    except ValueError:
        return words(rng, data)
    _change(rng, whole)
    new = json.dumps(whole).encode("latin-1")
    if rng.random() < 0.7:
        new = new.ljust(length)
    return data[:start] + new + data[start + length :]


def _change(rng: np.random.Generator, place: object) -> None:
    """Put something else, or nothing, somewhere into plain JSON."""
    while isinstance(place, dict | list) and place:
        names = list(place) if isinstance(place, dict) else range(len(place))
        name = names[int(rng.integers(len(names)))]
        inside = place[name]
        if isinstance(inside, dict | list) and inside and rng.random() < 0.75:
            place = inside
            continue
        way = rng.random()
        if way < 0.2:
            del place[name]
        elif way < 0.5 and isinstance(inside, int | float):
            place[name] = LIES[int(rng.integers(len(LIES)))]
        else:
            place[name] = PLAIN[int(rng.integers(len(PLAIN)))]
        return


def deep_json(rng: np.random.Generator, data: bytes) -> bytes:
    """Nest the JSON of a file, or all of it, deeper than a parser goes."""
    start, text = data.find(b'{"'), deep(rng).encode()
    if start < 0 or rng.random() < 0.3:
        return text
    colon = data.find(b":", start + int(rng.integers(200)))
    return data[: colon + 1] + text + (data[colon + 1 :] if rng.random() < 0.5 else b"")


def empty(rng: np.random.Generator, data: bytes) -> bytes:
    """Leave nothing, or next to nothing."""
    return [b"", b"\0", b"\n", b" " * 100, b"\xff\xfe", b"\0" * 5000][int(rng.integers(6))]


BYTES = {
    "truncated": truncate,
    "bits": flip,
    "overwritten": overwrite,
    "shifted": shift,
    "number": number,
    "byte order": turn,
    "NaN": nan,
    "digits": digits,
    "words": words,
    "lines": lines,
    "JSON": plain_json,
    "deep JSON": deep_json,
    "empty": empty,
}


# --- packing -----------------------------------------------------------------------------------


def inside(
    rng: np.random.Generator, data: bytes, change: Callable[[np.random.Generator, bytes], bytes]
) -> bytes:
    """Change what is packed in a file and pack it again, so that sums of checks hold."""
    if data[:2] == b"\x1f\x8b":
        return gzip.compress(change(rng, gzip.decompress(data)), 1, mtime=0)
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _inside_png(rng, data, change)
    if data[:2] == b"PK":
        return _inside_zip(rng, data, change)
    return change(rng, data)


def _inside_png(rng: np.random.Generator, data: bytes, change: Callable) -> bytes:
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append(data[at + 4 : at + 8 + length])
        at += 12 + length
    number = int(rng.integers(len(chunks)))
    chunk = chunks[number]
    if chunk[:4] == b"IDAT" and rng.random() < 0.5:
        chunks[number] = b"IDAT" + zlib.compress(change(rng, zlib.decompress(chunk[4:])))
    else:
        chunks[number] = chunk[:4] + change(rng, chunk[4:])
    return data[:8] + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in chunks
    )


def _inside_zip(rng: np.random.Generator, data: bytes, change: Callable) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(packed, "w") as new:
        names = old.namelist()
        chosen = names[int(rng.integers(len(names)))]
        for name in names:
            text = old.read(name)
            if name == chosen:
                text = change(rng, text)
                if rng.random() < 0.1:
                    name = str(rng.choice(["../" + name, "/tmp/" + name, "", name.upper()]))
            new.writestr(zipfile.ZipInfo(name), text)
    return packed.getvalue()


# --- files -------------------------------------------------------------------------------------


def files_of(path: Path) -> list[Path]:
    """Return the files of a specimen, in their order."""
    return sorted(file for file in path.parent.rglob("*") if file.is_file())


def of_bytes(change: Callable[[np.random.Generator, bytes], bytes]) -> Damage:
    """Return the damage of one file that changes its bytes, packed ones half of the time."""

    def apply(rng: np.random.Generator, path: Path) -> Path:
        files = files_of(path)
        # As often the file that is read as one beside it.
        file = path if path.is_file() and rng.random() < 0.5 else files[rng.integers(len(files))]
        data = file.read_bytes()
        new = inside(rng, data, change) if rng.random() < 0.5 else change(rng, data)
        file.write_bytes(new)
        return path

    return apply


def rename(rng: np.random.Generator, path: Path) -> Path:
    """Give a file another format's suffix."""
    from trabecula.io.formats import suffixes
    from trabecula.mesh.formats import READABLE

    known = [*suffixes(), *READABLE, "", ".gz", ".TIF", ".tif.part"]
    new = path.with_name("y" + str(rng.choice(known)))
    path.rename(new)
    return new


def lose(rng: np.random.Generator, path: Path) -> Path:
    """Remove one of the files."""
    files = files_of(path)
    files[rng.integers(len(files))].unlink()
    return path


def exchange(rng: np.random.Generator, path: Path) -> Path:
    """Put a folder, a link, a pipe or a device in the place of a file."""
    files = [*files_of(path), path]
    file = files[rng.integers(len(files))]
    way = int(rng.integers(7))
    aside = file.with_name("aside")
    file.rename(aside)
    if way == 0:
        file.mkdir()
    elif way == 1:
        file.symlink_to("nowhere")
    elif way == 2:
        file.symlink_to(file.name)
    elif way == 3:
        file.symlink_to("/dev/zero")
    elif way == 4:
        os.mkfifo(file)
    elif way == 5:
        file.symlink_to("..")
    else:
        file.symlink_to("aside")
    return path


def crowd(rng: np.random.Generator, path: Path) -> Path:
    """Put strange files among those of a folder, or beside a file."""
    folder = path if path.is_dir() else path.parent
    folders = [folder, *sorted(place for place in folder.rglob("*") if place.is_dir())]
    place = folders[rng.integers(len(folders))]
    for name in rng.choice(["x.json", "zarr.json", ".zattrs", "a.png", "c", "0.tif"], 2):
        if not (place / name).exists():
            (place / name).write_bytes(rng.bytes(40))
    files = files_of(path)
    shutil.copy(files[rng.integers(len(files))], place / "slice_9.png")
    return path


DAMAGES: dict[str, Damage] = {
    **{name: of_bytes(change) for name, change in BYTES.items()},
    "other suffix": rename,
    "file lost": lose,
    "other sort": exchange,
    "crowded": crowd,
}
