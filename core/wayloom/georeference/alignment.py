"""GNSS alignment of a drive: fixes and odometry to T_enu_cam of every frame, with its covariance.

The graph is built in the tangent plane of the drive's own place, where up is up; the result is moved to the map's frame as a whole.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.receiver import ReceiverEvidence
from wayloom.config.progress import Progress, silent
from wayloom.errors import StageError
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import median_place
from wayloom.geodesy.map_frame import MapFrame, map_frame_for
from wayloom.geometry import se3
from wayloom.georeference.closures import closure_links, closures_report
from wayloom.georeference.first_guess import guess_nodes, level_world
from wayloom.georeference.fixes import UsableFixes, usable_fixes
from wayloom.georeference.gravity.witnesses import SeenUp, seen_up, witnesses_report
from wayloom.georeference.joints import Joints, joints_between
from wayloom.georeference.nodes import choose_nodes, nearest_node, odometry_chain, spread_covariances, spread_poses, travelled
from wayloom.georeference.receiver_prior import ReceiverPrior, lever_sigma_m, receiver_prior
from wayloom.georeference.receiver_report import ReceiverFound
from wayloom.georeference.refusal import why_doubted, why_not_placed
from wayloom.georeference.report import WORST_GRADE, PlacedDrive, georeference_report
from wayloom.georeference.scale_prior import scale_prior
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import FixResiduals, GeoReference, Wanted
from wayloom.georeference.uncertainty import moved_covariance, moved_cross
from wayloom.logs.types import DriveLog, GnssTrack
from wayloom.loops.types import LoopClosures, no_loops
from wayloom.mapping.drive_graph import optimise_drive, optimise_without_fixes
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain
from wayloom.mapping.evidence import Evidence
from wayloom.odometry.types import OdometryResult, Trajectory

FloatArray = NDArray[np.float64]
CURVED_S = 0.02
"""Time offset beyond which the way is no straight line over it: a corner at 2 m/s^2 leaves it by half a millimetre."""
NO_GNSS = "no GNSS: map in the drive's own frame"


def georeference(
    log: DriveLog,
    odometry: OdometryResult,
    wanted: Wanted = Wanted(),
    settings: GeoReferenceSettings = GeoReferenceSettings(),
    progress: Progress = silent,
    closures: LoopClosures | None = None,
    up: SeenUp | None = None,
    rig_receiver: Sequence[ReceiverEvidence] = (),
) -> GeoReference:
    """T_enu_cam and its covariance for every frame of the log.

    odometry : none of its points is read
    wanted : the map's frame, and of which keyframes the joint covariance. Without a usable fix the result has no frame: its
             poses are in the drive's own (`wayloom.mapping.own_frame`), covariances relative to the first frame.
    closures : loops between keyframes; None has none
    up : what is seen of up; None is what the log's accelerometer alone says
    rig_receiver : what other drives of the rig tell of its GNSS clock and lever arm
    Raises StageError when nothing was tracked, a pose is not finite, or no place fits the fixes.
    """
    trajectory = odometry.trajectory
    if not trajectory.tracked.any():
        raise StageError("the odometry tracked no frame: there is nothing to geo-reference; look at the odometry's report")
    finite = np.isfinite(trajectory.T_world_cam).all(axis=(1, 2))
    if not finite.all():
        raise StageError(f"the odometry's pose of frame {int(np.argmin(finite))} is not finite: track the drive again")
    nodes = choose_nodes(trajectory, odometry.keyframes.frame, settings.node_spacing_m)
    road_m = travelled(trajectory)[nodes]
    joints = joints_between(trajectory, nodes, wanted.anchors)
    chain = odometry_chain(trajectory, nodes, settings.level_every_m, odometry.keyframes)
    up = up or seen_up(log, odometry, None, settings)
    closing = closure_links(closures or no_loops(), odometry.keyframes, nodes, chain)
    evidence = Evidence(closing, up.at_nodes(trajectory, nodes, settings))
    prior = receiver_prior(log, int(trajectory.t_ns[0]), settings, rig_receiver)
    noise = _noise(settings, log, scale_prior(odometry.report, settings), prior)
    if log.gnss is None or len(log.gnss) == 0:
        return _in_own_frame(trajectory, nodes, chain, evidence, noise, joints, NO_GNSS)
    progress(0.0, "choosing fixes")
    gnss = _on_time(log.gnss, prior.mean[0])
    usable = usable_fixes(gnss, trajectory, settings.max_fix_rate_hz)
    if len(usable.rows) == 0:
        message = f"none of {len(log.gnss)} GNSS fixes can be used; {NO_GNSS}"
        geo = _in_own_frame(trajectory, nodes, chain, evidence, noise, joints, message)
        geo.report["fixes"]["unusable"] = usable.unusable
        return geo
    local = median_place(log.gnss.lon_lat_height[usable.rows])
    fixes = _antenna_fixes(prior.mean[1:], gnss, usable, trajectory, nodes, local, settings)
    progress(0.2, "first alignment")
    try:
        guess = guess_nodes(chain.T_world_node, trajectory.segment[nodes], fixes, road_m, settings)
        progress(0.3, "optimising")
        solution = optimise_drive(chain, fixes, guess, noise, evidence, joints.pairs)
        denied, late_s = why_not_placed(fixes, solution, noise), float(solution.receiver[0])
        drift = solution.clock_drift
        if denied is None and (abs(late_s) > CURVED_S or drift):
            of_drift_s = _drifted_s(gnss, gnss.t_ns[usable.rows[solution.inlier]], drift)
            usable = usable_fixes(_on_time(gnss, late_s + of_drift_s), trajectory, settings.max_fix_rate_hz)
            fixes = _antenna_fixes(prior.mean[1:], gnss, usable, trajectory, nodes, local, settings, late_s)
            solution = optimise_drive(chain, fixes, guess, replace(noise, clock_drifts=drift != 0.0), evidence, joints.pairs)
            denied = why_not_placed(fixes, solution, noise)
    except np.linalg.LinAlgError:
        what = f"the {len(fixes)} GNSS fixes contradict each other and the odometry so much that no place fits them"
        raise StageError(f"{what}; look at them with `wayloom inspect`, or process the drive without GNSS") from None
    residuals = FixResiduals(log.gnss.t_ns[usable.rows], solution.residual_enu, _sigma_enu(fixes), solution.inlier)
    denied = denied or why_doubted(fixes, solution)
    if denied:
        geo = _in_own_frame(trajectory, nodes, chain, evidence, noise, joints, denied)
        return _refused(geo, len(log.gnss), usable, residuals)
    progress(0.9, "placing every frame")
    target = wanted.frame or map_frame_for(local.lon_deg, local.lat_deg)
    T_target_local = wgs84.T_enu_enu(target, local)
    T_local_cam = spread_poses(trajectory, nodes, solution.T_enu_node)
    covariance = spread_covariances(len(trajectory), nodes, solution.covariance)
    cross = solution.cross.copy()
    for of_poses in (covariance, cross):  # all poses lie higher together
        of_poses[:, 2, 2] += settings.height_datum_sigma_m**2
    placed = PlacedDrive(T_local_cam, covariance, trajectory)
    receiver = ReceiverFound(solution, prior, log.p_cam_gnss, drift)
    report = georeference_report(log.gnss, usable, fixes, solution, placed, receiver, settings)
    report["up"] = witnesses_report(evidence.up)
    report["loops"] = closures_report(evidence.loops, solution.closed, solution.T_enu_node, nodes)
    progress(1.0, "geo-referenced")
    covariance, joined = moved_covariance(T_target_local, covariance), joints.told(moved_cross(T_target_local, cross))
    return GeoReference(target, T_target_local @ T_local_cam, covariance, report, residuals, joined)


def _in_own_frame(
    trajectory: Trajectory,
    nodes: NDArray[np.int64],
    chain: OdometryChain,
    evidence: Evidence,
    noise: DriveNoise,
    joints: Joints,
    message: str,
) -> GeoReference:
    """The drive by odometry, loops and gravity alone, level, its first frame at the origin."""
    T_level_world = level_world(chain.T_world_node)
    T_level_world[:3, 3] = -T_level_world[:3, :3] @ chain.T_world_node[0, :3, 3]
    solution = optimise_without_fixes(chain, T_level_world @ chain.T_world_node, noise, evidence, joints.pairs)
    report: dict[str, Any] = {
        "geo_referenced": False,
        "messages": [message],
        "fixes": {"used": 0, "unusable": {}},
        "up": witnesses_report(evidence.up),
        "loops": closures_report(evidence.loops, solution.closed, solution.T_enu_node, nodes),
    }
    T = spread_poses(trajectory, nodes, solution.T_enu_node)
    covariance = spread_covariances(len(trajectory), nodes, solution.covariance)
    return GeoReference(None, T, covariance, report, anchors=joints.told(solution.cross))


def _refused(geo: GeoReference, in_log: int, usable: UsableFixes, residuals: FixResiduals) -> GeoReference:
    """The drive in its own frame, of the worst grade: it has fixes, which are shown and of which none is believed.

    residuals : against the place that is refused
    """
    geo.report["grade"] = WORST_GRADE
    geo.report["fixes"] = {"in_log": in_log, "used": 0, "rejected": len(usable.rows), "unusable": usable.unusable}
    return replace(geo, fixes=replace(residuals, used=np.zeros(len(residuals), np.bool_)))


def _sigma_enu(fixes: AntennaFixes) -> FloatArray:
    """(M, 3) m as the receiver states it."""
    return np.sqrt(np.diagonal(fixes.covariance, axis1=1, axis2=2))


def _noise(settings: GeoReferenceSettings, log: DriveLog, scale_sigma: float, prior: ReceiverPrior) -> DriveNoise:
    return DriveNoise(
        position_m=settings.position_noise_m,
        rotation_rad=float(np.radians(settings.rotation_noise_deg)),
        standing_position_m=settings.standing_position_m,
        standing_rotation_rad=float(np.radians(settings.standing_rotation_deg)),
        scale_sigma=scale_sigma,
        scale_length_m=settings.scale_length_m,
        level_rad=float(np.radians(settings.level_sigma_deg)),
        correlation_s=settings.gnss_correlation_s,
        gate_floor_m=settings.gate_floor_m,
        gate_probability=settings.gate_probability,
        time_offset_s=settings.time_offset_sigma_s,
        lever_m=lever_sigma_m(log, settings),
        receiver=prior.covariance,
        window_factor=settings.window_factor,
    )


def _on_time(gnss: GnssTrack, late_s: float | FloatArray) -> GnssTrack:
    """The fixes with the stamps of a clock that is late_s, for all or each (M,), too late put right."""
    return replace(gnss, t_ns=gnss.t_ns - np.rint(1e9 * np.asarray(late_s)).astype(np.int64))


def _drifted_s(gnss: GnssTrack, used_ns: NDArray[np.int64], drift: float) -> FloatArray:
    """(M,) s by which a clock's drift, s/s, has made each stamp late, about the middle of those that were used, used_ns (m,)."""
    middle_ns = (int(used_ns[0]) + int(used_ns[-1])) // 2
    return np.asarray(drift * 1e-9 * (gnss.t_ns - middle_ns))


