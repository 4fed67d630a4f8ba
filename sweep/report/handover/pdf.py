"""A report as PDF: what a browser prints of the page.

Chromium's own print is chosen over pages drawn by matplotlib: the PDF is then the same page as the HTML, with its
tables and links, and there is one layout to keep. Where no browser of that family is installed, any browser prints the
HTML.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from ....plant.errors import SeqsweepError

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
)
"""Commands of browsers that print a page without a window."""

PRINT_S = 120.0
"""Wall time (s) that printing may take."""

_FLAGS = (
    "--headless",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--no-default-browser-check",
    "--no-pdf-header-footer",
)
_DATE = re.compile(rb"/(CreationDate|ModDate) \(D:[^)]*\)")


class PdfError(SeqsweepError):
    """A PDF that cannot be made here, with the way out."""


def browser() -> str:
    """The path of a browser that can print.

    Raises
    ------
    PdfError
        If there is none.
    """
    for name in BROWSERS:
        if found := shutil.which(name):
            return found
    raise PdfError(
        "--pdf is printed by Chromium, Chrome or Edge, and none of them is installed here (Debian: apt-get install "
        "chromium). Leave --pdf away: the HTML report prints from any browser"
    )


def printed(page: str, printer: str) -> bytes:
    """The page as PDF, without the date of printing. Chromium does not promise the same bytes for the same page.

    Parameters
    ----------
    page : str
        The HTML.
    printer : str
        The browser; see `browser`.

    Raises
    ------
    PdfError
        If the browser fails.
    """
    with tempfile.TemporaryDirectory(prefix="seqsweep-print-") as name:
        folder = Path(name)
        source, target = folder / "report.html", folder / "report.pdf"
        source.write_text(page, "utf-8")
        command = [
            printer, *_FLAGS, *_sandbox(), f"--user-data-dir={folder / 'profile'}", f"--print-to-pdf={target}",
            source.as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PRINT_S)
        except subprocess.TimeoutExpired:
            raise PdfError(f"{printer} took longer than {PRINT_S:g} s to print the report") from None
        if done.returncode or not target.is_file():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise PdfError(f"{printer} could not print the report (exit status {done.returncode}): {last}")
        return _without_time(target.read_bytes())


def _sandbox() -> list[str]:
    """Chromium refuses its sandbox to root; the page is our own and may fetch nothing."""
    import os

    return ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []


def _without_time(content: bytes) -> bytes:
    """The date of printing replaced by as many digits of another one, so that places in the file stay right."""
    return _DATE.sub(lambda found: re.sub(rb"\d", b"0", found.group(0)), content)
