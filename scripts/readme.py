"""The README's table and clip, from a site that `wbmpc reproduce` made: figures of merit over all finished runs beside the
papers', between two marks in the README (before "The problem" when it has none yet)."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from wbmpc.reproduce import Job, summarise

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- figures: made by 'make readme' -->\n", "<!-- end of figures -->\n"
BEFORE = "## The problem\n"
CLIP = "swerve-track"
SPEED, SIZE, LONGEST = 6.0, (360, 200), 60.0


def jobs_of(site: Path) -> list[Job]:
    """All finished runs of a site."""
    found = [Job(f.parent.parent.name, int(f.parent.name[4:]), f.parent) for f in site.glob("*/seed*/finished")]
    return sorted(found, key=lambda job: (job.name, job.seed))


def number(value: float | None) -> str:
    """Three digits; nothing for what nobody has published or asked for."""
    return "" if value is None else f"{value:.3g}"


def table(site: Path) -> str:
    """Markdown: every metric that a paper gives or a goal asks for."""
    found = summarise(jobs_of(site))
    if not found:
        raise SystemExit(f"readme: {site} holds no finished runs: wbmpc reproduce --out {site}")
    versions = {r["versions"].get("wbmpc", "?") for e in found.values() for r in e["runs"].values()}
    about = f"wbmpc {', '.join(sorted(versions))}, simulated; the papers' figures are of the real robots."
    rows = [
        "| experiment | figure | median | largest | paper | goal (at most) | |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, entry in found.items():
        title = f"`{name}`, {len(entry['runs'])} seeds"
        for metric, m in entry["metrics"].items():
            if m["paper"] is None and m["goal"] is None:
                continue
            verdict = {True: "pass", False: "falls short", None: ""}[m["met"]]
            figures = " | ".join(number(m[key]) for key in ("median", "worst", "paper", "goal"))
            rows.append(f"| {title} | {metric} [{m['unit']}] | {figures} | {verdict} |")
            title = ""
    return f"{about}\n\n" + "\n".join(rows) + "\n"


def put(readme: Path, text: str) -> None:
    """Put the text between the marks."""
    old = readme.read_text()
    if BEGIN in old and END in old:
        head, rest = old.split(BEGIN, 1)
        tail = rest.split(END, 1)[1]
    elif BEFORE in old:
        head, after = old.split(BEFORE, 1)
        tail = "\n" + BEFORE + after
    else:
        raise SystemExit(f"readme: {readme} has neither the marks nor a line '{BEFORE.strip()}'")
    readme.write_text(head + BEGIN + text + END + tail)


def clip(site: Path, path: Path) -> None:
    """The README's clip: the beginning of the first finished run of its experiment."""
    from wbmpc.recording.reader import read
    from wbmpc.view.render import render
    from wbmpc.view.replay import Film

    runs = [job for job in jobs_of(site) if job.name == CLIP]
    if runs:
        render(Film(read(runs[0].directory)), path, (0.0, LONGEST), SIZE, SPEED)


def main() -> None:
    """Table, then clip."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--site", type=Path, default=ROOT / "reproduced")
    parser.add_argument("--readme", type=Path, default=ROOT / "README.md")
    parser.add_argument("--clip", type=Path, default=ROOT / "docs" / "images" / "swerve.gif")
    given = parser.parse_args()
    put(given.readme, table(given.site))
    clip(given.site, given.clip)
    print(json.dumps({"readme": str(given.readme)}))


if __name__ == "__main__":
    main()
