"""`wayloom config`: the settings in force, and where each of them comes from."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from wayloom.cli.options import ConfigOption
from wayloom.cli.results import JsonOption, print_json

if TYPE_CHECKING:
    from wayloom.config.sources import Loaded
    from wayloom.pipeline.settings import WayloomSettings

group = typer.Typer(add_completion=False, no_args_is_help=True, help="The settings of drives, map and service.")


@group.callback()
def config_command() -> None:
    """The settings of drives, map and service."""


@group.command()
def show(
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the settings in force as a settings file that `--config` takes, with the origin and the meaning of each.

    Keys and addresses that hold passwords are not printed.
    """
    from wayloom.pipeline.settings import load_settings

    loaded = load_settings(config)
    if as_json:
        print_json(document(loaded))
    else:
        typer.echo(as_toml(loaded), nl=False)


def document(loaded: "Loaded[WayloomSettings]") -> dict[str, Any]:
    """`settings`, nested, without what is secret; `origins` by the path of the field."""
    from wayloom.config.sources import leaves, value_of

    settings: dict[str, Any] = {}
    origins: dict[str, str] = {}
    for key, info in leaves(type(loaded.settings)).items():
        value = value_of(loaded.settings, key)
        if info.repr or value is None:
            table = settings
            for name in key[:-1]:
                table = table.setdefault(name, {})
            table[key[-1]] = str(value) if isinstance(value, Path) else value
        origins[".".join(key)] = str(loaded.origin(key))
    return {"settings": settings, "origins": origins}


def as_toml(loaded: "Loaded[WayloomSettings]") -> str:
    """A settings file: `key = value  # origin: meaning`. What is not set, or secret, stands in a comment."""
    from wayloom.config.sources import leaves, value_of
    from wayloom.config.toml_text import toml_text

    tables: dict[tuple[str, ...], list[str]] = {}
    for key, info in leaves(type(loaded.settings)).items():
        value, origin = value_of(loaded.settings, key), loaded.origin(key)
        remark = f"# {origin}: {info.description}" if info.description else f"# {origin}"
        if value is None:
            line = f"# {key[-1]} is not set  {remark}"
        elif not info.repr:
            line = f"# {key[-1]} is set and not shown  {remark}"
        else:
            line = f"{key[-1]} = {toml_text(value)}  {remark}"
        tables.setdefault(key[:-1], []).append(line)
    parts = ["\n".join(([f"[{'.'.join(table)}]"] if table else []) + lines) for table, lines in tables.items()]
    return "\n\n".join(parts) + "\n"
