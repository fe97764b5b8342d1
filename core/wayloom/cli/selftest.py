"""`wayloom selftest`: a service tried from outside, or with a grip on its processes."""

import contextlib
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wayloom.cli.options import SERVER_HELP, ConfigOption, known_server
from wayloom.cli.results import JsonOption, print_json, words
from wayloom.errors import ConfigError

if TYPE_CHECKING:
    from wayloom.client.selftest.hands import Hands
    from wayloom.client.selftest.report import Verdict
    from wayloom.pipeline.settings import WayloomSettings


def selftest_command(
    url: Annotated[str | None, typer.Argument(metavar="URL", help="Address of the service.")] = None,
    to: Annotated[str | None, typer.Option("--to", "--server", metavar="URL", help=SERVER_HELP)] = None,
    local: Annotated[bool, typer.Option("--local", help="Start a service of its own, and drill its processes too.")] = False,
    compose: Annotated[
        Path | None,
        typer.Option(help="Drill the processes of this compose file's deployment at URL too, if it has no drives."),
    ] = None,
    as_json: JsonOption = False,
    config: ConfigOption = None,
) -> None:
    """Try a running service: what tus 1.0.0 asks of it clause by clause, and that nothing is lost when links break. It sends a
    drive of random bytes that is never processed, and removes it. With --local or --compose its processes are killed, held and
    starved too, while simulated drives go through them. Ends with 1 where something failed."""
    from wayloom.client.selftest import report as reports
    from wayloom.pipeline.settings import load_settings

    url = url or to if local else known_server(url, to)
    if local == (url is not None) or (compose is not None and url is None):
        raise ConfigError("the service is named by URL, or started by --local", remedy="give one of the two; --compose wants a URL")
    say = words(as_json)
    with contextlib.ExitStack() as stack:
        hands = None
        if url is None or compose is not None:
            hands = stack.enter_context(_grip(url, compose, load_settings(config).settings))
        url, key = (url, load_settings(config).settings.api_key) if hands is None else (hands.url, hands.key)
        verdicts, removed = _from_outside(url or "", key, say)
        if hands is not None:
            verdicts += _of_processes(hands, say)
    report = reports.as_json(url or "", verdicts, removed)
    counts = Counter(one.verdict for one in verdicts)
    told = ("passed", "failed", "not offered", *(("not tried",) if counts["not tried"] else ()))
    say(", ".join(f"{counts[verdict]} {verdict}" for verdict in told))
    if as_json:
        print_json(report)
    sys.exit(0 if report["passed"] else 1)


@contextlib.contextmanager
def _grip(url: str | None, compose: Path | None, settings: "WayloomSettings") -> "Iterator[Hands]":
    """On a service that is started, or on a deployment."""
    from wayloom.client.selftest.compose import ComposeHands
    from wayloom.client.selftest.embedded import EmbeddedHands

    if compose is not None and url is not None:
        key = settings.api_key or os.environ.get("WAYLOOM_API_KEY")
        yield ComposeHands(compose, url, key, settings.lease_s)
    else:
        with EmbeddedHands() as hands:
            yield hands


def _from_outside(url: str, key: str | None, say: Callable[[str], None]) -> "tuple[list[Verdict], bool]":
    """Verdicts of the protocol and of the way, and whether the drive is removed again."""
    from wayloom.client.selftest.report import tried
    from wayloom.client.selftest.subject import Subject

    with Subject(url, key) as subject:
        verdicts = [_told(one, say) for one in tried(subject)]
        removed = subject.remove()
    if not removed:
        typer.echo(f"the drive {subject.drive_id[:12]} was left there: this key may not remove it", err=True)
    return verdicts, removed


def _of_processes(hands: "Hands", say: Callable[[str], None]) -> "list[Verdict]":
    """Verdicts of the drills of processes."""
    from wayloom.client.selftest.process_drills import drilled
    from wayloom.client.selftest.trial import Trial, small_drives

    with tempfile.TemporaryDirectory(prefix="wayloom-drives-") as folder:
        trial = Trial(hands.url, hands.key, small_drives(Path(folder)))
        try:
            trial.check_empty()
            return [_told(one, say) for one in drilled(hands, trial)]
        finally:
            trial.close()


def _told(one: "Verdict", say: Callable[[str], None]) -> "Verdict":
    say(f"{one.verdict:<12} {one.kind:<7} {one.name:<16} {one.asks}{f': {one.found}' if one.found else ''}")
    return one
