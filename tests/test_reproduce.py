"""`wbmpc reproduce`: runs in processes of their own, and their site. Truth: the runs' own files; processes that crash."""

from __future__ import annotations

import json
import os
import re
import statistics
import sys
import threading
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from fake_experiment import FAKE as EXPERIMENT
from fake_experiment import FakeSettings
from wbmpc import reproduce
from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.report import write_run
from wbmpc.reproduce import Job, parse_seeds, plan, run_all, summarize, write_site

HERE = Path(__file__).parent
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(HERE.parent / "src")}
PATHS = f"import os, sys; sys.path[:0] = [{str(HERE)!r}, {str(HERE.parent / 'src')!r}]"


def fake(job: Job, previous: str = "", *more: str) -> list[str]:
    run = "from fake_experiment import REGISTRY; from wbmpc.cli import main; sys.exit(main(sys.argv[1:], REGISTRY))"
    code = f"{PATHS}\n{previous}\n{run}"
    arguments = ["run", "fake", "--seed", str(job.seed), "--out", str(job.directory), "--json"]
    return [sys.executable, "-c", code, *arguments, "--set", "duration=0.2", *more]


def crash(job: Job) -> list[str]:
    """Seed 1 is killed, seed 2 raises, seed 3 falls."""
    deaths = {1: "os.kill(os.getpid(), 9)", 2: "raise ValueError('no <luck>')"}
    return fake(job, deaths.get(job.seed, ""), *(["--set", "fall_at=0.1"] if job.seed == 3 else []))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    out = tmp_path_factory.mktemp("site")
    jobs = plan(["fake"], range(6), out)
    seen: list[tuple[float, str]] = []
    failed = run_all(jobs, 2, lambda fraction, note: seen.append((fraction, note)), crash)
    return out, jobs, failed, seen


def test_runs_that_crash_lose_only_themselves(site) -> None:  # type: ignore[no-untyped-def]
    out, jobs, failed, seen = site
    assert {j.seed: reason for j, reason in failed.items()} == {
        1: "the process ended with code -9",
        2: "ValueError: no <luck>",
    }
    assert [j.seed for j in jobs if j.done] == [0, 3, 4, 5]
    assert seen[-1] == (1.0, "6 of 6 runs, 2 failed") and len(seen) == 6
    saved = json.loads((out / "fake" / "seed4" / "metrics.json").read_text())
    assert saved["seed"] == 4 and all(Path(f).is_file() for f in saved["files"].values())


def test_what_is_finished_is_not_run_again(site) -> None:  # type: ignore[no-untyped-def]
    _, jobs, _, _ = site
    previous = {j.seed: (j.directory / "metrics.json").stat().st_mtime_ns for j in jobs if j.done}
    again: list[int] = []

    def make(job: Job) -> list[str]:
        again.append(job.seed)
        return crash(job)

    failed = run_all(jobs, 2, None, make)
    assert sorted(again) == [1, 2] and sorted(j.seed for j in failed) == [1, 2]
    assert previous == {j.seed: (j.directory / "metrics.json").stat().st_mtime_ns for j in jobs if j.done}


def test_runs_go_on_beside_each_other(tmp_path: Path) -> None:
    """Each of two runs waits for the other one: alone neither would end."""
    meet = (
        f"import pathlib, time; here = pathlib.Path({str(tmp_path)!r})\n"
        "(here / sys.argv[sys.argv.index('--seed') + 1]).touch(); end = time.monotonic() + 300\n"
        "while not all((here / s).exists() for s in '01') and time.monotonic() < end: time.sleep(0.01)\n"
        "assert time.monotonic() < end"
    )
    jobs = plan(["fake"], [0, 1], tmp_path / "out")
    assert run_all(jobs, 2, None, lambda job: fake(job, meet)) == {}


def test_a_pipe_in_the_place_of_a_runs_errors_is_replaced(tmp_path: Path) -> None:
    """Its reader would never come."""
    job = Job("fake", 0, tmp_path / "a")
    job.directory.mkdir()
    os.mkfifo(job.directory / "errors.txt")
    said: list[dict[Job, str]] = []
    call = lambda _: [sys.executable, "-c", "import sys; sys.exit('over')"]
    thread = threading.Thread(target=lambda: said.append(run_all([job], 1, make=call)), daemon=True)
    thread.start()
    thread.join(30.0)
    assert said == [{job: "over"}]


