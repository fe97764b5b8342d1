"""Training material: simulated views in memory, and random crops of them, each as another camera would take it."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

VOID = 255
CLASSES = 19
FULL_HEIGHT = 376
SMALLEST, LARGEST = 0.42, 1.15
"""Scale of the crops, where 1 is the full size of the simulator's cameras; no view is enlarged by more than 1.3."""

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Views:
    """Views of one or more sizes. images: (h, w, 3) RGB uint8 each; classes: (h, w) uint8 train ids each, 255 = void."""

    images: list[Image]
    classes: list[Image]

    def __len__(self) -> int:
        return len(self.images)


def rendered(seed: int, count: int, size: str, cache: Path) -> Views:
    """`count` views of the streets of city `seed`; rendered once and kept in the folder `cache`."""
    path = cache / f"views-{size}-{seed}-{count}.npz"
    if not path.is_file():
        from wayloom.simulation.recording.dataset import render_views

        pairs = list(render_views(seed=seed, count=count, size=size))
        cache.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        with part.open("wb") as file:
            np.savez(file, images=np.stack([p[0] for p in pairs]), classes=np.stack([p[1] for p in pairs]))
        part.replace(path)
    with np.load(path) as archive:
        return Views(list(archive["images"]), list(archive["classes"]))


def class_weights(classes: list[Image]) -> NDArray[np.float32]:
    """(CLASSES,) weight of each class: frequency to the power -0.4, mean 1, at most 8 times the least."""
    frequency = sum(np.bincount(c.ravel(), minlength=256)[:CLASSES].astype(float) for c in classes)
    share = np.maximum(frequency / frequency.sum(), 1e-4)
    weights = share**-0.4
    weights = np.minimum(weights / weights.min(), 8.0)
    return (weights / weights.mean()).astype(np.float32)


def batches(views: Views, size: int, crop: tuple[int, int], seed: int) -> Iterator[tuple[Image, Image]]:
    """Endless batches: images (size, h, w, 3) RGB uint8 and their classes (size, h, w) uint8. `crop` is (h, w)."""
    rng = np.random.default_rng(seed)
    weights = class_weights(views.classes)
    while True:
        order = rng.permutation(len(views))
        for start in range(0, len(order) - size + 1, size):
            crops = [random_crop(views.images[i], views.classes[i], crop, weights, rng) for i in order[start : start + size]]
            yield np.stack([image for image, _ in crops]), np.stack([classes for _, classes in crops])


def random_crop(
    image: Image, classes: Image, crop: tuple[int, int], weights: NDArray[np.float32], rng: np.random.Generator
) -> tuple[Image, Image]:
    """A part at a random scale, maybe mirrored, with another camera's colours, sharpness and noise.

    Half of the parts are anywhere; the others hold a pixel of a class that is drawn by its weight, so that rare things are seen.
    """
    share = image.shape[0] / FULL_HEIGHT
    scale = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(min(LARGEST, 1.3 * share))))) / share
    size = (round(crop[0] / scale), round(crop[1] / scale))
    corner = _anywhere(classes.shape, size, rng) if rng.random() < 0.5 else _around_a_rare_pixel(classes, size, weights, rng)
    part, ids = _cut(image, classes, corner, size)
    part = np.asarray(cv2.resize(part, crop[::-1], interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR), np.uint8)
    ids = np.asarray(cv2.resize(ids, crop[::-1], interpolation=cv2.INTER_NEAREST_EXACT), np.uint8)
    if rng.random() < 0.5:
        part, ids = part[:, ::-1], ids[:, ::-1]
    return _as_another_camera(np.ascontiguousarray(part), rng), np.ascontiguousarray(ids)


def _anywhere(shape: tuple[int, ...], size: tuple[int, int], rng: np.random.Generator) -> tuple[int, int]:
    """Top left corner of a part inside the view, or around it where the part is the larger."""
    top, left = (int(rng.integers(min(0, a - b), max(0, a - b) + 1)) for a, b in zip(shape, size, strict=False))
    return top, left


def _around_a_rare_pixel(
    classes: Image, size: tuple[int, int], weights: NDArray[np.float32], rng: np.random.Generator
) -> tuple[int, int]:
    """Top left corner of a part that holds a random pixel of a class of this view."""
    coarse = classes[::4, ::4]
    present = np.flatnonzero(np.bincount(coarse.ravel(), minlength=256)[:CLASSES])
    chosen = rng.choice(present, p=weights[present] / weights[present].sum())
    rows, columns = np.nonzero(coarse == chosen)
    k = int(rng.integers(len(rows)))
    corner = [4 * int(at[k]) - int(rng.integers(length)) for at, length in ((rows, size[0]), (columns, size[1]))]
    top, left = (min(max(c, min(0, a - b)), max(0, a - b)) for c, a, b in zip(corner, classes.shape, size, strict=True))
    return top, left


def _cut(image: Image, classes: Image, corner: tuple[int, int], size: tuple[int, int]) -> tuple[Image, Image]:
    """The part of the view; what lies outside repeats the view's border and counts as void."""
    height, width = classes.shape
    (top, left), (bottom, right) = corner, (corner[0] + size[0], corner[1] + size[1])
    rows, columns = slice(max(0, top), min(height, bottom)), slice(max(0, left), min(width, right))
    border = (max(0, -top), max(0, bottom - height), max(0, -left), max(0, right - width))
    part = cv2.copyMakeBorder(image[rows, columns], *border, cv2.BORDER_REPLICATE)
    ids = cv2.copyMakeBorder(classes[rows, columns], *border, cv2.BORDER_CONSTANT, value=VOID)
    return np.asarray(part, np.uint8), np.asarray(ids, np.uint8)


def _as_another_camera(image: Image, rng: np.random.Generator) -> Image:
    """Gamma, gain, white balance, contrast, saturation down to grey, blur, noise and JPEG, each by chance."""
    ramp = np.linspace(0, 1, 256, dtype=np.float32)[:, None] ** np.float32(np.exp(rng.normal(0, 0.25)))
    ramp = ramp * np.exp(rng.normal(0, 0.06, 3))
    ramp = (ramp - 0.5) * np.exp(rng.normal(0, 0.2)) + 0.5 + rng.normal(0, 0.07)
    out = cv2.LUT(image, np.clip(255 * ramp, 0, 255).astype(np.uint8)[None])
    saturation = 0.0 if rng.random() < 0.12 else float(rng.uniform(0.5, 1.4))
    grey = np.tile(np.array([0.299, 0.587, 0.114]), (3, 1))
    out = cv2.transform(out, grey + saturation * (np.eye(3) - grey))
    if rng.random() < 0.4:
        out = cv2.GaussianBlur(out, (0, 0), float(rng.uniform(0.3, 1.3)))
    if rng.random() < 0.6:
        noise = rng.standard_normal(out.shape[:2], np.float32) * np.float32(rng.uniform(0, 8))
        out = np.clip(out + noise.astype(np.int16)[..., None], 0, 255).astype(np.uint8)
    if rng.random() < 0.2:
        _, data = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(50, 95))])
        out = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return np.asarray(out, np.uint8)
