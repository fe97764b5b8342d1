"""The memory that a worker may hold."""

import subprocess
import sys

import pytest

from wayloom.config.machine import machine_memory
from wayloom.config.service import ServiceSettings
from wayloom_workers.faults import WORKER_SHARE


def held(limit: str, more: str) -> str:
    """What a process says that limits itself and then asks for more."""
    code = f"""
import resource
from wayloom.config.machine import machine_memory
from wayloom_workers.faults import limit_memory
limit_memory({limit})
print(resource.getrlimit(resource.RLIMIT_DATA)[0])
try:
    bytearray({more})
    print("got it")
except MemoryError:
    print("MemoryError")
"""
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_a_worker_is_limited_by_default_to_a_share_of_the_machine() -> None:
    assert ServiceSettings.model_fields["stage_memory_bytes"].default == -1
    assert machine_memory() > 1 << 28
    limit, outcome = held("-1", "machine_memory()").split("\n")[:2]
    assert (int(limit), outcome) == (int(WORKER_SHARE * machine_memory()), "MemoryError")


@pytest.mark.parametrize(("limit", "said"), [("300 << 20", "MemoryError"), ("0", "got it")])
def test_a_limit_that_is_set_counts_and_0_is_none(limit: str, said: str) -> None:
    assert held(limit, "400 << 20").split("\n")[1] == said
