"""States of a drive in a service, in the order in which it may come to them."""

from typing import Literal

DriveState = Literal["uploading", "queued", "running", "stitching", "done", "held", "quarantined", "failed", "removing"]
