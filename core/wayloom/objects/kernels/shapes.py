"""Shapes of bars of several pieces: places and widths by medians, a disparity by weighted mean."""

from wayloom.odometry.kernels.compiler import kernel, part

PLACE_U, PLACE_V, DISPARITY, WEIGHT, TYPICAL, WIDTH = range(6)
"""Columns of `bar_shapes`."""


@kernel
def bar_shapes(pieces, disparity, sigma, start, least_sigma, shapes, space):  # type: ignore[no-untyped-def]
    """One row of shapes (b, 6) for each bar, whose pieces (n, 4) u0, v0, u1, v1 begin at start (b + 1,).

    disparity, sigma  (n,) px
    least_sigma       px that no piece is surer than
    space             (longest bar's pieces,), whatever is in it

    Columns: median of the middles, mean row, disparity with outliers held down and its weight 1/px^2, median disparity, median
    width; all px.
    """
    for b in range(shapes.shape[0]):
        first, last = start[b], start[b + 1]
        count = last - first
        row = 0.0
        for k in range(first, last):
            space[k - first] = disparity[k]
            row += 0.5 * (pieces[k, 1] + pieces[k, 3] - 1)
        typical = _median(space[:count])
        weight, weighted = 0.0, 0.0
        for k in range(first, last):
            one = 1.0 / (max(sigma[k], least_sigma) ** 2 + (disparity[k] - typical) ** 2)
            weight += one
            weighted += one * disparity[k]
        for k in range(first, last):
            space[k - first] = 0.5 * (pieces[k, 0] + pieces[k, 2] - 1)
        shapes[b, PLACE_U] = _median(space[:count])
        for k in range(first, last):
            space[k - first] = pieces[k, 2] - pieces[k, 0]
        shapes[b, WIDTH] = _median(space[:count])
        shapes[b, PLACE_V] = row / count
        shapes[b, DISPARITY], shapes[b, WEIGHT], shapes[b, TYPICAL] = weighted / weight, weight, typical


@part
def _median(values):  # type: ignore[no-untyped-def]
    """The median of a few values, which are sorted in place."""
    for k in range(1, values.shape[0]):
        one, at = values[k], k
        while at > 0 and values[at - 1] > one:
            values[at] = values[at - 1]
            at -= 1
        values[at] = one
    middle = values.shape[0] // 2
    return values[middle] if values.shape[0] % 2 else 0.5 * (values[middle - 1] + values[middle])
