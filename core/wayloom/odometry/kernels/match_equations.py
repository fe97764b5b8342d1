"""Normal equations of calibration's match groups, the points' depths eliminated.

Each point's ten residuals are linearised, weighed and added.
`calibration.residuals` has the residuals in words and as arrays. Unknowns of a group: lens (10), the drive's offsets (3), kappa,
and the twists of two targets (6 each); their columns are those of the arrays there.
"""

import math

from wayloom.odometry.kernels.compiler import inlined, kernel

KAPPA, POSES = 13, 14
"""Columns: kappa's, and the first of the poses'."""


@kernel
def fill_group_equations(  # type: ignore[no-untyped-def]
    rays, measured, rho, starts, T, R, dR, numbers, noise, robust_scale, rho_prior, J, weights, H, g, rho_step, rho_gain
):
    """Of points with rays (P, 3), matches measured (P, 5, 2) px and rho (P,) 1/m, those of group s from starts[s] to starts[s + 1].

    T (S, 2, 4, 4) T_target_host; R (3, 3) R_real_ideal, dR (3, 3, 3) its derivatives by pitch, yaw, roll; numbers (15,): fx, fy,
    cx, cy, focal ratio, cx shift, k1, p1, p2, baseline, ty, tz, t_right_left; noise (5,) px of a point's matches; rho_prior added
    to a depth's information. J (12, 27) is working space. Fills weights (P, 5), Cauchy's over none, 0 without a match, and of each
    group, the depths eliminated, H (S, 26, 26) and g (S, 26), H x = g; the way back is rho_step (P,) - rho_gain (P, 26) @ x.
    """
    coupling = J[10]
    for s in range(starts.shape[0] - 1):
        H[s], g[s] = 0.0, 0.0
        for i in range(starts[s], starts[s + 1]):
            for a in range(11):
                for b in range(27):
                    J[a, b] = 0.0
            linearise_point(rays[i], rho[i], T[s], R, dR, numbers, J)
            information, step = rho_prior, 0.0
            for row in range(5):
                first = POSES - 1 if row in (1, 2) else 0
                pose = POSES + 6 * ((row - 1) & 1)
                ru, rv = weigh_match(J, row, measured[i, row], noise[row], robust_scale, weights[i])
                if weights[i, row] == 0.0:
                    continue
                for k in range(2):
                    j, r = J[2 * row + k], rv if k else ru
                    information += j[26] * j[26]
                    step -= j[26] * r
                    add_row(j, r, first, pose if row else 0, H[s], g[s], coupling)
            rho_step[i] = step / information
            for a in range(26):
                rho_gain[i, a] = coupling[a] / information
                g[s, a] -= coupling[a] * rho_step[i]
                c = rho_gain[i, a]
                for b in range(a + 1):
                    H[s, a, b] -= c * coupling[b]
        for a in range(26):
            for b in range(a):
                H[s, b, a] = H[s, a, b]


@inlined
def add_row(j, r, first, pose, H, g, coupling):  # type: ignore[no-untyped-def]
    """j^T j and -j^T r of a residual's row (27,) to H (26, 26, lower) and g (26,), j times the depth's derivative to the coupling.
    Its columns are those from `first` to kappa, and six from `pose` on, none where that is 0."""
    depth = j[26]
    for a in range(first, POSES):
        c = j[a]
        g[a] -= c * r
        coupling[a] += c * depth
        for b in range(first, a + 1):
            H[a, b] += c * j[b]
    if pose:
        for a in range(pose, pose + 6):
            c = j[a]
            g[a] -= c * r
            coupling[a] += c * depth
            for b in range(first, POSES):
                H[a, b] += c * j[b]
            for b in range(pose, a + 1):
                H[a, b] += c * j[b]


@inlined
def weigh_match(J, row, measured, noise, robust_scale, weights):  # type: ignore[no-untyped-def]
    """The two rows of a match times the root of its weight over the noise; its residuals px, predicted less measured, likewise.
    Fills weights[row]: 0 where there is no match, or nothing to differentiate."""
    ru, rv = J[11, 2 * row] - measured[0], J[11, 2 * row + 1] - measured[1]
    total = ru + rv
    for k in range(27):
        total += J[2 * row, k] + J[2 * row + 1, k]
    weight = 0.0
    if math.isfinite(total):
        weight = 1.0 / (1.0 + (ru * ru + rv * rv) / (robust_scale * noise) ** 2)
    weights[row] = weight
    root = math.sqrt(weight) / noise
    for k in range(27):
        J[2 * row, k] *= root
        J[2 * row + 1, k] *= root
    return ru * root, rv * root


