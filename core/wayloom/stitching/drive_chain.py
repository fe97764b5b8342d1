"""Gauss-Markov chain of a drive's submaps, which counts none of the drive's information twice.

What a drive knows of its submaps is the marginal covariance P_k of each, of left perturbations xi_k in the map's frame (a common
shift of the drive is one and the same xi for all), and the covariance C_k of neighbours. The chain
    xi_1 ~ N(0, P_1),   xi_{k+1} = A_k xi_k + w_k,   A_k = C_k^T P_k^-1,   w_k ~ N(0, P_{k+1} - A_k C_k)
is the tree distribution nearest to the drive's own (Chow and Liu 1968): it has just these marginals and covariances of neighbours.
Cut anywhere, it begins with P_k: what lies before is integrated out exactly.

Where the drive's graph does not tell C, it is derived: neighbours L metres apart differ by no more than the odometry allows, D,
white noise growing with the root of the road and a share for the scale. In the axes in which the mean of both P is one and D is
diagonal, d, the correlation is max(0, 1 - d / 2): the difference has the odometry's variance where GNSS knows less, and the
neighbours are independent where GNSS alone knows each better.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.geometry import se3
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import DrivePlaces

FloatArray = NDArray[np.float64]
CLOSEST = 1.0 - 1e-12
"""Correlation of neighbours, at most."""
OWN_M, OWN_RAD = 1e-3, 1e-5
"""How well a drive's first submap lies in the drive's own frame, which begins there."""


@dataclass(frozen=True, slots=True)
class DriveChain:
    """A drive and its chain, in the solver's right perturbation e_k = log(T0_k^-1 T_k), each submap in its own axes.

    T0           (n, 4, 4) the drive's own places
    ahead        (n, 6, 6) A from the submap before; 0 for the first
    information  (n, 6, 6) of w; of the marginal for the first
    alone        (n, 6, 6) information of the marginal, where the chain is cut before a submap
    around       (n, 6, 6) covariance of the left perturbation about the submap's own place, axes of the map
    step         (n, 6, 6) covariance of the left perturbation of T_before_this; 0 for the first
    digest       SHA-256 of all that the drive tells
    """

    drive: DrivePlaces
    T0: FloatArray
    ahead: FloatArray
    information: FloatArray
    alone: FloatArray
    around: FloatArray
    step: FloatArray
    digest: str


def drive_chain(
    drive: DrivePlaces, settings: CityGraphSettings, known: Mapping[str, DriveChain] = MappingProxyType({})
) -> DriveChain:
    """The chain of a located drive, or the one of the same digest that is known already.

    Raises InputError: shapes that do not fit, covariances that are not positive definite.
    """
    digest = _digest(drive, settings)
    if digest in known:
        return known[digest]
    _check(drive)
    n, T0 = len(drive), drive.T_map_submap
    own = _moved(se3.inverse(T0), drive.covariance)
    at = _shift(-T0[:, :3, 3])
    ahead, information, step = np.zeros((n, 6, 6)), np.linalg.inv(own), np.zeros((n, 6, 6))
    alone = information.copy()
    if n > 1:
        middle = _shift(-0.5 * (T0[:-1, :3, 3] + T0[1:, :3, 3]))
        P, Q = _moved(middle, drive.covariance[:-1]), _moved(middle, drive.covariance[1:])
        cross = _neighbours(P, Q, _odometry(drive, settings))
        if drive.cross is not None:
            Ad = se3.adjoint(middle)
            told = np.isfinite(drive.cross).all(axis=(1, 2))
            cross[told] = (Ad @ drive.cross @ np.swapaxes(Ad, 1, 2))[told]
        A = np.swapaxes(np.linalg.solve(P, cross), 1, 2)
        noise = _symmetric(Q - A @ cross)
        here, before = se3.adjoint(se3.inverse(middle @ T0[1:])), se3.adjoint(se3.inverse(middle @ T0[:-1]))
        ahead[1:] = here @ A @ np.linalg.inv(before)
        information[1:] = np.linalg.inv(_symmetric(here @ noise @ np.swapaxes(here, 1, 2)))
        step[1:] = _symmetric(before @ (P + Q - cross - np.swapaxes(cross, 1, 2)) @ np.swapaxes(before, 1, 2))
    return DriveChain(drive, T0, ahead, _symmetric(information), _symmetric(alone), _moved(at, drive.covariance), step, digest)


def across(chain: DriveChain, last: int, here: int) -> tuple[FloatArray, FloatArray]:
    """A (6, 6) and information (6, 6) of the link from submap `last` to `here`, what lies between integrated out."""
    A, noise = np.eye(6), np.zeros((6, 6))
    for k in range(last + 1, here + 1):
        A, noise = chain.ahead[k] @ A, chain.ahead[k] @ noise @ chain.ahead[k].T + np.linalg.inv(chain.information[k])
    return A, _symmetric(np.linalg.inv(noise))


def joined(drive: DrivePlaces, T_map_own: FloatArray, settings: CityGraphSettings) -> DrivePlaces:
    """A drive without GNSS, its frame placed in the map's by a level T_map_own (4, 4): as good as free but for being level."""
    T = T_map_own @ drive.T_map_submap
    free = np.diag([settings.free_m**2] * 3 + [0.0, 0.0, settings.free_rad**2])
    covariance = _moved(_shift(T[0, :3, 3]), free) + _moved(T_map_own, drive.covariance)
    cross = None
    if drive.cross is not None:
        Ad = se3.adjoint(T_map_own)
        cross = _moved(_shift(T[0, :3, 3]), free) + Ad @ drive.cross @ Ad.T
    return replace(drive, T_map_submap=T, covariance=_symmetric(covariance), cross=cross, located=True)


