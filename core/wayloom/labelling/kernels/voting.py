"""Projection of points into an observer's images, label look-up, and weighted majority voting (eqs. 2 and 3).

Every kernel is linear in its points and reads the images of one keyframe only. Votes are float32 and their sums float64, which hold
sums of a few hundred such numbers exactly: the order in which observers are visited does not matter, to the bit.
"""

import numpy as np
from numba import njit

_VOID = 255
_MAX_CLASSES = 32
_MIN_LOG_SHARE = np.float32(-6.0)


@njit(cache=True, error_model="numpy")
def project(rays, inverse_depth, T_observer_host, t_right_left, K, bias_px, rows, max_inverse_depth):  # type: ignore[no-untyped-def]
    """Projection of N points of one host into both images of an observer, and their inverse depths there.

    In units of the point's own depth: q = R ray + t d, so that z = q_z / d and d_j = d / q_z; d = 0 is no special case.

    rays               (N, 3) directions in the host camera with z = 1
    inverse_depth      (N,) 1/m along the host's z axis
    T_observer_host    (4, 4)
    t_right_left       (3,) m
    K                  (4,) fx, fy, cx, cy in pixels
    bias_px, rows      the right image's disparity bias and (3,) row field: see `OdometryResult`
    max_inverse_depth  1/m: from this on a vote does not count (eq. 3: 1 / dist_min)
    returns            (2, N, 2) pixels; (2, N) float32 d_j, 1/m, 0 behind the camera or too near; left image, then right
    """
    count = len(inverse_depth)
    uv = np.zeros((2, count, 2), np.float64)
    d_observer = np.zeros((2, count), np.float32)
    T = T_observer_host
    for n in range(count):
        d = inverse_depth[n]
        if not d > 0.0:
            continue
        x = T[0, 0] * rays[n, 0] + T[0, 1] * rays[n, 1] + T[0, 2] * rays[n, 2] + T[0, 3] * d
        y = T[1, 0] * rays[n, 0] + T[1, 1] * rays[n, 1] + T[1, 2] * rays[n, 2] + T[1, 3] * d
        z = T[2, 0] * rays[n, 0] + T[2, 1] * rays[n, 1] + T[2, 2] * rays[n, 2] + T[2, 3] * d
        if not z > 0.0:
            continue
        uv[0, n, 0] = K[0] * x / z + K[2]
        uv[0, n, 1] = K[1] * y / z + K[3]
        if d / z < max_inverse_depth:
            d_observer[0, n] = d / z
        x += t_right_left[0] * d
        y += t_right_left[1] * d
        z += t_right_left[2] * d
        if z > 0.0:
            x /= z
            y /= z
            dv = rows[0] * (1.0 + y * y) + rows[1] * x + rows[2] * x * y
            uv[1, n, 0] = K[0] * x + K[2] - bias_px
            uv[1, n, 1] = K[1] * y + K[3] + dv
            if d / z < max_inverse_depth:
                d_observer[1, n] = d / z
    return uv, d_observer


@njit(cache=True, error_model="numpy")
def read_labels(labels, uv):  # type: ignore[no-untyped-def]
    """The label of the pixel in whose square uv lies, void outside the image and for NaN.

    labels (h, w) uint8; uv (N, 2) pixels; returns (N,) uint8
    """
    height, width = labels.shape
    found = np.full(len(uv), _VOID, np.uint8)
    for n in range(len(uv)):
        u, v = uv[n, 0], uv[n, 1]
        if u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5:
            found[n] = labels[int(np.floor(v + 0.5)), int(np.floor(u + 0.5))]
    return found


@njit(cache=True, error_model="numpy")
def add_hard_votes(votes, label, weight):  # type: ignore[no-untyped-def]
    """Eq. 2: each point's vote for one class. votes (N, C) float64 is added to; label (N,) uint8, void votes not; weight (N,)."""
    for n in range(len(label)):
        if weight[n] > 0.0 and label[n] < votes.shape[1]:
            votes[n, label[n]] += np.float64(weight[n])


@njit(cache=True, error_model="numpy", inline="always")
def _share(nats):  # type: ignore[no-untyped-def]
    return np.exp(nats) if nats > _MIN_LOG_SHARE else np.float32(0.0)


