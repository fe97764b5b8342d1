"""Stages by name: their keys, and their runs into one folder each.

A stage's key is a hash of all that its result depends on: the contents of its inputs, the parts of the log that it reads, its
settings, the code that its room imports, and the versions of the libraries that make its numbers.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from wayloom.config.one_heap import give_back
from wayloom.config.progress import Progress, silent
from wayloom.config.stages import INGEST, ODOMETRY, Stage, find_stage
from wayloom.errors import StageError
from wayloom.pipeline.code_version import CodeVersion, code_version
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.kernels_ahead import compile_stages
from wayloom.pipeline.log_parts import fingerprint, read_log_file
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext
from wayloom.pipeline.stage_files import STAGE_FILE, digest_of_folder, read_stage_file


@dataclass(frozen=True, slots=True)
class StageKey:
    """All that a stage's result depends on.

    inputs      digest of each result and part of the log that the stage reads
    parameters  its settings, and what they mean by content
    code        the version of what its room imports
    """

    stage: str
    inputs: Mapping[str, str]
    parameters: Mapping[str, Any]
    code: CodeVersion

    @property
    def hex(self) -> str:
        """SHA-256 of it all."""
        code, libraries = self.code.digest, dict(self.code.libraries)
        about = {"stage": self.stage, "inputs": dict(self.inputs), "parameters": dict(self.parameters)}
        return sha256_of_json({**about, "code": code, "libraries": libraries})


def stage_key(name: str, context: StageContext) -> StageKey:
    """The key that a stage's result has, or would have: a folder whose stage.json says it (`finished_key`) need not be made again.

    Raises StageError where a stage that it reads is not finished, InputError for a bad log, network or setting.
    """
    stage = find_stage(name)
    inputs = {read: _digest_of_input(stage, read, context) for read in stage.inputs}
    if name == INGEST:
        inputs["log"] = fingerprint(context.source.log, context.reader_version)
    else:
        inputs |= _log_inputs(stage, context)
    return StageKey(name, inputs, _parameters(stage, context), code_version(_room(stage)))


def compile_for(stages: Sequence[str], context: StageContext, progress: Progress = silent) -> None:
    """Have the kernels at hand that these stages of this drive call, compiled by as many processes as the settings have threads."""
    compile_stages(stages, progress, ODOMETRY in stages and _is_inertial(context), context.settings.threads)


def _is_inertial(context: StageContext) -> bool:
    from wayloom.odometry.backend.visual_inertial import for_log  # of the odometry's whole room, which is not always needed

    return for_log(context.log, context.settings.odometry) is not None


def run_stage(
    name: str, context: StageContext, out_dir: Path, progress: Progress = silent, key: StageKey | None = None
) -> dict[str, Any]:
    """Run a stage into out_dir, which exists and is empty, and return what its stage.json says (`key`, `digest`, `seconds` …).

    key : as of `stage_key`, where the caller has it
    stage.json is written last: a folder that has it is whole. Raises InputError for a bad log, network or setting and
    StageError where the stages before it left nothing to go on with.
    """
    key = key or stage_key(name, context)
    compile_for((name,), context, progress)
    start = time.perf_counter()
    try:
        import_module(_room(find_stage(name))).run(context, out_dir, progress)
    finally:
        give_back()  # else the next stage's memory comes on top of what this one held at most
    metadata = {
        "stage": name,
        "key": key.hex,
        "digest": digest_of_folder(out_dir),
        "seconds": round(time.perf_counter() - start, 3),
        "code": key.code.digest,
        "libraries": dict(key.code.libraries),
        "inputs": dict(key.inputs),
        "parameters": dict(key.parameters),
    }
    (out_dir / STAGE_FILE).write_text(json.dumps(metadata, indent=1) + "\n")
    return metadata


@dataclass(frozen=True, slots=True)
class PartRoom:
    """What a room that makes its stage in parts can do; parts are numbered from 0.

    missing  (context, folder of the parts, progress) → numbers of the parts to be made, after what all need is in the folder
    has      (folder of the parts, number): whether a part is there and undamaged
    make     (context, number, out_dir, progress): one part into an empty folder
    name     of a finished part's folder
    """

    missing: Callable[[StageContext, Path, Progress], list[int]]
    has: Callable[[Path, int], bool]
    make: Callable[[StageContext, int, Path, Progress], None]
    name: Callable[[int], str]


def part_room(name: str) -> PartRoom | None:
    """The room of a stage, where it makes the stage in parts: it has `missing_parts`, `has_part`, `make_part` and
    `part_name`."""
    room = import_module(_room(find_stage(name)))
    if not hasattr(room, "make_part"):
        return None
    return PartRoom(room.missing_parts, room.has_part, room.make_part, room.part_name)


def stage_settings(stage: Stage, settings: ProcessSettings) -> dict[str, Any]:
    """The parts of the settings that the stage's entry names, as JSON."""
    content = settings.model_dump(mode="json")
    return {path: _part(content, path) for path in stage.settings}


def _room(stage: Stage) -> str:
    if stage.room is None:
        raise StageError(f"{stage.name} is a stage of the map: only the service's workers run it")
    return stage.room


def _digest_of_input(stage: Stage, read: str, context: StageContext) -> str:
    metadata = read_stage_file(context.inputs_dir / read)
    if metadata is None:
        raise StageError(f"{stage.name} needs the result of {read}, which is not in {context.inputs_dir}; run {read} first")
    return str(metadata["digest"])


def _log_inputs(stage: Stage, context: StageContext) -> dict[str, str]:
    """The digests of the parts of the log that the stage reads; of the drive's name, the one that it leaves."""
    if not stage.log_parts:
        return {}
    content = read_log_file(context.inputs_dir / INGEST)
    digests = content["digests"] | {"drive": context.drive_id or content["name"]}
    return {f"log/{part}": digests[part] for part in stage.log_parts}


def _parameters(stage: Stage, context: StageContext) -> dict[str, Any]:
    key_parts = getattr(import_module(_room(stage)), "key_parts", None)
    return stage_settings(stage, context.settings) | ({} if key_parts is None else key_parts(context))


def _part(content: Mapping[str, Any], path: str) -> Any:
    value: Any = content
    for name in path.split("."):
        value = value[name]
    return value
