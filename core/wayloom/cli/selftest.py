"""`wayloom selftest`: a service tried from outside."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from wayloom.cli.options import ConfigOption


def selftest_command(
    url: Annotated[str, typer.Argument(metavar="URL", help="Address of the service, e.g. http://127.0.0.1:8088")],
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write every verdict there.")] = None,
    config: ConfigOption = None,
) -> None:
    """Try a running service: what tus 1.0.0 asks of it clause by clause, and that nothing is lost when links break. It sends a
    drive of random bytes that is never processed, and removes it. Ends with 1 where something failed."""
    from wayloom.client.selftest.report import as_json, tried
    from wayloom.client.selftest.subject import Subject
    from wayloom.files.atomic import write_atomically
    from wayloom.pipeline.settings import load_settings

    with Subject(url, load_settings(config).settings.api_key) as subject:
        verdicts = []
        for one in tried(subject):
            verdicts.append(one)
            typer.echo(f"{one.verdict:<12} {one.kind:<6} {one.name:<16} {one.asks}{f': {one.found}' if one.found else ''}")
        removed = subject.remove()
    report = as_json(url, verdicts, removed)
    if json_file is not None:
        write_atomically(json_file, json.dumps(report, indent=1).encode())
    if not removed:
        typer.echo(f"the drive {subject.drive_id[:12]} was left there: this key may not remove it", err=True)
    passed = sum(one.verdict == "passed" for one in verdicts)
    typer.echo(f"{passed} passed, {report['failed']} failed, {len(verdicts) - passed - report['failed']} not offered")
    sys.exit(0 if report["passed"] else 1)
