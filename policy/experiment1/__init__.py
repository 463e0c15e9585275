"""The paper's first experiment (section IV) as tables and figures; `tables.run` does all of it."""
