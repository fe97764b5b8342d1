"""Geo-referencing benchmark: cases of wrong GNSS on made drives, with error against stated sigma, and NEES over random drives."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.evaluation.gnss_drives import (
    LEVER_M,
    MadeDrive,
    Receiver,
    city_way,
    made_drive,
    straight_way,
    told_which_are_wrong,
    with_bursts,
)
from wayloom.georeference.alignment import georeference
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.logs.types import FixType
from wayloom.simulation.vehicle.vehicle_settings import GnssBurst

FloatArray = NDArray[np.float64]


BEYOND_SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Case:
    """A named way of going wrong: a drive for each seed; told: the same without its wrong fixes, where there are such."""

    name: str
    drive: Callable[[int], MadeDrive]
    told: Callable[[int], MadeDrive] | None = None


@dataclass(frozen=True, slots=True)
class CaseResult:
    """Over some seeds: rms and worst error of the positions, the rms of the stated sigma (root of the trace), m; the largest
    ratio of error to sigma, and how many drives have one beyond BEYOND_SIGMAS; shares of the drives that were placed and that bore
    a message; told_m: the rms error where the wrong fixes are known and taken out, NaN where there are none or nobody asked."""

    name: str
    seeds: int
    rms_m: float
    worst_rms_m: float
    sigma_m: float
    ratio: float
    placed: float
    warned: float
    told_m: float = np.nan
    beyond: int = 0


def errors_and_sigmas(drive: MadeDrive, geo: GeoReference) -> tuple[FloatArray, FloatArray]:
    """(N,) m each: distance of every position from the truth, root of the trace of its covariance. The drive must be placed."""
    assert geo.frame is not None
    error = np.linalg.norm(geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3], axis=1)
    return error, np.sqrt(np.trace(position_covariance(geo.T_enu_cam, geo.covariance), axis1=1, axis2=2))


def nees(drive: MadeDrive, geo: GeoReference) -> FloatArray:
    """(N,) normalised estimation errors squared of the positions, over 3. The drive must be placed."""
    assert geo.frame is not None
    error = geo.T_enu_cam[:, :3, 3] - drive.truth_in(geo.frame)[:, :3, 3]
    covariance = position_covariance(geo.T_enu_cam, geo.covariance)
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]) / 3.0)


def judge(
    case: Case,
    seeds: Sequence[int],
    settings: GeoReferenceSettings = GeoReferenceSettings(),
    told: dict[bytes, float] | None = None,
) -> CaseResult:
    """Geo-reference the case's drives of these seeds; told: and those without the wrong fixes, of which it keeps what it finds."""
    rms, sigmas, ratios, placed, warned = [], [], [], 0, 0
    for seed in seeds:
        drive = case.drive(seed)
        geo = georeference(drive.log, drive.odometry, settings=settings)  # type: ignore[arg-type]
        warned += bool(geo.report["messages"])
        if geo.frame is not None:
            error, sigma = errors_and_sigmas(drive, geo)
            placed += 1
            rms.append(float(np.sqrt((error**2).mean())))
            sigmas.append(float(np.sqrt((sigma**2).mean())))
            ratios.append(float((error / sigma).max()))
    told_m = np.nan if told is None else told_rms_m(case, seeds, settings, told)
    if not rms:
        return CaseResult(case.name, len(seeds), np.nan, np.nan, np.nan, np.nan, 0.0, warned / len(seeds), told_m)
    median = float(np.median(rms))
    return CaseResult(
        case.name,
        len(seeds),
        median,
        max(rms),
        float(np.median(sigmas)),
        max(ratios),
        placed / len(seeds),
        warned / len(seeds),
        told_m,
        int((np.array(ratios) > BEYOND_SIGMAS).sum()),
    )


def told_rms_m(case: Case, seeds: Sequence[int], settings: GeoReferenceSettings, told: dict[bytes, float]) -> float:
    """Median rms error, m, where the wrong fixes are known and taken out: what odometry and the good fixes allow. Bursts of any
    size leave the same: told holds what was found for the fixes that remain."""
    if case.told is None:
        return np.nan
    return float(np.median([_told_rms_m(case.told(seed), settings, told) for seed in seeds]))


