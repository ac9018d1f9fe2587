"""The documents that are written by hand (README.md and docs/), and the words of the code. Truth: the files that links and images
name, the list of words below."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: Words by hand in README and docs, tables and code blocks included.
MAX_WORDS = 25_000
#: Words that only this project's authors would understand, and what the field says.
PRIVATE = {
    r"\btold\b": "reported",
    r"\btells?\b": "reports, shows, informs",
    r"\brefuse[sd]?\b": "rejects, rejected",
    r"\bsentences?\b": "message",
    r"\brivals?\b": "baseline",
    r"\bburdens?\b": "load",
    r"\bwish(es)?\b": "soft constraint",
    r"\bzoo\b": "test problems",
    r"\bverdicts?\b": "diagnostics",
    r"\bagents?\b": "controller",
    r"\bpilots?\b": "adapter",
    r"\bdied of\b": "the cause of failure",
    r"\bearlier version": "nothing: documents have no history",
    r"\bversion before": "nothing: documents have no history",
    r"\bno longer\b": "nothing: documents have no history",
    r"\b(no|some)body\b|\bwhoever\b": "the user, another process; not, unknown",
    r"\bin(to)? force\b": "active",
    r"\bon and on\b": "continuously",
    r"\bnotebook\.md\b": "nothing",
}
#: The same for code: names (``told_apart``, ``Teller``, ``TOLD``), comments, docstrings and messages. A file's ``tell`` method is
#: not among them.
CODE = (
    "told", "teller", "tells", "refuse", "refuses", "refused", "refusal", "sentence", "sentences", "rival", "rivals", "verdict", "burden",
    "wish", "wishes", "zoo", "agent", "agents", "pilot", "inbox", "breathe", "leaning",
)  # fmt: skip
#: Every match of the following contains one of them.
STEMS = (*CODE, "tell", "died of")
PRIVATE_IN_CODE = re.compile(
    "|".join(rf"(?<![A-Za-z])(?:{w}|{w.upper()})(?![A-Za-z])|(?<![A-Z]){w.capitalize()}(?![a-z])" for w in CODE)
    + r"|(?<![.\w])[Tt]ell\b(?!\()|(?<![A-Za-z])_tell(?![a-z])|\bdied of\b"
)
#: What the operating system calls it.
NOT_PRIVATE = re.compile(r"[Cc]onnection ?[Rr]efused(Error)?")
GENERATED = re.compile(r"<!-- (?P<mark>[a-z ]+) -->\n.*?<!-- end of (?P=mark) -->", re.DOTALL)
LINK = re.compile(r"(!?)\[[^\]]*\]\(<?([^)\s>]*)>?\)")
#: Pages that the build writes.
WRITTEN = re.compile(r"docs/reference/_(api/|settings|metrics|cli|changelog)")


def pages() -> list[Path]:
    """Markdown by hand: what the build writes and its output are left out."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    names = [p.relative_to(ROOT).as_posix() for p in found]
    return [p for p, n in zip(found, names) if not n.startswith("docs/_build") and not WRITTEN.match(n)]


def by_hand(page: Path) -> str:
    return GENERATED.sub("", page.read_text())


