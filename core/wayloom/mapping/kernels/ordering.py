"""Approximate minimum degree ordering of a sparse symmetric matrix (Amestoy, Davis, Duff, SIMAX 1996).

The graph is kept as a quotient graph: a variable i has a list of elements (variables that were eliminated and now stand for
the clique of their neighbours) and a list of variables. Both lie in i's own segment of `adjacent`, elements first:
no segment ever grows,
since each new element in it stands for an element or a variable that was there. The variables of an element lie in `members`.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

IntArray = NDArray[np.int64]


@njit(cache=True, error_model="numpy")
def minimum_degree(start: IntArray, adjacent: IntArray) -> IntArray:
    """Order of elimination (N,): row k is the variable that is eliminated as the k-th.

    start (N + 1,), adjacent : neighbours of each variable, without itself, each once, both directions; adjacent is overwritten
    """
    n = len(start) - 1
    length = start[1:] - start[:-1]
    elements = np.zeros(n, np.int64)
    weight = np.ones(n, np.int64)  # variables that this one stands for; 0: eliminated, or another stands for it
    is_element = np.zeros(n, np.bool_)
    degree = length.copy()
    head, following, previous = np.full(n + 1, -1), np.full(n, -1), np.full(n, -1)
    for i in range(n - 1, -1, -1):
        insert(i, degree[i], head, following, previous)
    member_start, member_end, size = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n, np.int64)
    members, used = np.empty(2 * len(adjacent) + 16, np.int64), 0
    outside, mark = np.zeros(n, np.int64), np.full(n, -1)
    next_alike = np.full(n, -1)  # list of the variables that one stands for, from itself on
    last_alike = np.arange(n)
    bucket, in_bucket, hashes = np.full(n, -1), np.full(n, -1), np.zeros(n, np.int64)
    pivots, pivot_count, left, lowest, stamp = np.empty(n, np.int64), 0, n, 0, 0
    while left > 0:
        while head[lowest] < 0:
            lowest += 1
        p = head[lowest]
        remove(p, degree[p], head, following, previous)
        left -= weight[p]
        if used + left > len(members):
            larger = np.empty(2 * len(members) + left, np.int64)
            larger[:used] = members[:used]
            members = larger
        stamp += 1
        end = gather_element(
            p, stamp, used, start, adjacent, length, elements, weight, is_element, member_start, member_end, members, mark
        )
        pivots[pivot_count] = p
        pivot_count += 1
        own = 0
        for k in range(used, end):
            i = members[k]
            remove(i, degree[i], head, following, previous)
            own += weight[i]
        stamp += 1
        count_outside(used, end, members, start, adjacent, elements, weight, is_element, size, outside, mark, stamp)
        is_element[p] = True
        for k in range(used, end):
            i = members[k]
            degree[i] = update_variable(
                i, p, own, left, stamp - 1, start, adjacent, length, elements, weight, is_element, outside, mark, degree, hashes
            )
            if degree[i] == 0:  # adjacent to nothing but the element: eliminated with p
                left -= weight[i]
                own -= weight[i]
                join(p, i, weight, next_alike, last_alike)
            else:
                in_bucket[i] = bucket[hashes[i]]
                bucket[hashes[i]] = i
        stamp = join_alike(
            used, end, members, start, adjacent, length, elements, weight, hashes, bucket, in_bucket, mark, stamp,
            next_alike, last_alike,
        )  # fmt: skip
        kept = used
        for k in range(used, end):
            i = members[k]
            if weight[i] > 0:
                degree[i] = max(1, min(degree[i] + own - weight[i], left - weight[i]))
                insert(i, degree[i], head, following, previous)
                lowest = min(lowest, degree[i])
                members[kept] = i
                kept += 1
        weight[p] = 0
        member_start[p], member_end[p], size[p] = used, kept, own
        used = kept
    return expanded(pivots[:pivot_count], next_alike, n)


@njit(cache=True, error_model="numpy")
def insert(i: int, degree: int, head: IntArray, following: IntArray, previous: IntArray) -> None:
    """Put variable i in front of the list of its degree."""
    first = head[degree]
    following[i], previous[i] = first, -1
    if first >= 0:
        previous[first] = i
    head[degree] = i


@njit(cache=True, error_model="numpy")
def remove(i: int, degree: int, head: IntArray, following: IntArray, previous: IntArray) -> None:
    """Take variable i out of the list of its degree."""
    if previous[i] >= 0:
        following[previous[i]] = following[i]
    else:
        head[degree] = following[i]
    if following[i] >= 0:
        previous[following[i]] = previous[i]


@njit(cache=True, error_model="numpy")
def join(i: int, j: int, weight: IntArray, next_alike: IntArray, last_alike: IntArray) -> None:
    """Let i stand for j and all that j stands for."""
    weight[i] += weight[j]
    weight[j] = 0
    next_alike[last_alike[i]] = j
    last_alike[i] = last_alike[j]


@njit(cache=True, error_model="numpy")
def gather_element(
    p: int,
    stamp: int,
    used: int,
    start: IntArray,
    adjacent: IntArray,
    length: IntArray,
    elements: IntArray,
    weight: IntArray,
    is_element: NDArray[np.bool_],
    member_start: IntArray,
    member_end: IntArray,
    members: IntArray,
    mark: IntArray,
) -> int:
    """Write the neighbours of p, marked with the stamp, to members from `used` on; absorb its elements. Returns the end."""
    mark[p] = stamp
    end = used
    for a in range(start[p], start[p] + length[p]):
        q = adjacent[a]
        if a < start[p] + elements[p]:
            if not is_element[q]:
                continue
            is_element[q] = False
            for b in range(member_start[q], member_end[q]):
                i = members[b]
                if weight[i] > 0 and mark[i] != stamp:
                    mark[i] = stamp
                    members[end] = i
                    end += 1
        elif weight[q] > 0 and mark[q] != stamp:
            mark[q] = stamp
            members[end] = q
            end += 1
    return end


@njit(cache=True, error_model="numpy")
def count_outside(
    used: int,
    end: int,
    members: IntArray,
    start: IntArray,
    adjacent: IntArray,
    elements: IntArray,
    weight: IntArray,
    is_element: NDArray[np.bool_],
    size: IntArray,
    outside: IntArray,
    mark: IntArray,
    stamp: int,
) -> None:
    """For each element beside the new one, the weight of its variables outside of the new one, in `outside`."""
    for k in range(used, end):
        i = members[k]
        for a in range(start[i], start[i] + elements[i]):
            e = adjacent[a]
            if is_element[e]:
                if mark[e] != stamp:
                    mark[e] = stamp
                    outside[e] = size[e]
                outside[e] -= weight[i]


@njit(cache=True, error_model="numpy")
def update_variable(
    i: int,
    p: int,
    own: int,
    left: int,
    inside: int,
    start: IntArray,
    adjacent: IntArray,
    length: IntArray,
    elements: IntArray,
    weight: IntArray,
    is_element: NDArray[np.bool_],
    outside: IntArray,
    mark: IntArray,
    degree: IntArray,
    hashes: IntArray,
) -> int:
    """Degree of variable i outside of the new element p, after its lists have been cleared of what p covers; its hash is set.

    inside is the mark of p's variables. 0: nothing is left but p.
    """
    begin, write, total, code = start[i], start[i], 0, p
    for a in range(begin, begin + elements[i]):
        e = adjacent[a]
        if is_element[e] and outside[e] > 0:
            adjacent[write] = e
            write += 1
            total += outside[e]
            code += e
        else:
            is_element[e] = False  # all its variables are p's
    element_end, variable_begin = write, begin + elements[i]
    stop = begin + length[i]
    kept = 0
    for a in range(variable_begin, stop):  # compacted behind a gap of one, for p
        j = adjacent[a]
        if weight[j] > 0 and mark[j] != inside and j != i:
            total += weight[j]
            code += j
            adjacent[variable_begin + kept] = j
            kept += 1
    if total == 0:
        return 0
    if element_end < variable_begin:
        adjacent[element_end] = p
        for k in range(kept):
            adjacent[element_end + 1 + k] = adjacent[variable_begin + k]
    else:  # p takes the place of a variable that it covers
        for k in range(kept, 0, -1):
            adjacent[element_end + k] = adjacent[element_end + k - 1]
        adjacent[element_end] = p
    elements[i] = element_end + 1 - begin
    length[i] = elements[i] + kept
    hashes[i] = code % len(start[1:])
    return min(total, degree[i])


@njit(cache=True, error_model="numpy")
def join_alike(
    used: int,
    end: int,
    members: IntArray,
    start: IntArray,
    adjacent: IntArray,
    length: IntArray,
    elements: IntArray,
    weight: IntArray,
    hashes: IntArray,
    bucket: IntArray,
    in_bucket: IntArray,
    mark: IntArray,
    stamp: int,
    next_alike: IntArray,
    last_alike: IntArray,
) -> int:
    """Join variables of the new element with the same neighbours; empties the buckets. Returns the last stamp used."""
    for k in range(used, end):
        i = members[k]
        if weight[i] == 0 or bucket[hashes[i]] < 0:
            continue
        i = bucket[hashes[i]]
        bucket[hashes[i]] = -1
        while i >= 0:
            if weight[i] > 0 and in_bucket[i] >= 0:
                stamp += 1
                for a in range(start[i], start[i] + length[i]):
                    mark[adjacent[a]] = stamp
                j = in_bucket[i]
                while j >= 0:
                    if weight[j] > 0 and length[j] == length[i] and elements[j] == elements[i]:
                        alike = True
                        for a in range(start[j], start[j] + length[j]):
                            if mark[adjacent[a]] != stamp:
                                alike = False
                                break
                        if alike:
                            join(i, j, weight, next_alike, last_alike)
                    j = in_bucket[j]
            i = in_bucket[i]
    return stamp


@njit(cache=True, error_model="numpy")
def expanded(pivots: IntArray, next_alike: IntArray, n: int) -> IntArray:
    """All variables in the order of the pivots that stand for them."""
    order, k = np.empty(n, np.int64), 0
    for p in pivots:
        i = p
        while i >= 0:
            order[k] = i
            k += 1
            i = next_alike[i]
    return order
