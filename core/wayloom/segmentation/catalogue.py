"""Catalogue of segmentation networks, and the search for their files.

A network is an ONNX file beside a TOML file that describes it; the catalogue's own are described in `networks/`, in the same
format that users write. A file is looked for beside its TOML, then in the folders that WAYLOOM_MODELS names.
"""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from wayloom.config.sources import MODELS_VARIABLE
from wayloom.errors import ModelError
from wayloom.segmentation.description import ModelDescription, read_description

NETWORKS: Final = Path(__file__).parent / "networks"
DEFAULT_MODEL: Final = "wayloom-city"

MODELS: Final[dict[str, ModelDescription]] = {
    DEFAULT_MODEL: read_description(NETWORKS / "wayloom-city.toml"),
    "efficientvit-b0": read_description(NETWORKS / "efficientvit-b0.toml"),
    "deeplab-slim": read_description(NETWORKS / "deeplab-slim.toml"),
}

State = Literal["ready", "absent", "damaged"]


@dataclass(frozen=True, slots=True)
class ModelFile:
    """Where a network's file is and what was found there.

    path    None where absent
    state   ready, absent, or damaged: its SHA-256 is not the described one
    sha256  of the file found
    """

    path: Path | None
    state: State
    sha256: str | None


def find_model(name_or_file: str | Path) -> ModelDescription:
    """The description of a network of the catalogue, or of the user's own: a TOML file, or an ONNX file with its TOML beside it.

    Raises ModelError that lists the known names, or says what the file lacks.
    """
    text = str(name_or_file)
    if text in MODELS:
        return MODELS[text]
    path = Path(text)
    if path.suffix == ".toml":
        return read_description(path)
    if path.suffix == ".onnx":
        return _beside(path)
    known = ", ".join(MODELS)
    raise ModelError(f"unknown network {text!r}", remedy=f"known are {known}, and any TOML or ONNX file")


def _beside(onnx: Path) -> ModelDescription:
    if not onnx.is_file():
        raise ModelError("no such file", file=onnx, remedy="name an ONNX file with its TOML beside it")
    toml = onnx.with_suffix(".toml")
    if not toml.is_file():
        raise ModelError(
            "has no description", file=onnx, remedy=f"write {toml.name} beside it (input, output and classes: docs/labelling.md)"
        )
    return read_description(toml).model_copy(update={"file": onnx.name, "folder": onnx.resolve().parent})


def model_folders() -> tuple[Path, ...]:
    """The folders that WAYLOOM_MODELS names, in order (separated as in PATH); none by default."""
    return tuple(Path(part).expanduser() for part in os.environ.get(MODELS_VARIABLE, "").split(os.pathsep) if part)


def inspect_file(description: ModelDescription) -> ModelFile:
    """Look for the network's file and check its SHA-256 against the description."""
    folders = (*((description.folder,) if description.folder else ()), *model_folders())
    path = next((folder / description.file for folder in folders if (folder / description.file).is_file()), None)
    if path is None:
        return ModelFile(None, "absent", None)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return ModelFile(path, "ready" if description.sha256 in (None, digest) else "damaged", digest)


def locate(description: ModelDescription) -> tuple[Path, str]:
    """The network's file and its SHA-256. Raises ModelError where it is absent or not the described one."""
    found = inspect_file(description)
    if found.path is None or found.sha256 is None:
        where = ", ".join(str(folder) for folder in model_folders()) or "unset"
        source = f" ({description.source})" if description.source else ""
        fetch = f"`wayloom models fetch {description.name}`, or " if description.url else ""
        raise ModelError(
            f"network {description.name}: {description.file} is not here",
            remedy=f"{fetch}put it{source} into a folder named by WAYLOOM_MODELS ({where})",
        )
    if found.state == "damaged":
        raise ModelError(
            f"network {description.name}: SHA-256 is {found.sha256}, not {description.sha256}",
            file=found.path,
            remedy="the file is damaged or another one; get it again",
        )
    return found.path, found.sha256
