"""Links of pages that GitHub shows, as the site has them: pages outside ``docs`` stand in ``docs/generated``."""

from __future__ import annotations

import os
import re
from pathlib import Path

from executed import DOCS, TOP

BROUGHT = {
    TOP / "CHANGELOG.md": "changelog",
    TOP / "CONTRIBUTING.md": "contributing",
    TOP / "data" / "README.md": "data",
}
"""Files outside ``docs`` that are pages of the site."""

MOVED = {
    **{source: DOCS / "generated" / f"{name}.md" for source, name in BROUGHT.items()},
    TOP / "README.md": DOCS / "index.md",
}

_LINK = re.compile(r"(\]\()([^)\s:#]+)(#[^)\s]*)?(\))")


def brought(source: Path) -> str:
    """A file from outside as a page of `docs/generated`."""
    return for_site(source.read_text("utf-8"), source.parent, DOCS / "generated")


def for_site(text: str, written_in: Path, shown_in: Path) -> str:
    """Text with its links turned to where the site has what they lead to."""

    def turned(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(written_in / match[2]))
        moved = MOVED.get(target, target)
        if target.parent == TOP / "examples" / "notebooks":
            moved = DOCS / "notebooks" / target.name
        if target.is_dir() or not (target.exists() or moved.exists()):
            return match[0]
        return f"{match[1]}{os.path.relpath(moved, shown_in)}{match[3] or ''}{match[4]}"

    return _LINK.sub(turned, text)
