"""The texts and JSON files of a dataset."""

from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

from bci_app.bids.about import About
from bci_app.bids.columns import HED_VERSION

SIMULATED = "SIMULATED: no person was recorded. A computer program took the participant's place. "
TASKS = {
    "calibration": (
        "An agent moves over an 11 x 11 grid towards a goal, one cell a move, and errs with a set probability. The "
        "participant sees the goal and the agent and judges each move in silence. The epochs train a decoder of the "
        "error-related potential (ErrP)."
    ),
    "online": (
        "An agent searches a grid for a goal that only the participant sees. A decoder tells from the EEG after each "
        "move whether it was an error, and a policy chooses the next move by these verdicts. One episode for each "
        "initial distance."
    ),
}
INSTRUCTIONS = (
    "Watch the agent and judge each move in silence: did it come closer to the goal or not? "
    "Blink while the agent rests."
)
PARTICIPANTS = {
    "participant_id": {"Description": "The participant's label"},
    "simulated": {
        "Description": "Whether a program took the participant's place",
        "Levels": {"no": "A person", "yes": "A program; nobody was recorded", "some": "A program in some of the runs"},
    },
    "age": {"Description": "Age at the recording", "Units": "year"},
    "sex": {"Description": "Sex as the participant told it", "Levels": {"F": "female", "M": "male", "O": "other"}},
    "hand": {"Description": "Dominant hand", "Levels": {"R": "right", "L": "left", "A": "both"}},
}
SCANS = {
    "filename": {"Description": "The run's EEG"},
    "acq_time": {"Description": "When it was recorded; never told, for it may identify a person"},
    "map": {"Description": "Map of the run"},
    "simulated": {
        "Description": "Whether a program took the participant's place",
        "Levels": {"yes": "It did; nobody was recorded", "no": "A person"},
    },
    "ended": {
        "Description": "How the run ended",
        "Levels": {
            "complete": "All of it was done",
            "interrupted": "By the experimenter or the participant",
            "failed": "A program or a device failed",
            "cut": "Its end isn't in the record",
        },
    },
    "continues": {"Description": "Runs that this one went on from after they were broken off"},
    "lost_samples": {"Description": "Samples that are missing inside the run"},
}
README = """# {name}

EEG of a closed-loop brain-computer interface: an agent searches a grid for a goal that only the participant can see,
and is steered by the participant's error-related potentials. After X. Wang, H.-T. Chen, C.-T. Lin, J. Neural Eng. 19
066023 (2022). Recorded and exported with errp-bci.

## Tasks

- `calibration`: {calibration}
- `online`: {online}

## Where things are

- `sub-*/ses-*/eeg/*_eeg.vhdr`: the EEG as it was recorded, unfiltered, all samples, in microvolts as 32-bit floats.
  `*_eeg.json` also tells each run's seed, map, configuration and the versions of all software (`ErrpBci`).
- `*_events.tsv`: one row a move with truth, verdict, score and latencies, and what else happened; `*_events.json`
  describes each column.
- `*_scans.tsv`: map of each run, how it ended, which runs go on from others.
- `sourcedata/`: the recordings as LabRecorder wrote them (XDF), with all messages, their sidecars and the decoders.

## Read with care

- `participants.tsv` tells in column `simulated` whether a program took the participant's place. Where it says `yes`, no
  person was recorded, and the EEG is made up.
- Where samples are missing those that are there follow one another, so that time is shorter than it was. `BAD_gap` and
  `boundary` mark the places. The EEG's own stamps are in the XDF.
- `electrodes.tsv` holds places of a template by the channels' names, not measured ones.
- A run that `continues` another (`*_scans.tsv`) goes on with its blocks; in a calibration it numbers its episodes anew.
"""
PLACES = (
    "Not measured. Places of the 10-05 system on the Colin27 template, as MNE-Python ships them, "
    "by the channels' names."
)


def dataset(about: About) -> dict[str, Any]:
    """The content of ``dataset_description.json``, without what the library that makes it knows itself."""
    return {
        "Name": "errp-bci",
        "HEDVersion": HED_VERSION,
        "GeneratedBy": [
            {
                "Name": "errp-bci",
                "Version": version("errp-bci"),
                "Description": "Recorded the EEG and exported it with `bci-app export-bids`",
            }
        ],
        "Keywords": ["EEG", "BCI", "ErrP", "error-related potential", "shared autonomy"],
    } | about.dataset.given()


def readme(name: str) -> str:
    """The dataset's README."""
    return README.format(name=name, **TASKS)


def participants(columns: Sequence[str], about: About) -> dict[str, Any]:
    """The content of ``participants.json``."""
    own = {name: {"Description": about.columns.get(name, "As the lab told it")} for name in columns}
    return {name: PARTICIPANTS.get(name, own[name]) for name in columns}


def places(made: dict[str, Any]) -> dict[str, Any]:
    """The content of ``coordsystem.json``: where the places come from, and that the landmarks are the template's."""
    landmarks = {
        "FiducialsCoordinates": made["AnatomicalLandmarkCoordinates"],
        "FiducialsCoordinateSystem": made["AnatomicalLandmarkCoordinateSystem"],
        "FiducialsCoordinateUnits": made["AnatomicalLandmarkCoordinateUnits"],
        "FiducialsCoordinateSystemDescription": PLACES,
        "AnatomicalLandmarkCoordinateSystemDescription": PLACES,
    }
    return made | landmarks | {"EEGCoordinateSystemDescription": PLACES}


def presentation(versions: dict[str, str]) -> dict[str, Any]:
    """What ``events.json`` tells of the software that showed the stimulus."""
    told = {
        "OperatingSystem": versions.get("platform", "n/a"),
        "SoftwareName": "errp-bci",
        "SoftwareVersion": versions.get("errp-bci", "n/a"),
    }
    return {"StimulusPresentation": told}


def eeg(run: dict[str, Any], stream: str, n_misc: int, task: str, about: About) -> dict[str, Any]:
    """What a run's ``_eeg.json`` tells beside what the library finds in the file.

    `run` is `ErrpBci`, which must tell whether it is ``Simulated``; `stream` the name of the amplifier's stream, which
    has `n_misc` channels that are neither EEG nor EOG.
    """
    simulated = run["Simulated"]
    unknown = dict.fromkeys(("EEGReference", "EEGGround", "PowerLineFrequency", "Manufacturer"), "n/a")
    return (
        unknown
        | {
            "TaskDescription": (SIMULATED if simulated else "") + TASKS[task],
            "Instructions": INSTRUCTIONS,
            "ManufacturersModelName": stream,
            "HardwareFilters": "n/a",
            "SoftwareFilters": "n/a",
            "MISCChannelCount": n_misc,
        }
        | ({"SubjectArtefactDescription": SIMULATED.strip()} if simulated else {})
        | about.eeg.given()
        | {"ErrpBci": run}
    )
