"""Keyframes labelled while the drive is still tracked: the same result, sooner, and nothing left lying about."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pipeline.real_log import colour_network, first_frames
from wayloom.errors import LogError
from wayloom.files.atomic import UNFINISHED
from wayloom.labelling.settings import LabellingSettings
from wayloom.pipeline.drive import process_drive
from wayloom.pipeline.labels_ahead import LabelsAhead, labels_ahead
from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.segmentation.network import Labelled, Network
from wayloom.segmentation.settings import SegmentationSettings


@pytest.fixture
def context(clip_a: Path, tmp_path: Path) -> StageContext:
    log_path = first_frames(clip_a, tmp_path / "street")
    return StageContext(LogSource(log_path), tmp_path, settings(tmp_path, threads=2))


def settings(folder: Path, threads: int) -> ProcessSettings:
    return ProcessSettings(threads=threads, segmentation=SegmentationSettings(model=str(colour_network(folder))))


def test_what_it_is_told_of_is_labelled(context: StageContext) -> None:
    with labels_ahead(context) as followed:
        assert followed.ahead is not None
        followed.ahead.on_keyframe(0)
        followed.ahead.on_keyframe(4)
        followed.ahead._coming[-1].result()
        folder = followed.ahead.finished()
        labelled = [sorted(path.stem for path in (folder / side).iterdir()) for side in ("left", "right")]
        assert labelled == [["0000000000", "0000000004"], ["0000000000"]]
        assert folder.name.startswith(UNFINISHED)  # what a killed run leaves is swept by the next one
    assert not folder.exists()


def test_all_right_images_are_labelled_where_all_vote(context: StageContext, tmp_path: Path) -> None:
    every = context.settings.model_copy(update={"labelling": LabellingSettings(right_images=1)})
    ahead = LabelsAhead(StageContext(context.source, tmp_path, every), tmp_path / "ahead")
    for frame in (0, 2, 4):
        ahead.on_keyframe(frame)
    ahead._coming[-1].result()
    assert sorted(path.stem for path in (ahead.finished() / "right").iterdir()) == ["0000000000", "0000000002", "0000000004"]


@pytest.mark.parametrize("changed", [{"threads": 1}, {"labelling": LabellingSettings(between_keyframes=True)}])
def test_one_thread_or_frames_between_have_none(context: StageContext, tmp_path: Path, changed: dict[str, object]) -> None:
    one = StageContext(context.source, tmp_path, context.settings.model_copy(update=changed))
    with labels_ahead(one) as followed:
        assert followed is one


def test_images_that_cannot_be_labelled_are_told_of_by_the_stage(context: StageContext) -> None:
    with labels_ahead(context) as followed:
        assert followed.ahead is not None
        followed.ahead.on_keyframe(10**6)
        assert followed.ahead._coming[-1].exception() is not None
        assert followed.ahead.finished().is_dir()


def test_keyframes_are_labelled_while_the_drive_is_tracked(clip_a: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    before: list[int] = []
    label, hear = Network.label_images, LabelsAhead.on_keyframe

    def patient(ahead: LabelsAhead, frame: int) -> None:
        hear(ahead, frame)
        ahead._coming[-1].result()

    def counted(network: Network, images: Sequence[np.ndarray], k: int = 4) -> list[Labelled]:
        before.append(sum(name == "segmentation" for name in said))
        return label(network, images, k)

    monkeypatch.setattr(Network, "label_images", counted)
    monkeypatch.setattr(LabelsAhead, "on_keyframe", patient)
    log_path = first_frames(clip_a, tmp_path / "street")
    process_drive(log_path, tmp_path / "out", settings(tmp_path, 2), progress=lambda name: lambda share, what, /: said.append(name))
    assert before
    assert not any(before)  # all were labelled when the segmentation's turn came
    assert [path.name for path in (tmp_path / "out" / "stages").glob(f"{UNFINISHED}*")] == []


def test_a_drive_that_cannot_be_tracked_leaves_nothing(clip_a: Path, tmp_path: Path) -> None:
    log_path = first_frames(clip_a, tmp_path / "street")
    images = sorted((log_path / "image_0").iterdir())
    for image in images[5:]:
        image.write_bytes(image.read_bytes()[:3000])
    with pytest.raises(LogError):
        process_drive(log_path, tmp_path / "out", settings(tmp_path, 2))
    assert not list((tmp_path / "out").rglob(f"{UNFINISHED}*"))
