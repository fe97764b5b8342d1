"""Label benchmark (the paper's sec. IV): map points labelled from single images, by TCL mono and stereo, and by default.

Points, depths, poses and observers are those of the odometry.
"""

import hashlib
import json
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.self_calibration import track_calibrated
from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError, WayloomError
from wayloom.evaluation.label_gains import Gain, Tally, gain, pieces, pooled, tally
from wayloom.evaluation.label_matching import REASONS, Matches, MatchSettings, match_points
from wayloom.evaluation.label_scores import Counts, LabelScores, count, scores
from wayloom.evaluation.label_truth import LabelledDrive
from wayloom.labelling.settings import PAPER, LabellingSettings
from wayloom.labelling.tcl import label_points
from wayloom.labelling.voting_frames import voting_frames
from wayloom.odometry.result.odometry_file import load_odometry, save_odometry
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.segmentation.network import Network
from wayloom.segmentation.stage import segment_keyframes

ROWS: Final = ("baseline", "tcl_mono", "tcl_stereo", "best")
FORMS: Final = {"baseline": "baseline", "tcl_mono": "mono", "tcl_stereo": "stereo"}
"""The paper's rows and the fields of `PointLabels` that they are."""


@dataclass(frozen=True, slots=True)
class LabelBenchmarkSettings:
    """variants: further rows by name, beside the paper's and `best` (the default form); match: the filters; odometry: tracking."""

    variants: Mapping[str, LabellingSettings] = field(default_factory=dict)
    match: MatchSettings = field(default_factory=MatchSettings)
    odometry: OdometrySettings = field(default_factory=OdometrySettings)


@dataclass(frozen=True, slots=True)
class LabelledPoints:
    """One labelled drive. labels: row of the table to labels (P,); images: of its keyframes, as long as the folder is there."""

    drive: LabelledDrive
    odometry: OdometryResult
    matches: Matches
    labels: dict[str, NDArray[np.uint8]]
    images: KeyframeLabels


@dataclass(frozen=True, slots=True)
class LabelBenchmark:
    """Rows of the table, pooled over the drives: with the paper's filters, and with points at label boundaries as well.

    gains, gains_with_boundaries: of each row but the first over the first
    """

    model: str
    drives: tuple[str, ...]
    filters: dict[str, int]
    rows: dict[str, LabelScores]
    rows_with_boundaries: dict[str, LabelScores]
    losses: dict[str, str] = field(default_factory=dict)
    gains: dict[str, Gain] = field(default_factory=dict)
    gains_with_boundaries: dict[str, Gain] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """What `--json` writes."""
        return {
            "rows": {name: row.as_json() for name, row in self.rows.items()},
            "filters": self.filters,
            "with_boundaries": {name: row.as_json() for name, row in self.rows_with_boundaries.items()},
            "model": self.model, "drives": list(self.drives), "left_out": self.losses,
            "gains": {name: asdict(value) for name, value in self.gains.items()},
            "gains_with_boundaries": {name: asdict(value) for name, value in self.gains_with_boundaries.items()},
        }  # fmt: skip


