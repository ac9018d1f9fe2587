"""The studies that come with the package. Truth: the protocol's seeds; settings that the experiments take."""

from __future__ import annotations

from pathlib import Path

import pytest

import wbmpc.studies
from wbmpc.cli.study import built_in_studies
from wbmpc.study.definition import Search
from wbmpc.study.plan import combinations
from wbmpc.study.study import Study
from wbmpc.study.tuning import with_settings

FILES = sorted(Path(wbmpc.studies.__file__).parent.glob("*/*.yaml"))
TUNING, REPORTING = set(range(20)), set(range(300, 320))


def test_all_are_found_by_their_names() -> None:
    assert built_in_studies() == {path.stem: path for path in FILES} and len(FILES) > 20


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_their_settings_are_those_of_the_experiments(path: Path) -> None:
    """Also at both ends of what is searched."""
    study = Study.load(path)
    assert study.combinations and set(study.definition.seeds) <= REPORTING
    tune = study.definition.tune
    if tune is None:
        return
    assert set(tune.seeds) <= TUNING and tune.trials >= 200
    for end in ("low", "high"):
        given = {key: getattr(s, end) for key, s in tune.search.items() if isinstance(s, Search)}
        assert combinations(with_settings(study.definition, given), path.parent, path.name)
