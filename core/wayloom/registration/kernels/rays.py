"""Free space: voxels that lines of sight pass through."""

from numba import njit


@njit(cache=True, error_model="numpy")
def carve(cameras, xyz, margin, origin, voxel_m, free):  # type: ignore[no-untyped-def]
    """Count in each voxel the lines of sight that pass it well before the point that they end at.

    cameras, xyz : (N, 3) m, both ends of each line; margin (N,) m: how far before its end a line stops counting
    origin       : (3,) m, lower corner of the grid
    Fills free (X, Y, Z) uint8, at most 255.
    """
    nx, ny, nz = free.shape
    for n in range(len(xyz)):
        dx, dy, dz = xyz[n, 0] - cameras[n, 0], xyz[n, 1] - cameras[n, 1], xyz[n, 2] - cameras[n, 2]
        length = (dx * dx + dy * dy + dz * dz) ** 0.5
        steps = int((length - margin[n]) / voxel_m)
        last = -1
        for s in range(1, steps):
            t = s * voxel_m / length
            x = (cameras[n, 0] + t * dx - origin[0]) / voxel_m
            y = (cameras[n, 1] + t * dy - origin[1]) / voxel_m
            z = (cameras[n, 2] + t * dz - origin[2]) / voxel_m
            if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
                continue
            i, j, k = int(x), int(y), int(z)
            cell = (i * ny + j) * nz + k
            if cell != last and free[i, j, k] < 255:
                free[i, j, k] += 1
            last = cell


@njit(cache=True, error_model="numpy")
def blow_up(xyz, group, reach, origin, voxel_m, seen):  # type: ignore[no-untyped-def]
    """Mark the voxels near points by the points' groups, one bit a group.

    xyz (N, 3) m; group (N,) int8, 0 to 7; reach : voxels to each side; fills seen (X, Y, Z) uint8.
    """
    nx, ny, nz = seen.shape
    for n in range(len(xyz)):
        i = int((xyz[n, 0] - origin[0]) // voxel_m)
        j = int((xyz[n, 1] - origin[1]) // voxel_m)
        k = int((xyz[n, 2] - origin[2]) // voxel_m)
        bit = 1 << group[n]
        for a in range(max(i - reach, 0), min(i + reach + 1, nx)):
            for b in range(max(j - reach, 0), min(j + reach + 1, ny)):
                for c in range(max(k - reach, 0), min(k + reach + 1, nz)):
                    seen[a, b, c] |= bit
