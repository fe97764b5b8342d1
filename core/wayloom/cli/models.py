"""`wayloom models`: which networks there are, under which licence, and whether they are here."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer


def models_command(
    name: Annotated[
        str | None, typer.Argument(help="One network of the catalogue, or a TOML or ONNX file; all by default.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the list as JSON to this file.", metavar="FILE")] = None,
) -> None:
    """List the networks: licence, and whether the file is here and is the right one."""
    from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS, find_model

    descriptions = [find_model(name)] if name else list(MODELS.values())
    rows = [_row(description, description.name == DEFAULT_MODEL) for description in descriptions]
    if json_file:
        json_file.write_text(json.dumps({"models": rows}, indent=1) + "\n", encoding="utf-8")
    for row in rows:
        typer.echo(f"{row['name']}{' (default)' if row['default'] else ''}: {row['state']}")
        for key in ("title", "file", "sha256", "licence", "source", "input", "output"):
            typer.echo(f"  {key:8} {row[key]}")


def _row(description: Any, default: bool) -> dict[str, Any]:
    """What is said of one network. `state` is ready, absent (then `source` says where to get it) or damaged (SHA-256 differs)."""
    from wayloom.segmentation.catalogue import inspect_file

    found = inspect_file(description)
    d = description
    size = f"tiles of {d.tile_px} px" if d.size == "tiles" else f"whole frames, padded to multiples of {d.multiple} px"
    return {
        "name": d.name,
        "default": default,
        "state": found.state,
        "title": d.title,
        "file": str(found.path or d.file),
        "sha256": found.sha256 or d.sha256 or "",
        "licence": d.licence,
        "source": d.source,
        "input": f"{d.dtype} {d.layout} {'colour' if d.colour else 'colour or grey'}, {size}",
        "output": f"{d.output}, {len(d.classes)} classes",
    }
