"""Philox against its authors' known answers, and what the kernels make of its words."""

import numpy as np
import pytest

from trabecula.core.seeds import key
from trabecula.engine.compile import kernel
from trabecula.engine.random import below, philox

# From the file kat_vectors of Random123 (philox4x32, 10 rounds): counter, key (low word first),
# answer.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


@kernel
def _draw(words, key, start):
    """The four words of each counter (start + i, 2, -1, 0)."""
    for i in range(len(words)):
        a, b, c, d = philox(key, start + i, 2, -1, 0)
        words[i, 0], words[i, 1], words[i, 2], words[i, 3] = a, b, c, d


@kernel
def _histogram(counts, key, draws, lows):
    for i in range(draws):
        words = philox(key, i, 0, 0, 0)
        counts[below(words[0], len(counts))] += 1
        lows[0] = min(lows[0], words[1])
        lows[1] = max(lows[1], words[1])


def drawn(seed_key, start, count):
    words = np.empty((count, 4), np.uint64)
    _draw(words, seed_key, start)
    return words


@pytest.mark.parametrize(("counter", "words", "answer"), KNOWN)
def test_known_answers(counter, words, answer):
    low, high = words
    assert tuple(int(word) for word in philox(np.uint64(high << 32 | low), *counter)) == answer


def test_a_plain_philox_agrees():
    """NumPy has Philox4x64 only, so a plain-integer Philox4x32 stands beside the kernel for
    arbitrary counters.
    """

    def plain(k, counter):
        k0, k1, x = k & 0xFFFFFFFF, k >> 32, list(counter)
        for _ in range(10):
            p0, p1 = 0xD2511F53 * x[0], 0xCD9E8D57 * x[2]
            x = [(p1 >> 32) ^ x[1] ^ k0, p1 & 0xFFFFFFFF, (p0 >> 32) ^ x[3] ^ k1, p0 & 0xFFFFFFFF]
            k0, k1 = (k0 + 0x9E3779B9) & 0xFFFFFFFF, (k1 + 0xBB67AE85) & 0xFFFFFFFF
        return x

    seed_key = key(5, "stage")
    expected = [plain(int(seed_key), (i, 2, 0xFFFFFFFF, 0)) for i in range(100, 150)]
    assert drawn(seed_key, 100, 50).tolist() == expected


def test_numbers_are_a_function_of_the_coordinate():
    seed_key = key(5, "stage")
    whole = drawn(seed_key, 0, 60)
    np.testing.assert_array_equal(
        np.concatenate([drawn(seed_key, a, 20) for a in (0, 20, 40)]), whole
    )
    assert len(np.unique(whole[:, 0])) == 60
    assert not np.isin(drawn(key(6, "stage"), 0, 60), whole).any()
    assert not np.isin(drawn(key(5, "other"), 0, 60), whole).any()


@pytest.mark.parametrize("n", [1, 2, 7, 100])
def test_below_is_uniform(n):
    draws = 40000
    counts, ends = np.zeros(n, np.int64), np.array([2**32, 0], np.uint64)
    _histogram(counts, key(11, "uniform"), draws, ends)
    assert counts.sum() == draws
    expected = draws / n
    chi2 = float(((counts - expected) ** 2 / expected).sum())
    # Mean n - 1, variance 2 (n - 1): five deviations, for numbers that never change.
    assert abs(chi2 - (n - 1)) <= 5 * np.sqrt(2 * max(n - 1, 1))
    assert ends[0] < 2**32 / 5000 and 2**32 - 2**32 / 5000 < ends[1] < 2**32


def test_below_keeps_to_its_range_at_the_ends():
    for n in (1, 3, 2**31 - 1):
        assert below(np.uint64(0), n) == 0
        assert below(np.uint64(2**32 - 1), n) == n - 1
