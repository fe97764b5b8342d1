"""Deferred shading of the triangle ids of each pixel."""

import math

import numpy as np
from numba import njit

from wayloom.simulation.kernels.arrays import Float32, Float64, Int32, Light, Number, Rgb, TextureStack, Triangles, View
from wayloom.simulation.kernels.options import INLINE, KERNEL
from wayloom.simulation.kernels.raster import NO_TRIANGLE
from wayloom.simulation.kernels.sampling import anisotropic, noise
from wayloom.simulation.kernels.shadow import lit_share
from wayloom.simulation.kernels.sky import sky_radiance

Meeting = tuple[Number, Number, Number, Number, Number, Number, Number]
STEEPEST_FOOTPRINT = 0.2
"""A neighbouring pixel's ray may run at most this many times more grazing than the pixel's own."""
STAIN_LARGE, STAIN_MIDDLE, STAIN_SMALL = 0.16, 0.10, 0.11
STAIN_SMALL_TO_M = 25.0
FACET_PX, FACET_TURN = 1.5, 75.0
IN_SHADE = 0.45
"""How much of the facets' spread remains without sun."""
WAVY_GLASS, WAVE_PER_M = 0.02, 0.004
"""Spread of a pane's normal, and texture repeats a metre of it: no pane mirrors quite as its neighbour."""
DAMP_DARKENS, DAMP_GLOSS, POOL_GLOSS = 0.45, 0.35, 0.6
FLAT_ENOUGH = 0.7
MARCH_FIRST_M, MARCH_GROWTH, MARCH_STEPS = 1.2, 1.55, 10
MARCH_SOFT_M = 0.5
GLOW = 2.5
SHADOW_OFFSET_M, SHADOW_OFFSET_PER_M = 0.05, 0.0015
SHADOW_BIAS_M, FAR_BIAS_M, MOVER_BIAS_M = 0.06, 0.45, 0.04
LEAF_LEAST_LIGHT = 0.15
OPEN_OFFSET_M = 0.6
"""The open sky over a wall is that over the ground before it, not that inside the house."""
OCCLUSION_FADE_M = 9.0
"""Height above the ground at which the ground's occlusion no longer counts."""
BOUNCE = 0.2
REFLECTANCE_AT_NORMAL = 0.04
ROOFLINE, ROOFLINE_BLUR = 0.34, 0.10
"""Upward share of a ray that a dull surface mirrors over which it meets the sky rather than house fronts."""
SHINES = 0.2
"""Gloss above which a surface mirrors the houses that stand there, not a guess."""
HIGHLIGHT, HIGHLIGHT_POWER = 5.0, 200
SHEEN, SHEEN_POWER = 8.0, 12


@njit(**INLINE)
def meet(tri: Triangles, t: int, view: View, dx: float, dy: float, dz: float) -> Meeting:
    """Where the ray (dx, dy, dz) of camera depth 1 meets triangle t: depth m, barycentric l1, l2, and their pixel steps.

    With s = o - p0: depth = s.n / den, l1 = d.(e2 x s) / den, l2 = d.(s x e1) / den, den = -d.n, n = e1 x e2 (Cramer).
    """
    p, T = tri.corners[t], view.T_world_cam
    sx, sy, sz = T[0, 3] - p[0, 0], T[1, 3] - p[0, 1], T[2, 3] - p[0, 2]
    e1x, e1y, e1z = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
    e2x, e2y, e2z = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
    nx, ny, nz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
    ax, ay, az = e2y * sz - e2z * sy, e2z * sx - e2x * sz, e2x * sy - e2y * sx
    bx, by, bz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    den = -(dx * nx + dy * ny + dz * nz)
    if den == 0.0:
        den = 1e-12
    n1, n2 = dx * ax + dy * ay + dz * az, dx * bx + dy * by + dz * bz
    l1, l2 = n1 / den, n2 / den
    xx, xy, xz = T[0, 0] / view.fx, T[1, 0] / view.fx, T[2, 0] / view.fx
    yx, yy, yz = T[0, 1] / view.fy, T[1, 1] / view.fy, T[2, 1] / view.fy
    den_x, den_y = den - (xx * nx + xy * ny + xz * nz), den - (yx * nx + yy * ny + yz * nz)
    if abs(den_x) < STEEPEST_FOOTPRINT * abs(den):
        den_x = STEEPEST_FOOTPRINT * den
    if abs(den_y) < STEEPEST_FOOTPRINT * abs(den):
        den_y = STEEPEST_FOOTPRINT * den
    l1x, l2x = (n1 + xx * ax + xy * ay + xz * az) / den_x - l1, (n2 + xx * bx + xy * by + xz * bz) / den_x - l2
    l1y, l2y = (n1 + yx * ax + yy * ay + yz * az) / den_y - l1, (n2 + yx * bx + yy * by + yz * bz) / den_y - l2
    return (sx * nx + sy * ny + sz * nz) / den, l1, l2, l1x, l2x, l1y, l2y


