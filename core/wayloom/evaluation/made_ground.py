"""Made ground sheets: true top-down pictures of a simulated city's ground, blurred and noisy as a drive's sheets are."""

from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID
from wayloom.geometry.camera import PinholeCamera
from wayloom.ground.sheet import CELL_M, GROUND_CLASSES, LARGEST_SIGMA_MM, NO_HEIGHT, PIXEL_M, VOTE_UNIT, GroundSheet
from wayloom.simulation.city.ground import KERB_M
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.camera import developed, metered_gain
from wayloom.simulation.vehicle.vehicle_settings import SensorSettings

FloatArray = NDArray[np.float64]
ALTITUDE_M: Final = 300.0
VOTES: Final = 2.0
"""1/m of the true class in every cell."""


@dataclass(frozen=True, slots=True)
class Wear:
    """What tells a drive's sheet from the truth.

    track_y_m      north of the drive's track from the sheet's middle, m
    near_px_m      pixels a metre beside the track, falling to far_px_m at half_width_m to the side
    height_m       sigma of the heights' noise, correlated over smear_m, over which steps are smeared, too
    unseen_share   of the ground, in patches as parked cars leave them
    """

    near_px_m: float = 60.0
    far_px_m: float = 10.0
    half_width_m: float = 12.0
    track_y_m: float = 0.0
    height_m: float = 0.01
    smear_m: float = 0.08
    unseen_share: float = 0.0
    seed: int = 0


def made_sheet(world: World, centre: tuple[float, float], size_m: tuple[float, float], wear: Wear | None = None) -> GroundSheet:
    """The ground within size_m (width, height) of centre, ENU m; its T_submap_sheet is T_enu_sheet: the centre, on the ground.

    wear : None for the truth at the sheet's resolution
    """
    columns, rows = (round(size / CELL_M / 2) * 2 for size in size_m)
    low = np.array([-columns, -rows]) // 2
    z0 = float(world.city.ground.height(np.array(centre[0]), np.array(centre[1])))
    colour, label = _pictures(world, centre, (columns, rows))
    x, y = (np.arange(count) * CELL_M + (first + 0.5) * CELL_M for count, first in zip((columns, rows), low, strict=True))
    cells = label[::2, ::2]
    flat = world.city.ground.height(*np.meshgrid(x + centre[0], y + centre[1])) - z0
    height = flat + np.where(cells == CLASS_ID["road"], 0.0, KERB_M)
    T = np.eye(4)
    T[:3, 3] = [*centre, z0]
    votes = np.stack([np.where(cells == c, VOTES / VOTE_UNIT, 0) for c in GROUND_CLASSES], axis=-1).astype(np.uint16)
    true = GroundSheet(
        "made", T, low.astype(np.int32), np.zeros(2, np.int64), _millimetres(height), np.ones(height.shape, np.uint8), votes,
        colour, np.full(label.shape, 255, np.uint8),
    )  # fmt: skip
    return true if wear is None else worn(true, wear)


def worn(sheet: GroundSheet, wear: Wear) -> GroundSheet:
    """The sheet as a drive along its middle, from west to east, would have it."""
    rng = np.random.default_rng(wear.seed)
    rows, columns = sheet.sharpness.shape
    aside = np.abs((np.arange(rows) - rows / 2) * PIXEL_M - wear.track_y_m) / wear.half_width_m
    sharpness = np.repeat(np.clip(wear.near_px_m * (wear.far_px_m / wear.near_px_m) ** aside, 1, 255)[:, None], columns, axis=1)
    colour = _blurred(sheet.colour.astype(np.float32), sharpness)
    colour += rng.normal(0, 1.5, colour.shape).astype(np.float32)
    hidden = _patches(rng, sheet.height_mm.shape, wear.unseen_share)
    seen = (sheet.sharpness > 0) & ~np.kron(hidden, np.ones((2, 2), bool)) & (aside < 1.0)[:, None]
    known = seen[::2, ::2]
    sigma = wear.smear_m / CELL_M
    noise = cv2.GaussianBlur(rng.normal(0, 1, known.shape), (0, 0), max(sigma, 0.3))
    smeared = cv2.GaussianBlur(sheet.height, (0, 0), max(sigma, 0.3))
    height = smeared + noise / max(float(noise.std()), 1e-9) * wear.height_m
    return replace(
        sheet,
        height_mm=np.where(known, _millimetres(height), NO_HEIGHT).astype(np.int16),
        sigma_mm=np.full(known.shape, min(LARGEST_SIGMA_MM, np.ceil(wear.height_m * 1000)), np.uint8),
        votes=np.where(known[..., None], sheet.votes, 0).astype(np.uint16),
        colour=np.where(seen[..., None], np.clip(np.rint(colour), 0, 255), 0).astype(np.uint8),
        sharpness=np.where(seen, np.rint(sharpness), 0).astype(np.uint8),
    )


