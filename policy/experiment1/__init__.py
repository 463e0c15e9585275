"""The paper's first experiment (section IV) as tables and figures; `tables.run` does all of it."""

from typing import Any

Row = dict[str, Any]
Tables = dict[str, list[Row]]
