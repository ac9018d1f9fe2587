"""A study's file: what it may say, and which runs it means. Truth: the combinations written out by hand, NumPy's ranges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wbmpc.errors import InputError
from wbmpc.study.definition import load_definition
from wbmpc.study.plan import combinations, runs

VALLEY = Path(__file__).with_name("valley.py")


def planned(tmp_path: Path, text: str):  # type: ignore[no-untyped-def]
    file = tmp_path / "study.yaml"
    file.write_text(text.replace("VALLEY", str(VALLEY)).replace("RANGE", "{from: 0, to: 1, steps: 10000}"))
    definition = load_definition(file)
    return definition, combinations(definition, tmp_path, "study.yaml")


def test_the_product_of_everything_seed_by_seed(tmp_path: Path) -> None:
    definition, found = planned(
        tmp_path,
        """
experiments: [VALLEY]
robots: [one, two]
seeds: [300-301, 7]
settings: {offset: 0.5}
vary: {control.gain: [1, 2, 5]}
conditions:
  plain:
  shifted: {settings: {offset: 2}}
""",
    )
    said = [(c.condition, c.robot, c.settings["control"]["gain"], c.settings["offset"]) for c in found]
    assert said == [
        (name, robot, gain, offset)
        for name, offset in (("plain", 0.5), ("shifted", 2.0))
        for robot in ("one", "two")
        for gain in (1.0, 2.0, 5.0)
    ]
    assert [r.seed for r in runs(found, definition.seeds)] == [300] * 12 + [301] * 12 + [7] * 12
    assert len({r.key for r in runs(found, definition.seeds)}) == 36
    assert found[0].label == "plain, one, control.gain=1"


def test_ranges_are_numpys(tmp_path: Path) -> None:
    _, found = planned(
        tmp_path,
        "experiments: [VALLEY]\nseeds: 3\nvary:\n  control.gain: {from: 1e-3, to: 10, steps: 5, log: true}\n"
        "  offset: {from: -1, to: 2, steps: 4}",
    )
    both = [(c.settings["control"]["gain"], c.settings["offset"]) for c in found]
    expected = [(g, o) for g in np.geomspace(1e-3, 10, 5) for o in np.linspace(-1, 2, 4)]
    np.testing.assert_allclose(both, expected, rtol=1e-10, atol=1e-12)


def test_draws_are_the_same_for_all_conditions_and_stay_in_their_range(tmp_path: Path) -> None:
    text = """
experiments: [VALLEY]
seeds: 0-1
draws: 40
vary: {control.gain: {from: 0.01, to: 100, log: true, random: true}}
conditions: {a: {settings: {offset: 0}}, b: {settings: {offset: 1}}}
"""
    _, found = planned(tmp_path, text)
    gains = {name: [c.varied["control.gain"] for c in found if c.condition == name] for name in "ab"}
    assert gains["a"] == gains["b"] and len(set(gains["a"])) == 40
    assert 0.01 <= min(gains["a"]) < 0.1 and 10 < max(gains["a"]) <= 100  # by its logarithm: a quarter of them each
    assert [c.key for c in planned(tmp_path, text)[1]] == [c.key for c in found]


WRONG = {
    "experiments: [VALLEY]": "seeds: field required",
    "experiments: [nowhere]\nseeds: 3": "unknown experiment 'nowhere'",
    "experiments: [VALLEY]\nseeds: 9-3": "seeds: '9-3': valid: 300-319",
    "experiments: [VALLEY]\nseeds: 3\nvery: {}": "unknown key 'very' (did you mean 'vary'?); valid: title, experiments",
    "experiments: [VALLEY]\nseeds: 3\nvary: {control.gian: [1]}": "unknown key 'control.gian'",
    "experiments: [VALLEY]\nseeds: 3\nvary: {control.gain: [-1]}": "control.gain=-1: input should be greater than 0",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: {from: 0, to: yes, steps: 4}}": "to: a number is needed, not true or false",
    "experiments: [VALLEY]\nseeds: 3\ndraws: on": "draws: a number is needed, not true or false",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: 5}": "vary.offset=5: a list, or a mapping with from, to and steps",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: {from: 3, to: 1, steps: 4}}": "from=3 must be below to=1",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: {from: 0, to: 1, steps: 4, log: true}}": "a log range needs from > 0",
    "experiments: [VALLEY]\nseeds: 3\ndraws: 4": "draws: nothing is random",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: [1, 1.0]}": "offset=1: these settings appear twice",
    # counted, not made: they would fill the memory
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: RANGE, control.gain: RANGE, robot: [a, b]}": "200000000 combinations of settings; at most",
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: {from: -1.0e+308, to: 1.0e+308, random: true}}": "and both from -",
    "experiments: [VALLEY]\nseeds: 0-999999\nvary: {offset: [1, 2]}": "2000000 runs; at most 1000000 are planned",
    "experiments: [VALLEY]\nseeds: 3\ndraws: 100000\nvary: {offset: {from: 0, to: 1, random: true}}": "100000 combinations of settings",
    "experiments: [VALLEY]\nseeds: 3\nconditions: {a: }\ncompare_with: b": "compare_with: unknown condition 'b'",
    "experiments: [VALLEY]\nseeds: 0-9\ntune: {seeds: 5-12, search: {offset: [0, 1]}, minimize: [{metric: error, limit: 1}]}":
        "tune.seeds: 5, 6, 7, 8, 9 are in 'seeds' too",
    "experiments: [VALLEY]\nseeds: 0\nvary: {offset: [1]}\n"
    "tune: {seeds: 5, search: {offset: [0, 1]}, minimize: [{metric: error, limit: 1}]}": "'offset' is in vary too",
    # a condition, or a robot, would be the name of runs that have another one
    "experiments: [VALLEY]\nseeds: 3\nvary: {offset: [1]}\nconditions: {a: {settings: {offset: 2}}}":
        "conditions.a.settings: 'offset' is given by vary too, which would win",
    "experiments: [VALLEY]\nseeds: 3\nrobots: [one]\nvary: {robot: [two]}": "vary: 'robot' is given by robots too",
    "experiments: [VALLEY]\nseeds: 3\nrobots: [one]\nconditions: {a: {settings: {robot: two}}}": "'robot' is given by robots too",
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_is_named(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError) as error:
        planned(tmp_path, text)
    assert WRONG[text] in str(error.value) and "study.yaml" in str(error.value)
