"""Start-up of the kernels of executable pages: Plotly's figures load the script beside the page, so that pages open from ``file://``."""

from __future__ import annotations

from typing import Any

import plotly.io as pio
from plotly.io.base_renderers import MimetypeRenderer


class Beside(MimetypeRenderer):
    """A figure as HTML that refers to the site's own copy of Plotly's script."""

    def to_mimebundle(self, figure: dict[str, Any]) -> dict[str, str]:
        """The figure, in the colors and margins of the site."""
        layout = {
            "height": 360,
            "margin": {"l": 60, "r": 20, "t": 20, "b": 50},
            "legend": {"orientation": "h", "y": 1.1},
        }
        drawn = {**figure, "layout": {**layout, **figure["layout"]}}
        html = pio.to_html(drawn, full_html=False, include_plotlyjs="../_static/plotly.min.js", validate=False)
        return {"text/html": html}


pio.renderers["beside"] = Beside()
pio.renderers.default = "beside"
pio.templates.default = "plotly_white"