def own_covariance(T_own_submap: FloatArray, length_m: FloatArray, settings: CityGraphSettings) -> FloatArray:
    """(n, 6, 6) of the left perturbations of a drive's submaps (n, 4, 4) in its own level frame, by the odometry's noise alone.

    The first is known but for being level; from each submap to the next the odometry errs about the middle between them.
    """
    n = len(T_own_submap)
    first = np.diag([OWN_M**2] * 3 + [np.radians(settings.level_deg) ** 2] * 2 + [OWN_RAD**2])
    drive = DrivePlaces("", T_own_submap, np.zeros((n, 6, 6)), length_m, np.ones(max(n - 1, 0), np.bool_))
    middle = 0.5 * (T_own_submap[:-1, :3, 3] + T_own_submap[1:, :3, 3])
    steps = _moved(_shift(middle), _odometry(drive, settings))
    return np.asarray(np.cumsum(np.concatenate([_moved(_shift(T_own_submap[:1, :3, 3]), first), steps]), axis=0))


def _neighbours(P: FloatArray, Q: FloatArray, D: FloatArray) -> FloatArray:
    """(k, 6, 6) cross-covariances of neighbours with marginals P and Q and odometry D between them, (k, 6, 6) each."""
    mean = 0.5 * (P + Q)
    root, white = _power(mean, 0.5), _power(mean, -0.5)
    d, axes = np.linalg.eigh(_symmetric(white @ D @ white))
    K = (axes * np.clip(1.0 - 0.5 * d, 0.0, CLOSEST)[:, None, :]) @ np.swapaxes(axes, 1, 2)
    return np.asarray(root @ _power(white @ P @ white, 0.5) @ K @ _power(white @ Q @ white, 0.5) @ root)


def _odometry(drive: DrivePlaces, settings: CityGraphSettings) -> FloatArray:
    """(n - 1, 6, 6) variance of the difference of neighbours, about the middle between them."""
    L = 0.5 * (drive.length_m[:-1] + drive.length_m[1:])
    turn = np.radians(settings.rotation_noise_deg)
    rotation = turn**2 * L
    position = settings.position_noise_m**2 * L + rotation * L**2 / 12.0 + (settings.scale_sigma * L) ** 2
    lost = np.where(drive.connected, 1.0, 1e6)
    return np.asarray((np.repeat(np.stack([position, rotation], axis=1), 3, axis=1) * lost[:, None])[:, :, None] * np.eye(6))


def _power(S: FloatArray, power: float) -> FloatArray:
    """Of symmetric positive matrices (k, 6, 6)."""
    value, axes = np.linalg.eigh(_symmetric(S))
    return np.asarray((axes * np.maximum(value, 1e-300)[:, None, :] ** power) @ np.swapaxes(axes, 1, 2))


def _shift(t: FloatArray) -> FloatArray:
    """(..., 4, 4) translations by t (..., 3)."""
    return se3.from_rotation_translation(np.broadcast_to(np.eye(3), (*t.shape, 3)), t)


def _moved(T: FloatArray, covariance: FloatArray) -> FloatArray:
    Ad = se3.adjoint(T)
    return _symmetric(Ad @ covariance @ np.swapaxes(Ad, -1, -2))


def _symmetric(M: NDArray[np.floating[Any]]) -> FloatArray:
    return np.asarray(0.5 * (M + np.swapaxes(M, -1, -2)))


def _check(drive: DrivePlaces) -> None:
    n = len(drive)
    if n == 0 or drive.covariance.shape != (n, 6, 6) or drive.length_m.shape != (n,) or drive.connected.shape != (n - 1,):
        raise InputError(
            f"drive {drive.drive_id}: {n} submaps, but covariances {drive.covariance.shape}", remedy="make its submaps again"
        )
    at = _shift(-drive.T_map_submap[:, :3, 3])
    wrong = ~np.isfinite(drive.T_map_submap).all(axis=(1, 2)) | ~np.isfinite(drive.covariance).all(axis=(1, 2))
    if not wrong.any():
        wrong = np.linalg.eigvalsh(_moved(at, drive.covariance))[:, 0] <= 0.0
    if wrong.any():
        what = "has a covariance that is not positive definite" if drive.located else "has no covariance"
        raise InputError(
            f"drive {drive.drive_id} {what}", record=f"submap {int(np.argmax(wrong))}", remedy="geo-reference the drive again"
        )


def _digest(drive: DrivePlaces, settings: CityGraphSettings) -> str:
    parts = [drive.T_map_submap, drive.covariance, drive.length_m, drive.connected, drive.cross]
    text = hashlib.sha256((drive.drive_id + settings.model_dump_json()).encode())
    for part in parts:
        text.update(b"none" if part is None else np.ascontiguousarray(part).tobytes())
    return text.hexdigest()
