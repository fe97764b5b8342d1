"""Top-k class scores of each cell from logits."""

import numpy as np
from numba import njit

_VOID = 255
_LEAST = 1e-30


@njit(cache=True, error_model="numpy", nogil=True)
def best_scores(logits, train_ids, class_count, k, steps_per_nat):  # type: ignore[no-untyped-def]
    """The k likeliest of our classes in each cell, best first, and how unlikely they are.

    A class's probability is the sum of those of the network's classes that are mapped to it (softmax); what is mapped to void is
    left out of the k, but not of the sum. Of equals the lower class comes first.

    logits         (gh, gw, C) float32
    train_ids      (C,) uint8, 255 = void
    class_count    how many classes are ours; k <= class_count
    steps_per_nat  -ln p is rounded to this many steps a nat, and ends at 255 steps
    returns        (gh, gw, k) uint8 classes, (gh, gw, k) uint8 steps
    """
    grid_height, grid_width, channels = logits.shape
    classes = np.empty((grid_height, grid_width, k), np.uint8)
    steps = np.empty((grid_height, grid_width, k), np.uint8)
    share = np.empty(class_count, np.float64)
    for v in range(grid_height):
        for u in range(grid_width):
            top = logits[v, u, 0]
            for c in range(1, channels):
                top = max(top, logits[v, u, c])
            share[:] = 0.0
            total = 0.0
            for c in range(channels):
                e = np.exp(np.float64(logits[v, u, c]) - np.float64(top))
                total += e
                if train_ids[c] != _VOID:
                    share[train_ids[c]] += e
            for i in range(k):
                best = 0
                for c in range(1, class_count):
                    if share[c] > share[best]:
                        best = c
                nats = -np.log(max(share[best] / total, _LEAST))
                classes[v, u, i] = best
                steps[v, u, i] = min(255, int(nats * steps_per_nat + 0.5))
                share[best] = -1.0
    return classes, steps
