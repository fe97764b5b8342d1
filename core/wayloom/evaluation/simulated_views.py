"""Simulator benchmark: image statistics beside photographs, segmentation of simulated views, rendering cost."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_COUNT, CLASS_NAMES
from wayloom.errors import StageError
from wayloom.evaluation.label_scores import count
from wayloom.evaluation.labelled_images import ImageScores
from wayloom.segmentation.network import Network
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.recording.dataset import StereoView, render_pairs
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import LightSettings
from wayloom.simulation.rendering.outlines import without_holes
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.camera import developed, metered_gain
from wayloom.simulation.sensors.optics import through_lens, true_cameras, truth_of
from wayloom.simulation.vehicle.rigs import camera_on_ground, given_rig
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

FOUND_PERCENT = 25.0
"""IoU from which a network is said to find a class."""
CAMVID_MEANS: Final = {0: (10,), 1: (2,), 2: (5,), 3: (0,), 4: (1,), 5: (8,), 6: (7,), 7: (4,), 8: (13,), 9: (11,), 10: (12, 18)}
"""Which of our classes a class of CamVid mostly is; that it finds its cars says nothing about buses, which are cars to it."""
SPEED_STEP_M = 1.0
PROTOTYPE_FILES = ("citygen.py", "make_city.py", "make_textures.py", "nbr.py", "outseq.py", "render_raster.py", "imugnss.py")
PROTOTYPE_FRAMES = 12


@dataclass(frozen=True, slots=True)
class ClassRow:
    """IoU in percent of one class on labelled KITTI, CamVid (where several of ours are one) and simulated images; None: absent."""

    name: str
    kitti: float | None
    camvid: float | None
    simulated: float | None
    share: float

    @property
    def found_on_real(self) -> bool:
        """Whether the network finds the class on photographs."""
        return max(self.kitti or 0.0, self.camvid or 0.0) >= FOUND_PERCENT

    @property
    def falls_short(self) -> bool:
        """Found on photographs, not on simulated images that hold it."""
        return self.found_on_real and self.simulated is not None and self.simulated < FOUND_PERCENT


@dataclass(frozen=True, slots=True)
class Cost:
    """CPU seconds: set-up of the city, and each stereo pair with the truth of both cameras (median)."""

    set_up_s: float
    pair_s: float

    def as_json(self) -> dict[str, float]:
        """The numbers by name."""
        return asdict(self)


def views_of_cities(seeds: Sequence[int], count_each: int, size: str = "full") -> list[StereoView]:
    """Stereo pairs from random places of several cities in everyday light, the same at each call."""
    views: list[StereoView] = []
    for seed in seeds:
        world = build_world(CitySettings(seed=seed), LightSettings(), size)
        for k in range(count_each):
            views += render_pairs(world, 1, size, np.random.default_rng([seed, k, 5]))
    return views


def counts_of_views(network: Network, views: Iterable[StereoView]) -> NDArray[np.int64]:
    """(19, 256) pixels of each true class that got each label; things have no holes, as on labelled photographs."""
    total = np.zeros((CLASS_COUNT, 256), np.int64)
    for view in views:
        total += count(without_holes(view.truth).ravel(), network.labels(view.left).ravel())
    return total


def accuracy(counts: NDArray[np.int64]) -> float:
    """Percent of pixels with the right label."""
    return 100.0 * float(np.trace(counts[:, :CLASS_COUNT]) / max(counts.sum(), 1))


def class_rows(counts: NDArray[np.int64], kitti: ImageScores, camvid: ImageScores) -> list[ClassRow]:
    """One row a class: photographs beside simulated images."""
    camvid_of = {ours: camvid.iou.get(theirs) for theirs, members in CAMVID_MEANS.items() for ours in members}
    hits, of_class, found = np.diag(counts), counts.sum(axis=1), counts.sum(axis=0)
    return [
        ClassRow(
            name,
            kitti.iou.get(c),
            camvid_of.get(c),
            100.0 * float(hits[c] / (of_class[c] + found[c] - hits[c])) if of_class[c] else None,
            100.0 * float(of_class[c] / counts.sum()),
        )
        for c, name in enumerate(CLASS_NAMES)
    ]


def cost_of(size: str, frames: int, seed: int = 7) -> Cost:
    """CPU seconds on this machine, compiled kernels loaded before: a drive of `frames` pairs along a street, 1 m apart."""
    start = time.process_time()
    world = build_world(CitySettings(seed=seed), LightSettings(), size)
    set_up_s = time.process_time() - start
    graph = world.city.graph
    street = graph.inner_streets()[0]
    a, b = graph.nodes[street.a], graph.nodes[street.b]
    along = (b - a) / np.hypot(*(b - a))
    spent = []
    for k in range(frames + 1):
        x, y = a + along * (12.0 + SPEED_STEP_M * k) + 1.9 * np.array([along[1], -along[0]])
        T_world_left = camera_on_ground(float(x), float(y), float(np.arctan2(along[1], along[0])), k)
        start = time.process_time()
        _draw_with_truth(world, size, T_world_left, 0.1 * k)
        spent.append(time.process_time() - start)
    return Cost(set_up_s, float(np.median(spent[1:])))


def _draw_with_truth(world: World, size: str, T_world_left: NDArray[np.float64], t_s: float) -> None:
    """Render one stereo pair with its truth, without writing it."""
    vehicle = VehicleSettings()
    cameras, given = true_cameras(vehicle, size), given_rig(vehicle, size).camera
    scene = world.scene(given, T_world_left, t_s)
    for k, camera in enumerate(cameras):
        T_world_cam = T_world_left @ camera.T_left_cam
        light = through_lens(scene.image(camera.rendered, T_world_cam), camera, vehicle.left.blur_px)
        developed(light, metered_gain(light), given, vehicle.left, np.random.default_rng(k))
        truth_of(scene, camera, T_world_cam)


def cost_of_prototype(folder: Path) -> float:
    """CPU seconds a pair (median) of the prototype in `folder`, run in a copy. Raises StageError where it does not run."""
    with tempfile.TemporaryDirectory() as place:
        for name in PROTOTYPE_FILES:
            shutil.copy(folder / name, place)
        environment = {**os.environ, "NUMBA_NUM_THREADS": "1"}
        commands = (["make_textures.py"], ["make_city.py"], ["render_raster.py", "0", str(PROTOTYPE_FRAMES), "out"])
        for command in commands:
            done = subprocess.run(
                [sys.executable, *command], cwd=place, env=environment, capture_output=True, text=True, check=False
            )
            if done.returncode:
                why = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
                raise StageError(f"the prototype's {command[0]} failed: {why}")
    found = re.search(r"CPU s/pair best [\d.]+ median ([\d.]+)", done.stdout)
    if found is None:
        raise StageError("the prototype did not say what a pair costs")
    return float(found.group(1))
