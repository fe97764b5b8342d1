"""Layered settings: defaults, then a TOML file, then environment variables, then options; each value with its origin.

A key of the file is the path of a field (`window` in the table `[odometry]`), its variable the same path in capitals
(`WAYLOOM_ODOMETRY__WINDOW`). There is no file that is read without being named: a settings file may name Python code to run, and
the working folder may hold somebody else's recordings.
"""

import difflib
import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Generic, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from wayloom.config.settings import Settings
from wayloom.errors import ConfigError

PREFIX: Final = "WAYLOOM_"
CONFIG_VARIABLE: Final = "WAYLOOM_CONFIG"
MODELS_VARIABLE: Final = "WAYLOOM_MODELS"
"""No setting, though nearly called as one is: folders of networks (`wayloom.segmentation.catalogue`)."""
MISTYPED: Final = 0.8
"""`difflib`'s ratio from which a name is taken for another one, mistyped: one letter of five that lacks or is wrong."""
FILE_SUFFIXES: Final = (".onnx", ".toml")
S = TypeVar("S", bound=Settings)
Key = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a value comes from; name is the file, the variable or the option, and empty for a default."""

    kind: Literal["default", "file", "environment", "option"]
    name: str = ""

    def __str__(self) -> str:
        return self.name or self.kind


DEFAULT: Final = Origin("default")


@dataclass(frozen=True, slots=True)
class Option:
    """A command-line option that sets a field. key : path of the field, joined by dots; value : None where it was not given."""

    name: str
    key: str
    value: object


@dataclass(frozen=True, slots=True)
class Loaded(Generic[S]):
    """Settings in force and the origin of each value, by the path of its field."""

    settings: S
    origins: Mapping[Key, Origin] = field(default_factory=dict)

    def origin(self, key: Key) -> Origin:
        """Where the value of a field comes from."""
        return self.origins.get(key, DEFAULT)

    def refusal(self, key: str, what: str, remedy: str | None = None) -> ConfigError:
        """The error for a value of the right type that cannot be used. It names file and key, variable or option."""
        return _error(tuple(key.split(".")), self.origin(tuple(key.split("."))), what, remedy)


def load(
    model: type[S],
    config: Path | None = None,
    options: tuple[Option, ...] = (),
    defaults: Mapping[str, object] | None = None,
    part: bool = False,
) -> Loaded[S]:
    """The settings in force. Raises ConfigError that names the file and key, the variable or the option, and what is possible.

    config   : TOML file; None takes the one that WAYLOOM_CONFIG names, if any
    defaults : defaults of a command that differ from the model's, by the path of the field
    part     : the model is one part of what the file holds: tables and keys of other parts are left to them
    """
    fields = leaves(model)
    tree: dict[str, Any] = {}
    origins: dict[Key, Origin] = {}
    layers = (
        ((tuple(key.split(".")), value, DEFAULT) for key, value in (defaults or {}).items()),
        _from_file(_config_file(config), fields, part),
        _from_environment(fields),
        ((tuple(one.key.split(".")), one.value, Origin("option", one.name)) for one in options if one.value is not None),
    )
    for layer in layers:
        for key, value, origin in layer:
            _put(tree, key, _split(value, fields.get(key)))
            origins[key] = origin
    try:
        return Loaded(model.model_validate(tree), origins)
    except ValidationError as error:
        raise _refused(error, fields, origins) from None


def leaves(model: type[BaseModel], above: Key = ()) -> dict[Key, FieldInfo]:
    """Every field that holds a value, by its path; tables of the model are gone through."""
    found: dict[Key, FieldInfo] = {}
    for name, info in model.model_fields.items():
        inner = _table(info)
        found |= {(*above, name): info} if inner is None else leaves(inner, (*above, name))
    return found


def variable(key: Key) -> str:
    """The environment variable of a field."""
    return PREFIX + "__".join(key).upper()


def value_of(settings: BaseModel, key: Key) -> Any:
    """The value of a field, by its path."""
    value: Any = settings
    for name in key:
        value = getattr(value, name)
    return value


def child_environment(settings: Settings) -> dict[str, str]:
    """This process's variables, changed so that a child that loads the same model gets exactly these settings, and no file."""
    fields = leaves(type(settings))
    ours = {name for key, info in fields.items() for name in _variables(key, info)} | {CONFIG_VARIABLE}
    tables = tuple(f"{PREFIX}{key[0].upper()}__" for key in fields if len(key) > 1)
    kept = {name: text for name, text in os.environ.items() if name not in ours and not name.startswith(tables)}
    values = {key: value_of(settings, key) for key in fields}
    return kept | {variable(key): _as_text(value) for key, value in values.items() if value != fields[key].get_default()}


def _table(info: FieldInfo) -> type[BaseModel] | None:
    kind = info.annotation
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def _config_file(given: Path | None) -> Path | None:
    return given if given is not None else Path(os.environ[CONFIG_VARIABLE]) if os.environ.get(CONFIG_VARIABLE) else None


