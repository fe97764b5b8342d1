"""docs/command-line.md says what the program says of itself, and commands end as its table has it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.testing import CliRunner

from logs.made_drives import write_drive
from wayloom.cli.main import COMMANDS, app
from wayloom.cli.options import SERVER_HELP
from wayloom.cli.results import JsonOption
from wayloom.cli.statuses import BAD_INPUT, DONE, FAILED, STATUSES

JSON_HELP = JsonOption.__metadata__[0].help
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


def test_json_is_the_one_switch_of_every_command_but_those_that_are_named() -> None:
    without = set()
    for name in (name for names in COMMANDS.values() for name in names):
        command = commands_of_the_program()[name]
        for below, one in (getattr(command, "commands", None) or {"": command}).items():
            options = [option for option in one.params if isinstance(option, TyperOption) and "--json" in option.opts]
            assert all(option.is_flag and option.help == JSON_HELP for option in options), (name, below)
            without |= set() if options else {f"{name} {below}".strip()}
    told = PAGE.split("- `--json`")[1].split("\n- ")[0]
    always, files = (set(re.findall(r"`([a-z ]+)`", part)) for part in re.findall(r"\(([^)]+)\)", told))
    assert {name for name in without if name.split()[0] not in always} == files
    assert {name.split()[0] for name in without} >= always


def test_the_address_of_a_service_has_one_spelling_everywhere_beside_that_of_its_direction() -> None:
    found: dict[str, set[str]] = {"--to": set(), "--from": set()}
    for name, command in commands_of_the_program().items():
        for one in (getattr(command, "commands", None) or {"": command}).values():
            for option in one.params:
                if option.metavar == "URL" and isinstance(option, TyperOption):
                    direction, alias = option.opts
                    assert (alias, option.help) == ("--server", SERVER_HELP), name
                    found[direction].add(name)
    told = PAGE.split("- `--server URL`")[1].split("\n- ")[0]
    to, of = (set(re.findall(r"`([a-z]+)`", part)) for part in re.findall(r"\(([^)]+)\)", told))
    assert found == {"--to": to, "--from": of}


@pytest.mark.parametrize(
    "arguments",
    [
        ("areas", "list"), ("drives", "list"), ("selftest",), ("sync", "DIR"), ("rigs", "list"), ("rigs", "show", "RIG"),
        ("export", "--out", "map.laz"), ("render", "--out", "map.png"), ("report", "--out", "map.html"),
    ],
)  # fmt: skip
def test_the_address_is_taken_from_the_option_else_from_the_environment(
    arguments: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def asked(*more: str) -> str:
        return str(CliRunner().invoke(app, [*arguments, *more], standalone_mode=False).exception)

    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("WAYLOOM_SERVER", raising=False)
    assert re.search("no service is named|Missing parameter|nothing to show|named by URL|--from URL", asked())
    monkeypatch.setenv("WAYLOOM_SERVER", "set.example")
    assert asked().startswith("set.example is no address of a server")
    direction = "--to" if arguments[0] in ("areas", "drives", "selftest") else "--from"
    for option in (direction, "--server"):
        assert asked(option, "given.example").startswith("given.example is no address of a server")


@pytest.mark.parametrize(
    "arguments", [("sync", "http://one", "DIR"), ("rigs", "show", "http://one", "RIG"), ("rigs", "list", "http://one")]
)
def test_an_address_that_is_an_argument_and_an_option_is_refused(arguments: tuple[str, ...]) -> None:
    told = CliRunner().invoke(app, [*arguments, "--server", "http://two"], standalone_mode=False).exception
    assert str(told) == "the service is named twice, http://one and http://two; leave one of the two out"


@pytest.mark.parametrize(
    "arguments",
    [
        ("config", "show", "--json"),
        ("doctor", "--json"),
        ("inspect", "drive", "--json"),
        ("models", "--json"),
        ("models", "show", "wayloom-city", "--json"),
    ],
)
def test_with_json_standard_output_is_one_document(arguments: tuple[str, ...], tmp_path: Path) -> None:
    write_drive(tmp_path, "kitti-odometry").rename(tmp_path / "drive")
    done = subprocess.run(
        [sys.executable, "-m", "wayloom.cli.main", *arguments], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode in (DONE, FAILED), done.stderr
    assert json.loads(done.stdout)


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
