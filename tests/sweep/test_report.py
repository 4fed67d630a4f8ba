"""The report that is handed over: one file, complete, that fetches nothing."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser

import pytest

from seqsweep.sweep.report.handover.page import _sentence_of

from ..support.commands import call, campaign


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    file = campaign(folder, plant="branch-v1", powers=(0.0,), n=24)
    assert call("run", file, "-o", folder / "y.parquet", "--jobs", 1).returncode == 0
    tuned = ("tune", folder / "y.parquet", "--grid", "0.02+0.3j", "--scale", "1.0,2.0", "-o", folder / "t.json")
    assert call(*tuned).returncode == 0
    done = call("report", folder / "y.parquet", folder / "t.json", "-o", folder / "r.html")
    assert done.returncode == 0, done.stderr
    return folder


class Page(HTMLParser):
    """Every tag with its attributes, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def page(folder):
    return Page((folder / "r.html").read_text("utf-8"))


def test_the_answer_comes_first_and_every_section_is_there(page):
    before = page.text[: page.text.index("Closed-loop modes")]
    assert "of 2 cases 2 stable" in before
    for title in ("Verdict", "Admittance", "What was swept", "What operators ask of a scan", "Provenance"):
        assert title in page.text


def test_a_gain_that_was_confirmed_is_told_with_what_it_makes_of_the_device():
    point = {"op_id": "p", "scale": 1.4, "verdict": "unstable", "margin_m": 0.95, "margin_met": False}
    assert "Swept again" not in _sentence_of("d", point)
    confirmed = {**point, "k": 1.214, "with_k": {"verdict": "stable"}, "margin_m_with_k": 1.403}
    assert "Swept again with damping gain k = 1.21 in place: stable, with a margin of 1.4." in _sentence_of(
        "d", confirmed
    )


def test_nothing_is_fetched_and_no_script_runs(folder, page):
    text = (folder / "r.html").read_text("utf-8")
    assert not [tag for tag, _ in page.tags if tag in ("script", "link", "iframe", "img", "object")]
    targets = [v for _, attributes in page.tags for k, v in attributes.items() if k in ("src", "href", "xlink:href")]
    assert all(target.startswith("#") for target in targets if target)
    assert not re.search(r"url\((?!#)", text)


def test_pictures_have_words_and_identifiers_are_unique(page):
    figures = [attributes for tag, attributes in page.tags if tag == "figure"]
    assert len(figures) == 2
    assert all(figure.get("aria-label") for figure in figures)
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))


def test_tables_have_headers_with_a_scope(page):
    heads = [attributes for tag, attributes in page.tags if tag == "th"]
    assert heads
    assert all(head.get("scope") in ("col", "row") for head in heads)


def test_what_is_not_covered_is_said(page):
    assert "Not covered by this report." in page.text
    assert "zero sequence" in page.text.lower()


def test_the_same_files_give_the_same_bytes_and_a_stamp_is_asked_for(folder):
    again = ("report", folder / "y.parquet", folder / "t.json", "-o", folder / "again.html")
    assert call(*again).returncode == 0
    assert (folder / "again.html").read_bytes() == (folder / "r.html").read_bytes()
    assert call(*again, "--stamp", "--force").returncode == 0
    assert "Made on" in (folder / "again.html").read_text("utf-8")


REFUSED = {
    "no table": (["t.json"], "0 tables given"),
    "two tables": (["y.parquet", "y.parquet"], "2 tables given"),
    "twice": (["y.parquet", "t.json", "t.json"], "a second result of kind tuning"),
    "unknown": (["y.parquet", "x.json"], "not a result of seqsweep"),
    "no JSON": (["y.parquet", "broken.json"], "neither a table nor a JSON result"),
    "missing": (["y.parquet", "none.json"], "no such file"),
    "no Parquet": (["broken.parquet"], "not a Parquet file"),
}


@pytest.mark.parametrize(("names", "words"), REFUSED.values(), ids=REFUSED)
def test_files_that_make_no_report_are_refused(folder, names, words):
    (folder / "x.json").write_text('{"format": "other"}')
    (folder / "broken.json").write_text("{")
    (folder / "broken.parquet").write_bytes(b"PAR1 nothing PAR1")
    done = call("report", *(folder / name for name in names), "-o", folder / "refused.html")
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert not (folder / "refused.html").exists()


def test_a_result_about_another_table_is_told(folder, tmp_path):
    file = campaign(tmp_path, plant="branch-v1", powers=(0.0,), n=12)
    assert call("run", file, "-o", tmp_path / "other.parquet", "--jobs", 1).returncode == 0
    done = call("report", tmp_path / "other.parquet", folder / "t.json", "-o", tmp_path / "r.html")
    assert done.returncode == 0
    assert "was made from another table" in (tmp_path / "r.html").read_text("utf-8")


CHROMIUM = shutil.which("chromium")


@pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium (apt-get install chromium): the page is not shown by a browser"
)
def test_a_browser_shows_it_without_an_error(folder, tmp_path):
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    done = subprocess.run(
        [
            *command,
            "--enable-logging=stderr",
            f"--user-data-dir={tmp_path}",
            "--dump-dom",
            f"file://{folder / 'r.html'}",
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "What operators ask of a scan" in done.stdout
    assert "CONSOLE" not in done.stderr
