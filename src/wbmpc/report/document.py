"""An HTML page that needs no network, and its tables."""

from __future__ import annotations

import html
from functools import cache
from pathlib import Path


def table(header: list[str], rows: list[list[str]], numeric: set[int]) -> str:
    """A table of ready-made cells; the columns ``numeric`` are set right."""

    def line(tag: str, cells: list[str]) -> str:
        return (
            "<tr>"
            + "".join(f"<{tag}{' class=n' if i in numeric else ''}>{c}</{tag}>" for i, c in enumerate(cells))
            + "</tr>"
        )

    return f'<div class="card scroll"><table>{line("th", header)}{"".join(line("td", r) for r in rows)}</table></div>'


def named(name: str, definition: str) -> str:
    """A metric's name as HTML that shows its definition, where it has one, under a pointer, with the focus or at a touch."""
    text = html.escape(name).replace("_", "_<wbr>")
    return f'<span tabindex="0" data-about="{html.escape(definition)}">{text}</span>' if definition else text


@cache
def beside(name: str) -> str:
    """The text of a file of this package."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


def document(title: str, body: str, plots: bool = True) -> str:
    """A page, with the plotting library in it if there are ``plots``.

    A plot is drawn as soon as it is read. The grid keeps its columns while it fills (``auto-fill``), and plots are fitted
    once more at the end, when a scroll bar may have come: else they would be wider than their cards.
    """
    library = ""
    if plots:
        from plotly.offline import get_plotlyjs

        library = f"<script>{get_plotlyjs()}</script>"
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title><style>{beside("page.css")}</style>
{library}</head><body><main>
{body}
</main><script>addEventListener("load", () => {{ {beside("page.js")} }})</script></body></html>
"""