@inlined
def linearise_point(ray, rho, T, R, dR, numbers, J):  # type: ignore[no-untyped-def]
    """Predictions px into J[11], and their derivatives by the unknowns and, in column 26, by rho into rows 0 to 9."""
    fx, fy, cx, cy = numbers[0], numbers[1], numbers[2], numbers[3]
    square = ray[0] * ray[0] + ray[1] * ray[1]
    kx, ky = -ray[0] * square, -ray[1] * square
    right_match(0, ray[0], ray[1], 1.0, rho, 0.0, 0.0, 0.0, kx, ky, 0.0, 0, R, dR, numbers, J)
    for t in range(2):
        P = T[t]
        x = P[0, 0] * ray[0] + P[0, 1] * ray[1] + P[0, 2] + rho * P[0, 3]
        y = P[1, 0] * ray[0] + P[1, 1] * ray[1] + P[1, 2] + rho * P[1, 3]
        z = P[2, 0] * ray[0] + P[2, 1] * ray[1] + P[2, 2] + rho * P[2, 3]
        turned_x, turned_y, turned_z = (P[0, 0] * kx + P[0, 1] * ky, P[1, 0] * kx + P[1, 1] * ky, P[2, 0] * kx + P[2, 1] * ky)
        pose = POSES + 6 * t
        right_match(
            3 + t, x, y, z, rho, P[0, 3], P[1, 3], P[2, 3], turned_x, turned_y, turned_z, pose, R, dR, numbers, J
        )  # fmt: skip
        depth = z if z > 0.0 else math.nan
        xn, yn = x / depth, y / depth
        u, v, radial = J[2 + 2 * t], J[3 + 2 * t], xn * xn + yn * yn
        J[11, 2 + 2 * t], J[11, 3 + 2 * t] = fx * xn + cx, fy * yn + cy
        iu, iv = fx / depth, fy / depth
        by_twist(u, iu, 0.0, -iu * xn, x, y, z, rho, pose)
        by_twist(v, 0.0, iv, -iv * yn, x, y, z, rho, pose)
        u[KAPPA] = iu * (turned_x - xn * turned_z) + fx * xn * radial
        v[KAPPA] = iv * (turned_y - yn * turned_z) + fy * yn * radial
        u[26], v[26] = iu * (P[0, 3] - xn * P[2, 3]), iv * (P[1, 3] - yn * P[2, 3])


@inlined
def by_twist(j, a, b, c, x, y, z, rho, pose):  # type: ignore[no-untyped-def]
    """Fill six columns of a row from `pose` on: its derivatives (a, b, c) by q, times those of q = (x, y, z) by the twist, dq =
    rho v + omega x q."""
    j[pose], j[pose + 1], j[pose + 2] = a * rho, b * rho, c * rho
    j[pose + 3], j[pose + 4], j[pose + 5] = c * y - b * z, a * z - c * x, b * x - a * y


@inlined
def right_match(  # type: ignore[no-untyped-def]
    row, qx, qy, qz, rho, rho_x, rho_y, rho_z, kappa_x, kappa_y, kappa_z, pose, R, dR, numbers, J
):
    """Prediction and derivatives of a match in a right image, of q, a point times its rho in the left camera there, by q of which
    derivatives by rho and kappa are given; pose is the first column of the target's twist, 0 for the host."""
    fx, fy, cx, cy, focal, shift = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4], numbers[5]
    k1, p1, p2, baseline = numbers[6], numbers[7], numbers[8], numbers[9]
    lift, ahead = baseline * numbers[10], baseline * numbers[11]
    tx, ty, tz = numbers[12], numbers[13], numbers[14]
    mx, my, mz = qx + rho * tx, qy + rho * (ty + lift), qz + rho * (tz + ahead)
    px, py = R[0, 0] * mx + R[0, 1] * my + R[0, 2] * mz, R[1, 0] * mx + R[1, 1] * my + R[1, 2] * mz
    pz = R[2, 0] * mx + R[2, 1] * my + R[2, 2] * mz
    z = pz if pz > 0.0 else math.nan
    x, y = px / z, py / z
    r2 = x * x + y * y
    radial = 1.0 + k1 * r2
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    J[11, 2 * row], J[11, 2 * row + 1] = focal * fx * xd + cx + shift, focal * fy * yd + cy
    xx, xy = radial + 2.0 * x * x * k1 + 2.0 * p1 * y + 6.0 * p2 * x, 2.0 * x * y * k1 + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + 2.0 * y * y * k1 + 6.0 * p1 * y + 2.0 * p2 * x
    for k in range(2):
        j, f = J[2 * row + k], focal * (fy if k else fx)
        a, b = (xy, yy) if k else (xx, xy)
        real_x, real_y, real_z = f * a / z, f * b / z, -f * (a * x + b * y) / z
        by_x = real_x * R[0, 0] + real_y * R[1, 0] + real_z * R[2, 0]
        by_y = real_x * R[0, 1] + real_y * R[1, 1] + real_z * R[2, 1]
        by_z = real_x * R[0, 2] + real_y * R[1, 2] + real_z * R[2, 2]
        for i in range(3):
            j[i] = real_x * (dR[i, 0, 0] * mx + dR[i, 0, 1] * my + dR[i, 0, 2] * mz)
            j[i] += real_y * (dR[i, 1, 0] * mx + dR[i, 1, 1] * my + dR[i, 1, 2] * mz)
            j[i] += real_z * (dR[i, 2, 0] * mx + dR[i, 2, 1] * my + dR[i, 2, 2] * mz)
        j[3], j[4] = by_y * baseline * rho, by_z * baseline * rho
        j[5], j[6] = (fy * yd, 0.0) if k else (fx * xd, 1.0)
        j[7] = f * r2 * (y if k else x)
        j[8], j[9] = f * (r2 + 2.0 * y * y if k else 2.0 * x * y), f * (2.0 * x * y if k else r2 + 2.0 * x * x)
        j[10], j[11], j[12] = -j[6], j[0], j[2]  # the drive's offsets: disparity bias, pitch, roll
        j[KAPPA] = j[7] + by_x * kappa_x + by_y * kappa_y + by_z * kappa_z
        j[26] = by_x * (rho_x + tx) + by_y * (rho_y + ty + lift) + by_z * (rho_z + tz + ahead)
        if pose:
            by_twist(j, by_x, by_y, by_z, qx, qy, qz, rho, pose)
