"""The report that is handed over: one file, complete without a script, that fetches nothing."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from seqsweep.sweep.report.handover.checklist import ProfileError, checked, read_profiles, shipped
from seqsweep.sweep.report.handover.inputs import read_inputs
from seqsweep.sweep.report.handover.quantities import QUANTITIES
from seqsweep.sweep.report.handover.words import sentence_of, sentences

from ..support.commands import campaign, command, without_pictures


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    file = campaign(folder, plant="branch-v1", powers=(0.0,), n=24)
    assert command("run", file, "-o", folder / "y.parquet", "--jobs", 1).returncode == 0
    tuned = ("tune", folder / "y.parquet", "--grid", "0.02+0.3j", "--scale", "1.0,2.0", "-o", folder / "t.json")
    assert command(*tuned).returncode == 0
    done = command("report", folder / "y.parquet", folder / "t.json", "-o", folder / "r.html")
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
    assert "Of 2 cases all 2 stable" in before
    for title in ("Verdict", "Admittance", "What was swept", "What operators ask of a scan", "Provenance"):
        assert title in page.text


class _Nothing:
    results: dict = {}  # noqa: RUF012 (a stand-in)


CASE = {"op_id": "p", "scale": 1.4, "verdict": "unstable", "margin_m": 0.95, "margin_met": False}


def test_a_gain_that_was_confirmed_is_told_with_what_it_makes_of_the_device():
    assert len(sentences(_Nothing, [CASE])) == 1
    confirmed = {**CASE, "k": 1.214, "with_k": {"verdict": "stable"}, "margin_m_with_k": 1.403}
    assert sentences(_Nothing, [confirmed])[1] == (
        "With damping gain k = 1.21 in place the device was swept again: stable, with a margin of 1.4."
    )


def test_the_answer_needs_no_vocabulary():
    growing = {
        **CASE,
        "resonance_hz": [22.58, 77.42],
        "poles": [{"kind": "resonance", "re_rad_s": np.log(2.0) / 0.147}],
    }
    assert "an oscillation at 22.6 and 77.4 Hz doubles every 0.15 s" in sentence_of(growing)
    dying = {**growing, "verdict": "stable", "poles": [{"kind": "resonance", "re_rad_s": -np.log(2.0) / 2.0}]}
    assert "dies out, halving every 2 s" in sentence_of(dying)
    left_open = {**CASE, "verdict": "undecided", "reason": "4 of 4 rows are usable"}
    assert "the data do not carry a verdict: 4 of 4 rows are usable." in sentence_of(left_open)
    several = sentences(_Nothing, [CASE, {**CASE, "verdict": "stable"}, {**CASE, "verdict": "stable"}])
    assert several[0] == "Of 3 cases 1 unstable and 2 stable."


def test_nothing_is_fetched_and_the_page_forbids_it(folder, page):
    text = (folder / "r.html").read_text("utf-8")
    assert not [tag for tag, _ in page.tags if tag in ("link", "iframe", "img", "object")]
    assert not [a for tag, a in page.tags if tag == "script" and "src" in a]
    targets = [v for _, attributes in page.tags for k, v in attributes.items() if k in ("src", "href", "xlink:href")]
    assert all(target.startswith(("#", "data:image/png")) for target in targets if target)
    assert not re.search(r"url\((?!#)", text)
    policy = next(a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert "default-src 'none'" in policy
    script = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(script) == 1
    assert base64.b64encode(hashlib.sha256(script[0].encode()).digest()).decode() in policy


def test_values_to_point_at_are_those_of_the_table(folder):
    from seqsweep.identify.table.read import read_table

    text = (folder / "r.html").read_text("utf-8")
    figure = text[text.index('<figure id="bode">') :]
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', figure).group(1))
    response = read_table(folder / "y.parquet").responses[0]
    group = data["groups"][0]
    assert group["x"] == pytest.approx(response.f_hz, rel=1e-4)
    assert group["columns"][0] == pytest.approx(abs(response.y[:, 0, 0]), rel=1e-4)
    assert data["heads"][0] == "|Ypp| (S)"
    assert all(0.0 < p["left"] < p["right"] < 1.0 and 0.0 < p["top"] < p["bottom"] < 1.0 for p in data["panels"])


def test_pictures_have_words_and_identifiers_are_unique(page):
    pictures = [attributes for _, attributes in page.tags if attributes.get("role") == "img"]
    assert len(pictures) == len([1 for tag, _ in page.tags if tag == "figure"]) == 4  # loop, locus, poles, admittance
    assert all(picture.get("aria-label") for picture in pictures)
    names = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(names) == len(set(names))


def test_tables_have_headers_with_a_scope(page):
    heads = [attributes for tag, attributes in page.tags if tag == "th"]
    assert heads
    assert all(head.get("scope") in ("col", "row") for head in heads)


def test_what_is_not_covered_is_said(page):
    assert "Not covered by this report." in page.text
    assert "zero sequence" in page.text.lower()


def test_the_same_files_give_the_same_bytes(folder):
    again = ("report", folder / "y.parquet", folder / "t.json", "-o", folder / "again.html")
    assert command(*again).returncode == 0
    assert (folder / "again.html").read_bytes() == (folder / "r.html").read_bytes()
    assert "Made on" not in (folder / "again.html").read_text("utf-8")


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
    done = command("report", *(folder / name for name in names), "-o", folder / "refused.html")
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert not (folder / "refused.html").exists()


def test_a_result_about_another_table_is_told_and_so_is_the_date_that_is_asked_for(folder, tmp_path):
    file = campaign(tmp_path, plant="branch-v1", powers=(0.0,), n=12)
    assert command("run", file, "-o", tmp_path / "other.parquet", "--jobs", 1).returncode == 0
    with without_pictures():
        done = command("report", tmp_path / "other.parquet", folder / "t.json", "-o", tmp_path / "r.html", "--stamp")
    assert done.returncode == 0
    text = (tmp_path / "r.html").read_text("utf-8")
    assert "was made from another table" in text
    assert "Made on" in text


def test_commands_that_make_the_files_again_make_them_again(folder, tmp_path):
    """The line for the tuning result, run as it stands beside the table, gives the same bytes."""
    import shlex
    import shutil

    text = (folder / "r.html").read_text("utf-8")
    lines = re.search(r"this order;.*?<pre>(.*?)</pre>", text, re.DOTALL).group(1).replace("\\\n", " ")
    tuned = next(line for line in lines.splitlines() if line.startswith("seqsweep tune"))
    shutil.copy(folder / "y.parquet", tmp_path)
    words = [str(tmp_path / w) if w.endswith((".parquet", ".json")) else w for w in shlex.split(tuned)[1:]]
    assert command(*words).returncode == 0
    assert (tmp_path / "t.json").read_bytes() == (folder / "t.json").read_bytes()


# Profiles ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_profile_can_be_answered_and_repeats_no_id(folder, name):
    inputs = read_inputs([folder / "y.parquet", folder / "t.json"])
    found = checked(inputs, read_profiles([name])[0])
    assert len({item.id for item in found.items}) == len(found.items)
    assert any(item.covered for item in found.items)
    assert all("Not covered" in item.answer for item in found.items if not item.covered)
    assert all(not item.met for item in found.items if item.threshold in ("", "not read"))


def test_a_threshold_is_met_or_not_by_the_number_in_the_report(folder, tmp_path):
    highest = read_inputs([folder / "y.parquet"]).table.responses[0].f_hz[-1]
    mine = tmp_path / "mine.toml"
    demand = '[[demand]]\nid = "{0}"\ntext = "t"\nsource = "s"\nquantity = "highest_frequency_hz"\nthreshold = {1}\n'
    mine.write_text('title = "Mine"\n' + demand.format("low", highest * 0.99) + demand.format("high", highest * 1.01))
    inputs = read_inputs([folder / "y.parquet", folder / "t.json"])
    found = checked(inputs, read_profiles([str(mine)])[0])
    assert [item.met for item in found.items] == ["yes", "no"]
    assert "1 of 2 thresholds met" in found.summary
    assert found.items[0].found == f"{highest:.4g} Hz"


def test_quantities_are_those_of_the_table(folder):
    inputs = read_inputs([folder / "y.parquet"])
    response = inputs.table.responses[0]
    value = {name: quantity.value(inputs) for name, quantity in QUANTITIES.items()}
    assert value["lowest_frequency_hz"] == response.f_hz[0]
    assert value["highest_harmonic"] == response.f_hz[-1] / 50.0
    assert value["rows_ok_percent"] == 100.0
    assert value["margin_m"] is None
    assert value["grids"] is None


WRONG_PROFILES = {
    "no demand": ("title = 'x'", "at least one"),
    "no source": ("[[demand]]\nid = 'a'\ntext = 't'", "needed is text for source"),
    "unknown key": ("[[demand]]\nid = 'a'\ntext = 't'\nsource = 's'\nanswr = 'band'", "did you mean 'answer'"),
    "unknown quantity": ("[[demand]]\nid = 'a'\ntext = 't'\nsource = 's'\nquantity = 'margin'", "margin_m"),
    "words": ("[[demand]]\nid='a'\ntext='t'\nsource='s'\nquantity='margin_m'\nthreshold='x'", "is no number"),
    "bare threshold": ("[[demand]]\nid = 'a'\ntext = 't'\nsource = 's'\nthreshold = 1", "needs the quantity"),
    "no TOML": ("[[demand", "not TOML"),
}


@pytest.mark.parametrize(("content", "words"), WRONG_PROFILES.values(), ids=WRONG_PROFILES)
def test_a_profile_that_cannot_be_answered_is_refused(tmp_path, content, words):
    (tmp_path / "p.toml").write_text(content)
    with pytest.raises(ProfileError, match=words):
        read_profiles([str(tmp_path / "p.toml")])


def test_an_unknown_profile_names_those_that_are_there():
    with pytest.raises(ProfileError, match=r"australia.*did you mean 'texas'"):
        read_profiles(["texs"])
