"""What a rig's file is worth on simulated rigs whose calibration is a little wrong: each drive with nothing but rows and
disparity bias, with the lens of its own images, with a file of the other drives of its rig, with the true lens, and beside it the
same way of a perfect rig; and by how many of its stated sigmas each learnt parameter is off.

    python benchmarks/calibration.py [--faults worn lens] [--judged 1 5] [--size full] [--seeds 1] [--cache FOLDER] [--sigmas]
                                     [--write]

--faults  kinds of `wayloom.simulation.vehicle.rig_faults`; each has five drives of 120 frames, 85 to 144 m
--judged  the ways on which it is measured; files are learnt from the four others
--seeds   of the choice of points; medians are told
--sigmas  only by how many sigmas the parameters are off: no drive is judged
--write   the tables into docs/calibration.md

Drives are drawn where they do not yet lie in the cache folder: half a minute to a minute of processor time for each 60 frames.
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pages import DOCS, put_between_marks
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.self_calibration import track_calibrated
from wayloom.cli.calibrate import observations_of
from wayloom.errors import InputError
from wayloom.evaluation.odometry import SEEDS
from wayloom.evaluation.odometry_table import head, row
from wayloom.evaluation.trajectory import evaluate
from wayloom.geometry.lens import PARAMETERS, RightLens
from wayloom.logs.registry import open_log
from wayloom.odometry.rig.calibration_observations import CalibrationObservations
from wayloom.odometry.settings import OdometrySettings
from wayloom.simulation.recording.presets import RIG, RIG_WAYS, DrivePlan, Preset
from wayloom.simulation.recording.simulate import OutputSettings, PresetVariant, simulate
from wayloom.simulation.vehicle.rig_faults import FAULTS
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

PAGE = DOCS / "calibration.md"
DRAWN = ("lens", "perfect", "worn")
SCALES = {"full": 1.0, "half": 0.5, "quarter": 0.25}


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one drive: ATE m, and by what share its way is too long; medians over seeds."""

    ate_m: float
    longer: float

    def cell(self, perfect: "Outcome | None" = None) -> str:
        """Error of the way's length in %, what of it is more than the perfect rig's, ATE in m."""
        more = "" if perfect is None else f" ({100 * (self.longer - perfect.longer):+.2f})"
        return f"{100 * self.longer:+.2f}{more}; {self.ate_m:.3f}"


def rigs() -> Preset:
    """The preset `rig` with all of its five ways for each of the kinds DRAWN."""
    drives = tuple(
        DrivePlan(
            vehicle_id=f"{fault}-{number}", nodes=nodes, reference=reference, before_m=before_m, frames=120, start_s=start_s,
            vehicle=VehicleSettings(right_lens=FAULTS[fault], rig_name=fault),
        )
        for fault in DRAWN
        for number, (nodes, reference, before_m, start_s) in enumerate(RIG_WAYS, start=1)
    )  # fmt: skip
    return RIG.model_copy(update={"drives": drives})


def drawn(names: list[str], size: str, cache: Path) -> dict[str, Path]:
    """The folders of these drives."""
    folders = simulate(rigs(), cache / f"rigs-{size}", OutputSettings(size=size), PresetVariant(drives=tuple(names)), progress=say)
    return {folder.name: folder for folder in folders}


def say(share: float, what: str) -> None:
    """Progress, to stderr."""
    sys.stderr.write(f"calibration benchmark: {100 * share:.0f} % {what}\n")


def outcome(folder: Path, seeds: int, lens: RightLens | None, self_calibration: bool = True) -> Outcome:
    """A drive tracked once for each seed, with a lens that is given, its own one, or none."""
    log, rows = open_log(folder), []
    if log.truth is None:
        raise InputError("has no poses to be measured against", file=folder, remedy="delete the folder: it is drawn anew")
    for seed in SEEDS[:seeds]:
        result = track_calibrated(log, OdometrySettings(seed=seed, self_calibration=self_calibration), lens=lens)
        errors = evaluate(result.trajectory.T_world_cam, log.truth)
        rows.append((errors.ate_m, errors.length_ratio - 1.0))
    ate_m, longer = np.median(rows, axis=0)
    return Outcome(float(ate_m), float(longer))


