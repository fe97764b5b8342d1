"""Measures of the city graph on made fleets: places and NEES by kind of GNSS, verdicts on meetings, cells against the whole."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.evaluation.made_fleets import KINDS, MadeFleet
from wayloom.geometry import se3
from wayloom.stitching.city_graph import canonical
from wayloom.stitching.types import AlignedDrive, City

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class KindRow:
    """Drives of one kind: how many, and of them placed; rms m of submaps before and after, NaN where there was no place before;
    the rms and largest error of submaps that meet a drive with RTK; NEES / 6 of each fleet."""

    drives: int
    placed: int
    before_m: float
    after_m: float
    near_rtk_m: float
    worst_near_rtk_m: float
    nees: list[float]


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Counts of meetings."""

    false: int
    false_used: int
    right: int
    right_refused: int


def judged_kinds(fleets: Sequence[MadeFleet], cities: Sequence[City]) -> tuple[dict[str, KindRow], Verdicts]:
    """A row for each kind of drive over all fleets, and how their meetings were judged."""
    rows = {}
    for kind in KINDS:
        before: list[FloatArray] = []
        after: list[FloatArray] = []
        near: list[float] = []
        nees: list[float] = []
        drives = placed = 0
        for fleet, city in zip(fleets, cities, strict=True):
            own, met, chi2 = {drive.drive_id: drive for drive in fleet.drives}, _meet_rtk(fleet), []
            names = [name for name, its in fleet.kind.items() if its == kind]
            drives += len(names)
            for name in names:
                drive, true = city.drives[name], fleet.truth[name]
                if not drive.placed:
                    continue
                placed += 1
                off = np.linalg.norm((drive.T_map_submap - true)[:, :3, 3], axis=1)
                after.append(off)
                near += [float(off[k]) for one, k in met if one == name]
                chi2 += nees_of(drive, true).tolist()
                if own[name].located:
                    before.append(np.linalg.norm((own[name].T_map_submap - true)[:, :3, 3], axis=1))
            nees.append(float(np.mean(chi2)) / 6.0)
        was = _rms(np.concatenate(before)) if before else np.nan
        rows[kind] = KindRow(drives, placed, was, _rms(np.concatenate(after)), _rms(np.array(near)), max(near), nees)
    return rows, _verdicts(fleets, cities)


def nees_of(drive: AlignedDrive, T_true: FloatArray) -> FloatArray:
    """(n,) chi-square of the errors of a drive's submaps, by their own covariances; T_true (n, 4, 4)."""
    at = se3.from_rotation_translation(np.tile(np.eye(3), (len(T_true), 1, 1)), -T_true[:, :3, 3])
    off = at @ drive.T_map_submap @ se3.inverse(T_true) @ se3.inverse(at)
    Ad = se3.adjoint(at)
    covariance = Ad @ drive.covariance @ np.swapaxes(Ad, 1, 2)
    return np.array([xi @ np.linalg.solve(C, xi) for xi, C in zip([se3.log(T) for T in off], covariance, strict=True)])


def cells_against_whole(whole: City, parts: City) -> tuple[FloatArray, FloatArray, int]:
    """(N,) m by which submaps lie apart, the same in sigmas of their place, and how many meetings are judged otherwise."""
    moved, sigmas = [], []
    for name, drive in whole.drives.items():
        if drive.placed:
            off = np.linalg.norm((drive.T_map_submap - parts.drives[name].T_map_submap)[:, :3, 3], axis=1)
            p = drive.T_map_submap[:, :3, 3]
            J = np.concatenate([np.tile(np.eye(3), (len(p), 1, 1)), -se3.hat(p)], axis=2)
            moved.append(off)
            sigmas.append(off / np.sqrt(np.trace(J @ drive.covariance @ np.swapaxes(J, 1, 2), axis1=1, axis2=2)))
    pairs = zip(whole.meetings, parts.meetings, strict=True)
    return np.concatenate(moved), np.concatenate(sigmas), sum((a.refused == "") != (b.refused == "") for a, b in pairs)


def _meet_rtk(fleet: MadeFleet) -> set[tuple[str, int]]:
    """Submaps that truly meet one of a drive with RTK."""
    out = set()
    for one, false in zip(fleet.meetings, fleet.false.tolist(), strict=True):
        if not false and fleet.kind[one.drive_b] == "RTK":
            out.add((one.drive_a, one.submap_a))
        if not false and fleet.kind[one.drive_a] == "RTK":
            out.add((one.drive_b, one.submap_b))
    return out


def _verdicts(fleets: Sequence[MadeFleet], cities: Sequence[City]) -> Verdicts:
    counts = np.zeros((2, 2), np.int64)
    for fleet, city in zip(fleets, cities, strict=True):
        false = {canonical(one) for one, mark in zip(fleet.meetings, fleet.false.tolist(), strict=True) if mark}
        for one in city.meetings:
            counts[int(canonical(one.meeting) in false), int(one.refused != "")] += 1
    return Verdicts(int(counts[1].sum()), int(counts[1, 0]), int(counts[0].sum()), int(counts[0, 1]))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))
