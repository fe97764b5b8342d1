"""`wayloom models`: which networks there are, under which licence, and whether they are here; and how they get here."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from wayloom.cli.progress_bars import ProgressBars
from wayloom.cli.results import JsonOption, print_json


class _NameOrCommand(TyperGroup):
    """`wayloom models NAME` is short for `wayloom models show NAME`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        known = not args or args[0] in self.commands
        return super().resolve_command(ctx, args if known else ["show", *args])


group = typer.Typer(cls=_NameOrCommand, add_completion=False)


@group.callback(invoke_without_command=True)
def models_command(context: typer.Context, as_json: JsonOption = False) -> None:
    """List the networks: licence, and whether the file is here and is the right one. `wayloom models NAME` shows one."""
    from wayloom.segmentation.catalogue import MODELS

    if context.invoked_subcommand is None:
        _tell(list(MODELS.values()), as_json)


@group.command()
def show(
    name: Annotated[str, typer.Argument(help="A network of the catalogue, or a TOML or ONNX file.")], as_json: JsonOption = False
) -> None:
    """Show one network."""
    from wayloom.segmentation.catalogue import find_model

    _tell([find_model(name)], as_json)


@group.command()
def convert(
    name: Annotated[str, typer.Argument(help="What the weights are of: efficientvit-b0.")],
    weights: Annotated[Path, typer.Argument(help="The published file of weights (.pt).")],
    out: Annotated[Path, typer.Option(help="The ONNX file to write; its description goes beside it as TOML.")],
) -> None:
    """Make an ONNX file of published weights. Nothing in the file of weights is run; PyTorch is not needed."""
    from wayloom.segmentation.conversion.convert import convert as convert_weights

    toml = convert_weights(name, weights, out)
    typer.echo(f"{out}\nuse it by --model {toml}")


@group.command()
def fetch(
    name: Annotated[str, typer.Argument(help="A network of the catalogue, or a TOML file that names a url and its SHA-256.")],
    to: Annotated[Path | None, typer.Option(help="Folder; default the first that WAYLOOM_MODELS names.")] = None,
) -> None:
    """Download a network, check its SHA-256, and convert it where it is published in another form."""
    from wayloom.errors import ModelError
    from wayloom.segmentation.catalogue import find_model, model_folders
    from wayloom.segmentation.download import fetch as fetch_network

    description = find_model(name)
    folder = to or next(iter(model_folders()), None)
    if folder is None:
        raise ModelError("no folder to put it into", remedy="give --to DIR, or set WAYLOOM_MODELS")
    typer.echo(f"{description.name}: {description.licence}")
    with ProgressBars(quarters=True) as bars:
        path = fetch_network(description, folder, bars(f"fetching {description.name}"))
    typer.echo(str(path))


def _tell(descriptions: list[Any], as_json: bool) -> None:
    from wayloom.segmentation.catalogue import DEFAULT_MODEL

    rows = [_row(description, description.name == DEFAULT_MODEL) for description in descriptions]
    if as_json:
        print_json({"models": rows})
        return
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
