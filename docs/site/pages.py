"""What is added to sphinx: pages made of the program, the box of a page, links to files outside docs/."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import campaign_keys
import command_line
import formats
import links
import notebooks
from docutils import nodes
from sphinx.application import Sphinx

MADE = {
    "commands.md": command_line.page,
    "campaign-keys.md": campaign_keys.page,
    "columns.md": formats.columns_page,
    "json-files.md": formats.json_page,
    "api.md": formats.api_page,
    **{f"{name}.md": partial(links.brought, source) for source, name in links.BROUGHT.items()},
}
"""Pages of `docs/generated/`, and what writes them."""

GLANCE = "At a glance"
"""The first head of the table that is shown as a box."""


def make_pages(app: Sphinx) -> None:
    """Write the pages that are made of the program; a page that is the same is left alone."""
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    for name, make in MADE.items():
        text = make()
        path = folder / name
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")
    notebooks.bring(app.config.seqsweep_run)


def turn_links(app: Sphinx, name: str, content: list[str]) -> None:
    """Links to what stands outside ``docs`` lead to its page."""
    path = Path(app.env.doc2path(name))
    if path.suffix == ".md":
        content[0] = links.for_site(content[0], path.parent, path.parent)


def spare_bars(app: Sphinx, kind: str, name: str, found: object, options: object, lines: list[str]) -> None:
    """``|v|`` in a docstring is a magnitude and no substitution. Runs before napoleon."""
    lines[:] = [line if "``" in line else re.sub(r"(?<!\\)\|", r"\\|", line) for line in lines]


def mark_boxes(app: Sphinx, document: nodes.document) -> None:
    """Give the box of a page its class."""
    for table in document.findall(nodes.table):
        if table.astext().strip().startswith(GLANCE):
            table["classes"].append("glance")


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_config_value("seqsweep_run", True, "env")
    app.connect("builder-inited", make_pages)
    app.connect("source-read", turn_links)
    app.connect("doctree-read", mark_boxes)
    app.connect("autodoc-process-docstring", spare_bars, priority=100)
    return {"version": "1", "env_version": 2, "parallel_read_safe": True, "parallel_write_safe": True}
