"""What `inspect_log` finds."""

from pathlib import Path

import numpy as np
import pytest

from logs.made_drives import FRAMES, START_NS, write_drive
from wayloom.logs.inspection import LogReport, inspect_log, rate_report
from wayloom.logs.registry import LOG_FORMATS, open_log, open_log_unchecked
from wayloom.logs.types import StereoFrame


@pytest.mark.parametrize("log_format", list(LOG_FORMATS))
def test_a_made_drive_is_described_as_it_was_made(tmp_path: Path, log_format: str) -> None:
    log = open_log(write_drive(tmp_path, log_format))
    shares: list[float] = []
    report = inspect_log(log, progress=lambda share, what: shares.append(share))
    assert report.usable
    assert report.frames.count == FRAMES
    assert report.frames.rate_hz == pytest.approx(10.0, abs=1e-3)
    assert [(gap.after, round(gap.seconds, 3)) for gap in report.frames.gaps] == [(FRAMES - 2, 0.3)]
    assert (report.rig_id, report.vehicle_id) == ("rig-7", "car-7")
    assert report.start == "2011-09-26 13:04:32.345808896"
    assert report.gnss is not None
    assert report.gnss.share == pytest.approx({"none": 1 / 6, "single": 1 / 6, "float": 1 / 3, "fixed": 1 / 3})
    assert report.gnss.sigma_worst_m == pytest.approx(50.0)
    assert report.gnss.frames_covered == FRAMES - 1
    assert (report.distance_from, report.distance_m) == ("truth", pytest.approx(5.0, rel=1e-3))
    assert report.camera.baseline_m == 0.5
    assert report.files == len(log.files)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert LogReport.model_validate_json(report.model_dump_json()) == report


@pytest.mark.parametrize("log_format", [name for name in LOG_FORMATS if name != "mcap"])
def test_each_image_is_told_of_once_with_its_bytes(tmp_path: Path, log_format: str) -> None:
    log, told = open_log(write_drive(tmp_path, log_format)), list[tuple[Path, bytes]]()
    inspect_log(log, threads=2, seen=lambda file, data: told.append((file, data)))
    assert len(told) == len({file for file, _ in told}) == 2 * len(log)
    assert {file for file, _ in told} <= {log.root / name for name in log.files}
    assert all(file.read_bytes() == data for file, data in told)


def test_nothing_is_told_of_images_that_are_not_read_as_a_whole(tmp_path: Path) -> None:
    told: list[Path] = []
    inspect_log(open_log(write_drive(tmp_path, "kitti-raw")), decode=False, seen=lambda file, data: told.append(file))
    assert not told


def test_without_truth_the_distance_is_that_of_the_fixes_and_noise_does_not_add_up(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw", gnss=False)
    (drive / "poses.txt").unlink()
    rng = np.random.default_rng(0)
    rows = ["t_ns,lon_deg,lat_deg,height_m,sigma_e_m,sigma_n_m,sigma_u_m"]
    for i in range(400):
        north_m = 0.0 if i < 300 else (i - 299) * 1.0
        noise_m = rng.normal(0, 0.3)
        rows.append(f"{START_NS + i * 10**8},8.4,{49 + (north_m + noise_m) / 111_200},100,0.3,0.3,0.5")
    (drive / "gnss.csv").write_text("\n".join(rows) + "\n")
    report = inspect_log(open_log(drive))
    assert report.distance_from == "GNSS"
    assert report.distance_m == pytest.approx(100.0, abs=3.0)


def test_without_truth_and_gnss_the_distance_is_unknown(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-raw", gnss=False)
    (drive / "poses.txt").unlink()
    report = inspect_log(open_log(drive))
    assert (report.distance_m, report.gnss) == (None, None)


@pytest.mark.parametrize("decode", [True, False])
def test_all_damaged_images_are_listed(tmp_path: Path, decode: bool) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    for name in ("image_2/000001.png", "image_3/000001.png", "image_3/000004.png"):
        (drive / name).write_bytes((drive / name).read_bytes()[:500])
    report = inspect_log(open_log_unchecked(drive), decode=decode)
    assert not report.usable
    assert [Path(damaged.file).name for damaged in report.damaged] == ["000001.png", "000001.png", "000004.png"]
    assert all("truncated" in damaged.problem for damaged in report.damaged)


def test_damage_inside_a_picture_is_found_by_decoding_only(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    data = bytearray((drive / "image_3/000004.png").read_bytes())
    data[1000] ^= 1
    (drive / "image_3/000004.png").write_bytes(data)
    assert inspect_log(open_log(drive), decode=False).usable
    assert len(inspect_log(open_log(drive), decode=True).damaged) == 1


class AnyLog:
    """A drive log of another kind: only what the protocol promises."""

    def __init__(self, folder: Path) -> None:
        self._log = open_log_unchecked(folder)

    def __getattr__(self, name: str) -> object:
        if name in ("pairs", "stored_sizes", "rectifier", "damaged", "check_headers"):
            raise AttributeError(name)
        return getattr(self._log, name)

    def __len__(self) -> int:
        return len(self._log)

    def frame(self, index: int) -> StereoFrame:
        return self._log.frame(index)


def test_a_log_of_any_kind_can_be_inspected(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    (drive / "image_2/000003.png").write_bytes(b"")
    report = inspect_log(AnyLog(drive))  # type: ignore[arg-type]
    assert [Path(damaged.file).name for damaged in report.damaged] == ["000003.png"]
    assert not report.camera.rectified_on_load


def test_a_single_record_has_no_rate() -> None:
    report = rate_report(np.array([5], dtype=np.int64))
    assert (report.count, report.rate_hz, report.duration_s, report.gaps) == (1, 0.0, 0.0, [])
