"""Draws the contact sheets of the simulation: `python docs/pictures/simulation_presets.py [presets|weathers]`.

simulation_presets.jpg has one frame of each preset, simulation_weathers.jpg one place in each weather of `light.WEATHERS`.
"""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.city.instance_ids import FIRST_MOVER
from wayloom.simulation.recording.presets import DEMO, PRESETS, Preset
from wayloom.simulation.recording.record_drive import plan_recording, route_plan
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.light import WEATHERS, CityLight
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors.capture import CaptureSettings, StereoCamera, capture
from wayloom.simulation.traffic.drives import plan_drives
from wayloom.simulation.vehicle.rigs import sized_rig

FOLDER = Path(__file__).parent
COLUMNS, WIDTH, HEIGHT = 2, 704, 188
MOST_BYTES = 400_000
Image = NDArray[np.uint8]
SHOWN = {
    "demo": (0, 18), "fleet": (4, 60), "photometry": (0, 20), "rig": (0, 40), "benchmark": (0, 90), "long": (0, 150),
}  # fmt: skip
"""Drive and frame of each preset; of `movers` the fullest, of the others frame 30 of the first drive."""
LOOK_EVERY = 10


def frame_of(preset: Preset, world: World, number: int, frame: int) -> Image:
    """(HEIGHT, WIDTH, 3) BGR: what the left camera records; exposure control starts a second before."""
    drives = plan_drives(world.city, [route_plan(plan, preset) for plan in preset.drives])
    recording = plan_recording(preset, number, drives[number])
    camera = StereoCamera(recording.plan.vehicle, "half", recording.motion)
    around = replace(world, traffic=recording.drive.traffic)
    t_s = recording.t_s[frame - 1 : frame + 1]
    *_, pair = capture(camera, around, t_s, CaptureSettings(recording.drive.left_out, False, (0,)))
    return np.asarray(cv2.resize(pair.left[..., ::-1], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)


def moving_shares(preset: Preset, world: World, number: int) -> dict[int, float]:
    """How much of the left image moves in every LOOK_EVERYth frame of a drive."""
    drives = plan_drives(world.city, [route_plan(plan, preset) for plan in preset.drives])
    recording = plan_recording(preset, number, drives[number])
    around, camera = replace(world, traffic=recording.drive.traffic), sized_rig("quarter").camera
    out = {}
    for frame in range(1, len(recording), LOOK_EVERY):
        T_enu_cam = recording.T_enu_cam[frame]
        scene = around.scene(camera, T_enu_cam, float(recording.t_s[frame]), recording.drive.left_out)
        out[frame] = float(np.mean(scene.truth(camera, T_enu_cam).instance >= FIRST_MOVER))
    return out


def fullest(preset: Preset, world: World) -> tuple[int, int]:
    """Drive and frame in which most of the image moves."""
    shares = {(k, f): share for k in range(len(preset.drives)) for f, share in moving_shares(preset, world, k).items()}
    return max(shares, key=lambda at: shares[at])


def named(image: Image, name: str) -> Image:
    """The image with its name on a dark corner."""
    out = image.copy()
    (width, height), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
    out[: height + 12, : width + 14] //= 3
    cv2.putText(out, name, (7, height + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA)
    return out


def write_sheet(path: Path, images: list[Image]) -> None:
    """A JPEG of MOST_BYTES at most, COLUMNS images wide."""
    blank = [np.zeros_like(images[0])] * (-len(images) % COLUMNS)
    rows = [np.hstack((images + blank)[k : k + COLUMNS]) for k in range(0, len(images), COLUMNS)]
    for quality in range(92, 40, -3):
        _, data = cv2.imencode(".jpg", np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) <= MOST_BYTES:
            break
    path.write_bytes(data.tobytes())


def presets() -> None:
    """One frame of each preset."""
    images = []
    for name, preset in PRESETS.items():
        world = build_world(preset.city, preset.light, "half")
        number, frame = fullest(preset, world) if name == "movers" else SHOWN.get(name, (0, 30))
        images.append(named(frame_of(preset, world, number, frame), name))
    write_sheet(FOLDER / "simulation_presets.jpg", images)


def weathers() -> None:
    """One place in all weathers."""
    world = build_world(DEMO.city, DEMO.light, "half")
    images = []
    for name, settings in WEATHERS.items():
        light = CityLight(world.city, world.textures, settings)
        images.append(named(frame_of(DEMO, replace(world, light=light), 0, 18), name))
    images.append(named(frame_of(DEMO, world, 0, 18), "as in the presets"))
    write_sheet(FOLDER / "simulation_weathers.jpg", images)


if __name__ == "__main__":
    chosen = sys.argv[1:] or ["presets", "weathers"]
    for sheet in chosen:
        {"presets": presets, "weathers": weathers}[sheet]()