def benchmark_labels(
    drives: list[LabelledDrive],
    network: Network,
    settings: LabelBenchmarkSettings = LabelBenchmarkSettings(),
    work_dir: Path | None = None,
    threads: int = 1,
    progress: Progress = silent,
    show: Callable[[LabelledPoints], None] = lambda done: None,
) -> LabelBenchmark:
    """Track, label and judge every drive, one after the other.

    work_dir : where tracks and label images stay for the next run; None: nowhere
    show : called with each drive when it is labelled, while its label images are there
    A drive that cannot be tracked is left out and named in the result's `losses`; raises StageError where none is left.
    """
    counts: dict[str, tuple[Counts, Counts]] = {}
    tallies: dict[str, tuple[list[Tally], list[Tally]]] = defaultdict(lambda: ([], []))
    filters, losses = dict.fromkeys(REASONS, 0), {}
    for number, drive in enumerate(drives):

        def on_progress(share: float, what: str, /, number: int = number, drive: LabelledDrive = drive) -> None:
            progress((number + share) / len(drives), f"{drive.name}: {what}")

        with _folder_for(work_dir, drive) as folder:
            try:
                done = _labelled(drive, network, settings, folder, threads, on_progress)
            except StageError as error:
                losses[drive.name] = str(error)
                continue
            show(done)
        for name in REASONS:
            filters[name] += done.matches.filters[name]
        truth, piece = done.matches.truth, pieces(done.odometry)
        sure, every = done.matches.judged, done.matches.judged_with_boundaries
        for row, labels in done.labels.items():
            kept, all_of_it = counts.get(row, (0, 0))
            counts[row] = (kept + count(truth[sure], labels[sure]), all_of_it + count(truth[every], labels[every]))
            for part, judged in zip(tallies[row], (sure, every), strict=True):
                part.append(tally(truth[judged], labels[judged], piece[judged]))
    if not counts:
        raise StageError("no drive could be labelled: " + "; ".join(f"{name}: {why}" for name, why in losses.items()))
    progress(1.0, "judged")
    return LabelBenchmark(
        network.description.name, tuple(drive.name for drive in drives if drive.name not in losses), filters,
        {row: scores(sure) for row, (sure, _) in counts.items()},
        {row: scores(every) for row, (_, every) in counts.items()}, losses, *(_gains(tallies, kind) for kind in (0, 1)),
    )  # fmt: skip


def _gains(tallies: dict[str, tuple[list[Tally], list[Tally]]], kind: int) -> dict[str, Gain]:
    """Of every row over the single image. kind : 0 without points at boundaries, 1 with them."""
    baseline = pooled(tallies["baseline"][kind])
    return {row: gain(pooled(parts[kind]), baseline) for row, parts in tallies.items() if row != "baseline"}


def _labelled(
    drive: LabelledDrive,
    network: Network,
    settings: LabelBenchmarkSettings,
    folder: Path,
    threads: int,
    progress: Progress,
) -> LabelledPoints:
    forms = {"best": LabellingSettings(), **settings.variants}
    odometry = _tracked(drive, settings.odometry, folder, threads, lambda share, what: progress(0.4 * share, what))
    if len(odometry.keyframes) < 2:
        raise StageError("the odometry found fewer than 2 keyframes")
    labels_dir = labels_folder(folder, network)
    widest = max(forms.values(), key=lambda form: form.between_keyframes)
    frames = voting_frames(odometry, widest)
    segment_keyframes(drive.log, frames, network, labels_dir, lambda share, what: progress(0.4 + 0.4 * share, what))
    matches = match_points(odometry, drive.truth, settings.match, lambda share, what: progress(0.8 + 0.1 * share, what))
    progress(0.9, "votes")
    by_paper = label_points(odometry, KeyframeLabels(labels_dir, odometry.keyframes.frame), PAPER)
    labels = {row: getattr(by_paper, form) for row, form in FORMS.items()}
    for row, form in forms.items():
        images = KeyframeLabels(labels_dir, voting_frames(odometry, form))
        labels[row] = label_points(odometry, images, form).stereo
    progress(1.0, "labelled")
    return LabelledPoints(drive, odometry, matches, labels, KeyframeLabels(labels_dir, odometry.keyframes.frame))


def labels_folder(folder: Path, network: Network) -> Path:
    """Where the label images of a network lie below a drive's folder."""
    return folder / f"labels-{network.description.name}-{network.sha256[:12]}"


def _tracked(drive: LabelledDrive, settings: OdometrySettings, folder: Path, threads: int, progress: Progress) -> OdometryResult:
    """The odometry, from the folder where an earlier run left it."""
    inputs = json.dumps([settings.model_dump(mode="json"), drive.log.t_ns.tolist()], sort_keys=True)
    file = folder / f"odometry-{hashlib.sha256(inputs.encode()).hexdigest()[:16]}.npz"
    if file.is_file():
        try:
            return load_odometry(file)
        except WayloomError:
            file.unlink()
    odometry = track_calibrated(drive.log, settings, progress, threads)
    save_odometry(odometry, file)
    return odometry


@contextmanager
def _folder_for(work_dir: Path | None, drive: LabelledDrive) -> Iterator[Path]:
    """A drive's folder below work_dir, or one that does not outlive the benchmark."""
    if work_dir is None:
        with tempfile.TemporaryDirectory() as scratch:
            yield Path(scratch)
    else:
        folder = work_dir / drive.name
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
