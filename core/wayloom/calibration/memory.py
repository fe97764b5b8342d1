"""Memory of a rig: the evidence of its drives, split into epochs where it contradicts itself, and one file for each epoch.

Everything here is a function of the set of drives: they are taken by the time at which they were recorded, whatever the order in
which they were processed.

- A drive whose own lens is beyond what chance explains from that of the epoch's other drives, by
  (x_d - x_e)^T (C_d + C_e)^-1 (x_d - x_e), begins a new epoch: the rig was knocked. If the next drive agrees with the epoch before,
  that drive was a lone stray and the old epoch goes on.
- An epoch's file is learnt from the observations of its drives at once (`learn`); of very many, from those of the newest, on top of
  the sums of the others. Scales by GNSS come on top (`baseline`), and the rig's own uncertainty decides how much of the lens is
  used (`shrinkage`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import chdtri

from wayloom.calibration.baseline import ScaleByGnss, joint_covariance, with_gnss
from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.epochs import Epoch, split
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.residuals import LENS
from wayloom.calibration.rig_file import RigFile, differences
from wayloom.calibration.score_moments import ScoreMoments
from wayloom.calibration.settings import CalibrationSettings, with_bias_sigma
from wayloom.calibration.shrinkage import shrunk
from wayloom.errors import CalibrationError
from wayloom.geometry.lens import RightLens, lens_from_values
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

KNOCKED_CHI_SQUARE: Final = 41.3
"""Of ten degrees of freedom, exceeded once in a hundred thousand."""
ANOTHER_RIG: Final = 1e9
"""Chi-square of a log that has another focal length, baseline or size of images."""
LEAST_GROUPS: Final = 10
"""Match groups without which a drive cannot begin an epoch."""
LEAST_BIAS_SIGMA_PX: Final = 0.005
"""However alike the drives are: matches are not known better."""
AT_ONCE: Final = 24
"""Drives whose observations are adjusted together."""


@dataclass(frozen=True, slots=True)
class RememberedDrive:
    """Evidence of one drive.

    drive_id      names it
    t_ns          when it was recorded
    own           what it says of the rig alone
    observations  reads its match groups, when they are needed
    scale         what GNSS says of its length, if it does
    """

    drive_id: str
    t_ns: int
    own: RigFile
    observations: Callable[[], CalibrationObservations]
    scale: ScaleByGnss | None = None


def split_epochs(
    drives: Sequence[RememberedDrive], settings: CalibrationSettings = CalibrationSettings()
) -> list[Epoch[RememberedDrive]]:
    """The epochs of a rig's lens, by time; each drive is in one of them."""
    return split(drives, lambda drive, epoch: contradiction(drive, epoch, settings), KNOCKED_CHI_SQUARE)


def contradiction(
    drive: RememberedDrive, epoch: Epoch[RememberedDrive], settings: CalibrationSettings = CalibrationSettings()
) -> float:
    """Chi-square of ten degrees of freedom of a drive's own lens against that of an epoch; 0 where either says too little,
    ANOTHER_RIG where the log's calibration is another one's.

    Sums of drives take the place of learning them at once: they are within a fifth of a sigma of each other.
    """
    try:
        differences(epoch.drives[0].own, drive.own.rig, drive.own.rig_id, file=drive.drive_id)
    except CalibrationError:
        return ANOTHER_RIG
    known = sum_of([one.own for one in epoch.drives], settings)
    if min(_groups(drive.own), _groups(known)) < LEAST_GROUPS:
        return 0.0
    difference = drive.own.lens.values - known.lens.values
    covariance = lens_covariance(drive.own, settings)[0] + lens_covariance(known, settings)[0]
    return float(difference @ np.linalg.solve(covariance, difference))


def sum_of(rigs: Sequence[RigFile], settings: CalibrationSettings = CalibrationSettings()) -> RigFile:
    """The rig that drives tell of together, by the sums that their own files hold. Two files of one drive count once."""
    rigs = list({rig.drives: rig for rig in rigs}.values())
    information = np.sum([rig.information for rig in rigs], axis=0)
    pull = np.sum([rig.pull for rig in rigs], axis=0)
    x = np.linalg.solve(information[:LENS, :LENS] + np.diag(1.0 / settings.lens.sigmas**2), pull[:LENS])
    return replace(
        rigs[0], lens=lens_from_values(RightLens().values + x), information=information, pull=pull,
        drives=tuple(sorted(name for rig in rigs for name in rig.drives)), matches=sum(rig.matches for rig in rigs),
        scores=sum((rig.scores or ScoreMoments() for rig in rigs), ScoreMoments()),
    )  # fmt: skip


def learn_epoch(epoch: Epoch[RememberedDrive], settings: CalibrationSettings = CalibrationSettings()) -> RigFile:
    """The file of an epoch: what its drives say together, with scales by GNSS, as far as its own uncertainty lets it be used."""
    older, newest = epoch.drives[:-AT_ONCE], epoch.drives[-AT_ONCE:]
    known = sum_of([drive.own for drive in older], settings) if older else None
    in_order = sorted(newest, key=lambda drive: drive.drive_id)
    observations = [drive.observations() for drive in in_order]
    learnt = learn_rig(observations, settings, known)
    bias_sigma = bias_sigma_px([drive.disparity_bias_px for drive in learnt.drives], settings)
    if bias_sigma < settings.drive.disparity_bias_px:  # what drives share of the columns is the lens's, and known that well
        settings = with_bias_sigma(settings, bias_sigma)
        learnt = learn_rig(observations, settings, known)
    scales = [drive.scale for drive in epoch.drives if drive.scale is not None]
    return with_scales(replace(learnt.rig, bias_sigma_px=bias_sigma), scales, settings)


def bias_sigma_px(biases_px: Sequence[float], settings: CalibrationSettings = CalibrationSettings()) -> float:
    """How much the disparity bias of a next drive may differ from the rig's, by those of its drives: the upper end of what is
    likely, s^2 (n - 1) / chi^2_(n - 1)(0.05), as few drives tell a spread badly; what is believed before of a single one."""
    count, believed = len(biases_px), settings.drive.disparity_bias_px
    if count < 2:
        return believed
    squares = float(np.square(np.array(biases_px) - np.mean(biases_px)).sum())
    return float(np.clip(np.sqrt(squares / chdtri(count - 1, 0.95)), LEAST_BIAS_SIGMA_PX, believed))


def with_scales(rig: RigFile, scales: Sequence[ScaleByGnss], settings: CalibrationSettings = CalibrationSettings()) -> RigFile:
    """A learnt rig with its baseline and their joint covariance, its lens shrunk to what is worth using."""
    before = joint_covariance(lens_covariance(rig, settings)[0], settings.baseline_sigma)
    found, covariance, used = with_gnss(rig.lens.values - RightLens().values, before, scales)
    lens = shrunk(found[:LENS], covariance[:LENS, :LENS], settings)
    sigma = np.sqrt(np.diag(covariance)[:LENS])
    return replace(
        rig, lens=lens_from_values(RightLens().values + lens), sigma=sigma, baseline_ratio=float(np.exp(found[LENS])),
        covariance=covariance, scales=used, determined=sigma < settings.least_information * settings.lens.sigmas,
    )  # fmt: skip


def _groups(rig: RigFile) -> float:
    return 0.0 if rig.scores is None else rig.scores.groups
