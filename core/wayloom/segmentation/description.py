"""Description of a network: its file, licence, input and output, as a TOML file gives them."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from wayloom.config.classes import CLASS_COUNT, VOID
from wayloom.config.settings import Settings
from wayloom.errors import ModelError

Triple = tuple[float, float, float]
TrainId = Annotated[int, Field(ge=0, le=255)]


class ModelDescription(Settings):
    """One network, as its TOML file describes it. A value that the file leaves out is the default here.

    The network's input is `(RGB * scale - mean) / std` where its dtype is float32, and plain RGB where it is uint8.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="short name, as `--model` takes it")
    title: str = Field("", description="one line for people")
    file: str = Field(description="the ONNX file, relative to the folder of its TOML or to a folder of WAYLOOM_MODELS")
    sha256: str | None = Field(None, pattern=r"^[0-9a-f]{64}$", description="checked before the file is opened, where given")
    licence: str = Field("unknown", description="under which the weights may be used")
    source: str = Field("", description="who made it and where to get it")
    url: str | None = Field(
        None, pattern=r"^https?://", description="where `wayloom models fetch` gets the file, or the weights that become the file"
    )
    url_sha256: str | None = Field(None, pattern=r"^[0-9a-f]{64}$", description="of what lies at `url`, where that is not the file")
    conversion: str | None = Field(None, description="how the weights at `url` become the file: a name of `wayloom models convert`")
    layout: Literal["NCHW", "NHWC"] = Field("NCHW", description="order of the input's axes, and of the logits' axes")
    dtype: Literal["float32", "uint8"] = Field("float32", description="of the input")
    scale: float = Field(1.0 / 255.0, gt=0)
    mean: Triple = Field((0.485, 0.456, 0.406), description="of RGB after scaling")
    std: Triple = Field((0.229, 0.224, 0.225), description="of RGB after scaling")
    size: Literal["dynamic", "tiles"] = Field(
        "dynamic", description="dynamic: the whole frame, padded; tiles: near-square overlapping tiles, each resized to the input"
    )
    multiple: int = Field(32, ge=1, le=1024, description="dynamic: height and width must be multiples of this, pixels")
    zoom: float = Field(
        1.0,
        ge=0.25,
        le=4,
        description="dynamic: the frame is resized by about this (to whole multiples) before the network sees it",
    )
    tile_px: int = Field(513, ge=32, le=4096, description="tiles: height and width of the input, pixels")
    output: Literal["logits", "ids"] = Field(
        "logits", description="logits at any stride, or the arg max for each pixel of the input"
    )
    classes: tuple[TrainId, ...] = Field(
        tuple(range(CLASS_COUNT)), min_length=2, max_length=256, description="train id of each of the network's classes, 255 = void"
    )
    colour: bool = Field(True, description="whether it needs colour to be judged fairly")
    balanced: bool = Field(
        False,
        description="whether its training weighted rare classes; else votes get a class prior correction "
        "(`LabellingSettings.class_prior_power`)",
    )
    simulated: bool = Field(False, description="whether it was trained on simulated streets alone and knows no photographs")
    folder: Path | None = Field(None, exclude=True, description="of the TOML file: set by the reader, not written in it")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        unknown = sorted({c for c in self.classes if c >= CLASS_COUNT and c != VOID})
        if unknown:
            raise ValueError(f"classes holds {unknown}: train ids are 0 to {CLASS_COUNT - 1}, and {VOID} for void")
        if min(self.std) <= 0:
            raise ValueError("std must be above 0")
        if self.url and not (self.url_sha256 if self.conversion else self.sha256):
            raise ValueError("url needs " + ("url_sha256" if self.conversion else "sha256") + ": nothing is fetched unchecked")
        if Path(self.file).suffix.lower() != ".onnx":
            raise ValueError(f"file is {self.file!r}: only .onnx files are loaded")
        return self


def read_description(path: Path) -> ModelDescription:
    """The description in the TOML file `path`; name and file default to the TOML's own name.

    Raises ModelError where the file is missing, is not TOML, or says something that cannot be.
    """
    try:
        values: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ModelError("no such file", file=path, remedy="name a TOML file that describes an ONNX network") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise ModelError(f"not a readable TOML file ({error})", file=path, remedy="see docs/labelling.md for an example") from error
    defaults = {"name": path.stem, "file": f"{path.stem}.onnx"}
    try:
        return ModelDescription(**{**defaults, **values, "folder": path.resolve().parent})
    except (ValidationError, TypeError) as error:
        raise ModelError(_first_fault(error), file=path, remedy="see docs/labelling.md for an example") from error


def _first_fault(error: ValidationError | TypeError) -> str:
    if isinstance(error, TypeError):
        return str(error)
    fault = error.errors()[0]
    where = ".".join(str(part) for part in fault["loc"])
    return f"{where}: {fault['msg']}" if where else str(fault["msg"])
