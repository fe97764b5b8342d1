"""The pages as a site, the commands of the ten minutes, and the functions that the page of the maths names."""

import importlib
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SMALLER = {
    "--size half": "--size quarter --frames 24",
    "--seconds 4": "--seconds 0.2 --size 320x180",
    "city.png": "city.png --size 640x360",
}
"""The same commands on less."""


def run(*command: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
    return subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, cwd=folder, env=environment)


def test_the_site_is_built_without_a_warning_and_has_every_page(tmp_path: Path) -> None:
    done = run("mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site"), folder=ROOT, NO_MKDOCS_2_WARNING="1")
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    built = {path.relative_to(tmp_path / "site").with_suffix(".md").as_posix() for path in (tmp_path / "site").rglob("*.html")}
    pages = {path.relative_to(DOCS).as_posix().replace("README", "index") for path in DOCS.rglob("*.md")}
    assert pages - built == set()
    start = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert "fonts.googleapis" not in start  # nothing is fetched from elsewhere
    assert "wayloom.pipeline" not in (tmp_path / "site" / "own-vehicle.html").read_text(encoding="utf-8")


def commands_of(page: str) -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    lines = [line.partition("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line.startswith("wayloom ")]


def test_the_commands_of_the_ten_minutes_run_one_after_another(tmp_path: Path) -> None:
    commands = commands_of("ten-minutes.md")
    assert len(commands) >= 10
    for command in commands:
        for words, smaller in SMALLER.items():
            command = command.replace(words, smaller)
        done = run("wayloom.cli.main", *shlex.split(command)[1:], folder=tmp_path)
        assert done.returncode == 0, f"{command}: {done.stderr}"
    (code,) = re.findall(r"```python\n(.*?)```", (DOCS / "ten-minutes.md").read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "code.py").write_text(code)
    done = run("code", folder=tmp_path)
    assert (done.returncode, done.stdout.count("\n")) == (0, 2), done.stderr
    made = ("city.png", "drives.png", "flight.webm", "city.gpkg", "city.copc.laz", "city.mcap", "out/car-1/report.html")
    assert [name for name in made if not (tmp_path / name).stat().st_size] == []


def test_every_function_beside_an_equation_is_there() -> None:
    rows = re.findall(r"^\| (.+?) \| (.+?) \| `(wayloom[\w.]+)` \|$", (DOCS / "maths.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) > 15
    for _, _, name in rows:
        module, _, function = name.rpartition(".")
        assert callable(getattr(importlib.import_module(module), function)), name


@pytest.mark.parametrize("page", ["own-vehicle.md", "deployment.md", "comparison.md", "index.md", "exports.md"])
def test_the_commands_and_settings_that_a_page_names_exist(page: str) -> None:
    from wayloom.cli.main import COMMANDS
    from wayloom.pipeline.settings import WayloomSettings

    text = (DOCS / page).read_text(encoding="utf-8")
    known = {name for names in COMMANDS.values() for name in names}
    code = "\n".join(re.findall(r"```sh\n.*?```|^    .*?$|`wayloom [^`]*`", text, re.DOTALL | re.MULTILINE))
    assert set(re.findall(r"(?:`|^|^ +)wayloom ([a-z]+)\b", code, re.MULTILINE)) <= known
    settings = {f"WAYLOOM_{name.upper()}" for name in WayloomSettings.model_fields}
    assert {*re.findall(r"`(WAYLOOM_[A-Z_]+)`", text)} <= settings
    for script in re.findall(r"python (benchmarks/\w+\.py)", text):
        assert (ROOT / script).is_file()