def test_ctrl_c_ends_what_goes_on(tmp_path: Path) -> None:
    def interrupt(fraction: float, note: str) -> None:
        raise KeyboardInterrupt

    pid = tmp_path / "pid"
    # the file is there as a whole or not at all, whenever the process is ended
    note = f"new = pathlib.Path({str(pid)!r} + str(os.getpid())); new.write_text(str(os.getpid())); new.rename({str(pid)!r})"
    slow = f"import time, pathlib\nif '1' in sys.argv: {note}; time.sleep(300)"
    jobs = plan(["fake"], [0, 1], tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run_all(jobs, 2, interrupt, lambda job: fake(job, slow))
    assert [j.done for j in jobs] == [True, False]
    if pid.exists():  # else it was ended before it had begun
        with pytest.raises(ProcessLookupError):
            os.kill(int(pid.read_text()), 0)


def test_medians_are_judged(site) -> None:  # type: ignore[no-untyped-def]
    out, jobs, _, _ = site
    metrics = summarize(jobs)["fake"]["metrics"]
    files = [json.loads((out / "fake" / f"seed{s}" / "metrics.json").read_text())["metrics"] for s in (0, 3, 4, 5)]
    values = [f["hand_error_mean_odometry"]["value"] for f in files]
    m = metrics["hand_error_mean_odometry"]
    assert (m["median"], m["worst"]) == (statistics.median(values), max(values))
    assert (m["paper"], m["goal"], m["met"]) == (0.0167, 0.003, True)
    assert metrics["hand_error_max_odometry"]["met"] is False
    assert metrics["rise_time_max"]["worst"] == float("inf") and metrics["rise_time_max"]["median"] == 0.9
    assert metrics["path_length"]["met"] is None
    assert metrics["fell"]["median"] == 0.0 and metrics["fell"]["met"] is False  # one of four fell


def test_the_site_stands_alone(site) -> None:  # type: ignore[no-untyped-def]
    out, jobs, failed, _ = site
    index = write_site(jobs, failed, out, clips=False)
    for page in (index, out / "fake" / "index.html"):
        text, links = page.read_text(), []

        class Finder(HTMLParser):
            def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]], links=links) -> None:  # type: ignore[no-untyped-def]
                links.extend(v for k, v in attrs if k in ("src", "href") and v)

        Finder().feed(text)
        assert links and all((page.parent / link.partition("#")[0]).is_file() for link in links), links
        assert "http" not in re.sub(r"<style>.*?</style>", "", text, flags=re.S)
    body = index.read_text()
    assert "1 of 3 goals pass; short: fake: hand_error_max_odometry, fake: fell." in body
    row = next(r for r in body.split("<tr>") if "<td>hand_error_mean_odometry" in r.replace("<wbr>", ""))
    assert "16.7" in row and "≤ 3" in row and "pass" in row
    row = next(r for r in body.split("<tr>") if "<td>hand_error_max_odometry" in r.replace("<wbr>", ""))
    assert "falls short" in row
    assert "3 of 4 runs completed, 1 gave_up, 2 gave no result" in body and "mujoco" in body
    own = (out / "fake" / "index.html").read_text()
    assert "the robot fell at 0.10 s" in own and "no result: ValueError: no &lt;luck&gt;" in own
    assert "there is no physics &lt;at all&gt;" in own and "&quot;rate&quot;: 50.0" in own and "There is no clip" in own


def test_goals_are_ranges_and_least_values_too(tmp_path: Path) -> None:
    """A figure of three seeds is judged by its median against both bounds, and the page shows them."""
    jobs = plan(["fake"], range(3), tmp_path)
    targets = {"ratio": {"least": 10.0}, "torque": {"least": 195.0, "goal": 206.0}, "low": {"least": 5.0}}
    for job, ratio in zip(jobs, (9.0, 11.0, 12.0), strict=True):
        values = {"ratio": ratio, "torque": 200.0 + ratio, "low": 4.0}
        metrics = {name: {"value": v, "unit": "1"} for name, v in values.items()}
        job.directory.mkdir(parents=True)
        run = {"completed": True, "metrics": metrics, "targets": targets, "idealisations": [], "settings": {}}
        (job.directory / "metrics.json").write_text(json.dumps(run))
        job.mark.touch()
    met = {name: m["met"] for name, m in summarize(jobs)["fake"]["metrics"].items()}
    assert met == {"ratio": True, "torque": False, "low": False}  # medians 11, 211 and 4
    page = write_site(jobs, {}, tmp_path, clips=False).read_text()
    assert "≥ 10" in page and "195 to 206" in page and "1 of 3 goals pass; short: fake: torque, fake: low." in page