@njit(**INLINE)
def on_plane(x: Number, y: Number, z: Number, nx: Number, ny: Number, nz: Number) -> tuple[Number, Number]:
    """The two coordinates along the plane that a surface with normal n faces most."""
    ax, ay, az = abs(nx), abs(ny), abs(nz)
    u, v = x, z
    if az >= ax and az >= ay:
        v = y
    elif ax > ay:
        u = y
    return u, v


@njit(**INLINE)
def stain(light: Light, u: float, v: float, depth: float) -> float:
    """Factor near 1 that breaks the repeats of a texture, from the place (u, v) m on the surface's plane."""
    f = (
        1.0
        + STAIN_LARGE * noise(light.stains, u * 0.013, v * 0.013)
        + STAIN_MIDDLE * noise(light.stains, u * 0.09 + 0.37, v * 0.09)
    )
    if depth < STAIN_SMALL_TO_M:
        f += STAIN_SMALL * (1.0 - depth / STAIN_SMALL_TO_M) * noise(light.stains, u * 0.8, v * 0.8)
    return max(f, 0.25)


@njit(**INLINE)
def facets(light: Light, u: float, v: float, du: float, dv: float, pixel_m: float) -> float:
    """What the facets of a rough surface add for a viewer, zero mean and unit spread: detail down to the pixel at any distance.

    (u, v) m is the place on the surface's plane, (du, dv) the view's direction along it. Another direction meets other facets: the
    pattern moves by FACET_TURN texels a radian, which tells left from right. Two octaves are mixed, so that it changes smoothly.
    """
    octave = math.log2(max(FACET_PX * pixel_m, 1e-4))
    k = math.floor(octave)
    coarser = octave - k
    scale = 2.0**-k / light.facets.shape[0]
    su, sv = du * FACET_TURN / light.facets.shape[0], dv * FACET_TURN / light.facets.shape[0]
    fine = noise(light.facets, u * scale + su, v * scale + sv)
    return fine + coarser * (noise(light.facets, u * 0.5 * scale + su, v * 0.5 * scale + sv) - fine)


@njit(**INLINE)
def sunlit(light: Light, px: float, py: float, pz: float) -> float:
    """Share of the sun's light that reaches a point."""
    share = lit_share(light.near, light.axes, px, py, pz, SHADOW_BIAS_M)
    if share < 0.0:
        share = abs(lit_share(light.far, light.axes, px, py, pz, FAR_BIAS_M))  # outside both maps: -1, lit
    if share > 0.0:
        share *= abs(lit_share(light.movers, light.axes, px, py, pz, MOVER_BIAS_M))
    return share


@njit(**INLINE)
def sky_share(light: Light, px: float, py: float, pz: float) -> float:
    """Share of the sky that a point sees: the ground's, growing to 1 with height."""
    x = int((px - light.openness.x0) * light.openness.texels_per_m)
    y = int((py - light.openness.y0) * light.openness.texels_per_m)
    if x < 0 or y < 0 or x >= light.ground.shape[1] or y >= light.ground.shape[0]:
        return 1.0
    share, above = light.openness.values[y, x], pz - light.ground[y, x]
    return share + (1.0 - share) * min(max(above / OCCLUSION_FADE_M, 0.0), 1.0)


