"""What a notebook shows of every result of the face: short as text, a small table as HTML, and nothing of arrays."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

import seqsweep as ss

TOP = Path(__file__).parents[2]


class Parsed(HTMLParser):
    """Tags, text and cells per row."""

    def __init__(self, text):
        super().__init__()
        self.open, self.text, self.cells = [], "", []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "tr":
            self.cells.append(0)
        if tag in ("td", "th"):
            self.cells[-1] += 1

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def whole(result):
    """The HTML of a result is well-formed, every row has as many cells as the head, and it is small."""
    page = Parsed(result._repr_html_())
    assert len(set(page.cells)) == 1
    assert len(page.cells) <= 14
    return page


@pytest.fixture(scope="module")
def y():
    return ss.sweep("dpmsg-v1", active_power_mw=0.65, f_hz=ss.log_grid(4.0, 400.0, 24), jobs=2, progress=False)


@pytest.fixture(scope="module")
def tuned(y):
    return ss.tune(y, grid="0.012+0.25j", scale=[1.0, 1.4])


def test_a_tuning_result_has_its_verdicts(tuned):
    page = whole(tuned)
    assert "stable" in page.text
    assert "m >= 1.4" in page.text
    assert "op" in repr(tuned)


def test_a_long_tuning_result_shows_what_is_in_greatest_need(tuned):
    many = replace(tuned, points=tuned.points[:1] * 40 + tuned.points[1:])
    assert "... and 29 more entries" in repr(many)
    assert len(repr(many).splitlines()) < 40
    page = whole(many)
    assert "and 29 more" in page.text
    assert tuned.worst.verdict in page.text


def test_metrics_show_no_arrays(y):
    found = ss.metrics(y)
    assert "least |dP/dtheta|" in repr(found)
    assert len(repr(found)) < 1000
    assert "array" not in repr(found)
    assert "passive where" in whole(found).text


def test_a_bank_shows_its_worst_pairs(y, tmp_path):
    for k in range(15):
        text = f"[[element]]\nkind = 'series'\nr_ohm = 0.012\nx_ohm = {0.1 + 0.02 * k}\n"
        (tmp_path / f"g{k:02d}.toml").write_text(text)
    found = ss.judge(y, tmp_path, elements=0, jobs=1)
    assert isinstance(found, list)
    assert len(found) == 15
    assert "Stable on" in repr(found)
    assert len(repr(found).splitlines()) < 40
    assert "and 3 more" in whole(found).text


def test_a_table_shows_its_operating_points(y):
    page = whole(ss.Table({"f1_hz": 50.0}, (y,) * 20))
    assert "Table of 20 operating points" in page.text
    assert "and 8 more" in page.text


def test_names_are_escaped():
    from seqsweep.identify.views.html import html_table

    assert "<script>" not in html_table("<script>", ["<b>"], [["<i>", "a & b"]])
