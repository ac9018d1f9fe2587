"""What small studies share: runs kept in a file, so that one which was interrupted goes on, and a figure's frame."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from wbmpc.configuration import configure
from wbmpc.registry import REGISTRY

Figures = dict[str, float]


class Kept:
    """Figures of runs by name in a JSON file."""

    def __init__(self, file: Path) -> None:
        file.parent.mkdir(parents=True, exist_ok=True)
        self.file = file
        self.runs: dict[str, Figures] = json.loads(file.read_text()) if file.exists() else {}

    def get(self, key: str, make: Callable[[], Figures]) -> Figures:
        """Figures by that name: from the file, or made now and written at once."""
        if key not in self.runs:
            self.runs[key] = make()
            part = self.file.with_suffix(".part")
            part.write_text(json.dumps(self.runs, indent=1) + "\n")
            part.replace(self.file)
            print(f"{key}: done", flush=True)
        return self.runs[key]

    def run(self, experiment: str, settings: Sequence[str], seed: int) -> Figures:
        """Metrics of one run, ``completed`` (1 or 0) and the median ``solve_ms``."""

        def make() -> Figures:
            e = REGISTRY[experiment]
            result = e.run(configure(e.config_type, settings, experiment), seed, None)
            solve = result.mpc.solve_ms["median"] if result.mpc is not None else 0.0
            more = {"completed": float(result.completed), "solve_ms": solve}
            return {k: m.value for k, m in result.metrics.items()} | more

        return self.get(f"{experiment}, {' '.join(settings)}, seed {seed}", make)


@contextmanager
def drawing(path: Path, panels: int) -> Iterator[Any]:
    """Axes side by side; saved at the end. Raises ImportError without matplotlib."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, panels, figsize=(4.2 * panels, 4.0), layout="constrained", squeeze=False)
    for axis in axes[0]:
        axis.grid(alpha=0.3)
    yield axes[0]
    figure.savefig(path, dpi=100)
    plt.close(figure)
