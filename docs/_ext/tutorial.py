"""What executable pages share: a figure that opens from ``file://``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import plotly.graph_objects as go
from IPython.display import HTML


def figure(t: Any, lines: Mapping[str, Any], x: str = "time [s]", y: str = "") -> HTML:
    """Lines over ``t`` (n,), by name, as a figure that loads the Plotly script beside the page."""
    made = go.Figure(
        [go.Scatter(x=np.asarray(t), y=np.asarray(v), name=name) for name, v in lines.items()],
        layout={"xaxis": {"title": x}, "yaxis": {"title": y}, "height": 360, "template": "plotly_white",
                "margin": {"l": 60, "r": 20, "t": 20, "b": 50}, "legend": {"orientation": "h", "y": 1.1}},
    )  # fmt: skip
    return HTML(made.to_html(full_html=False, include_plotlyjs="../_static/plotly.min.js"))
