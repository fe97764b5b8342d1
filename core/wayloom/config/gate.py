"""Gate of the city map: which grades of drives are merged, held for an operator, or quarantined."""

from typing import Final, Literal, Self

from pydantic import Field, model_validator

from wayloom.config.settings import Settings

Gate = Literal["merge", "hold", "quarantine"]
Grade = Literal["A", "B", "C", "D", "E"]
GATES: Final[tuple[Gate, ...]] = ("merge", "hold", "quarantine")
"""Strictest last."""


class GateSettings(Settings):
    """Thresholds, the same for a drive's own grade and for the one that its meetings in the map earn.

    A drive without GNSS is held, whatever they are; so is one of any worse grade whose place alone is uncertain.
    """

    merge_up_to: Grade = Field("C", description="drives of this grade and better are merged into the map")
    hold_up_to: Grade = Field(
        "D", description="worse ones up to this are held; beyond it, where not the place alone is in doubt, quarantined"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.hold_up_to < self.merge_up_to:
            raise ValueError(
                f"hold_up_to {self.hold_up_to} is a better grade than merge_up_to {self.merge_up_to}: name a worse one"
            )
        return self


def gate_of(grade: str | None, settings: GateSettings = GateSettings(), sound: bool = False) -> Gate:
    """What the map does with a drive of this grade, A to E; None: the drive has no place on Earth.

    sound : nothing speaks against the drive itself, however uncertain its place is: other drives may still place it
    """
    if grade is None:
        return "hold"
    if grade <= settings.merge_up_to:
        return "merge"
    return "hold" if sound or grade <= settings.hold_up_to else "quarantine"
