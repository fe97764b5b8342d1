"""A local rig file taught by processed drives, with the code of the service's rig memory.

A drive whose lens contradicts the file's beyond chance begins it anew, as a knock does in the service; a receiver's epochs are
split when the file is read (`wayloom.calibration.receiver`), so nothing that it holds of receivers is ever lost.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from wayloom.calibration.epochs import Epoch
from wayloom.calibration.learn import Calibration, learn_rig
from wayloom.calibration.memory import KNOCKED_CHI_SQUARE, RememberedDrive, contradiction
from wayloom.calibration.receiver import ReceiverEvidence, begins_epoch
from wayloom.calibration.rig_file import RigFile, read_rig_file, write_rig_file
from wayloom.errors import CalibrationError
from wayloom.georeference.receiver_report import receiver_by_drive
from wayloom.odometry.rig.calibration_file import load_observations
from wayloom.odometry.rig.calibration_observations import CalibrationObservations
from wayloom.pipeline.stage_report import REPORT_FILE
from wayloom.pipeline.stages.odometry import EVIDENCE_FILE

CHANGED: Final = "the GNSS clock or the antenna was changed before this drive: drives from now on are placed with what it tells"


def learn_from_drive(stages_dir: Path, file: Path) -> list[str]:
    """Add a processed drive to a rig file, which is made where there is none; what people should know, in words.

    stages_dir : of `wayloom process`. Raises CalibrationError for another rig's file, and where the drive is too short for any.
    """
    observations = load_observations(stages_dir / "odometry" / EVIDENCE_FILE)
    known = read_rig_file(file) if file.exists() else None
    if known is not None and observations.name in known.drives:
        return [f"{file} holds {observations.name} already: nothing was added"]
    notes = []
    if known is not None and (chi_square := _against(observations, known)) > KNOCKED_CHI_SQUARE:
        notes.append(f"the rig was knocked before this drive (chi-square {chi_square:.0f} of ten): {file} begins anew with it")
        calibration, receivers = learn_rig([observations]), known.receivers
    else:
        calibration, receivers = learn_rig([observations], known=known), () if known is None else known.receivers
        if known is not None and known.scales:
            notes.append(f"the baseline that {known.scales} drives with RTK told is not carried over: only the service keeps it")
    own = receivers_of(stages_dir, observations.name)
    if own and begins_epoch((*receivers, *own), observations.name):
        notes.append(CHANGED)
    write_rig_file(with_receivers(calibration, (*receivers, *own)), file)
    return notes


def with_receivers(calibration: Calibration, receivers: Sequence[ReceiverEvidence]) -> RigFile:
    """The rig as learnt, with what drives tell of the receiver; of two words of one drive the later counts."""
    return replace(calibration.rig, receivers=tuple({one.drive_id: one for one in receivers}.values()))


def receivers_of(stages_dir: Path, name: str) -> tuple[ReceiverEvidence, ...]:
    """What a processed drive of that name tells of its receiver: one entry, or none."""
    report = stages_dir / "georeference" / REPORT_FILE
    content: dict[str, Any] = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}
    told = receiver_by_drive(content)
    return () if told is None else (ReceiverEvidence.from_facts(name, int(told["t_ns"]), told),)


def _against(observations: CalibrationObservations, known: RigFile) -> float:
    """Chi-square of ten of the drive's own lens against the file's; of a drive that says too little, 0."""
    try:
        own = RememberedDrive(observations.name, 1, learn_rig([observations]).rig, lambda: observations)
    except CalibrationError:
        return 0.0
    return contradiction(own, Epoch((RememberedDrive("known", 0, known, lambda: observations),)))
