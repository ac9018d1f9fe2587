"""Below each executable page a link to it as an executed notebook (.ipynb)."""

from __future__ import annotations

from typing import Any

LINK = "\n\nThis page as an executed notebook: {{nb-download}}`{name}.ipynb`\n"


def setup(app: Any) -> dict[str, bool]:
    """Sphinx: the link is added to the source, so that it is checked as all others."""
    app.connect("source-read", _linked)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _linked(app: Any, name: str, source: list[str]) -> None:
    if "```{code-cell}" in source[0]:
        source[0] += LINK.format(name=name.rpartition("/")[2])
