"""`wayloom`: one module a command. It ends with one of `STATUSES`; a failure is one clear line on stderr."""

import importlib
import os
import sys
from io import TextIOWrapper

import typer

from wayloom import __version__
from wayloom.cli.interrupts import listen
from wayloom.cli.statuses import BAD_INPUT, FAILED, STOPPED, epilog
from wayloom.errors import InputError, WayloomError

COMMANDS = {
    "One drive": ("inspect", "process", "odometry", "calibrate", "export", "render", "report", "convert"),
    "A fleet's service": ("demo", "up", "upload", "sync", "drives", "rigs", "areas", "keys", "users", "audit", "selftest"),
    "Made and measured": ("simulate", "benchmark", "models"),
    "This installation": ("config", "doctor"),
}
"""By what they are for, as the help shows them."""

app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    help="Weaves the drives of a vehicle fleet into one semantic 3D map of a city.",
    epilog=epilog(),
)


@app.callback(invoke_without_command=True)
def root(version: bool = typer.Option(False, "--version", help="Print the version and end.")) -> None:
    """Options before the command."""
    if version:
        typer.echo(__version__)
        raise typer.Exit


for _panel, _names in COMMANDS.items():
    for _name in _names:
        _module = importlib.import_module(f"wayloom.cli.{_name}")
        if hasattr(_module, "group"):  # a command with commands of its own
            app.add_typer(_module.group, name=_name, rich_help_panel=_panel)
        else:
            app.command(_name, rich_help_panel=_panel)(getattr(_module, f"{_name}_command"))


def main() -> None:
    """Run the command line and end the process with its status."""
    listen()
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a path may hold what the terminal's encoding does not
    try:
        status = app(standalone_mode=False)
    except KeyboardInterrupt:
        status = STOPPED
    except SystemError as error:  # what Python makes of a Ctrl-C that numba answers while it hands over a kernel's result
        if not _stems_from_ctrl_c(error):
            raise
        status = STOPPED
    except typer.TyperException as error:
        status = _told_usage(error)
    except InputError as error:
        status = _told(f"{error} [{error.reason}]", BAD_INPUT)
    except WayloomError as error:
        status = _told(str(error), FAILED)
    except BrokenPipeError:
        status = FAILED
    except OSError as error:
        status = _told(f"{f'{error.filename}: ' if error.filename else ''}{error.strerror or error}", FAILED)
    if status == STOPPED:
        _told("stopped", STOPPED)
    try:
        sys.stdout.flush()
    except OSError as error:  # full disk, reader gone: Python would try again at its end, and complain in its own words
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = status or _told(error.strerror or str(error), FAILED)
    sys.exit(status)


def _stems_from_ctrl_c(error: BaseException | None) -> bool:
    return error is not None and (isinstance(error, KeyboardInterrupt) or _stems_from_ctrl_c(error.__cause__))


def _told(what: str, status: int) -> int:
    """One line on stderr, whatever characters a path holds; the exit status."""
    line = "".join(character if character.isprintable() else repr(character)[1:-1] for character in what)
    sys.stderr.write(f"wayloom: {line}\n")
    return status


def _told_usage(error: typer.TyperException) -> int:
    """A mistake in the command line: one line that says where help is. No arguments at all: the help itself."""
    context = getattr(error, "ctx", None)
    if type(error).__name__ == "NoArgsIsHelpError":
        return int(error.exit_code)
    command = context.command_path if context else "wayloom"
    message = " ".join(error.format_message().split()).rstrip(".").replace(": Value error, ", ": ")
    return _told(f"{message}{_value_of(error, message)}; see {command} --help", error.exit_code)


def _value_of(error: typer.TyperException, message: str) -> str:
    """The value that was refused, where the message does not have it."""
    from pydantic import ValidationError

    from wayloom.files.text_files import quoted

    if not isinstance(error.__cause__, ValidationError):
        return ""
    value = quoted(str(error.__cause__.errors()[0]["input"]))
    return "" if value in message else f", not {value}"


if __name__ == "__main__":
    main()
