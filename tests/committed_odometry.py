"""The committed table of benchmarks/odometry.json, and the bounds that follow from its spread over seeds."""

import json
from pathlib import Path
from typing import Any

from wayloom.evaluation.odometry import DEFAULT

TABLE = Path(__file__).resolve().parents[1] / "benchmarks" / "odometry.json"


def committed_row(recording: str, variant: str = DEFAULT) -> dict[str, Any]:
    """Medians and spreads (largest minus smallest of the seeds) of a recording."""
    rows = json.loads(TABLE.read_text())
    return next(row for row in rows if row["recording"] == recording and row["variant"] == variant)


def least(recording: str, measure: str) -> float:
    """The table's median minus its spread: every seed of the table lies above, and a loss of more than their scatter below."""
    row = committed_row(recording)
    return float(row["median"][measure] - row["spread"][measure])


def most(recording: str, measure: str) -> float:
    """The table's median plus its spread."""
    row = committed_row(recording)
    return float(row["median"][measure] + row["spread"][measure])
