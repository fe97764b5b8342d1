"""Stereo capture along a drive: rendering, exposure control, image development, ground truth.

Rendering and development run in threads; exposure control goes from frame to frame between them. The images do not depend on the
number of threads.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry.camera import PinholeCamera
from wayloom.logs.types import Image
from wayloom.simulation.rendering.renderer import Truth, World
from wayloom.simulation.sensors import exposure as control
from wayloom.simulation.sensors.camera import developed
from wayloom.simulation.sensors.exposure import Exposure
from wayloom.simulation.sensors.glare import open_sky_at_sun, with_glare
from wayloom.simulation.sensors.optics import TrueCamera, culling_camera, through_lens, true_cameras, truth_of
from wayloom.simulation.vehicle.motion import Motion, camera_poses, twists
from wayloom.simulation.vehicle.rigs import given_rig
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Captured:
    """One stereo pair: images (h, w, 3) RGB, exposures, ground truth of both true cameras where asked for, and the exposure factors
    (left, right) from which the next frame goes on."""

    left: Image
    right: Image
    exposures: tuple[Exposure, Exposure]
    truth: tuple[Truth, Truth] | None
    factors: tuple[float, float]

    @property
    def exposure_s(self) -> tuple[float, float]:
        """Equivalent exposure times at gain 1, left and right, s."""
        return self.exposures[0].exposure_s * self.exposures[0].gain, self.exposures[1].exposure_s * self.exposures[1].gain


@dataclass(frozen=True, slots=True)
class RenderedPair:
    """A rendered pair before exposure. Tuples are of left and right.

    radiance    as drawn, before the lens
    depth       (h, w) of the images' pixels, where it is needed
    twist       (6,) of each camera
    sun_cam     (3,) direction to the sun in each camera's frame
    """

    radiance: tuple[F32, F32]
    truth: tuple[Truth, Truth] | None
    twist: tuple[F64, F64]
    sun_cam: tuple[F64, F64]
    sun_rgb: F32


class StereoCamera:
    """The stereo cameras of a vehicle. `render` and `develop` may run in several threads."""

    def __init__(self, vehicle: VehicleSettings, size: str, motion: Motion) -> None:
        self.vehicle, self.motion = vehicle, motion
        self.given: PinholeCamera = given_rig(vehicle, size).camera
        self.cameras: tuple[TrueCamera, TrueCamera] = true_cameras(vehicle, size)
        self.sensors = (vehicle.left, vehicle.right)
        self._culling = culling_camera(self.cameras)
        self._needs_depth = vehicle.motion_blur or vehicle.glare.sun > 0

    def poses(self, t_s: float) -> tuple[F64, F64]:
        """T_enu_cam (4, 4) of the true left and right camera."""
        left = camera_poses(self.motion, self.vehicle.T_body_cam, np.array([t_s]))[0]
        return left, left @ self.cameras[1].T_left_cam

    def render(self, world: World, t_s: float, left_out: frozenset[int], truth: bool) -> RenderedPair:
        """Render both images before exposure at one moment: the middle of the exposure."""
        T = self.poses(t_s)
        scene = world.scene(self._culling, T[0], t_s, left_out)
        seen = [(camera, pose, scene.fine_ids(camera.rendered, pose)) for camera, pose in zip(self.cameras, T, strict=True)]
        radiance = [scene.shaded(ids, camera.rendered, pose) for camera, pose, ids in seen]
        needed = truth or self._needs_depth
        truths = [truth_of(scene, camera, pose, ids) for camera, pose, ids in seen] if needed else None
        twist = tuple(twists(self.motion, self.vehicle.T_body_cam @ c.T_left_cam, np.array([t_s]))[0] for c in self.cameras)
        sun = scene.light.axes[2].astype(float)
        return RenderedPair(
            (radiance[0], radiance[1]),
            None if truths is None else (truths[0], truths[1]),
            (twist[0], twist[1]),
            (T[0][:3, :3].T @ sun, T[1][:3, :3].T @ sun),
            scene.light.sun_rgb * np.float32(1 - scene.light.cloud_cover),
        )

    def metered(self, rendered: RenderedPair) -> tuple[float, float]:
        """Metered means of left and right, for exposure control."""
        settings = self.vehicle.exposure
        left = control.metered(rendered.radiance[0], settings) * self.sensors[0].gain
        return left, control.metered(rendered.radiance[1], settings) * self.sensors[1].gain if settings.each_for_itself else left

    def develop(self, rendered: RenderedPair, side: int, exposure: Exposure, light: float, rng: np.random.Generator) -> Image:
        """(h, w, 3) uint8 image of one side (0 left, 1 right). light: factor on all radiance."""
        camera, sensor, vehicle = self.cameras[side], self.sensors[side], self.vehicle
        depth = None if rendered.truth is None else rendered.truth[side].depth
        motion = rendered.twist[side] * exposure.exposure_s if vehicle.motion_blur else None
        x = through_lens(rendered.radiance[side], camera, sensor.blur_px, depth if motion is not None else None, motion)
        if vehicle.glare.veil > 0 or vehicle.glare.sun > 0:
            open_sky = 0.0 if depth is None else open_sky_at_sun(depth, camera, rendered.sun_cam[side])
            x = with_glare(x, camera, vehicle.glare, rendered.sun_cam[side], rendered.sun_rgb, open_sky)
        return developed(x, exposure.factor * light, self.given, sensor, rng, exposure.gain)


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """Instance numbers that are not rendered, whether ground truth is kept, and the seed of the sensors' noise.

    Each frame and side has its own random stream of the seed.
    """

    left_out: frozenset[int]
    truth: bool
    seed: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class ResumePoint:
    """The frame to begin with, and the exposure factors (left, right) of the one before it."""

    first: int = 0
    factors: tuple[float, float] | None = None


def capture(
    camera: StereoCamera,
    world: World,
    t_s: F64,
    settings: CaptureSettings,
    threads: int = 1,
    resume: ResumePoint = ResumePoint(),
    keep: Callable[[int, Captured], None] | None = None,
) -> Iterator[Captured]:
    """The pairs at t_s (N,) s since the city's time zero, in order; the drive starts at t_s[0].

    keep     called with each frame's index and pair in the threads, before the pair is yielded
    """
    first, factors = resume.first, resume.factors
    control_settings, start_s = camera.vehicle.exposure, float(t_s[0]) if len(t_s) else 0.0
    before_s = float(t_s[first - 1]) if first else start_s

    def developed_pair(
        index: int, rendered: RenderedPair, exposures: tuple[Exposure, Exposure], light: float, reached: tuple[float, float]
    ) -> Captured:
        left, right = (
            camera.develop(rendered, side, exposures[side], light, np.random.default_rng([*settings.seed, index, side]))
            for side in (0, 1)
        )
        captured = Captured(left, right, exposures, rendered.truth if settings.truth else None, reached)
        if keep is not None:
            keep(index, captured)
        return captured

    with ThreadPoolExecutor(threads) as pool:
        rendering: deque[Future[RenderedPair]] = deque()
        developing: deque[Future[Captured]] = deque()
        for index in range(first, len(t_s) + threads):
            if index < len(t_s):
                rendering.append(pool.submit(camera.render, world, float(t_s[index]), settings.left_out, settings.truth))
            frame = index - threads
            if frame < first:
                continue
            rendered, now_s = rendering.popleft().result(), float(t_s[frame])
            light = control.light_factor(control_settings.light_changes, now_s - start_s)
            means = camera.metered(rendered)
            previous = factors or (None, None)
            of_left = control.next_factor(previous[0], means[0] * light, now_s - before_s, control_settings)
            of_right = control.next_factor(previous[1], means[1] * light, now_s - before_s, control_settings)
            factors, before_s = (of_left, of_right), now_s
            exposures = (control.exposure_of(of_left, control_settings), control.exposure_of(of_right, control_settings))
            developing.append(pool.submit(developed_pair, frame, rendered, exposures, light, factors))
            if len(developing) >= threads:
                yield developing.popleft().result()
        while developing:
            yield developing.popleft().result()