def _told_rms_m(drive: MadeDrive, settings: GeoReferenceSettings, told: dict[bytes, float]) -> float:
    gnss = drive.log.gnss
    assert gnss is not None
    key = gnss.lon_lat_height[gnss.fix_type != FixType.NONE].tobytes()
    if key not in told:
        error, _ = errors_and_sigmas(drive, georeference(drive.log, drive.odometry, settings=settings))  # type: ignore[arg-type]
        told[key] = float(np.sqrt((error**2).mean()))
    return told[key]


def cases() -> list[Case]:
    """The table of docs/benchmarks/georeference.md."""
    return [*plain_cases(), *burst_cases(), *receiver_cases()]


def plain_cases() -> list[Case]:
    """Receivers that are as good as they say."""
    return [
        _city_case("RTK", Receiver(), 60.0),
        _straight_case("RTK, straight at 10 m/s", Receiver(), 10.0),
        _city_case("float", Receiver(FixType.FLOAT), 60.0),
        _city_case("single point", Receiver(FixType.SINGLE), 60.0),
        _city_case("outage of 30 s", Receiver(outages=((30.0, 30.0),)), 90.0),
    ]


def _city_case(name: str, receiver: Receiver, seconds: float) -> Case:
    known = told_which_are_wrong(receiver, seconds)
    told = None if known == receiver else lambda seed: made_drive(city_way(seconds), known, seed)
    return Case(name, lambda seed: made_drive(city_way(seconds), receiver, seed), told)


def creeping_case() -> Case:
    """An odometry whose metres grow by 6 % over the drive, with an outage in the middle."""
    receiver = Receiver(outages=((40.0, 20.0),))
    return Case(
        "odometry's scale creeps by 6 %, outage of 20 s", lambda seed: made_drive(city_way(100.0), receiver, seed, 0.01, 0.06)
    )


def _straight_case(name: str, receiver: Receiver, speed_m_s: float) -> Case:
    return Case(name, lambda seed: made_drive(straight_way(30.0, speed_m_s), receiver, seed))


def burst_case(size_m: float, length_s: float, wander_share: float) -> Case:
    """RTK with bursts over a fifth of a city drive of 100 s."""
    kind = "wandering" if wander_share else "constant"
    receiver = with_bursts(Receiver(), 100.0, size_m, length_s, wander_share)
    return _city_case(f"bursts {size_m:g} m, {length_s:g} s, {kind}", receiver, 100.0)


def burst_cases() -> list[Case]:
    """Bursts that jump, constant and wandering, and ramps."""
    found = [
        burst_case(size, length, wander)
        for wander in (0.0, 0.2)
        for length in (4.0, 10.0, 20.0)
        for size in (0.5, 1.0, 2.0, 3.0, 15.0, 50.0)
    ]
    for size in (1.0, 3.0, 15.0):
        ramp = (GnssBurst(share=0.4, duration_s=20.0, size_m=size, wander_share=0.0, ramp_s=8.0),)
        found.append(_city_case(f"ramp to {size:g} m and back, 20 s", Receiver(bursts=ramp), 100.0))
    return found


def receiver_cases() -> list[Case]:
    """Clocks, lever arms, covariances and shifts that no burst explains."""
    km = Receiver(
        outages=((20.0, 15.0), (70.0, 15.0)),
        bursts=(GnssBurst(share=0.4, duration_s=8.0, size_m=8.0), GnssBurst(share=0.9, duration_s=8.0, size_m=15.0)),
    )
    shifted, high = Receiver(shift_from=0.667, shift_enu_m=(1.2, -0.9, 0.0)), Receiver(shift_from=0.5, shift_enu_m=(0.0, 0.0, 13.0))
    thrown = Receiver(FixType.FLOAT, shift_from=0.6, shift_enu_m=(70.0, 70.0, 0.0))
    return [
        _city_case("clock 50 ms late", Receiver(late_s=0.05), 60.0),
        _city_case("clock 80 ms late", Receiver(late_s=0.08), 60.0),
        _city_case("clock 200 ms late", Receiver(late_s=0.2), 60.0),
        _straight_case("clock 50 ms late, straight at 15 m/s", Receiver(late_s=0.05), 15.0),
        _straight_case("clock 80 ms late, straight at 17 m/s", Receiver(late_s=0.08), 17.0),
        _city_case("clock drifts by 0.2 ms a second", Receiver(drift=2e-4), 120.0),
        _city_case("clock drifts by 0.5 ms a second", Receiver(drift=5e-4), 120.0),
        _city_case("lever arm not given", Receiver(lever_given=False), 60.0),
        _straight_case("lever arm not given, straight at 10 m/s", Receiver(lever_given=False), 10.0),
        _city_case("1 km, two outages, bursts of 8 and 15 m", km, 110.0),
        _city_case("last third shifted by 1.5 m", shifted, 60.0),
        _city_case("float, last 40 % shifted by 100 m", thrown, 60.0),
        _city_case("single point that claims 2 cm", Receiver(FixType.SINGLE, stated_ratio=0.0125), 60.0),
        _city_case("heights 13 m off for the last half", high, 60.0),
        creeping_case(),
    ]


