"""One job from its claim to its commit."""

import os
import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import structlog

from wayloom.errors import InputError, LeaseLostError, StageError, WayloomError
from wayloom.store import drives, jobs
from wayloom.store.jobs import Claim, JobMessage
from wayloom.store.processes import identity
from wayloom.store.queues import DRIVE_STAGES
from wayloom_workers.heartbeat import Heartbeat, StopRequestedError
from wayloom_workers.steps import StageAttempt, Step, Steps, WorkerContext

log = structlog.get_logger()


def run_job(bench: WorkerContext, steps: Steps, wake: Callable[[Iterable[JobMessage]], None], job_id: int) -> bool:
    """Run the job if it is to be had. Whatever goes wrong in the stage ends up in the job's row. Returns whether it was claimed."""
    held = jobs.claim(bench.database, job_id, identity(), bench.settings.lease_s)
    if held is None:
        log.info("nothing to do", job_id=job_id)
        return False
    with structlog.contextvars.bound_contextvars(job_id=job_id, drive_id=held.drive_id, stage=held.stage, attempt=held.attempt):
        started = time.monotonic()
        try:
            wake(_run(bench, steps[held.stage], held))
            log.info("stage done", seconds=round(time.monotonic() - started, 3))
        except LeaseLostError as error:
            log.warning("lease lost", error=str(error))
        except StopRequestedError:
            _give_back(bench, held)
        except Exception as error:
            log.exception("stage failed")
            _write_failure(bench, held, error)
    return True


def _run(bench: WorkerContext, step: Step, held: Claim) -> list[JobMessage]:
    """Make the output, or find it made, and commit. Returns the jobs to wake."""
    with Heartbeat(bench, held) as beat:
        attempt = _home(bench, held) / "attempts" / f"{held.stage}-{held.job_id}-{held.token}"
        try:
            work = _prepare(bench, held, attempt, beat)
            key = step.key(work)
            output = _output(bench, held, held.stage, key)
            if output.is_dir():
                log.info("output is there already", key=key[:12])
            else:
                step.run(work)
                beat.check()
                _keep(work.out_dir, output)
            done = replace(work, out_dir=output)
            step.share(done)
            with bench.database.write() as session:
                following = jobs.finish(session, held, key)
                woken = step.record(session, done)
            return woken + ([following] if following else [])
        finally:
            shutil.rmtree(attempt, ignore_errors=True)


def _home(bench: WorkerContext, held: Claim) -> Path:
    return bench.folders.map(held.map_id) if held.map_id is not None else bench.folders.drive(str(held.drive_id))


def _output(bench: WorkerContext, held: Claim, stage: str, key: str) -> Path:
    return _home(bench, held) / "stages" / stage / key


def _prepare(bench: WorkerContext, held: Claim, attempt: Path, beat: Heartbeat) -> StageAttempt:
    """Fresh folders for the attempt; what earlier attempts of the job left is removed."""
    for old in attempt.parent.glob(f"{held.stage}-{held.job_id}-*"):
        shutil.rmtree(old, ignore_errors=True)
    inputs_dir, out_dir = attempt / "inputs", attempt / "out"
    inputs_dir.mkdir(parents=True)
    out_dir.mkdir()
    inputs = _inputs(bench, held)
    for name, key in inputs.items():
        folder = _output(bench, held, name, key)
        if not folder.is_dir():
            raise StageError(f"the output of {name} is gone from {folder}: remove the drive and send it again")
        (inputs_dir / name).symlink_to(folder, target_is_directory=True)
    log_path, gnss_path = _drive_paths(bench, held)
    return StageAttempt(bench, held, log_path, gnss_path, inputs_dir, inputs, out_dir, beat)


def _inputs(bench: WorkerContext, held: Claim) -> dict[str, str]:
    """The stages before this one and the keys of their outputs."""
    if held.drive_id is not None and held.stage in DRIVE_STAGES:
        with bench.database.read() as session:
            return jobs.input_keys(session, held.drive_id, held.stage)
    return {"stitch": str(held.payload["stitch"])} if "stitch" in held.payload else {}


def _drive_paths(bench: WorkerContext, held: Claim) -> tuple[Path | None, Path | None]:
    if held.drive_id is None:
        return None, None
    with bench.database.read() as session:
        manifest = drives.get(session, held.drive_id).manifest
    folder = bench.folders.drive(held.drive_id)
    return folder / manifest["log"], folder / manifest["gnss"] if manifest.get("gnss") else None


def _keep(out_dir: Path, output: Path) -> None:
    """Turn the attempt into the output by one rename. If another attempt was faster, its output (the same bytes) stays."""
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.rename(out_dir, output)
    except OSError:
        if not output.is_dir():
            raise


def _give_back(bench: WorkerContext, held: Claim) -> None:
    try:
        with bench.database.write() as session:
            jobs.release(session, held)
        log.info("job given back")
    except LeaseLostError as error:
        log.warning("lease lost", error=str(error))


def _write_failure(bench: WorkerContext, held: Claim, error: Exception) -> None:
    """Bad input fails at once, anything else after the last attempt. A job to repeat waits for the sweeper: a short pause."""
    final = isinstance(error, InputError | StageError) or held.attempt >= bench.settings.max_attempts
    text = str(error) if isinstance(error, WayloomError) else f"{type(error).__name__}: {error}"
    try:
        with bench.database.write() as session:
            jobs.fail(session, held, _without_folders(bench, text), final=final)
    except LeaseLostError as lost:
        log.warning("lease lost", error=str(lost))


def _without_folders(bench: WorkerContext, text: str) -> str:
    """The message without this machine's paths, which say nothing to whoever sent the drive."""
    return text.replace(f"{bench.folders.root}/", "")
