"""A closed recording, read back and compared with what was heard while it was written."""

from dataclasses import dataclass
from pathlib import Path

from bci_app.errors import SetupError
from bci_app.heard import Heard
from bci_app.recording import Recording, read
from bci_app.runs import checksum, write_sums


@dataclass(frozen=True)
class Finding:
    """What came of it.

    Attributes
    ----------
    sentence : all of it in one.
    missing : what is missing or damaged, a sentence each.
    sha256 : of the file.
    recording : as it was read; None where it couldn't be.
    """

    sentence: str
    missing: list[str]
    sha256: str
    recording: Recording | None


def verify(path: Path, heard: Heard, eeg_type: str, has_truth: bool) -> Finding:
    """Read a closed recording back, and write down the checksums of its chunks.

    ``eeg_type`` is the LSL type of its EEG stream, ``has_truth`` whether our own stimulus ran.
    """
    try:
        recording = read(path, True, eeg_type)
        missing = heard.missing_in(recording, has_truth)
    except SetupError as error:
        recording, missing = None, [str(error)]
    sha256 = ""
    try:
        write_sums(path)
        sha256 = checksum(path)
    except SetupError as error:
        missing.append(str(error))
    except OSError as error:
        missing.append(f"{path} can't be read: {error.strerror}.")
    if recording is None or missing:
        return Finding(f"The recording isn't what was heard: {' '.join(missing)}", missing, sha256, recording)
    counts = f"{heard.moves} moves, {heard.verdicts.total()} verdicts, {len(recording.times)} EEG samples"
    sentence = f"Read back: {counts}; nothing that was heard is missing. SHA-256 {sha256}."
    return Finding(sentence, [], sha256, recording)
