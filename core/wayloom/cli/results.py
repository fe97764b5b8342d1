"""Results of commands: words for people, or with `--json` one document for programs, which then has standard output for itself."""

import json
from collections.abc import Callable
from typing import Annotated, Any

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as one JSON document; words go to standard error.")]


def words(as_json: bool) -> Callable[[str], None]:
    """Says a line to people: on standard output, unless that is the document's."""

    def say(line: str) -> None:
        typer.echo(line, err=as_json)

    return say


def print_json(document: Any) -> None:
    """The command's one document on standard output."""
    typer.echo(json.dumps(document, indent=1))
