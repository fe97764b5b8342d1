"""The file of labels: round trip, the same bytes for the same labels, refusal of what it is not."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from made_drive import made_drive, random_images

from wayloom.errors import StageError
from wayloom.labelling import files
from wayloom.labelling.files import load_labels, save_labels
from wayloom.labelling.settings import PAPER
from wayloom.labelling.tcl import label_points
from wayloom.labelling.types import PointLabels


@pytest.fixture
def labels() -> PointLabels:
    return label_points(made_drive(1), random_images(1), PAPER)


def test_labels_come_back_as_they_were(labels: PointLabels, tmp_path: Path) -> None:
    save_labels(labels, tmp_path / "labels.npz")
    back = load_labels(tmp_path / "labels.npz")
    for field in fields(PointLabels):
        one, other = getattr(labels, field.name), getattr(back, field.name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def test_without_votes_the_labels_stay(labels: PointLabels) -> None:
    alone = labels.without_votes()
    assert len(alone) == len(labels)
    assert all(np.array_equal(getattr(alone, form), getattr(labels, form)) for form in ("baseline", "mono", "stereo"))
    assert len(alone.vote_start) == len(labels) + 1
    assert alone.vote_start[-1] == len(alone.vote_class) == len(alone.vote_weight) == 0


def test_labels_read_without_votes_are_those_without_votes(labels: PointLabels, tmp_path: Path) -> None:
    save_labels(labels, tmp_path / "labels.npz")
    read, alone = load_labels(tmp_path / "labels.npz", votes=False), labels.without_votes()
    for field in fields(PointLabels):
        one, other = getattr(read, field.name), getattr(alone, field.name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other)


def test_the_same_labels_are_the_same_bytes(labels: PointLabels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_labels(labels, tmp_path / "one.npz")
    monkeypatch.setattr("time.localtime", lambda *_: (2031, 5, 4, 3, 2, 1, 0, 1, 0))
    save_labels(labels, tmp_path / "other.npz")
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "other.npz").read_bytes()


def test_nothing_but_the_file_is_left_behind(labels: PointLabels, tmp_path: Path) -> None:
    save_labels(labels, tmp_path / "labels.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["labels.npz"]


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn", b"no zip at all"])
def test_a_damaged_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "labels.npz").write_bytes(content)
    with pytest.raises(StageError, match=r"labels\.npz"):
        load_labels(tmp_path / "labels.npz")


def test_a_truncated_file_is_refused(labels: PointLabels, tmp_path: Path) -> None:
    save_labels(labels, tmp_path / "labels.npz")
    data = (tmp_path / "labels.npz").read_bytes()
    (tmp_path / "labels.npz").write_bytes(data[: len(data) // 2])
    with pytest.raises(StageError):
        load_labels(tmp_path / "labels.npz")


def test_another_version_is_refused(labels: PointLabels, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "FORMAT_VERSION", 99)
    save_labels(labels, tmp_path / "labels.npz")
    monkeypatch.undo()
    with pytest.raises(StageError, match="format 99"):
        load_labels(tmp_path / "labels.npz")
