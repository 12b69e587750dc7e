"""Arrays by name in one file in the format of safetensors: the length of a header, the header as
JSON, the raw numbers.

Nothing in such a file is ever executed. Everything in it is checked before a number of it is used:
anybody may have written it. The same arrays and words give the same bytes, on which the identity of
a model rests. The package safetensors (0.8) does not promise that: it writes several words in
another order at every call, and orders arrays of one width by their type.

Layout: https://github.com/huggingface/safetensors (8 bytes little-endian, JSON of at most that
many, data without holes).
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

TYPES = {
    "U8": "u1", "I8": "i1", "U16": "<u2", "I16": "<i2", "F16": "<f2",
    "U32": "<u4", "I32": "<i4", "F32": "<f4", "U64": "<u8", "I64": "<i8", "F64": "<f8",
}  # fmt: skip
_NAMES = {np.dtype(code): name for name, code in TYPES.items()}
_WORDS = "__metadata__"
_LONGEST = 64 << 20  # bytes of a header: recipes are long, but not that long
_ALIGNED = 8


def encode(arrays: Mapping[str, np.ndarray], words: Mapping[str, str]) -> bytes:
    """Return the bytes of a file.

    Parameters
    ----------
    arrays : mapping of str to array
        Of the types in `TYPES`.
    words : mapping of str to str
        What there is to say beside them.

    Examples
    --------
    >>> import numpy as np
    >>> data = encode({"a": np.arange(3, dtype=np.uint8)}, {"by": "hand"})
    >>> arrays, words = decode(data)
    >>> arrays["a"].tolist(), words
    ([0, 1, 2], {'by': 'hand'})
    """
    plain = {name: _as_little_endian(array) for name, array in arrays.items()}
    # The widest first, so that every array starts at a multiple of its width.
    order = sorted(plain, key=lambda name: (-plain[name].itemsize, name))
    header: dict[str, Any] = {_WORDS: dict(sorted(words.items()))}
    at = 0
    for name in order:
        array = plain[name]
        header[name] = {
            "dtype": _NAMES[array.dtype],
            "shape": list(array.shape),
            "data_offsets": [at, at + array.nbytes],
        }
        at += array.nbytes
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % _ALIGNED)
    return b"".join(
        [struct.pack("<Q", len(text)), text, *(plain[name].tobytes() for name in order)]
    )


def decode(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return arrays and words of a file's bytes; the arrays are read-only views.

    Raises
    ------
    ValueError
        The bytes are no such file, are cut off, or contradict themselves; the message says where.
    """
    header, start = _header(data)
    words = header.pop(_WORDS, {})
    if not isinstance(words, dict) or not all(isinstance(value, str) for value in words.values()):
        raise ValueError("its metadata are not words")
    body = memoryview(data)[start:]
    entries = {name: _entry(name, entry) for name, entry in header.items()}
    at = 0
    for name, (_, _, first, last) in sorted(entries.items(), key=lambda item: item[1][2:]):
        if first != at:
            raise ValueError(
                f"{name!r} starts at byte {first} where {at} is due: arrays overlap or leave a hole"
            )
        at = last
    if at != len(body):
        what = "it is cut off" if at > len(body) else "something was added at its end"
        raise ValueError(f"its arrays take {at} bytes, {len(body)} are there: {what}")
    return {
        name: np.frombuffer(body[first:last], dtype).reshape(shape)
        for name, (dtype, shape, first, last) in entries.items()
    }, words


def _as_little_endian(array: np.ndarray) -> np.ndarray:
    """Return an array in C order and little-endian, of a type that the format knows."""
    array = np.asarray(array, order="C")
    array = array.astype(array.dtype.newbyteorder("<"), copy=False)
    if array.dtype not in _NAMES:
        raise ValueError(f"arrays of {array.dtype} have no place in a model's file")
    return array


def _header(data: bytes) -> tuple[dict[str, Any], int]:
    if len(data) < 8:
        raise ValueError(f"it has {len(data)} bytes, which is too short for one")
    (length,) = struct.unpack("<Q", data[:8])
    if length > _LONGEST or not data[8:9] == b"{":
        raise ValueError("it does not start as one")
    if length > len(data) - 8:
        raise ValueError(
            f"its header should have {length} bytes, {len(data) - 8} are there: it is cut off"
        )
    try:
        header = json.loads(
            data[8 : 8 + length].decode("utf-8"), object_pairs_hook=_unique, parse_constant=_refuse
        )
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"its header is damaged ({error})") from None
    return header, 8 + length


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("its header names something twice")
    return found


def _refuse(word: str) -> None:
    raise ValueError(f"its header holds {word}, which is no number")


def _entry(name: str, entry: Any) -> tuple[np.dtype, tuple[int, ...], int, int]:
    """Return type, shape, first and last byte of an array."""
    if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
        raise ValueError(f"its header's entry {name!r} is damaged")
    kind = entry["dtype"]
    shape, offsets = entry["shape"], entry["data_offsets"]
    if not isinstance(kind, str) or kind not in TYPES:
        raise ValueError(f"{name!r} is of type {kind!r}, known are {', '.join(TYPES)}")
    if not (_is_whole(shape) and len(shape) <= 32 and _is_whole(offsets) and len(offsets) == 2):
        raise ValueError(f"the shape or place of {name!r} is damaged")
    dtype = np.dtype(TYPES[kind])
    if offsets[1] - offsets[0] != math.prod(shape) * dtype.itemsize:
        raise ValueError(
            f"{name!r} of shape {tuple(shape)} and type {kind} does not fit its place {offsets}"
        )
    return dtype, tuple(shape), offsets[0], offsets[1]


def _is_whole(numbers: Any) -> bool:
    """Return whether a value is a list of whole numbers that a file can have: neither negative nor
    beyond 2**62.
    """
    return isinstance(numbers, list) and all(type(n) is int and 0 <= n < 2**62 for n in numbers)
