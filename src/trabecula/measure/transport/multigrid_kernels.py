"""Steps of the multigrid cycle, and the aggregates and matrix of its next level; see `multigrid`."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel


@kernel
def apply(matrix, right):
    x = np.zeros(len(right), np.float32)
    for i in range(len(right)):
        total = 0.0
        for j in range(len(right)):
            total += matrix[i, j] * right[j]
        x[i] = total
    return x


@kernel
def forward(start, middle, other, weight, inverse, right):
    """One Gauss-Seidel sweep from zero: only neighbours before a node have a value yet."""
    x = np.empty(len(right), np.float32)
    for i in range(len(right)):
        total = right[i]
        for k in range(start[i], middle[i]):
            total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]
    return x


@kernel
def restrict(start, middle, other, weight, aggregate, x, count):
    """The residual summed over aggregates. After a forward sweep it is what the later neighbours
    add.
    """
    coarse = np.zeros(count, np.float32)
    for i in range(len(x)):
        total = np.float32(0.0)
        for k in range(middle[i], start[i + 1]):
            total += weight[k] * x[other[k]]
        coarse[aggregate[i]] += total
    return coarse


@kernel
def prolong(aggregate, coarse, x):
    for i in range(len(x)):
        x[i] += coarse[aggregate[i]]


@kernel
def backward(start, other, weight, inverse, right, x):
    for i in range(len(x) - 1, -1, -1):
        total = right[i]
        for k in range(start[i], start[i + 1]):
            total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]


@kernel
def sweeps(start, other, weight, diagonal, inverse, right, count):
    """Symmetric Gauss-Seidel from zero, `count` times."""
    x = np.zeros(len(right), np.float32)
    for _ in range(count):
        for n in range(2 * len(right)):
            i = n if n < len(right) else 2 * len(right) - 1 - n
            total = right[i]
            for k in range(start[i], start[i + 1]):
                total += weight[k] * x[other[k]]
            x[i] = total * inverse[i]
    return x


@kernel
def multiply(start, other, weight, diagonal, x):
    y = np.empty(len(x), np.float32)
    for i in range(len(x)):
        total = np.float32(diagonal[i]) * x[i]
        for k in range(start[i], start[i + 1]):
            total -= weight[k] * x[other[k]]
        y[i] = total
    return y


@kernel
def strongest_couplings(start, weight):
    strongest = np.zeros(len(start) - 1, np.float32)
    for i in range(len(strongest)):
        for k in range(start[i], start[i + 1]):
            strongest[i] = max(strongest[i], weight[k])
    return strongest


@kernel
def aggregate_blocks(start, middle, other, weight, strongest, place, strong):
    """Nodes of one 2x2x2 block joined along strong couplings; numbered by their first node."""
    parent = np.arange(len(start) - 1)
    for i in range(len(parent)):
        for k in range(start[i], middle[i]):
            j = other[k]
            same = (place[i, 0] >> 1 == place[j, 0] >> 1) and (place[i, 1] >> 1 == place[j, 1] >> 1)
            if not (same and place[i, 2] >> 1 == place[j, 2] >> 1):
                continue
            if weight[k] < strong * max(strongest[i], strongest[j]):
                continue
            a, b = i, np.int64(j)
            while parent[a] != a:
                a = parent[a]
            while parent[b] != b:
                b = parent[b]
            low, high = (a, b) if a < b else (b, a)
            parent[high] = low
    aggregate = np.empty(len(parent), np.int32)
    count = 0
    for i in range(len(parent)):
        if parent[i] == i:
            aggregate[i] = count
            count += 1
        else:  # the root comes first, and so does every node on the way to it
            aggregate[i] = aggregate[parent[i]]
    return aggregate, count


@kernel
def members(aggregate, count):
    """The nodes of every aggregate: member[first[c]] to member[first[c + 1]]."""
    first = np.zeros(count + 1, np.int64)
    for i in range(len(aggregate)):
        first[aggregate[i] + 1] += 1
    for c in range(count):
        first[c + 1] += first[c]
    member = np.empty(len(aggregate), np.int32)
    at = first[:-1].copy()
    for i in range(len(aggregate)):
        member[at[aggregate[i]]] = i
        at[aggregate[i]] += 1
    return first, member


@kernel
def galerkin(start, other, weight, diagonal, middle, place, aggregate, count):
    """The matrix between aggregates: sums of the couplings between them."""
    first, member = members(aggregate, count)
    begin, half = np.zeros(count + 1, np.int64), np.empty(count, np.int64)
    to, pull = np.empty(len(other), np.int32), np.empty(len(other), np.float32)
    total, where = np.zeros(count), np.empty((count, 3), np.int16)
    mark = np.full(count, -1, np.int64)
    used = 0
    for c in range(count):
        begin[c] = used
        for later in range(2):
            for m in range(first[c], first[c + 1]):
                i = member[m]
                if later == 0:
                    total[c] += diagonal[i]
                    for d in range(3):
                        where[c, d] = place[i, d] >> 1
                for k in range(start[i], start[i + 1]):
                    a = aggregate[other[k]]
                    if a == c:
                        total[c] -= weight[k] if later else 0.0
                    elif (a > c) == (later == 1):
                        if mark[a] < begin[c]:
                            mark[a] = used
                            to[used], pull[used] = a, 0.0
                            used += 1
                        pull[mark[a]] += weight[k]
            if later == 0:
                half[c] = used
    begin[count] = used
    return begin, half, to[:used].copy(), pull[:used].copy(), total, where