def _pictures(world: World, centre: tuple[float, float], cells: tuple[int, int]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(2 rows, 2 columns, 3) colour and (2 rows, 2 columns) train ids of the ground alone, row 0 in the south."""
    columns, rows = 2 * cells[0], 2 * cells[1]
    x = centre[0] + (np.arange(columns) - columns / 2 + 0.5) * PIXEL_M
    y = centre[1] + (np.arange(rows) - rows / 2 + 0.5) * PIXEL_M
    z = world.city.ground.height(*np.meshgrid(x, y))
    top = float(z.mean()) + ALTITUDE_M
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = [*centre, top]
    margin = 1.1
    f = ALTITUDE_M / PIXEL_M
    width, height = int(columns * margin), int(rows * margin)
    camera = PinholeCamera(f, f, (width - 1) / 2, (height - 1) / 2, width, height)
    scene = world.scene(camera, T, 0.0)
    ground = np.isin(scene.mesh.class_id, GROUND_CLASSES) & (scene.mesh.instance == 0)
    scene = replace(scene, mesh=scene.mesh.rows(ground))
    radiance = scene.image(camera, T)
    image = developed(radiance, metered_gain(radiance), camera, SensorSettings(vignette=0.0, noise=0.0), np.random.default_rng(0))
    u = (x[None] - centre[0]) * f / (top - z) + camera.cx
    v = -(y[:, None] - centre[1]) * f / (top - z) + camera.cy
    u, v = u.astype(np.float32), v.astype(np.float32)
    label = scene.truth(camera, T).class_id
    colour, labels = cv2.remap(image, u, v, cv2.INTER_LINEAR), cv2.remap(label, u, v, cv2.INTER_NEAREST)
    return colour.astype(np.uint8), labels.astype(np.uint8)


def _blurred(image: NDArray[np.float32], sharpness: FloatArray) -> NDArray[np.float32]:
    """Blurred by half an image pixel of the sharpness, between the few strengths that are made."""
    sigmas = np.array([0.0, 0.3, 0.5, 0.8, 1.2, 2.0, 3.0])
    stack = [image if s == 0 else cv2.GaussianBlur(image, (0, 0), s) for s in sigmas]
    at = np.interp(0.5 / sharpness / PIXEL_M, sigmas, np.arange(len(sigmas)))
    first = np.minimum(at.astype(int), len(sigmas) - 2)
    share = (at - first)[..., None].astype(np.float32)
    out = np.zeros_like(image)
    for k in range(len(sigmas) - 1):
        out = np.where((first == k)[..., None], (1 - share) * stack[k] + share * stack[k + 1], out)
    return out


def _patches(rng: np.random.Generator, shape: tuple[int, int], share: float) -> NDArray[np.bool_]:
    """Rectangles of 4.5 x 1.8 m until they cover the share."""
    out = np.zeros(shape, bool)
    while out.mean() < share:
        r, c = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        out[r : r + 18, c : c + 45] = True
    return out


def _millimetres(height: FloatArray) -> NDArray[np.int16]:
    return np.rint(height * 1000).astype(np.int16)