@njit(cache=True, error_model="numpy")
def add_soft_votes(votes, classes, steps, rest, steps_per_nat, covered, size, uv, label, weight):  # type: ignore[no-untyped-def]
    """Eq. 2 with soft votes: a vote shared among the classes by their probability at the pixel.

    ln p is taken bilinearly between the centres of the four cells around the pixel, as the network's own labels are from its
    logits, and brought to a sum of 1. Shares under e^-6 of the best class's are left out.

    votes          (N, C) float64, is added to
    classes, steps (gh, gw, k) uint8: the likeliest classes of each cell, and -ln p in steps
    rest           (gh, gw) float32: -ln p, in steps, of every other class
    covered        (height, width) in pixels of the image that the grid covers; size (h, w) of the image itself
    uv             (N, 2) pixels, none outside the image vote; label (N,) uint8, void votes not; weight (N,) float32
    """
    grid_height, grid_width, k = classes.shape
    class_count = votes.shape[1]
    per_row, per_column = grid_height / covered[0], grid_width / covered[1]
    to_nats = np.float32(1.0 / steps_per_nat)
    gain = np.empty(_MAX_CLASSES, np.float32)  # steps by which a class is likelier than those among the best of no corner
    is_listed = np.zeros(_MAX_CLASSES, np.bool_)
    listed = np.empty(_MAX_CLASSES, np.uint8)
    for n in range(len(label)):
        u, v = uv[n, 0], uv[n, 1]
        inside = u >= -0.5 and v >= -0.5 and u < size[1] - 0.5 and v < size[0] - 0.5
        if not (inside and weight[n] > 0.0 and label[n] < class_count):
            continue
        sv = min(max((v + 0.5) * per_row - 0.5, 0.0), grid_height - 1.0)
        su = min(max((u + 0.5) * per_column - 0.5, 0.0), grid_width - 1.0)
        v0, u0 = int(sv), int(su)
        down, along = np.float32(sv - v0), np.float32(su - u0)
        count = 0
        for corner in range(4):
            row = min(v0 + corner // 2, grid_height - 1)
            column = min(u0 + corner % 2, grid_width - 1)
            share = (down if corner >= 2 else np.float32(1.0) - down) * (along if corner % 2 else np.float32(1.0) - along)
            rest_here = rest[row, column]
            for i in range(k):
                c = classes[row, column, i]
                if not is_listed[c]:
                    is_listed[c] = True
                    gain[c] = 0.0
                    listed[count] = c
                    count += 1
                gain[c] += share * (rest_here - np.float32(steps[row, column, i]))
        largest = np.float32(0.0)
        for i in range(count):
            largest = max(largest, gain[listed[i]])
        of_others = _share(-largest * to_nats)
        total = np.float32(class_count - count) * of_others
        for i in range(count):
            c = listed[i]
            gain[c] = _share((gain[c] - largest) * to_nats)
            total += gain[c]
        scale = weight[n] / total
        if of_others > 0.0:
            for c in range(class_count):
                if not is_listed[c]:
                    votes[n, c] += np.float64(scale * of_others)
        for i in range(count):
            c = listed[i]
            votes[n, c] += np.float64(scale * gain[c])
            is_listed[c] = False


@njit(cache=True, error_model="numpy")
def argmax_classes(votes, baseline):  # type: ignore[no-untyped-def]
    """Eq. 2: the class with most votes; of equals the baseline's, else the lowest; the baseline where there is no vote.

    votes (N, C) float64; baseline (N,) uint8; returns (N,) uint8
    """
    count, class_count = votes.shape
    found = baseline.copy()
    for n in range(count):
        best = votes[n, baseline[n]] if baseline[n] < class_count else 0.0
        for c in range(class_count):
            if votes[n, c] > best:
                best = votes[n, c]
                found[n] = c
    return found


@njit(cache=True, error_model="numpy")
def sparse_votes(votes, min_share):  # type: ignore[no-untyped-def]
    """The classes that got votes, without those that got less than `min_share` of all of their point's.

    votes    (N, C) float64
    returns  how many classes of each point (N,) int64, their ids (V,) uint8, increasing within a point, their sums (V,) float32
    """
    count, class_count = votes.shape
    kinds = np.zeros(count, np.int64)
    ids = np.empty(count * class_count, np.uint8)
    sums = np.empty(count * class_count, np.float32)
    at = 0
    for n in range(count):
        total = 0.0
        for c in range(class_count):
            total += votes[n, c]
        for c in range(class_count):
            if votes[n, c] > min_share * total:
                ids[at] = c
                sums[at] = votes[n, c]
                at += 1
                kinds[n] += 1
    return kinds, ids[:at].copy(), sums[:at].copy()


@njit(cache=True, error_model="numpy")
def put_votes(point, start, ids, sums, ids_out, sums_out):  # type: ignore[no-untyped-def]
    """Put the sparse votes ids (V,), sums (V,) of points (N,), one point after the other, where theirs begin in the votes of all P
    points, ids_out and sums_out (M,), by start (P + 1,)."""
    at = 0
    for n in range(len(point)):
        for m in range(start[point[n]], start[point[n] + 1]):
            ids_out[m], sums_out[m] = ids[at], sums[at]
            at += 1