def observed(fault: str, size: str, cache: Path) -> dict[str, CalibrationObservations]:
    """The calibration observations of the five drives of a rig."""
    found = {}
    names = [f"{fault}-{k}" for k in range(1, len(RIG_WAYS) + 1)]
    for name, folder in drawn(names, size, cache).items():
        say(0.0, f"{name}: observations")
        found[name] = next(iter(observations_of(folder, 1, ())))
    return found


def ways(fault: str, observations: dict[str, CalibrationObservations], options: argparse.Namespace) -> list[str]:
    """The table of ways and ATE of one fault, as lines of Markdown."""
    size, seeds, cache = options.size, options.seeds, options.cache
    folders = drawn([*observations, *(f"perfect-{k}" for k in options.judged)], size, cache)
    truth = FAULTS[fault].lens(SCALES[size])
    lines = head(["drive", "perfect rig", "rows and bias only", "lens of its own images", "file of the four others", "true lens"])
    for k in options.judged:
        name = f"{fault}-{k}"
        say(0.0, f"{name}: judged")
        learnt = learn_rig([one for other, one in observations.items() if other != name]).rig
        perfect = outcome(folders[f"perfect-{k}"], seeds, None)
        found = [outcome(folders[name], seeds, None, self_calibration) for self_calibration in (False, True)]
        found += [outcome(folders[name], seeds, lens) for lens in (learnt.lens, truth)]
        lines.append(row([name, perfect.cell(), *(one.cell(perfect) for one in found)]))
    return [*lines, ""]


def sigmas(fault: str, observations: dict[str, CalibrationObservations], size: str) -> list[str]:
    """The table of errors in stated sigmas: a file of each drive alone, of all at once, and of one after the other."""
    truth, everyone, grown = FAULTS[fault].lens(SCALES[size]), list(observations.values()), None
    for one in everyone:
        grown = learn_rig([one], known=grown).rig
    files = {name: learn_rig([one]).rig for name, one in observations.items()}
    files |= {f"{fault}: all at once": learn_rig(everyone).rig, f"{fault}: one by one": grown}
    lines = head([f"file ({size} size)", *PARAMETERS, "mean square"])
    for name, rig in files.items():
        z = (rig.lens.values - truth.values) / rig.sigma
        lines.append(row([name, *(f"{error:+.2f}" for error in z), f"{(z**2).mean():.2f}"]))
    return [*lines, ""]


def main() -> None:
    """Measure, print, and where asked for write."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wayloom" / "benchmark-drives"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--faults", nargs="+", default=["worn", "lens"], choices=[fault for fault in DRAWN if fault != "perfect"])
    parser.add_argument("--judged", type=int, nargs="+", default=[1, 5], choices=range(1, len(RIG_WAYS) + 1))
    parser.add_argument("--size", default="full", choices=SCALES)
    parser.add_argument("--seeds", type=int, default=1, choices=range(1, len(SEEDS) + 1))
    parser.add_argument("--cache", type=Path, default=cache, help="of simulated drives")
    parser.add_argument("--sigmas", action="store_true")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    seen = {fault: observed(fault, options.size, options.cache) for fault in options.faults}
    blocks = {"calibration sigmas": [line for fault, found in seen.items() for line in sigmas(fault, found, options.size)]}
    if not options.sigmas:
        blocks["calibration benchmark"] = [line for fault, found in seen.items() for line in ways(fault, found, options)]
    for name, lines in blocks.items():
        text = "\n".join(lines)
        print(text)
        if options.write:
            put_between_marks(PAGE, name, text)


if __name__ == "__main__":
    main()
