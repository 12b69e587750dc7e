"""Files of arrays: the layout as others read it, and every lie that a header can tell."""

import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from trabecula.engine.tensors import TYPES, decode, encode

ARRAYS = {
    "b": np.arange(6, dtype=np.float32).reshape(2, 3),
    "a": np.array([7, 8, 9], np.uint8),
    "c": np.zeros((0, 4), "f8"),
}


def parts(data):
    length = struct.unpack("<Q", data[:8])[0]
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def joined(header, body):
    text = json.dumps(header).encode() if not isinstance(header, bytes) else header
    return struct.pack("<Q", len(text)) + text + body


@pytest.mark.whole
@given(
    st.dictionaries(
        st.text(min_size=1, max_size=8).filter(lambda name: name != "__metadata__"),
        st.sampled_from([np.dtype(code) for code in TYPES.values()]).flatmap(
            lambda dtype: hnp.arrays(
                dtype, hnp.array_shapes(min_dims=0, min_side=0, max_dims=4, max_side=4)
            )
        ),
        max_size=4,
    ),
    st.dictionaries(st.text(max_size=5), st.text(max_size=9), max_size=3),
)
def test_what_is_written_is_read(arrays, words):
    found, said = decode(encode(arrays, words))
    assert said == words and set(found) == set(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and found[name].shape == array.shape
        assert found[name].tobytes() == array.tobytes()


def test_the_layout_is_the_one_that_is_published():
    """By hand: widest first, offsets from the end of the header, which is padded with blanks to a
    multiple of eight.
    """
    data = encode(ARRAYS, {"k": "v"})
    header, body = parts(data)
    assert header["__metadata__"] == {"k": "v"}
    assert header["c"] == {"dtype": "F64", "shape": [0, 4], "data_offsets": [0, 0]}
    assert header["b"] == {"dtype": "F32", "shape": [2, 3], "data_offsets": [0, 24]}
    assert header["a"] == {"dtype": "U8", "shape": [3], "data_offsets": [24, 27]}
    assert body == np.arange(6, dtype="<f4").tobytes() + bytes([7, 8, 9])
    assert (len(data) - len(body)) % 8 == 0


def test_big_endian_and_turned_arrays_are_written_little_endian_in_order():
    turned = np.arange(6, dtype=">i4").reshape(2, 3).T
    found, _ = decode(encode({"x": turned}, {}))
    assert np.array_equal(found["x"], turned) and found["x"].dtype == np.dtype("<i4")


def test_types_without_a_place_are_refused():
    with pytest.raises(ValueError, match="complex128"):
        encode({"x": np.zeros(2, complex)}, {})


def spoilt(name, **changes):
    header, body = parts(encode(ARRAYS, {}))
    header[name] = {**header[name], **changes}
    return joined(header, body)


HEADER, BODY = parts(encode(ARRAYS, {}))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 bytes"),
        (b"1234567", "7 bytes"),
        (b"PK\x03\x04" + bytes(60), "does not start as one"),
        (struct.pack("<Q", 1 << 40) + b"{}", "does not start as one"),
        (struct.pack("<Q", 1000) + b"{}", "header should have 1000 bytes, 2 are there"),
        (joined(b"{'a': 1}", b""), "header is damaged"),
        (joined(b'{"a": \xff}', b""), "header is damaged"),
        (joined(b'{"a":' + b"[" * 20000, b""), "header is damaged"),
        (joined(b'{"a": {}, "a": {}}', b""), "twice"),
        (joined(b'{"a": NaN}', b""), "NaN"),
        (joined({"__metadata__": {"x": 1}}, b""), "metadata"),
        (joined({"a": [1]}, b""), "entry 'a'"),
        (joined({"a": {**HEADER["a"], "more": 1}}, BODY), "entry 'a'"),
        (spoilt("a", dtype="BF17"), "BF17"),
        (spoilt("a", dtype=["U8"]), "of type"),
        (spoilt("a", shape=[-3]), "shape or place of 'a'"),
        (spoilt("a", shape=[3.0]), "shape or place of 'a'"),
        (spoilt("a", shape=[True]), "shape or place of 'a'"),
        (spoilt("a", shape=3), "shape or place of 'a'"),
        (spoilt("a", shape=[2**61, 2**61]), "does not fit its place"),
        (spoilt("a", shape=[4]), "does not fit its place"),
        (spoilt("a", data_offsets=[24]), "shape or place"),
        (spoilt("a", data_offsets=[27, 24]), "does not fit its place"),
        (spoilt("a", data_offsets=[25, 28]), "hole"),
        (spoilt("a", data_offsets=[20, 23]), "overlap"),
        (encode(ARRAYS, {})[:-1], "cut off"),
        (encode(ARRAYS, {}) + b"x", "added at its end"),
    ],
)
def test_a_damaged_file_says_where(data, words):
    with pytest.raises(ValueError, match=words):
        decode(data)


@given(st.integers(0, 10**6), st.integers(0, 255))
def test_any_changed_byte_is_read_as_something_or_refused_as_damaged(place, byte):
    data = bytearray(encode(ARRAYS, {"k": "v"}))
    data[place % len(data)] = byte
    try:
        found, _ = decode(bytes(data))
    except ValueError:
        return
    assert all(isinstance(array, np.ndarray) for array in found.values())
    assert sum(array.nbytes for array in found.values()) == len(BODY)