def test_the_files_of_a_site_are_not_trusted(tmp_path: Path) -> None:
    """A site's folder may come from somebody else: texts stay texts, also names of folders, and what is damaged is named."""
    (job,), about = plan(["javascript:alert(1)"], [3], tmp_path), {"outcome": "<script>", "metrics": {}}
    job.directory.mkdir(parents=True)
    job.mark.touch()
    file = job.directory / "metrics.json"
    file.write_text(json.dumps(about))
    page = write_site([job], {}, tmp_path, clips=False).read_text()
    assert "1 &lt;script&gt;" in page and 'href="javascript:' not in page
    for wrong in ({"versions": []}, {"versions": {"a": 1}}, {"targets": {"x": {"goal": "1"}}}, {"idealisations": 3}):
        file.write_text(json.dumps({**about, **wrong}))
        with pytest.raises(InputError, match=f"metrics.json: keys? .*{next(iter(wrong))}"):
            write_site([job], {}, tmp_path, clips=False)


def test_a_site_without_any_result(tmp_path: Path) -> None:
    jobs = plan(["fake"], [1], tmp_path)
    index = write_site(jobs, run_all(jobs, 1, None, crash), tmp_path, clips=False)
    assert "No run gave a result. seed 1: the process ended with code -9" in index.read_text()


def test_seeds() -> None:
    assert parse_seeds("200-203") == [200, 201, 202, 203]
    assert parse_seeds("1,5-7, 6") == [1, 5, 6, 7]
    for bad in ("", "a", "3-1", "1-", "-2", "1,,2", "²", "1-²", "9" * 5000):
        with pytest.raises(InputError, match="valid: 300-319, 3 or 1,5-7"):
            parse_seeds(bad)
    assert len(parse_seeds("0-999")) == 1000
    for many in ("0-1000", "0-999999999", "0-600,700-1200"):
        with pytest.raises(InputError, match="these are more than 1000 seeds"):
            parse_seeds(many)


def test_bad_input_of_the_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["reproduce", "--only", "swerve-trak", "--out", str(tmp_path / "x")]) == 2
    assert "did you mean 'swerve-track'" in capsys.readouterr().err
    assert main(["reproduce", "--seeds", "b"]) == 2
    (tmp_path / "file").write_text("")
    for out in ("file", "file/below"):
        capsys.readouterr()
        assert main(["reproduce", "--out", str(tmp_path / out)]) == 2
        assert capsys.readouterr().err.startswith(f"wbmpc: --out: '{tmp_path / out}' ")
    assert not (tmp_path / "x").exists()


def test_the_default_command_is_a_run(tmp_path: Path) -> None:
    failed = run_all(plan(["nonsense"], [1], tmp_path), 1)
    (reason,) = failed.values()
    assert reason.startswith("wbmpc: unknown experiment 'nonsense'")


def test_the_site_has_what_earlier_calls_have_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two experiments, one call for each, then another seed of the first: the site, the page and the object have all."""
    registry = {name: replace(EXPERIMENT, name=name) for name in ("first", "second")}
    monkeypatch.chdir(tmp_path)

    def run_all(jobs: list[Job], workers: int, progress: object) -> dict[Job, str]:
        """In this process: what a run's own one would do."""
        for job in jobs:
            result = EXPERIMENT.run(FakeSettings(duration=0.2), job.seed, None)  # type: ignore[arg-type]
            write_run(replace(result, experiment=job.name), job.directory)
            job.mark.touch()
        return {}

    monkeypatch.setattr(reproduce, "run_all", run_all)
    call = lambda *arguments: main(["reproduce", "--out", "site", "--no-clips", "--json", *arguments], registry)
    assert call("--only", "second", "--seeds", "3") == 0
    capsys.readouterr()
    assert call("--only", "first", "--seeds", "3") == 0
    said = json.loads(capsys.readouterr().out)
    assert list(said["experiments"]) == ["first", "second"]
    body = Path("site/index.html").read_text()
    assert -1 < body.index(">first</a>") < body.index(">second</a>")
    assert call("--only", "first", "--seeds", "1") == 0
    page = Path("site/first/index.html").read_text()
    assert "seed1/report.html" in page and "seed3/report.html" in page
    assert "2 of 2 runs completed" in Path("site/index.html").read_text()