@njit(**KERNEL)
def open_along(light: Light, px: float, py: float, pz: float, rx: float, ry: float, rz: float) -> float:
    """How free the way from a point along the unit direction r is of standing things: 0 blocked … 1 open, soft at their tops."""
    free, t = 1.0, MARCH_FIRST_M
    for _ in range(MARCH_STEPS):
        x = int((px + rx * t - light.openness.x0) * light.openness.texels_per_m)
        y = int((py + ry * t - light.openness.y0) * light.openness.texels_per_m)
        if x < 0 or y < 0 or x >= light.surface.shape[1] or y >= light.surface.shape[0]:
            break
        above = pz + rz * t - light.surface[y, x]
        free = min(free, max(0.5 + above / MARCH_SOFT_M, 0.0))
        t *= MARCH_GROWTH
    return free


@njit(**INLINE)
def mirrored(light: Light, gloss: float, px: float, py: float, pz: float, rx: float, ry: float, rz: float) -> Rgb:
    """Linear RGB that comes to a point from the unit direction r: sky over house fronts, looked up for what shines."""
    front = np.float32(0.13 + 0.03 * noise(light.stains, (rx - ry) * 0.08 + px * 0.004, py * 0.004))
    s0, s1, s2 = front * np.float32(1.1), front, front * np.float32(0.9)
    if gloss > SHINES:
        above = open_along(light, px, py, pz, rx, ry, rz) if rz > 0.0 else 0.0
    else:
        above = min(max((rz - ROOFLINE) / ROOFLINE_BLUR, 0.0), 1.0)
    if above > 0.0:
        k0, k1, k2 = sky_radiance(light, rx, ry, rz)
        s0, s1, s2 = s0 + (k0 - s0) * above, s1 + (k1 - s1) * above, s2 + (k2 - s2) * above
    return s0, s1, s2


@njit(**INLINE)
def reflect(
    light: Light,
    r: Number,
    g: Number,
    b: Number,
    gloss: float,
    pane: bool,
    share: float,
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    qx: float,
    qy: float,
    qz: float,
    facing: float,
) -> Rgb:
    """Mix what a glossy surface mirrors (sky, house fronts, sun) into its colour. facing is d.q <= 0."""
    rx, ry, rz = dx - 2 * facing * qx, dy - 2 * facing * qy, dz - 2 * facing * qz
    grazing = 1.0 + facing
    if pane:  # window panes and windscreens mirror more than paint and water
        weight = gloss * (0.22 + 0.78 * grazing**4)
    else:
        weight = gloss * (REFLECTANCE_AT_NORMAL + (1 - REFLECTANCE_AT_NORMAL) * grazing**5)
    s0, s1, s2 = mirrored(light, gloss, px, py, pz, rx, ry, rz)
    r, g, b = r + (s0 - r) * weight, g + (s1 - g) * weight, b + (s2 - b) * weight
    toward_sun = rx * light.axes[2, 0] + ry * light.axes[2, 1] + rz * light.axes[2, 2]
    if share > 0.0 and toward_sun > 0.0:
        if gloss > 0.2:
            glint = share * gloss * HIGHLIGHT * toward_sun**HIGHLIGHT_POWER
        else:  # a rough surface spreads the sun's image wide; it is bright only where the view grazes it
            glint = share * gloss * SHEEN * grazing**3 * toward_sun**SHEEN_POWER
        r, g, b = r + glint * light.sun_rgb[0], g + glint * light.sun_rgb[1], b + glint * light.sun_rgb[2]
    return r, g, b


@njit(**INLINE)
def wet(light: Light, px: float, py: float) -> tuple[float, float]:
    """Share by which damp darkens flat ground at (px, py) m, and its gloss: a film of water, and pools where the ground is low."""
    low = 0.6 * noise(light.stains, px * 0.011, py * 0.011) + 0.3 * noise(light.stains, px * 0.07 + 0.2, py * 0.07)
    pool = min(max(2.0 * (light.wetness - 0.75) + low, 0.0), 1.0)
    return DAMP_DARKENS * light.wetness, DAMP_GLOSS * light.wetness + POOL_GLOSS * pool