def _antenna_fixes(
    p_cam_gnss: FloatArray,
    gnss: GnssTrack,
    usable: UsableFixes,
    trajectory: Trajectory,
    nodes: NDArray[np.int64],
    local: MapFrame,
    settings: GeoReferenceSettings,
    late_s: float = 0.0,
) -> AntennaFixes:
    """The fixes in the local plane; each antenna as seen from the nearest node, through the odometry between the two.

    usable : at their times by a clock that is late_s too late
    """
    node = nearest_node(nodes, trajectory.segment, usable.frame)
    T_node_cam = se3.inverse(trajectory.T_world_cam[nodes[node]]) @ usable.T_world_cam
    from_node_m = np.linalg.norm(T_node_cam[:, :3, 3], axis=1)
    v_cam_gnss = usable.twist[:, :3] + np.cross(usable.twist[:, 3:], p_cam_gnss)
    variance = settings.sigma_floor_m**2 + settings.position_noise_m**2 * from_node_m
    return AntennaFixes(
        t_s=(gnss.t_ns[usable.rows] - trajectory.t_ns[0]) * 1e-9,
        node=node,
        late_s=np.full(len(usable.rows), late_s),
        p_node_gnss=T_node_cam[:, :3, :3] @ p_cam_gnss + T_node_cam[:, :3, 3],
        v_node_gnss=(T_node_cam[:, :3, :3] @ v_cam_gnss[:, :, None])[:, :, 0],
        R_node_cam=T_node_cam[:, :3, :3],
        position_enu=wgs84.enu_from_lonlatheight(gnss.lon_lat_height[usable.rows], local),
        covariance=gnss.covariance_enu[usable.rows] + variance[:, None, None] * np.eye(3),
        kind=gnss.fix_type[usable.rows],
        white_share=np.full(len(usable.rows), settings.gnss_white_share),
    )
