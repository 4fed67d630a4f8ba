"""TOML as people save it, read by whatever command takes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from seqsweep.plant.errors import SeqsweepError
from seqsweep.plant.foreign.toml_file import read_toml
from seqsweep.sweep.cli.farm import read_document as read_farm
from seqsweep.sweep.config.elements import read_elements
from seqsweep.sweep.verify.farm_story import read_farm_story
from seqsweep.sweep.verify.scenario import read_story
from seqsweep.tuning.grids.open import read_document

TEXT = '# Länge\r\nname = "x"\r\n'


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_mark_at_the_beginning_and_line_ends_of_windows_do_not_matter(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.toml").write_bytes(TEXT.encode(encoding))
    assert read_toml(tmp_path / "a.toml") == {"name": "x"}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (TEXT.encode("utf-16"), r"UTF-8 text \(UTF-16\): save it as UTF-8"),
        (b"a = 1\n" + TEXT.encode("latin-1"), r"line 2 has a byte 0xe4"),
        (b"a = \n", "not TOML: Invalid value"),
        (b"a = " + b"[" * 10000, "not TOML"),
    ],
)
def test_what_is_none_is_refused_with_its_name_and_the_way_out(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "a.toml").write_bytes(content)
    with pytest.raises(SeqsweepError, match=rf"a\.toml: .*{words}"):
        read_toml(tmp_path / "a.toml")


def test_no_file_and_a_folder_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(SeqsweepError, match="no such file"):
        read_toml(tmp_path / "a.toml")
    with pytest.raises(SeqsweepError, match="is a folder"):
        read_toml(tmp_path)


def test_every_reader_takes_a_file_that_an_editor_of_windows_saved(tmp_path: Path) -> None:
    place = tmp_path / "a.toml"
    place.write_bytes(b"\xef\xbb\xbfduration_s = 1.0\r\n")
    assert read_story(place).duration_s == 1.0
    assert read_farm_story(place).duration_s == 1.0
    assert read_farm(place) == read_document(place) == {"duration_s": 1.0}
    place.write_bytes(b'\xef\xbb\xbf[[element]]\r\nkind = "series"\r\nx_ohm = 0.25\r\n')
    assert read_elements(place)["element"][0]["x_ohm"] == 0.25
