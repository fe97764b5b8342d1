"""Quality report of a drive of a service, as one self-contained page."""

from collections.abc import Mapping
from typing import Any, Final

import jinja2
from markupsafe import Markup

TITLES: Final = {
    "residuals": "GNSS residuals over time",
    "drift": "Drift before and after",
    "sigma": "Uncertainty along the road",
    "track": "The track",
}
"""Of the pictures, in the order of the page."""


def render(drive: Mapping[str, Any], quality: Mapping[str, Any], pictures: Mapping[str, str]) -> str:
    """The HTML page.

    drive    : what `GET /v1/drives/{id}` says
    quality  : what `GET /v1/drives/{id}/quality` says
    pictures : by name, the SVG of `GET /v1/drives/{id}/quality/{name}.svg`
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("wayloom.reports"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    shown = [(TITLES.get(name, name), Markup(pictures[name])) for name in (*TITLES, *pictures) if name in pictures]  # noqa: S704  drawn by the service
    return environment.get_template("served_drive.html.j2").render(
        drive=drive, quality=quality, pictures=dict(shown).items(), rows=rows(drive, quality)
    )


def rows(drive: Mapping[str, Any], quality: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is known, in the order of interest: name and words."""
    out: list[tuple[str, str]] = []
    if quality["fixes"]:
        counted = drive["facts"]["georeference"]["fixes"]
        out.append(("Fixes used, not used", f"{counted['used']}, {counted['rejected']}"))
    for burst in quality["bursts"]:
        out.append(
            (
                "GNSS burst",
                f"{burst['from_s']:.1f} to {burst['to_s']:.1f} s, off by {metres(burst['offset_enu_m'])} (east, north, up)",
            )
        )
    if quality["receiver"]:
        receiver = quality["receiver"]
        late = 1e3 * receiver["time_offset_s"], 1e3 * receiver["sigma_time_offset_s"]
        out.append(("Time offset", f"{late[0]:.1f} ± {late[1]:.1f} ms"))
        arm = metres(receiver["lever_correction_m"]), metres(receiver["sigma_lever_m"])
        out.append(("Lever arm, correction", f"{arm[0]} ± {arm[1]} (right, down, forward)"))
    if quality["scale"]:
        out.append(("Scale of the odometry", f"{quality['scale']['mean']:.4f} ± {quality['scale']['sigma']:.4f}"))
    out.append(("Loop closures", str(quality["loops"]["count"]) if quality["loops"] else "none"))
    return out


def metres(values: list[float]) -> str:
    """Three lengths in words."""
    return f"{', '.join(f'{value:.2f}' for value in values)} m"
