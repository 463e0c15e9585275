"""What only the lab knows of a study: a TOML file in BIDS's own words."""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from bci_app.errors import SetupError


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    def given(self) -> dict[str, Any]:
        """What was told, under BIDS's names."""
        return self.model_dump(exclude_none=True)


class Dataset(_Part):
    """Goes into a new dataset's ``dataset_description.json``."""

    Name: str | None = None
    Authors: list[str] | None = None
    License: str | None = None
    Acknowledgements: str | None = None
    HowToAcknowledge: str | None = None
    Funding: list[str] | None = None
    EthicsApprovals: list[str] | None = None
    ReferencesAndLinks: list[str] | None = None
    DatasetDOI: str | None = None
    Keywords: list[str] | None = None


class Eeg(_Part):
    """Goes into each run's ``_eeg.json``."""

    EEGReference: str | None = None
    EEGGround: str | None = None
    PowerLineFrequency: Annotated[float, Field(gt=0)] | None = None
    Manufacturer: str | None = None
    ManufacturersModelName: str | None = None
    DeviceSerialNumber: str | None = None
    SoftwareVersions: str | None = None
    CapManufacturer: str | None = None
    CapManufacturersModelName: str | None = None
    InstitutionName: str | None = None
    InstitutionAddress: str | None = None
    InstitutionalDepartmentName: str | None = None
    Instructions: str | None = None
    HardwareFilters: dict[str, dict[str, Any]] | Literal["n/a"] | None = None
    SoftwareFilters: dict[str, dict[str, Any]] | Literal["n/a"] | None = None


Told = str | int | float
AGES = ("89+", "n/a")
"""What BIDS lets an age be that is no number."""


class About(_Part):
    """The whole file.

    Attributes
    ----------
    participants : columns of ``participants.tsv`` by participant: age, sex, hand ...
    columns : what columns of your own mean.
    """

    dataset: Dataset = Dataset()
    eeg: Eeg = Eeg()
    participants: dict[str, dict[str, Told]] = {}
    columns: dict[str, str] = {}

    @field_validator("participants")
    @classmethod
    def _years(cls, people: dict[str, dict[str, Told]]) -> dict[str, dict[str, Told]]:
        for who, row in people.items():
            age = row.get("age", 0)
            if age not in AGES and (isinstance(age, str) or not 0 <= age < math.inf):
                raise ValueError(
                    f"'participants.{who}.age' must be a number of years (or \"89+\"), found {age!r:.60}. Leave it out "
                    "if it isn't known"
                )
        return people


def read_about(path: Path | None) -> About:
    """What the lab tells; nothing without a file.

    Raises SetupError for one that can't be read, an unknown key or an age that is no number.
    """
    if path is None:
        return About()
    try:
        return About.model_validate(tomllib.loads(path.read_text(encoding="utf-8-sig")))
    except (OSError, UnicodeDecodeError) as error:
        raise SetupError(f"Can't read {path}: {error}.") from error
    except tomllib.TOMLDecodeError as error:
        raise SetupError(f"{path} is not valid TOML: {error}.") from error
    except ValidationError as error:
        raise SetupError(f"{path}: {'; '.join(_sentence(item) for item in error.errors())}.") from error


def _sentence(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] == "value_error":
        return str(item["msg"]).removeprefix("Value error, ")
    if item["type"] != "extra_forbidden":
        return f"'{key}': {item['msg']}, found {item['input']!r:.60}"
    known = {"dataset": Dataset.model_fields, "eeg": Eeg.model_fields}.get(str(item["loc"][0]), About.model_fields)
    return f"unknown key '{key}'; known: {', '.join(known)}"
