"""A site of thousands of names is built in less time; its pages are the same."""

from __future__ import annotations

from typing import Any

from sphinx import addnodes
from sphinx.domains.python import PythonDomain
from sphinx.environment.adapters.toctree import document_toc


class Names(PythonDomain):
    """Remembers what it has looked for: the names of others, as most types in signatures are, are compared with all of this project."""

    def find_obj(self, env: Any, modname: Any, classname: Any, name: Any, type: Any, searchmode: int = 0) -> Any:
        """As Sphinx finds it."""
        found: dict[Any, Any] = self.__dict__.setdefault("found", {})
        key = len(self.objects), modname, classname, name, type, searchmode
        if key not in found:
            found[key] = super().find_obj(env, modname, classname, name, type, searchmode)
        return found[key]


#: Contents of each page, with its classes and functions.
_contents: dict[str, Any] = {}


def setup(app: Any) -> dict[str, bool]:
    """Sphinx: contents are taken when all pages are read, and put into each before the theme looks at them."""
    app.add_domain(Names, override=True)
    app.connect("env-check-consistency", _cut)
    app.connect("html-page-context", _with_contents, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _cut(app: Any, env: Any) -> None:
    """The tree of pages, which every page shows, would be copied for each with all that is defined in them, and cut to titles then."""
    for page, contents in env.tocs.items():
        _contents[page] = document_toc(env, page, app.tags)
        for line in list(contents.findall(addnodes.compact_paragraph)):
            if line.get("skip_section_number"):  # of something that is defined there
                items = line.parent.parent
                items.remove(line.parent)
                if not items.children:
                    items.parent.remove(items)


def _with_contents(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    if page in _contents:
        context["toc"] = app.builder.render_partial(_contents[page])["fragment"]
