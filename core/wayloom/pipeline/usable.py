"""Checks that settings which passed their types can be used on this machine: rig file, network, device."""

from wayloom.calibration.rig_file import read_rig_file
from wayloom.config.sources import Loaded
from wayloom.errors import InputError
from wayloom.pipeline.settings import WayloomSettings
from wayloom.segmentation.catalogue import DEFAULT_MODEL, find_model, locate


def check_usable(loaded: Loaded[WayloomSettings], runs_stages: bool = True) -> None:
    """Raise ConfigError, naming where the value stands, for a rig, a network or a device that is not there.

    runs_stages : whether this process will run the network itself; else its file and the device are another machine's
    """
    check_rig(loaded)
    try:
        description = find_model(loaded.settings.segmentation.model or DEFAULT_MODEL)
        if runs_stages:
            locate(description)
    except InputError as error:
        raise loaded.refusal("segmentation.model", str(error)) from None
    if runs_stages:
        _check_device(loaded)


def check_rig(loaded: Loaded[WayloomSettings]) -> None:
    """Raise ConfigError, naming where the value stands, for a rig file or folder that is not there, and for a file that is none."""
    rig = loaded.settings.rig
    if rig is None or rig.is_dir():
        return
    if not rig.exists():
        raise loaded.refusal("rig", f"{rig}: no such file or folder", "name a RIG.toml of `wayloom calibrate`, or a folder of them")
    try:
        read_rig_file(rig)
    except InputError as error:
        raise loaded.refusal("rig", str(error)) from None


def _check_device(loaded: Loaded[WayloomSettings]) -> None:
    from wayloom.segmentation.providers import resolved_device  # onnxruntime is loaded only by who runs networks

    try:
        resolved_device(loaded.settings.segmentation.device)
    except InputError as error:
        raise loaded.refusal("segmentation.device", str(error)) from None
