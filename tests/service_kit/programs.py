"""Programs of the machine that tests call."""

import os
import shutil

import pytest


def needed(program: str, package: str) -> None:
    """A program that is missing is a failure in CI and a skip elsewhere. package : of Debian, that has it"""
    if shutil.which(program) is not None:
        return
    message = f"no {program} on this machine: install Debian's {package}"
    if os.environ.get("CI"):
        pytest.fail(message)
    pytest.skip(message)
