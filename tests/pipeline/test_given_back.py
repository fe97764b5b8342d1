"""A process that runs stages gives back what one freed before it runs the next."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from wayloom.config.stages import ODOMETRY
from wayloom.pipeline import running

KEY: Any = SimpleNamespace(hex="", code=SimpleNamespace(digest="", libraries={}), inputs={}, parameters={})


def done(*_: object) -> None:
    """A stage that leaves nothing."""


def failed(*_: object) -> None:
    """A stage that its input does not suit."""
    raise ValueError("unsuitable")


@pytest.mark.parametrize("stage", [done, failed])
def test_memory_is_given_back_however_a_stage_ends(
    stage: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    def run(*about: object) -> None:
        told.append("run")
        stage(*about)

    monkeypatch.setattr(running, "compile_for", done)
    monkeypatch.setattr(running, "import_module", lambda _name: SimpleNamespace(run=run))
    monkeypatch.setattr(running, "give_back", lambda: told.append("given back"))
    context: Any = None
    if stage is failed:
        with pytest.raises(ValueError, match="unsuitable"):
            running.run_stage(ODOMETRY, context, tmp_path, key=KEY)
    else:
        running.run_stage(ODOMETRY, context, tmp_path, key=KEY)
    assert told == ["run", "given back"]