@njit(**INLINE)
def surface_colour(
    tri: Triangles, t: int, tex: TextureStack, light: Light, view: View, dx: float, dy: float, dz: float, inv_len: float
) -> Rgb:
    """Linear RGB of triangle t along the ray (dx, dy, dz), whose length is 1 / inv_len."""
    depth, l1, l2, l1x, l2x, l1y, l2y = meet(tri, t, view, dx, dy, dz)
    uv, n, layer = tri.uv[t], tri.normals[t], tri.material[t]
    u1, v1, u2, v2 = uv[1, 0] - uv[0, 0], uv[1, 1] - uv[0, 1], uv[2, 0] - uv[0, 0], uv[2, 1] - uv[0, 1]
    r, g, b, al = anisotropic(
        tex, layer, uv[0, 0] + l1 * u1 + l2 * u2, uv[0, 1] + l1 * v1 + l2 * v2,
        l1x * u1 + l2x * u2, l1x * v1 + l2x * v2, l1y * u1 + l2y * u2, l1y * v1 + l2y * v2,
    )  # fmt: skip
    T = view.T_world_cam
    px, py, pz = T[0, 3] + dx * depth, T[1, 3] + dy * depth, T[2, 3] + dz * depth
    l0 = 1.0 - l1 - l2
    qx, qy = l0 * n[0, 0] + l1 * n[1, 0] + l2 * n[2, 0], l0 * n[0, 1] + l1 * n[1, 1] + l2 * n[2, 1]
    qz = l0 * n[0, 2] + l1 * n[1, 2] + l2 * n[2, 2]
    inv_q = 1.0 / max(1e-6, math.sqrt(qx * qx + qy * qy + qz * qz))
    qx, qy, qz = qx * inv_q, qy * inv_q, qz * inv_q
    leafy = tex.cutout[layer] == 1 and tex.smooth[layer] == 0
    dx, dy, dz = dx * inv_len, dy * inv_len, dz * inv_len
    facing = dx * qx + dy * qy + dz * qz
    if facing > 0.0 and not leafy:
        qx, qy, qz, facing = -qx, -qy, -qz, -facing
    sun_cos = qx * light.axes[2, 0] + qy * light.axes[2, 1] + qz * light.axes[2, 2]
    if leafy:  # light shines through leaves
        sun_cos = 0.25 + 0.75 * max(sun_cos, 0.0)
    share = 0.0
    if sun_cos > 0.0:
        off = SHADOW_OFFSET_M + SHADOW_OFFSET_PER_M * depth
        share = sunlit(light, px + qx * off, py + qy * off, pz + qz * off)
        if leafy:
            share = max(share, LEAF_LEAST_LIGHT)
    open_sky = sky_share(light, px + qx * OPEN_OFFSET_M, py + qy * OPEN_OFFSET_M, pz)
    ambient, bounce = (0.55 + 0.45 * qz) * open_sky, BOUNCE * (0.5 - 0.5 * qz) * (0.4 + 0.6 * open_sky)
    direct = share * max(sun_cos, 0.0)
    f = np.float32(1.0)
    if tex.smooth[layer] == 0:
        u, v = on_plane(px, py, pz, qx, qy, qz)
        du, dv = on_plane(dx, dy, dz, qx, qy, qz)
        spread = tex.relief[layer] * (IN_SHADE + (1.0 - IN_SHADE) * share)
        f = stain(light, u, v, depth) * max(1.0 + spread * facets(light, u, v, du, dv, depth / view.fx), 0.2)
    gloss, pane = al, al >= 0.5 and tex.cutout[layer] == 0
    if light.wetness > 0.0 and qz > FLAT_ENOUGH and not leafy and not pane:
        darker, gloss = wet(light, px, py)
        f *= 1.0 - darker
    if pane:
        qx += WAVY_GLASS * noise(light.stains, px * WAVE_PER_M, (py + pz) * WAVE_PER_M)
        qy += WAVY_GLASS * noise(light.stains, py * WAVE_PER_M, (px + pz) * WAVE_PER_M)
        qz += WAVY_GLASS * noise(light.stains, (px + py) * WAVE_PER_M, pz * WAVE_PER_M)
    r0, g0, b0 = r * tri.tint[t, 0], g * tri.tint[t, 1], b * tri.tint[t, 2]
    r = r0 * f * (direct * light.sun_rgb[0] + ambient * light.sky_rgb[0] * 1.5 + bounce * light.sun_rgb[0] * 0.4)
    g = g0 * f * (direct * light.sun_rgb[1] + ambient * light.sky_rgb[1] * 1.35 + bounce * light.sun_rgb[1] * 0.4)
    b = b0 * f * (direct * light.sun_rgb[2] + ambient * light.sky_rgb[2] * 1.1 + bounce * light.sun_rgb[2] * 0.4)
    if tex.cutout[layer] == 0 and gloss > 0.01:
        r, g, b = reflect(light, r, g, b, gloss, pane, share, px, py, pz, dx, dy, dz, qx, qy, qz, facing)
    if tex.glow[layer] > 0.0:
        r, g, b = r + GLOW * tex.glow[layer] * r0 * r0, g + GLOW * tex.glow[layer] * g0 * g0, b + GLOW * tex.glow[layer] * b0 * b0
    fog = 1.0 - math.exp(-light.haze_per_m * depth / inv_len)
    r, g, b = r + (light.horizon_rgb[0] - r) * fog, g + (light.horizon_rgb[1] - g) * fog, b + (light.horizon_rgb[2] - b) * fog
    return np.float32(r), np.float32(g), np.float32(b)