def _from_file(file: Path | None, fields: Mapping[Key, FieldInfo], part: bool) -> Iterator[tuple[Key, Any, Origin]]:
    if file is None:
        return
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot be read ({error.strerror})", file=file, remedy="name a TOML file of settings") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"is no TOML ({error})", file=file, remedy="docs/settings.md has an example") from None
    folder, origin = file.absolute().parent, Origin("file", str(file))
    for key, value in _flat(content, fields, file):
        if not part or any(known[0] == key[0] for known in fields):
            yield key, _from_folder(value, fields.get(key), folder), origin


def _flat(content: Mapping[str, Any], fields: Mapping[Key, FieldInfo], file: Path, above: Key = ()) -> Iterator[tuple[Key, Any]]:
    """The values of a file by their paths; what no field is called is left to be refused."""
    for name, value in content.items():
        key = (*above, name)
        is_table = any(known[: len(key)] == key and len(known) > len(key) for known in fields)
        if is_table and not isinstance(value, Mapping):
            raise ConfigError("is a table, not a value", file=file, record=".".join(key), remedy=f"write [{'.'.join(key)}]")
        if is_table:
            yield from _flat(value, fields, file, key)
        else:
            yield key, value


def _from_folder(value: Any, info: FieldInfo | None, folder: Path) -> Any:
    """A path in a settings file starts at the file's folder."""
    if info is None or not isinstance(value, str):
        return value
    is_path = Path in (info.annotation, *get_args(info.annotation)) or (_extra(info, "file") and value.endswith(FILE_SUFFIXES))
    return str(folder / Path(value).expanduser()) if is_path else value


def _from_environment(fields: Mapping[Key, FieldInfo]) -> Iterator[tuple[Key, str, Origin]]:
    """Variables that are set and not empty. Raises ConfigError for one in a table of ours that no field is called, and for one
    that is nearly called as a field is."""
    known = {name: key for key, info in fields.items() for name in _variables(key, info)}
    tables = {f"{PREFIX}{key[0].upper()}__" for key in fields if len(key) > 1}
    for name in os.environ:
        if name not in known and (name.startswith(tuple(tables)) or _is_mistyped(name, known)):
            raise ConfigError("no setting is called so", record=name, remedy=_nearest(name, list(known)))
    for name, key in known.items():
        if text := os.environ.get(name):
            yield key, text, Origin("environment", name)


def _is_mistyped(name: str, known: Mapping[str, Key]) -> bool:
    """Whether a variable of ours is no other part's setting, but nearly one of these."""
    if not name.startswith(PREFIX) or "__" in name or name == MODELS_VARIABLE:
        return False
    plain = [one.removeprefix(PREFIX) for one in known if "__" not in one]
    return bool(difflib.get_close_matches(name.removeprefix(PREFIX), plain, n=1, cutoff=MISTYPED))


def _variables(key: Key, info: FieldInfo) -> tuple[str, ...]:
    """The short name that a field may have, and its own, which stands above it."""
    short = _extra(info, "variable")
    return (*([short] if short else []), variable(key))


def _extra(info: FieldInfo, name: str) -> Any:
    return info.json_schema_extra.get(name) if isinstance(info.json_schema_extra, dict) else None


def _split(value: Any, info: FieldInfo | None) -> Any:
    """Text for a field of several values: `8.4,49.0,110` or a JSON list."""
    if info is None or not isinstance(value, str) or not _is_tuple(info.annotation):
        return value
    try:
        return json.loads(value) if value.startswith("[") else value.split(",")
    except ValueError:
        return value


def _is_tuple(kind: Any) -> bool:
    return get_origin(kind) is tuple or any(get_origin(part) is tuple for part in get_args(kind))


def _put(tree: dict[str, Any], key: Key, value: Any) -> None:
    for name in key[:-1]:
        tree = tree.setdefault(name, {})
    tree[key[-1]] = value


def _as_text(value: Any) -> str:
    return json.dumps(value) if isinstance(value, tuple | bool) else str(value)


def _refused(error: ValidationError, fields: Mapping[Key, FieldInfo], origins: Mapping[Key, Origin]) -> ConfigError:
    """The first complaint, told of the value that was given, or, of a rule between values, the last of those."""
    first = error.errors(include_url=False)[0]
    at = tuple(str(part) for part in first["loc"])
    given = [key for key in origins if at[: len(key)] == key or key[: len(at)] == at]
    key = given[-1] if given else at
    origin, info = origins.get(key, DEFAULT), fields.get(key)
    if first["type"] == "extra_forbidden":
        return _error(key, origin, "no setting is called so", _nearest(".".join(key), [".".join(known) for known in fields]))
    what = first["msg"].removeprefix("Value error, ")
    shown = info is None or info.repr
    what = f"{first['input']!r}: {what}" if shown and isinstance(first["input"], str | int | float) else what
    return _error(key, origin, what, info.description if info is not None and info.description else "see docs/settings.md")


def _error(key: Key, origin: Origin, what: str, remedy: str | None) -> ConfigError:
    name = ".".join(key)
    if origin.kind == "file":
        return ConfigError(what, file=origin.name, record=name, remedy=remedy)
    return ConfigError(what, record=origin.name or name, remedy=remedy)


def _nearest(name: str, known: list[str]) -> str:
    likely = difflib.get_close_matches(name, known, n=1)
    return f"{f'did you mean {likely[0]}? ' if likely else ''}`wayloom config show` lists every setting"
