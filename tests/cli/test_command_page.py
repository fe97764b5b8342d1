"""docs/command-line.md says what the program says of itself, and commands end as its table has it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from wayloom.cli.main import COMMANDS, app
from wayloom.cli.statuses import BAD_INPUT, DONE, FAILED, STATUSES

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "command-line.md").read_text(encoding="utf-8")


def rows(heading: str) -> list[list[str]]:
    """The cells of the table below a heading."""
    part = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[2:]]


def commands_of_the_program() -> dict[str, TyperCommand | TyperGroup]:
    """By name, as typer makes them."""
    program = typer.main.get_command(app)
    assert isinstance(program, TyperGroup)
    return dict(program.commands)


def test_every_command_stands_there_with_its_own_words() -> None:
    commands, expected = commands_of_the_program(), []
    for name in (name for names in COMMANDS.values() for name in names):
        command = commands[name]
        below = ", ".join(f"`{one}`" for one in sorted(getattr(command, "commands", ())))
        words = " ".join((command.help or "").split("\n\n")[0].split()).partition(". ")[0].rstrip(".")
        expected.append([f"`{name}` {below}".strip(), words])
    assert rows("Commands") == expected


def test_every_status_stands_there_and_in_the_help() -> None:
    assert {int(status): words for status, words in rows("Exit status")} == STATUSES
    told = subprocess.run([sys.executable, "-m", "wayloom.cli.main", "-h"], capture_output=True, text=True, check=True).stdout
    last = " ".join(told.split()).rpartition("Exit status: ")[2]
    assert last == "; ".join(f"{status} {words}" for status, words in STATUSES.items())


def test_json_is_a_switch_of_those_commands_and_a_file_of_the_others() -> None:
    commands = commands_of_the_program()
    switches, files = set(), set()
    for name in (name for names in COMMANDS.values() for name in names):
        command = commands[name]
        for below, one in (getattr(command, "commands", None) or {"": command}).items():
            for option in one.params:
                if isinstance(option, TyperOption) and "--json" in option.opts:
                    (switches if option.is_flag else files).add(name if name != "config" else f"{name} {below}")
    told = PAGE.split("- `--json`")[1].split("\n- ")[0]
    first, second = (re.findall(r"`([a-z ]+)`", part.split("(")[1]) for part in told.split("With those"))
    assert (sorted(first), sorted(second)) == (sorted(switches), sorted(files))


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        (("--version",), DONE),
        (("inspect", "no-such-log"), BAD_INPUT),
        (("drives", "list", "--to", "http://127.0.0.1:9"), FAILED),
        (("config", "show", "--config", "no-such-file.toml"), BAD_INPUT),
    ],
)
def test_commands_end_as_the_table_has_it(arguments: tuple[str, ...], status: int, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "wayloom.cli.main", *arguments], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == status, done.stderr
    assert done.stderr.count("\n") == (status != DONE)
    assert done.stderr.startswith("wayloom: ") == (status != DONE)
