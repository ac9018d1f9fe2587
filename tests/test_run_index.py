"""`wbmpc runs`: every run below a directory, whatever stands beside it; the page sorts and filters in a browser."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from fake_experiment import FakeSettings, run
from wbmpc.cli import main
from wbmpc.report import write_run
from wbmpc.result import Metric
from wbmpc.run_index import DEEPEST, Entry, differing_settings, find_runs, page

CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three runs, the last one fell; the second one is nested and has an odd name."""
    root = tmp_path_factory.mktemp("written") / "runs"
    for k, (name, seed, settings) in enumerate((
        ("fake-seed3", 3, FakeSettings()), ("a/<b> & 'c'", 7, FakeSettings()), ("fell", 5, FakeSettings(fall_at=2.0)),
    )):  # fmt: skip
        files = write_run(run(settings, seed), root / name)
        os.utime(files["metrics"], (1e9 + k, 1e9 + k))
    return root


@pytest.fixture
def some(written: Path, tmp_path: Path) -> Path:
    """A copy, for a test that changes it."""
    return Path(shutil.copytree(written, tmp_path / "runs"))


def test_the_newest_first_with_outcome_and_goals(some: Path) -> None:
    found = find_runs(some)
    assert [r.seed for r in found] == [5, 7, 3]
    assert [r.completed for r in found] == [False, True, True]
    assert (found[0].outcome, found[0].note) == ("gave_up", "the robot fell at 2.00 s") and found[0].goals == (0, 3)
    assert found[2].goals == (2, 3)
    assert found[1].metrics["path_length"].value == 20.53
    assert found[0].metrics["rise_time_max"].value == float("inf")  # null in the file


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "[" * 9999, '{"metrics": 3}', '{"metrics": {}, "targets": [1], "versions": 2}', '{"metrics": {"a": {"value": 1, '
             '"unit": "m"}}, "targets": {"a": {"goal": "x"}}}', '{"metrics": {"a": {"value": 1, "unit": "m"}}, "targets": {"a": 1}}']
)  # fmt: skip
def test_what_is_damaged_is_one_entry_with_its_file(some: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    broken = some / "broken" / "metrics.json"
    broken.parent.mkdir()
    broken.write_text(text)
    found = find_runs(some)
    assert len(found) == 4
    note = next(r for r in found if r.directory == broken.parent)
    assert (note.outcome, note.completed) == ("unreadable", False) and str(broken) in note.note
    assert main(["runs", str(some)]) == 0 and str(broken) in capsys.readouterr().out.replace("\n", "")


def test_links_and_deep_directories_are_not_followed(some: Path) -> None:
    (some / "loop").symlink_to(some)
    deep = some.joinpath(*"abcdefg"[: DEEPEST + 1])
    deep.mkdir(parents=True)
    shutil.copy(some / "fell" / "metrics.json", deep)
    assert len(find_runs(some)) == 3


def test_json_is_what_the_files_say(some: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(some), "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["page"] is None
    for entry in output["runs"]:
        saved = json.loads((Path(entry["directory"]) / "metrics.json").read_text())
        assert {k: entry[k] for k in ("experiment", "seed", "completed", "settings")} == {
            k: saved[k] for k in ("experiment", "seed", "completed", "settings")
        }
        finite = {n: m for n, m in saved["metrics"].items() if m["value"] is not None}
        assert {n: entry["metrics"][n] for n in finite} == finite


def test_a_directory_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", str(tmp_path / "no")]) == 2
    assert str(tmp_path / "no") in capsys.readouterr().err.replace("\n", "")


def test_the_page_links_to_what_is_there(some: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (some / "fell" / "report.html").unlink()
    target = tmp_path / "pages" / "all.html"
    target.parent.mkdir()
    assert main(["runs", str(some), "--page", str(target)]) == 0
    links: list[str] = []

    class Finder(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            links.extend(v for k, v in attrs if k in ("src", "href") and v)

    Finder().feed(target.read_text())
    assert "[]" not in target.read_text()  # a number without a unit has none in its heading
    assert len(links) == 2 and all((target.parent / unquote(link)).is_file() for link in links)
    ok = find_runs(some)[1]
    (ok.directory / "run.mcap").touch()
    assert main(["runs", str(some), "--page", str(target), "--force"]) == 0
    assert 'report.html#replay">replay</a>, <a href="' in target.read_text()
    assert main(["runs", str(some), "--page", str(target)]) == 2  # it is there already
    assert main(["runs", str(some), "--page", str(target), "--force"]) == 0


def test_a_run_that_did_not_complete_reaches_no_goal(tmp_path: Path) -> None:
    """Its figures are not green; headings say what is measured."""
    cells, metric = {}, Metric(0.0, "1", goal=1.0, definition="a < b")
    for completed in (True, False):
        text = page([Entry(tmp_path, datetime.now(UTC), "fake", 1, completed, "", {"fell": metric})], tmp_path)
        cells[completed] = text.count('<span class="met">0</span>')
        assert "<th class='n m' data-about=\"a &lt; b\">fell</th>" in text
    assert cells == {True: 1, False: 0}


@pytest.mark.parametrize(("unit", "shown"), [("1", True), ("m", False)])
def test_where_only_counts_have_goals_all_metrics_are_shown(unit: str, shown: bool, tmp_path: Path) -> None:
    """A table that says "fell 0" alone says nothing of how well a run went. The figures come before time and commit."""
    metrics = {"fell": Metric(0.0, "1", goal=0.0), "gap": Metric(0.5, unit, goal=1.0), "mean_error": Metric(0.2, "m")}
    text = page([Entry(tmp_path, datetime.now(UTC), "fake", 1, True, "", metrics)], tmp_path)
    assert ("mean_<wbr>error" in text) == shown
    assert text.index(">gap") < text.index("<th>ended</th>")


@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")
def test_a_click_sorts_and_words_filter(some: Path, tmp_path: Path) -> None:
    """Measured by a browser: order of seeds after one and two clicks, and what a word leaves."""
    measure = """<script>addEventListener("load", () => {
      const seeds = () => [...document.querySelectorAll("tr")].slice(1).filter(r => !r.hidden).map(r => r.cells[1].textContent).join("");
      const head = document.querySelectorAll("th")[1], filter = document.getElementById("filter"), out = [];
      head.click(); out.push(seeds()); head.click(); out.push(seeds());
      for (const words of ["FELL at", "fake completed", "nothing like it"]) {
        filter.value = words; filter.dispatchEvent(new Event("input")); out.push(seeds()) }
      document.title = out.join("|") })</script></body>"""
    text = page(find_runs(some), tmp_path)
    (tmp_path / "page.html").write_text(text.replace("</body>", measure))
    options = f"--headless --no-sandbox --disable-gpu --no-first-run --virtual-time-budget=2000 --user-data-dir={tmp_path / 'p'} --dump-dom"
    out = subprocess.run(
        [str(CHROMIUM), *options.split(), (tmp_path / "page.html").as_uri()], capture_output=True, text=True, timeout=90
    )
    found = re.search(r"<title>(.*?)</title>", out.stdout)
    assert found is not None and found.group(1) == "357|753|5|73|"


def test_runs_are_differing_settings_by_the_settings_in_which_they_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Folders of a study's runs have names that say nothing. Truth: what was changed; other experiments' settings count for nothing."""
    near, far = (FakeSettings.model_validate({"mpc": {"rate": rate}}) for rate in (50.0, 80.0))
    for name, settings, seed in (("a", near, 3), ("b", far, 3), ("c", far, 4)):
        write_run(run(settings, seed), tmp_path / "runs" / name)
    assert FakeSettings().fall_at is None
    write_run(run(FakeSettings(fall_at=9.0), 3), tmp_path / "runs" / "e")
    other = run(FakeSettings(duration=1.0), 3)
    other.experiment = "other"
    write_run(other, tmp_path / "runs" / "d")
    found = find_runs(tmp_path / "runs")
    differs = {entry.directory.name: about for entry, about in zip(found, differing_settings(found), strict=True)}
    assert differs.pop("e") == "mpc.rate=50, fall_at=9"
    assert differs == {"a": "mpc.rate=50", "b": "mpc.rate=80", "c": "mpc.rate=80", "d": ""}
    assert page(found, tmp_path).count('<span class="differs">mpc.rate=80</span>') == 2
    assert main(["runs", str(tmp_path / "runs")]) == 0
    assert capsys.readouterr().out.count("mpc.rate=80") == 2


def test_many_differences_are_cut(tmp_path: Path) -> None:
    """A table that shows all settings of two unlike runs is no table. Truth: counted by hand."""
    settings = [{f"k{i}": i + k for i in range(9)} for k in (0, 1)]
    runs = [Entry(tmp_path, datetime.now(UTC), "fake", 1, True, settings=s) for s in settings]
    assert differing_settings(runs) == [
        "k0=0, k1=1, k2=2, k3=3, k4=4, k5=5, …",
        "k0=1, k1=2, k2=3, k3=4, k4=5, k5=6, …",
    ]


def test_damaged_runs_hide_no_others(tmp_path: Path) -> None:
    """A pipe, a device that never ends, links that lead nowhere, numbers beyond all floats. Truth: POSIX, ISO/IEC 60559."""
    texts = {
        "good": '{"metrics": {}}',
        "huge": '{"metrics": {"a": {"value": 1, "unit": "1"}}, "targets": {"a": {"goal": %s}}}' % ("9" * 400),
    }
    for name in ("good", "huge", "pipe", "device", "nowhere", "circle"):
        (tmp_path / name).mkdir()
    for name, text in texts.items():
        (tmp_path / name / "metrics.json").write_text(text)
    os.mkfifo(tmp_path / "pipe" / "metrics.json")
    for name, target in (("device", "/dev/zero"), ("nowhere", "/no/such/file"), ("circle", "metrics.json")):
        (tmp_path / name / "metrics.json").symlink_to(target)
    found = {entry.directory.name: entry.outcome for entry in find_runs(tmp_path)}
    assert found.pop("good") != "unreadable"
    assert found == dict.fromkeys(("huge", "pipe", "device", "nowhere", "circle"), "unreadable")


def test_names_that_are_no_text_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Half of a pair of UTF-16, as JSON may have it, and bytes of a directory's name that are no UTF-8."""
    run = Path(os.fsdecode(os.fsencode(tmp_path) + b"/runs/a\xff"))
    run.mkdir(parents=True)
    (run / "metrics.json").write_text('{"experiment": "\\ud800", "metrics": {}}')
    (run / "report.html").touch()
    made = tmp_path / "page.html"
    assert main(["runs", str(tmp_path / "runs"), "--page", str(made)]) == 0
    text = made.read_text("utf-8")
    assert "\\udcff" in text and 'href="runs/a%FF/report.html"' in text
    assert main(["runs", str(tmp_path / "runs")]) == 0
    assert "\\udcff" in capsys.readouterr().out
