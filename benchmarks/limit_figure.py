"""The figure of the study on hard limits: every run as a point, by scenario and variant."""

from __future__ import annotations

from pathlib import Path

import numpy as np

Runs = dict[str, dict[str, list[dict[str, float]]]]
#: (figure, axis title, factor, goal, logarithmic).
PANELS = (
    ("command_excess", "commands over limits [%]", 100.0, 0.1, True),
    ("plan_state_excess", "planned states over [%]", 100.0, 0.1, True),
    ("return_time", "states back after [s]", 1.0, 0.5, False),
    ("clamped", "ticks clamped [%]", 100.0, 1.0, True),
    ("hand_error", "mean end effector error [mm]", 1e3, None, True),
)
#: What is drawn for less than this on a logarithmic axis [unit of the axis].
MINIMUM = 1e-3
COLORS = ("#1f5fa8", "#4aa3c7", "#8a5fbf", "#d1495b", "#2a9d6f")
SIZE = (1200, 1500)


def _points(found: Runs, figure: str, factor: float, variant: int, log: bool) -> tuple[np.ndarray, np.ndarray]:
    """Places along the axis (scenario and variant, runs side by side) and values."""
    x, y = [], []
    for k, by in enumerate(found.values()):
        names = list(by)
        if variant >= len(names):
            continue
        values = np.array([run[figure] for run in by[names[variant]]]) * factor
        width = 0.8 / len(COLORS)
        x.append(k - 0.4 + width * (variant + np.linspace(0.15, 0.85, values.size)))
        y.append(np.maximum(values, MINIMUM) if log else values)
    return np.concatenate(x), np.concatenate(y)


def _html(found: Runs, path: Path) -> None:
    from plotly.subplots import make_subplots

    names, variants = list(found), list(next(iter(found.values())))
    figure = make_subplots(rows=len(PANELS), shared_xaxes=True, vertical_spacing=0.03)
    for row, (key, title, factor, goal, log) in enumerate(PANELS, 1):
        for v, variant in enumerate(variants):
            x, y = _points(found, key, factor, v, log)
            marker = {"size": 5, "color": COLORS[v % len(COLORS)]}
            shown = row == 1
            figure.add_scatter(
                x=x,
                y=y,
                mode="markers",
                marker=marker,
                name=variant,
                legendgroup=variant,
                showlegend=shown,
                row=row,
                col=1,
            )
        if goal is not None:
            figure.add_hline(y=goal, line={"dash": "dash", "width": 1}, row=row, col=1)
        figure.update_yaxes(title_text=title, type="log" if log else "linear", row=row, col=1)
    figure.update_xaxes(tickvals=list(range(len(names))), ticktext=names, showticklabels=True)
    figure.update_layout(template="plotly_white", width=SIZE[0], height=SIZE[1], legend={"orientation": "h", "y": 1.04})
    figure.write_html(path, include_plotlyjs="cdn")


def _png(found: Runs, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    names, variants = list(found), list(next(iter(found.values())))
    figure, axes = plt.subplots(len(PANELS), sharex=True, figsize=(SIZE[0] / 100, SIZE[1] / 100), layout="constrained")
    for axis, (key, title, factor, goal, log) in zip(axes, PANELS, strict=True):
        for v, variant in enumerate(variants):
            x, y = _points(found, key, factor, v, log)
            axis.plot(x, y, ".", color=COLORS[v % len(COLORS)], label=variant, markersize=5)
        if goal is not None:
            axis.axhline(goal, color="0.3", linestyle="--", linewidth=1)
        if log:
            axis.set_yscale("log")
            axis.yaxis.set_major_formatter(lambda v, _: f"≤ {MINIMUM:g}" if v <= 1.001 * MINIMUM else f"{v:g}")
            axis.yaxis.set_minor_formatter(NullFormatter())
        for k in range(1, len(names)):
            axis.axvline(k - 0.5, color="0.8", linewidth=0.8)
        axis.set_ylabel(title, fontsize=8)
        axis.grid(axis="y", alpha=0.3)
    axes[-1].set_xticks(range(len(names)), names)
    axes[-1].set_xlim(-0.5, len(names) - 0.5)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(variants))
    figure.savefig(path, dpi=100)
    plt.close(figure)


def write_figure(found: Runs, directory: Path) -> list[Path]:
    """Write the figure as HTML, and as PNG when matplotlib is installed; returns the paths."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / "hard-limits.html"]
    _html(found, paths[0])
    try:
        _png(found, directory / "hard-limits.png")
        paths.append(directory / "hard-limits.png")
    except ImportError:
        pass
    return paths
