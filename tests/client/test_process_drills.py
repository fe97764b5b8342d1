"""Drills of a service's processes: ours passes them, one that loses something is told, and compose is asked for the same."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from service_kit.packed_drives import packed_drive
from service_kit.running import ROOT, environment
from wayloom.client.selftest.compose import ComposeHands
from wayloom.client.selftest.embedded import EmbeddedHands
from wayloom.client.selftest.hands import NotTriedError
from wayloom.client.selftest.process_drills import PROCESS_DRILLS, REPEATED, drilled
from wayloom.client.selftest.report import Verdict
from wayloom.client.selftest.trial import Trial, small_drives
from wayloom.config.stages import drive_stages
from wayloom.errors import ServiceError

QUICK = {name: {"seconds": 0.3} for name in drive_stages()}
PATHS = os.pathsep.join(str(ROOT / name) for name in ("core", "services", "workers", "tests"))
RUNNING = "api\nbroker\ndatabase\nsweeper\nworker-map\nworker-odometry\n"


@pytest.fixture(scope="module")
def hands() -> Iterator[EmbeddedHands]:
    """A service with small stages."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", PATHS)
        with EmbeddedHands(WAYLOOM_STAGE_HOOKS="service_kit.little_stages:hooks") as started:
            yield started


@pytest.fixture
def trial(hands: EmbeddedHands, tmp_path: Path) -> Iterator[Trial]:
    sent = Trial(hands.url, None, [packed_drive(tmp_path, "drilled", QUICK, sizes=(200_000,) * 20)])
    yield sent
    sent.close()


def test_our_service_passes_every_drill_that_this_machine_allows(hands: EmbeddedHands, trial: Trial) -> None:
    trial.check_empty()
    verdicts = {one.name: one for one in drilled(hands, trial)}
    left = {"ended database", *(() if hands.has_small_disk else ("full disk",))}
    assert {name: one for name, one in verdicts.items() if one.verdict != "passed" and name not in left} == {}
    assert {verdicts[name].verdict for name in left} == {"not tried"}
    assert list(verdicts) == [drill.name for drill in PROCESS_DRILLS]


def test_another_map_than_the_undisturbed_ones_fails(hands: EmbeddedHands, trial: Trial) -> None:
    trial.expected = "0" * 64
    first = next(drilled(hands, trial))
    assert (first.verdict, "that of the undisturbed run is 000000000000" in first.found) == ("failed", True)


def test_a_stage_that_failed_once_fails_the_drill_though_the_drive_came_through(hands: EmbeddedHands, tmp_path: Path) -> None:
    trial = Trial(hands.url, None, [packed_drive(tmp_path, "unlucky", {"odometry": {"fail": 1}})])
    first = next(drilled(hands, trial))
    trial.close()
    assert (first.verdict, "attempts were counted: {'odometry': 2}" in first.found) == ("failed", True)


def test_a_service_that_has_drives_is_not_drilled(hands: EmbeddedHands, trial: Trial) -> None:
    trial.send()
    with pytest.raises(ServiceError, match="has drives"):
        trial.check_empty()
    trial.finish()
    trial.forget()
    trial.check_empty()


def test_simulated_drives_are_of_the_vehicles_that_are_asked_for(tmp_path: Path) -> None:
    (drive,) = small_drives(tmp_path, ("car-2",), frames=2)
    assert drive.manifest.vehicle_id == "car-2"
    assert len([file for file in drive.manifest.files if file.path.endswith(".png")]) == 4


class Docker:
    """What would have been run; the deployment's services are those of RUNNING."""

    def __init__(self) -> None:
        self.commands: list[str] = []

    def __call__(self, command: Sequence[str]) -> str:
        self.commands.append(" ".join(command))
        return RUNNING if "ps" in command else ""


def compose(docker: Docker) -> ComposeHands:
    return ComposeHands(Path("stack.yml"), "http://127.0.0.1:8088", "k" * 16, 90.0, docker)


