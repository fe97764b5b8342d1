"""What the command line says of mistakes that no command is to blame for."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import IO

import pytest

from logs.made_drives import write_drive

WAYLOOM = (sys.executable, "-m", "wayloom.cli.main")


def wayloom(*arguments: object, stdout: IO[str] | int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    """Run the command line as a user would."""
    command = [*WAYLOOM, *(str(argument) for argument in arguments)]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("frobnicate",), "No such command 'frobnicate'; see "),
        (("process", "log"), "Missing option '--out'; see "),
        (("odometry", "log", "--out", "t", "--threads", "0"), "Invalid value for '--threads'"),
        (("odometry", "log", "--out", "t", "--format", "bag"), "'bag' is not one of 'tum', 'kitti'"),
        (("odometry", "log", "--out", "t", "--threads", "0"), "greater than or equal to 1, not '0'; see "),
        (("odometry", "log", "--out", "t", "--format", "bag"), "Invalid value for '--format': 'bag' is not one of"),
        (("demo", "--port", "-5"), "Invalid value for '--port': Input should be greater than or equal to 0, not '-5'; see "),
        (("render", "log", "--out", "a.png", "--azimuth", "nan"), "Invalid value for '--azimuth': "),
        (("inspect", "--fast", "log"), "No such option"),
    ],
)
def test_a_mistake_in_the_command_line_is_one_line_and_status_2(arguments: tuple[str, ...], said: str) -> None:
    done = wayloom(*arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.startswith("wayloom: ")
    assert done.stderr.endswith(" --help\n")
    assert done.stderr.count("\n") == 1


BOX = "give west,south,east,north in degrees, as 8.40,49.00,8.42,49.01 [input.invalid]"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("render", "log", "--out", "a.png", "--colour", "pink"), "--colour: pink is no colouring; known are class, height, "),
        (("render", "log", "--out", "a.png", "--bbox", "1,2,3"), f"--bbox: 3 numbers are no box; {BOX}"),
        (("export", "log", "--out", "a.laz", "--bbox", "9,9,1,1"), f"--bbox: 9,9,1,1 is no box on Earth; {BOX}"),
        (("export", "log", "--out", "a.laz", "--bbox", "town"), f"--bbox: 'town' is no box; {BOX}"),
        (("export", "log", "--out", "a.laz", "--format", "dwg"), "a.laz, --format: dwg is no format that is written; known are "),
        (("export", "log", "--out", "a.las"), "a.las: .las is no format that is written; did you mean .laz? give --format, "),
        (("drives", "list", "--state", "gone", "--to", "http://x"), "Invalid value for '--state': 'gone' is not one of "),
        (("export", "log", "--out", "a.laz", "--layers", "x"), "a.laz, --layers: x is no layer that this format holds; known are "),
        (("sync", "http://127.0.0.1:9", "d", "--bbox", "9,95,1,1"), f"--bbox: 9,95,1,1 is no box on Earth; {BOX}"),
        (("upload", "l", "--to", "http://127.0.0.1:9", "--limit-rate", "fast"), "--limit-rate: 'fast' is no rate; write one as "),
        (("simulate", "fleet", "--out", "d", "--drives", "x"), "--drives: no drive 'x' in fleet; use some of van-1, "),
        (("process", "log", "--out", "d", "--model", "x"), "--model: unknown network 'x'; known are wayloom-city, "),
    ],
)
def test_a_wrong_value_of_an_option_is_named_with_it_and_what_is_allowed(arguments: tuple[str, ...], said: str) -> None:
    done = wayloom(*arguments)
    assert done.returncode == 2
    assert done.stderr.startswith(f"wayloom: {said}")
    assert done.stderr.count("\n") == 1


def test_no_arguments_at_all_print_the_help() -> None:
    done = wayloom()
    assert done.returncode == 2
    assert "odometry" in done.stdout
    assert done.stderr == ""


def test_help_and_version_end_well() -> None:
    for arguments in (("--help",), ("process", "--help"), ("--version",)):
        assert wayloom(*arguments).returncode == 0


def test_a_name_with_control_characters_stays_on_one_line(tmp_path: Path) -> None:
    done = wayloom("inspect", tmp_path / "two\nlines \x1b[31mred")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "two\\nlines \\x1b[31mred: no such folder" in done.stderr


def test_a_full_disk_under_standard_output_is_one_line(tmp_path: Path) -> None:
    drive = write_drive(tmp_path, "kitti-odometry")
    with open("/dev/full", "w") as full:
        done = wayloom("inspect", drive, stdout=full)
    assert done.returncode == 1
    assert done.stderr == "wayloom: No space left on device\n"


def test_a_name_that_is_no_text_is_read_and_reported(tmp_path: Path) -> None:
    drive = write_drive(tmp_path / "drives", "kitti-odometry")
    folder = os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9")
    drive.rename(folder)
    done = wayloom("inspect", folder, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["name"] == "caf\ufffd"


def test_ctrl_c_inside_of_a_compiled_kernel_is_a_stop() -> None:
    code = (
        "from wayloom.cli import main\n"
        "def app(standalone_mode):\n"
        "    try:\n"
        "        raise SystemError('unpickling returned a result with an exception set') from KeyboardInterrupt()\n"
        "    except SystemError as error:\n"
        "        raise SystemError('the kernel returned a result with an exception set') from error\n"
        "main.app = app\n"
        "main.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "wayloom: stopped\n")


def test_output_that_is_still_to_be_written_when_the_disk_is_full_makes_no_noise_and_no_success() -> None:
    code = "import sys\nfrom wayloom.cli import main\nmain.app = lambda **_: sys.stdout.write('lost') and None\nmain.main()\n"
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", code], stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "wayloom: No space left on device\n")
