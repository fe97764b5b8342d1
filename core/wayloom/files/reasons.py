"""Reasons for which a file of a log, or a frame, is refused: stable codes for programs, in one table.

`InputError.reason` is one of these. A code never changes its meaning; the message beside it is for people, and may.
"""

from typing import Final

REASONS: Final[dict[str, str]] = {
    "file.missing": "a file that has to be there is not",
    "file.unreadable": "the system refuses to read it: permissions, a faulty disk",
    "file.irregular": "a pipe, device, socket or folder where a file should be; it is not opened",
    "file.outside": "a symbolic link leads out of the log",
    "file.too_large": "it would not fit into memory as a whole",
    "file.not_text": "bytes that are no UTF-8 where text belongs",
    "file.cut": "a line, a list or a record ends too early",
    "number.malformed": "a word where a number belongs",
    "number.out_of_range": "a number that is not finite, or beyond what it can mean",
    "times.malformed": "a time stamp that cannot be read, or is no possible time",
    "times.not_increasing": "a time stamp that repeats the one before it, or goes back",
    "times.count": "more or fewer time stamps than images",
    "times.other_clock": "records that never meet the frames in time",
    "image.missing": "no image, or no folder of images",
    "image.empty": "a file of no bytes",
    "image.truncated": "the file ends before its image does",
    "image.checksum": "a check sum that does not fit the bytes",
    "image.undecodable": "no image, or one that cannot be unpacked",
    "image.too_large": "more pixels than any camera has",
    "image.size": "another size than the log's other images",
    "image.unpaired": "a left image without a right one, or the other way round",
    "image.ambiguous": "two images of one frame",
    "recording.damaged": "an MCAP file, or a part of it, that is none",
    "format.unknown": "nothing that is known was recognised",
    "log.invalid": "a log, or a file in it, contradicts itself in another way",
    "calibration.invalid": "a calibration is missing or impossible",
    "model.invalid": "a network or its description cannot be used",
    "config.invalid": "a setting is unknown, out of range or contradicts another",
    "extra.missing": "packages that it needs are not installed; the remedy names the extra",
    "input.invalid": "anything else",
}
