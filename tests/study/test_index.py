"""Studies in `wbmpc runs`. Truth: an experiment whose figures are known in closed form, counts by hand, what was done to the files."""

from __future__ import annotations

import json
import os
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from valley import error

from wbmpc.cli import main
from wbmpc.study.index import find_studies, section
from wbmpc.study.store import Store
from wbmpc.study.study import Study

pytest.importorskip("pyarrow")
HERE = Path(__file__).parent
#: Two of ten runs fall; the error is 0.25 m and more with one gain, 4 m and more with the other; the goal is 0.5 m.
TEXT = """
title: <b> & co
experiments: {VALLEY: {fall_from: 304}}
seeds: 300-304
conditions: {near: {settings: {control.gain: 2.5}}, far: {settings: {control.gain: 5}}}
metrics: [error]
"""


def written(folder: Path) -> Path:
    file = folder / "a study.yaml"
    file.write_text(TEXT.replace("VALLEY", str(HERE / "valley.py")))
    return file


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one finished study."""
    root = tmp_path_factory.mktemp("listed")
    assert main(["study", str(written(root)), "--workers", "0", "--out", str(root / "runs" / "a"), "--quiet"]) == 0
    return root / "runs"


def test_a_study_is_listed_with_runs_failures_goals_and_page(done: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(done), "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["studies"]
    assert max(error(2.5, 0.0, seed) for seed in range(300, 304)) < 0.5 < error(5.0, 0.0, 300)
    assert (found["title"], found["experiments"]) == ("<b> & co", ["valley"])
    # one of five runs of each fell: with 95 % of the runs neither reaches its goal
    assert (found["planned"], found["finished"], found["failed"], found["goals"]) == (
        10,
        10,
        2,
        {"reached": 0, "of": 2},
    )
    assert Path(found["page"]).is_file() and found["note"] == ""
    assert main(["runs", str(done)]) == 0
    text = capsys.readouterr().out
    assert re.search(r"valley +10 of 10 +2 +0 of 2", text) and "0 runs, 1 study" in text


def test_the_page_of_runs_links_to_pages_of_studies(done: Path, tmp_path: Path) -> None:
    target = tmp_path / "pages" / "all.html"
    target.parent.mkdir()
    assert main(["runs", str(done), "--page", str(target), "--quiet"]) == 0
    links: list[str] = []

    class Finder(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            links.extend(v for k, v in attrs if k == "href" and v)

    Finder().feed(target.read_text())
    assert [(target.parent / unquote(link)).resolve() for link in links] == [(done / "a" / "index.html").resolve()]


def test_a_study_that_was_interrupted_says_how_far_it_is(done: Path, tmp_path: Path) -> None:
    """Three rows in the journal, one of them of a run that will be tried again."""
    file, out = written(tmp_path), tmp_path / "half"
    made = Study.load(file, out)
    with Store(out) as store:
        for seed, outcome in ((300, "completed"), (301, "fell"), (302, "error")):
            store.add({"key": f"{made.combinations[0].key}-{seed}", "experiment": "valley", "outcome": outcome})
    shutil.copy(done / "a" / "study.json", out)
    (found,) = find_studies(tmp_path)
    assert (found.planned, found.finished, found.failed, found.page) == (10, 2, 1, None)
    assert "interrupted or is running" in found.note


@pytest.mark.parametrize("name", ["study.json", "statistics.json"])
@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"title": 1, "planned": "x", "combinations": {"a": 1}}', '{"cells": 3}', "[" * 999]
)
def test_damaged_files_are_a_note_and_hide_no_others(name: str, text: str, done: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(done, tmp_path / "runs"))
    shutil.copytree(done / "a", root / "broken")
    (root / "broken" / name).write_text(text)
    os.mkfifo(root / "a" / "trials.db")  # is no study's, and is not read
    found = {entry.directory.name: entry for entry in find_studies(root)}
    assert found["a"].note == "" and found["a"].finished == 10
    assert "broken" in found["broken"].note


def test_names_in_the_page_are_text(done: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(done, tmp_path / "<i>"))
    about = json.loads((root / "a" / "study.json").read_text())
    for combination in about["combinations"].values():
        combination["experiment"] = "<script>"
    (root / "a" / "study.json").write_text(json.dumps(about))
    text = section(find_studies(root), tmp_path)
    assert "<script>" not in text and "&lt;script&gt;" in text and "<i>" not in text and "&lt;i&gt;" in text
    assert section([], tmp_path) == ""


def test_a_search_is_listed_with_its_trials(tmp_path: Path) -> None:
    pytest.importorskip("optuna")
    file = tmp_path / "search.yaml"
    tune = "{seeds: 0, search: {offset: {from: 0, to: 1}}, minimize: [{metric: error, limit: 9}], trials: 3}"
    file.write_text(f"experiments: [{HERE / 'valley.py'}]\nseeds: 1-2\ntune: {tune}\n")
    assert main(["tune", str(file), "--workers", "0", "--out", str(tmp_path / "out"), "--quiet"]) == 0
    found = {entry.directory.name: entry for entry in find_studies(tmp_path)}
    assert found["out"].runs == "3 trials" and found["out"].note == "3 of them keep the constraints"
    assert (found["report"].finished, found["report"].planned) == (4, 4)  # before and after, on two seeds
