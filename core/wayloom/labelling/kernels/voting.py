"""Where a point lies in an observer's images and what is written there; and the count of the votes.

Both kernels are linear in observations. They never meet the images of more than one keyframe.
"""

import numpy as np
from numba import njit

_VOID = 255


@njit(cache=True, error_model="numpy")
def _label_at(labels, u, v):  # type: ignore[no-untyped-def]
    """The label of the pixel in whose square (u, v) lies, void outside the image and for NaN."""
    height, width = labels.shape
    if not (u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5):
        return np.uint8(_VOID)
    return labels[int(np.floor(v + 0.5)), int(np.floor(u + 0.5))]


@njit(cache=True, error_model="numpy")
def read_votes(  # type: ignore[no-untyped-def]
    rays, inverse_depth, host, T_observer_host, wanted_right, left, right, K, t_right_left, bias_px, rows, max_inverse_depth
):
    """The labels and weights with which one keyframe j judges N points hosted elsewhere (or in itself).

    Projection in units of the point's own depth: q = R ray + t d, so that z = q_z / d and d_j = d / q_z; d = 0 is no special case.

    rays             (N, 3) directions in the host camera with z = 1
    inverse_depth    (N,) 1/m along the host's z axis
    host             (N,) index into T_observer_host
    T_observer_host  (H, 4, 4)
    wanted_right     (N,) whether the right image votes as well
    left, right      (h, w) uint8 train ids of keyframe j
    K                (4,) fx, fy, cx, cy in pixels
    t_right_left     (3,) m
    bias_px, rows    the right image's disparity bias and (3,) row field: see `OdometryResult`
    max_inverse_depth  1/m: from this on a vote does not count (1 / dist_min)
    returns          (N, 2) uint8 labels, void where nothing votes; (N, 2) float32 weights d_j, 1/m, 0 where nothing votes;
                     column 0 the left image, column 1 the right
    """
    count = len(inverse_depth)
    labels = np.full((count, 2), _VOID, np.uint8)
    weights = np.zeros((count, 2), np.float32)
    fx, fy, cx, cy = K[0], K[1], K[2], K[3]
    for n in range(count):
        d = inverse_depth[n]
        T = T_observer_host[host[n]]
        x = T[0, 0] * rays[n, 0] + T[0, 1] * rays[n, 1] + T[0, 2] * rays[n, 2] + T[0, 3] * d
        y = T[1, 0] * rays[n, 0] + T[1, 1] * rays[n, 1] + T[1, 2] * rays[n, 2] + T[1, 3] * d
        z = T[2, 0] * rays[n, 0] + T[2, 1] * rays[n, 1] + T[2, 2] * rays[n, 2] + T[2, 3] * d
        if not (d > 0.0 and z > 0.0):
            continue
        weight = d / z
        if weight < max_inverse_depth:
            label = _label_at(left, fx * x / z + cx, fy * y / z + cy)
            if label != _VOID:
                labels[n, 0] = label
                weights[n, 0] = weight
        if wanted_right[n]:
            x += t_right_left[0] * d
            y += t_right_left[1] * d
            z += t_right_left[2] * d
            weight = d / z
            if z > 0.0 and weight < max_inverse_depth:
                xn = x / z
                yn = y / z
                dv = rows[0] * (1.0 + yn * yn) + rows[1] * xn + rows[2] * xn * yn
                label = _label_at(right, fx * xn + cx - bias_px, fy * yn + cy + dv)
                if label != _VOID:
                    labels[n, 1] = label
                    weights[n, 1] = weight
    return labels, weights


@njit(cache=True, error_model="numpy")
def count_votes(start, labels, weights, baseline, class_count):  # type: ignore[no-untyped-def]
    """Eq. 2: the class with the largest sum of weights, for left images alone and for left and right.

    Weights are float32 and their sums float64, which hold such sums exactly: the order of the observers does not matter.

    start      (P + 1,) votes start[p]:start[p + 1] belong to point p
    labels     (M, 2) uint8, weights (M, 2) float32, as `read_votes` gives them: left, right
    baseline   (P,) uint8
    returns    mono (P,) uint8, stereo (P,) uint8, kinds (P,) int64: how many classes got votes in the stereo form
    """
    count = len(baseline)
    mono = np.empty(count, np.uint8)
    stereo = np.empty(count, np.uint8)
    kinds = np.zeros(count, np.int64)
    votes = np.zeros((2, class_count), np.float64)
    for p in range(count):
        votes[:] = 0.0
        for m in range(start[p], start[p + 1]):
            if weights[m, 0] > 0:
                votes[0, labels[m, 0]] += weights[m, 0]
                votes[1, labels[m, 0]] += weights[m, 0]
            if weights[m, 1] > 0:
                votes[1, labels[m, 1]] += weights[m, 1]
        mono[p] = _winner(votes[0], baseline[p])
        stereo[p] = _winner(votes[1], baseline[p])
        for c in range(class_count):
            if votes[1, c] > 0:
                kinds[p] += 1
    return mono, stereo, kinds


@njit(cache=True, error_model="numpy")
def sparse_votes(start, labels, weights, kinds, class_count):  # type: ignore[no-untyped-def]
    """The stereo votes of each point, summed by class, without the classes that got none.

    start, labels, weights, kinds  as for, and from, `count_votes`
    returns  vote_start (P + 1,) int64, vote_class (V,) uint8, vote_weight (V,) float32
    """
    count = len(kinds)
    vote_start = np.zeros(count + 1, np.int64)
    for p in range(count):
        vote_start[p + 1] = vote_start[p] + kinds[p]
    vote_class = np.empty(vote_start[count], np.uint8)
    vote_weight = np.empty(vote_start[count], np.float32)
    votes = np.zeros(class_count, np.float64)
    for p in range(count):
        votes[:] = 0.0
        for m in range(start[p], start[p + 1]):
            for side in range(2):
                if weights[m, side] > 0:
                    votes[labels[m, side]] += weights[m, side]
        at = vote_start[p]
        for c in range(class_count):
            if votes[c] > 0:
                vote_class[at] = c
                vote_weight[at] = votes[c]
                at += 1
    return vote_start, vote_class, vote_weight


@njit(cache=True, error_model="numpy")
def _winner(votes, baseline):  # type: ignore[no-untyped-def]
    """The class with most votes; of equals the baseline's, else the lowest; the baseline where there is no vote."""
    best = 0.0
    winner = baseline
    if baseline < len(votes):
        best = votes[baseline]
    for c in range(len(votes)):
        if votes[c] > best:
            best = votes[c]
            winner = np.uint8(c)
    return winner
