"""What is wrong with a study file, in sentences: where, what was expected, what was found."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

_EXPECTED = {
    "string_pattern_mismatch": "must be letters and digits only (as in P001)",
    "string_type": "must be text in quotes",
    "tuple_type": "must be a list in square brackets",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
}
"""By the kind of error; of other kinds the library's own words will do, such as `must be less than 1`."""


def sentences(error: ValidationError, values: Mapping[str, Any], known: Sequence[str], of_people: Sequence[str]) -> str:
    """All mistakes of a study file.

    Parameters
    ----------
    values : what the file holds.
    known, of_people : keys of the file, and of a participant in it.
    """
    return "; ".join(_sentence(item, values, known, of_people) for item in error.errors())


def _sentence(item: Any, values: Mapping[str, Any], known: Sequence[str], of_people: Sequence[str]) -> str:
    loc = list(item["loc"])
    whose = ""
    if loc[:1] == ["participants"] and len(loc) > 1:
        whose, known, loc = _participant(values["participants"], int(loc[1])) + ": ", of_people, loc[2:]
    match item["type"]:
        case "extra_forbidden":
            return f"{whose}unknown key '{_key(loc)}'; known: {', '.join(known)}"
        case "missing":
            return f"{whose}'{_key(loc)}' is missing"
        case "value_error":
            said = item["msg"].removeprefix("Value error, ")
            return f"{whose}'{_key(loc)}': {said}" if loc else whose + said
        case "too_short":
            return f"{whose}'{_key(loc)}' must hold at least {item['ctx']['min_length']}, found none"
    if loc == ["participants"] and item["type"] == "tuple_type":
        return "'participants' must be tables that begin with [[participants]] each"
    expected = _EXPECTED.get(item["type"], item["msg"].replace("Input should", "must"))
    return f"{whose}'{_key(loc)}' {expected}, found {item['input']!r:.60}"


def _participant(people: Sequence[Any], place: int) -> str:
    """By the name; by the place, from 1, where that is what's wrong."""
    name = people[place].get("name") if isinstance(people[place], Mapping) else None
    return f"participant {name}" if isinstance(name, str) and name.isalnum() else f"participant no. {place + 1}"


def _key(loc: Sequence[int | str]) -> str:
    """As in `conditions, no. 2`."""
    return ", ".join(f"no. {part + 1}" if isinstance(part, int) else part for part in loc)
