"""Surface covariances of points with anisotropic noise."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def surface_covariances(xyz, near, noise, least_m, most_m, surface):  # type: ignore[no-untyped-def]
    """Shape of the surface around each point: the scatter of its neighbours, less the noise along each principal axis.

    xyz      (N, 3) m
    near     (N, K) int32 rows of each point's neighbours, itself among them, -1 for none
    noise    (N, 3, 3) m^2, each point's own
    least_m, most_m : bounds of the standard deviation along a principal axis; most_m where there are too few neighbours
    Fills surface (N, 3, 3) m^2.
    """
    scatter, mean_noise, mean = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for n in range(len(xyz)):
        count = 0
        mean[:] = 0.0
        for k in range(near.shape[1]):
            if near[n, k] >= 0:
                mean += xyz[near[n, k]]
                count += 1
        surface[n] = 0.0
        if count < 4:
            for d in range(3):
                surface[n, d, d] = most_m * most_m
            continue
        mean /= count
        scatter[:], mean_noise[:] = 0.0, 0.0
        for k in range(near.shape[1]):
            j = near[n, k]
            if j >= 0:
                for r in range(3):
                    for c in range(3):
                        scatter[r, c] += (xyz[j, r] - mean[r]) * (xyz[j, c] - mean[c])
                        mean_noise[r, c] += noise[j, r, c] / count
        _, axes = np.linalg.eigh(scatter)
        for d in range(3):
            along, noisy = 0.0, 0.0
            for r in range(3):
                for c in range(3):
                    along += axes[r, d] * scatter[r, c] * axes[c, d] / (count - 1)
                    noisy += axes[r, d] * mean_noise[r, c] * axes[c, d]
            variance = min(max(along - noisy, least_m * least_m), most_m * most_m)
            for r in range(3):
                for c in range(3):
                    surface[n, r, c] += variance * axes[r, d] * axes[c, d]