@njit(**INLINE)
def pixel_colour(t: int, x: float, y: float, tri: Triangles, tex: TextureStack, light: Light, view: View) -> Rgb:
    """Linear RGB seen from pixel position (x, y) of triangle t, or of the sky for NO_TRIANGLE."""
    a, b, T = (x - view.cx) / view.fx, (y - view.cy) / view.fy, view.T_world_cam
    dx, dy = T[0, 0] * a + T[0, 1] * b + T[0, 2], T[1, 0] * a + T[1, 1] * b + T[1, 2]
    dz = T[2, 0] * a + T[2, 1] * b + T[2, 2]
    inv_len = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    if t == NO_TRIANGLE:
        return sky_radiance(light, dx * inv_len, dy * inv_len, dz * inv_len)
    return surface_colour(tri, t, tex, light, view, dx, dy, dz, inv_len)


@njit(**KERNEL)
def gather(ids: Int32, x: int, y: int, seen: Int32, count: Int32, mean_x: Float64, mean_y: Float64) -> int:
    """The triangles among the four samples of pixel (x, y): fill seen, count and the sums of their places; returns how many."""
    distinct = 0
    for j in range(2):
        for i in range(2):
            t, q = ids[2 * y + j, 2 * x + i], 0
            while q < distinct and seen[q] != t:
                q += 1
            if q == distinct:
                seen[q], count[q], mean_x[q], mean_y[q] = t, 0, 0.0, 0.0
                distinct += 1
            count[q] += 1
            mean_x[q] += 0.5 * i - 0.25
            mean_y[q] += 0.5 * j - 0.25
    return distinct


@njit(**KERNEL)
def shade_samples(
    ids: Int32, tri: Triangles, tex: TextureStack, light: Light, view: View, out: Float32, numbers: Int32, means: Float64
) -> None:
    """Fill out (H, W, 3) float32 linear from ids (2H, 2W): each triangle that a pixel sees is shaded once, where it is seen on
    average, and weighs as many quarters as it has samples. Scratch: numbers (2, 4) int32, means (2, 4) float64."""
    seen, count, mean_x, mean_y = numbers[0], numbers[1], means[0], means[1]
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            first, distinct = ids[2 * y, 2 * x], 1
            seen[0], count[0], mean_x[0], mean_y[0] = first, 4, 0.0, 0.0
            if ids[2 * y, 2 * x + 1] != first or ids[2 * y + 1, 2 * x] != first or ids[2 * y + 1, 2 * x + 1] != first:
                distinct = gather(ids, x, y, seen, count, mean_x, mean_y)
            out[y, x, 0] = out[y, x, 1] = out[y, x, 2] = 0.0
            for q in range(distinct):
                r, g, b = pixel_colour(seen[q], x + mean_x[q] / count[q], y + mean_y[q] / count[q], tri, tex, light, view)
                weight = np.float32(0.25 * count[q])
                out[y, x, 0] += weight * r
                out[y, x, 1] += weight * g
                out[y, x, 2] += weight * b
