"""`wayloom`: one module a command. Exit status: 0 done, 2 bad input (one clear line on stderr), 1 anything else."""

import importlib
import importlib.util
import os
import sys

import typer

from wayloom import __version__
from wayloom.errors import InputError, WayloomError

COMMANDS = ("inspect", "odometry", "process", "simulate", "models", "up", "upload", "export", "benchmark", "doctor", "demo")

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Weaves the drives of a vehicle fleet into one semantic 3D map of a city.",
)


@app.callback(invoke_without_command=True)
def root(version: bool = typer.Option(False, "--version", help="Print the version and end.")) -> None:
    """Options before the command."""
    if version:
        typer.echo(__version__)
        raise typer.Exit


for _name in COMMANDS:
    if importlib.util.find_spec(f"wayloom.cli.{_name}"):
        _module = importlib.import_module(f"wayloom.cli.{_name}")
        app.command(_name)(getattr(_module, f"{_name}_command"))


def main() -> None:
    """Run the command line and end the process with its status."""
    try:
        app()
    except InputError as error:
        sys.stderr.write(f"wayloom: {error}\n")
        sys.exit(2)
    except WayloomError as error:
        sys.stderr.write(f"wayloom: {error}\n")
        sys.exit(1)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


if __name__ == "__main__":
    main()
