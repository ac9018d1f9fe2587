"""Settings of experiments as the command line makes them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import yaml

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY


def check_taken(experiment: str, assignments: Sequence[str]) -> None:
    """Each ``key=value`` is accepted by the experiment's settings, and is there afterwards. Truth: YAML's reading of the value."""
    settings = configure(REGISTRY[experiment].config_type, assignments, experiment)
    for key, text in (a.split("=", 1) for a in assignments):
        value, found = yaml.safe_load(text), reduce(getattr, key.split("."), settings)
        found = getattr(found, "kind", found)  # a section by its kind alone
        assert (list(found) if isinstance(value, list) else found) == value, key
