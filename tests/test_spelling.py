"""Code and documents are in American English: Merriam-Webster's spelling of words that British English spells otherwise."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
BRITISH = re.compile(
    r"colour|centre|tyre|learnt|metre\b|metres\b|neighbour|behaviour|travelled|modelled|licence|grey\b|generalis|normalis|optimis[ei]"
    r"|linearis|localis|idealis|summaris|quantis|initialis|minimis|maximis|regularis|discretis|parametris|factoris|symmetris",
    re.IGNORECASE,
)
#: What begins a match: to look for it is much faster than for an expression.
STEMS = [re.split(r"\\|\[", word)[0] for word in BRITISH.pattern.split("|")]
#: A key of metrics.json, which programs read.
KEPT = '"idealisations"'
SUFFIXES = {".py", ".md", ".yaml", ".xml", ".toml", ".js", ".css", ".html"}


def test_words_are_spelled_the_american_way() -> None:
    files = [p for part in ("src", "docs", "examples", "benchmarks", "scripts") for p in (ROOT / part).rglob("*")]
    files = [p for p in files if p.suffix in SUFFIXES and "_build" not in p.parts and ".egg-info" not in str(p)]
    found = set()
    for path in [*files, ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"]:
        text = path.read_text(errors="replace").replace(KEPT, "")
        lower = text.lower()
        if any(stem in lower for stem in STEMS):
            found |= {f"{path.relative_to(ROOT)}: {word.group(0)}" for word in BRITISH.finditer(text)}
    assert not found