def prose(page: Path) -> str:
    """Without fenced blocks, literals and addresses of links: names of files and options are no prose."""
    text = re.sub(r"(?ms)^(```|:::).*?^\1", "", by_hand(page))
    return re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`\n]*`", "", text))


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and the site make it."""
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").strip().lower()).replace(" ", "-")


def anchors(page: Path) -> set[str]:
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text())
    return {slug(h) for h in re.findall(r"(?m)^#+ (.*)$", text)}


IDS = [p.relative_to(ROOT).as_posix() for p in pages()]


@pytest.mark.parametrize("page", pages(), ids=IDS)
def test_no_merge_is_left_half_done(page: Path) -> None:
    assert not re.search(r"^(<{7}|>{7}) ", page.read_text(), re.M)


def test_the_documents_are_short() -> None:
    words = {p.relative_to(ROOT).as_posix(): len(by_hand(p).split()) for p in pages()}
    longest = sorted(words, key=words.__getitem__)[-5:]
    assert sum(words.values()) <= MAX_WORDS, {n: words[n] for n in longest}


@pytest.mark.parametrize("page", pages(), ids=IDS)
def test_words_are_the_fields(page: Path) -> None:
    found = {w: [m[0] for m in re.finditer(w, prose(page), re.IGNORECASE)] for w in PRIVATE}
    assert not any(found.values()), {m[0]: PRIVATE[w] for w, m in found.items() if m}


def private_words(text: str) -> list[str]:
    found = []
    for i, line in enumerate(text.splitlines(), start=1):
        lower = line.lower()
        if any(w in lower for w in STEMS):  # an expression that looks behind every letter takes long
            found += [f"{i}: {m[0]}" for m in PRIVATE_IN_CODE.finditer(NOT_PRIVATE.sub("", line))]
    return found


@pytest.mark.parametrize("folder", ["src", "examples", "benchmarks", "scripts", "tests"])
def test_words_of_the_code_are_the_fields(folder: str) -> None:
    files = sorted(f for f in (ROOT / folder).rglob("*.py") if f != Path(__file__))  # which names the words
    found = {f.relative_to(ROOT).as_posix(): private_words(f.read_text()) for f in files}
    assert files and not {name: words for name, words in found.items() if words}


@pytest.mark.parametrize(
    "line",
    ["def _tell(self):", "class Teller:", "told_apart = 1", "BusAgent(robot)", "# it is refused", "REFUSED = 0.1", "#: Tell it",
     "'the rival fell'", "x._told_at"],
)  # fmt: skip
def test_a_private_word_in_code_is_found(line: str) -> None:
    assert private_words(line)


@pytest.mark.parametrize("line", ["file.tell()", "ConnectionRefusedError", "arrival", "agenda", "wisher"])
def test_other_words_in_code_are_not(line: str) -> None:
    assert not private_words(line)


@pytest.mark.parametrize("page", pages(), ids=IDS)
def test_links_and_images_lead_somewhere(page: Path) -> None:
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text())
    for image, target in LINK.findall(text):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        generated = file.is_relative_to(ROOT) and WRITTEN.match(file.relative_to(ROOT).as_posix())
        # settings.md gets its headings from a page that the build writes
        assert file.exists() or generated, f"{page.name}: '{target}' does not exist"
        if anchor and not image and file.suffix == ".md" and "{include}" not in file.read_text():
            assert anchor in anchors(file), f"{page.name}: {name or page.name} has no heading '#{anchor}'"


#: Code of a page, and what it imports of the package.
CODE_BLOCK = re.compile(r"^```(?:python|\{code-cell\}).*?\n(.*?)^```", re.DOTALL | re.MULTILINE)
PRIVATE_IMPORT = re.compile(r"^\s*(?:from wbmpc\b|import wbmpc\b(?! as wb$)).*", re.MULTILINE)


@pytest.mark.parametrize("page", pages(), ids=lambda p: p.name)
def test_programs_of_a_page_import_public_names_alone(page: Path) -> None:
    found = [line for code in CODE_BLOCK.findall(page.read_text()) for line in PRIVATE_IMPORT.findall(code)]
    assert not found, f"valid: import wbmpc as wb; {page.relative_to(ROOT)}: {found}"


@pytest.mark.parametrize("line", ["from wbmpc.types import Timing", "import wbmpc.types", "    from wbmpc import MPC"])
def test_a_private_import_of_a_page_is_found(line: str) -> None:
    page = f"```{{code-cell}}\nimport wbmpc as wb\n{line}\n```\n"
    assert [found for code in CODE_BLOCK.findall(page) for found in PRIVATE_IMPORT.findall(code)] == [line]


def test_every_image_is_shown_somewhere() -> None:
    """A picture that no document shows is dead weight of the repository."""
    text = "".join(p.read_text() for p in pages())
    unused = [p.name for p in (ROOT / "docs" / "images").iterdir() if f"images/{p.name}" not in text]
    assert not unused


def test_every_page_is_in_a_table_of_contents() -> None:
    """Sphinx warns of others, but only where it is installed."""
    listed = {(ROOT / "docs" / "index.md").resolve()}
    for page in pages():
        for block in re.findall(r"(?ms)^```\{toctree\}\n(.*?)^```", page.read_text()):
            listed |= {
                (page.parent / f"{line.strip()}.md").resolve() for line in block.splitlines() if line and line[0] != ":"
            }
    assert {p for p in pages() if p.name != "README.md"} <= listed


def test_every_module_that_a_page_refers_to_has_a_page_of_its_own() -> None:
    """Sphinx leaves a role without a page as it is, and warns of nothing."""
    assigned = {
        node.targets[0].id: ast.literal_eval(node.value)
        for node in ast.parse((ROOT / "docs" / "_ext" / "generated_pages.py").read_text()).body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    described = (*assigned["PACKAGES"], *assigned["MODULES"])
    for page in pages():
        for name in re.findall(r"\{py:\w+\}`(?:[^`<]*<)?wbmpc\.([\w.]+)>?`", page.read_text()):
            package, _, rest = name.partition(".")
            only = assigned["ONLY"].get(package, (rest.partition(".")[0],))
            assert package in described and rest.partition(".")[0] in only, f"{page.name}: {name}"


def test_the_size_of_the_translator_is_what_the_page_says() -> None:
    modules = ("translate", "expressions", "ir", "vectors", "library", "function")
    lines = sum(len((ROOT / "src" / "wbmpc" / "kernel" / f"{m}.py").read_text().splitlines()) for m in modules)
    said = re.search(r"translator has (\d+) lines", (ROOT / "docs" / "explanation" / "solver.md").read_text())
    assert said is not None and abs(int(said[1]) - lines) < 0.05 * lines
