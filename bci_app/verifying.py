"""A closed recording, read back and compared with what was heard while it was written."""

from pathlib import Path

from bci_app.errors import SetupError
from bci_app.heard import Heard
from bci_app.recording import read
from bci_app.runs import checksum, write_sums


def verify(path: Path, heard: Heard, eeg_type: str, has_truth: bool) -> tuple[str, list[str]]:
    """The finding in a sentence, and what is missing or damaged, a sentence each; writes the checksums of its chunks.

    ``eeg_type`` is the LSL type of its EEG stream, ``has_truth`` whether our own stimulus ran.
    """
    try:
        recording = read(path, True, eeg_type)
        missing = heard.missing_in(recording, has_truth)
    except SetupError as error:
        recording, missing = None, [str(error)]
    try:
        write_sums(path)
    except SetupError as error:
        missing.append(str(error))
    if recording is None or missing:
        return f"The recording isn't what was heard: {' '.join(missing)}", missing
    return (
        f"Read back: {heard.moves} moves, {heard.verdicts.total()} verdicts, {len(recording.times)} EEG samples; "
        f"nothing that was heard is missing. SHA-256 {checksum(path)}."
    ), []
