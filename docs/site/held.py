"""Holds a built site against what it promises: ``python docs/site/held.py build/site``.

Nothing is fetched from a network, every link leads somewhere, every picture has words, every table has heads.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import cache, cached_property
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

FETCHING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "object": "data"}
"""Attributes that a browser follows by itself."""

NO_FETCH = ("canonical", "search", "index", "genindex", "prev", "next", "author", "copyright")
"""``rel`` of links that are only told."""


class Page(HTMLParser):
    """Tags of a page with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, {name: value or "" for name, value in attrs}))

    @cached_property
    def anchors(self) -> set[str]:
        return {attributes["id"] for _, attributes in self.tags if "id" in attributes}


@cache
def read(path: Path) -> Page:
    return Page(path.read_text("utf-8"))


def problems_of(site: Path) -> Iterator[str]:
    """What a site does not keep, one line each."""
    for path in sorted(site.rglob("*.html")):
        name = path.relative_to(site)
        if "_static" in name.parts:
            continue
        for tag, attributes in read(path).tags:
            yield from (f"{name}: {problem}" for problem in _of_tag(path, tag, attributes))
    for path in sorted(site.rglob("*.css")):
        for target in re.findall(r"url\(\s*['\"]?(https?:[^)'\"]+)", path.read_text("utf-8")):
            yield f"{path.relative_to(site)}: fetches {target}"


def _of_tag(path: Path, tag: str, attributes: dict[str, str]) -> Iterator[str]:
    fetched = attributes.get(FETCHING.get(tag, ""), "")
    if re.match(r"(https?:)?//", fetched) and attributes.get("rel") not in NO_FETCH:
        yield f"<{tag}> fetches {fetched}"
    if tag == "img" and not attributes.get("alt", "").strip() and not re.search(r"sphx_glr_\w+_thumb", fetched):
        yield f"the picture {fetched} has no words (alt)"
    if tag == "a" and (problem := _of_link(path, attributes.get("href", ""))):
        yield problem
    if tag in ("img", "script", "link") and fetched and not re.match(r"(https?:|data:|//)", fetched):
        target = path.parent / unquote(fetched.partition("?")[0].partition("#")[0])
        if not target.exists():
            yield f"<{tag}> {fetched} is not there"


def _of_link(path: Path, href: str) -> str:
    """What is wrong with where a link leads; an empty text where nothing is."""
    if not href or re.match(r"[a-z]+:|//", href):
        return ""
    name, _, anchor = href.partition("#")
    target = (path.parent / unquote(name.partition("?")[0])).resolve() if name else path.resolve()
    if not target.exists():
        return f"the link {href} leads nowhere"
    if anchor and target.suffix == ".html" and unquote(anchor) not in read(target).anchors:
        return f"the link {href} leads to a place that is not there"
    return ""


def main(site: Path) -> int:
    found = list(problems_of(site))
    print(*found, sep="\n", end="\n" if found else "")
    return int(bool(found))


if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1])))