def test_compose_is_asked_for_what_the_drills_do(monkeypatch: pytest.MonkeyPatch) -> None:
    docker = Docker()
    hands = compose(docker)
    monkeypatch.setattr("wayloom.client.selftest.compose.time.sleep", lambda _: None)
    hands.kill_api()
    hands.kill_workers()
    hands.hold_workers(135.0)
    hands.wipe_broker()
    hands.restart_database()
    with hands.beside("-m", "wayloom_workers", "sweep"):
        pass
    base = "docker compose -f stack.yml"
    assert docker.commands == [
        f"{base} ps --services --status running",
        f"{base} kill --signal SIGKILL api",
        f"{base} start api",
        f"{base} kill --signal SIGKILL worker-map worker-odometry",
        f"{base} start worker-map worker-odometry",
        f"{base} pause worker-map worker-odometry",
        f"{base} unpause worker-map worker-odometry",
        f"{base} exec -T broker valkey-cli FLUSHALL",
        f"{base} kill --signal SIGKILL database",
        f"{base} start database",
        f"{base} exec -T -d sweeper timeout 600 python -m wayloom_workers sweep",
        f"{base} kill --signal SIGKILL sweeper",
        f"{base} start sweeper",
    ]


def test_messages_are_repeated_by_the_drills_alone(hands: EmbeddedHands) -> None:
    """The production entry point does not know how; what the drill runs instead does not end by itself."""
    command = [sys.executable, "-m", "wayloom_workers", "repeat"]
    refused = subprocess.run(command, env=hands.environment, capture_output=True, text=True, check=False)
    assert (refused.returncode, "invalid choice: 'repeat'" in refused.stderr) == (2, True)
    with pytest.raises(subprocess.TimeoutExpired):
        subprocess.run([sys.executable, "-c", REPEATED], env=hands.environment, check=False, timeout=6.0)


def test_what_would_harm_others_on_a_machine_of_containers_is_not_tried() -> None:
    hands = compose(Docker())
    with pytest.raises(NotTriedError, match="disk"), hands.full_disk():
        pass
    with pytest.raises(NotTriedError, match="clock"):
        hands.jump_clock(1.0)


def test_the_services_that_drills_name_are_those_of_the_repositorys_compose_file() -> None:
    text = (ROOT / "docker-compose.yml").read_text()
    for name in ("api", "broker", "database", "sweeper", "worker-odometry"):
        assert f"\n  {name}:\n" in text


def test_a_deployment_without_workers_is_not_drilled() -> None:
    with pytest.raises(ServiceError, match="no workers"):
        ComposeHands(Path("stack.yml"), "http://127.0.0.1:8088", None, 90.0, lambda _: "api\n")


@pytest.mark.parametrize("arguments", [(), ("http://127.0.0.1:9", "--local"), ("--compose", "stack.yml")])
def test_a_service_is_either_named_or_started(arguments: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "wayloom.cli.main", "selftest", *arguments]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)


def test_the_command_drills_a_service_of_its_own_and_reports(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With everything but the drills themselves, which the tests above run."""
    from wayloom.cli import selftest

    seen: list[Any] = []

    def of_processes(started: EmbeddedHands, say: Callable[[str], None]) -> list[Verdict]:
        say("drilling")
        seen.append((started.url, started.folder.is_dir()))
        return [Verdict("process", "killed workers", "nothing is lost", "failed", "a drive")]

    monkeypatch.setenv("PYTHONPATH", PATHS)
    monkeypatch.setattr(selftest, "_of_processes", of_processes)
    with pytest.raises(SystemExit, match="1"):
        selftest.selftest_command(local=True, as_json=True)
    printed, said = capsys.readouterr()
    report = json.loads(printed)
    assert "drilling" in said
    assert (report["url"], report["failed"], report["drive_removed"]) == (seen[0][0], 1, True)
    assert {one["verdict"] for one in report["checks"] if one["kind"] != "process"} == {"passed"}
    assert report["checks"][-1]["found"] == "a drive"