def random_drive(seed: int) -> MadeDrive:
    """A city drive of two minutes with bursts, outages, a clock and a scale by chance."""
    rng = np.random.default_rng(10_000 + seed)
    bursts = tuple(
        GnssBurst(
            share=float(share),
            duration_s=float(rng.uniform(4.0, 15.0)),
            size_m=float(np.exp(rng.uniform(np.log(0.5), np.log(50.0)))),
            wander_share=float(rng.choice([0.0, 0.2])),
        )
        for share in rng.uniform(0.0, 0.9, rng.integers(0, 4))
    )
    outages = tuple((float(start), float(rng.uniform(5.0, 30.0))) for start in rng.uniform(0.0, 100.0, rng.integers(0, 3)))
    late_s = float(rng.choice([0.0, rng.normal(0.0, 0.04)]))
    fix = FixType(int(rng.choice([FixType.FIXED, FixType.FIXED, FixType.FLOAT, FixType.SINGLE])))
    receiver = Receiver(fix, late_s=late_s, lever_given=bool(rng.random() < 0.7), bursts=bursts, outages=outages)
    return made_drive(city_way(120.0), receiver, seed, scale_sigma=float(np.exp(rng.uniform(np.log(0.002), np.log(0.02)))))


@dataclass(frozen=True, slots=True)
class RandomResult:
    """Of a random drive: mean NEES / 3 of its positions, largest ratio of error to stated sigma; NaN where it was not placed."""

    seed: int
    nees: float
    ratio: float


def random_result(seed: int, settings: GeoReferenceSettings = GeoReferenceSettings()) -> RandomResult:
    """Geo-reference a random drive."""
    drive = random_drive(seed)
    geo = georeference(drive.log, drive.odometry, settings=settings)  # type: ignore[arg-type]
    if geo.frame is None:
        return RandomResult(seed, np.nan, np.nan)
    error, sigma = errors_and_sigmas(drive, geo)
    return RandomResult(seed, float(nees(drive, geo).mean()), float((error / sigma).max()))


@dataclass(frozen=True, slots=True)
class ReceiverErrors:
    """Worst over some drives that turn: of the clock, s; of a lever arm that is not given, m, level and in height."""

    clock_s: float
    lever_level_m: float
    lever_height_m: float


def receiver_errors(seeds: Sequence[int]) -> ReceiverErrors:
    """What city drives of a minute tell of clocks that are 50 to 200 ms late and of a lever arm that nobody gave."""
    clock, level, height = [], [], []
    for seed in seeds:
        for late_s in (0.05, 0.08, 0.2):
            report = _report(Receiver(late_s=late_s), seed)
            clock.append(abs(report["time_offset_s"] - late_s))
        off = np.abs(np.array(_report(Receiver(lever_given=False), seed)["lever_correction_m"]) - LEVER_M)
        level.append(float(off[[0, 2]].max()))
        height.append(float(off[1]))
    return ReceiverErrors(max(clock), max(level), max(height))


def _report(receiver: Receiver, seed: int) -> dict[str, Any]:
    drive = made_drive(city_way(60.0), receiver, seed)
    return georeference(drive.log, drive.odometry).report  # type: ignore[arg-type]
