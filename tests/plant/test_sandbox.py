"""A process for foreign files: whatever happens there costs the question, never the one who asked."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from seqsweep.plant.errors import SeqsweepError
from seqsweep.plant.foreign import sandbox
from seqsweep.plant.foreign.sandbox import ForeignFileError, apart
from seqsweep.plant.recordings.recording import RecordingError
from seqsweep.plant.recordings.waveforms import open_waveforms

from ..support import recording_files as files
from ..support.commands import is_alive, wait_for
from .test_recordings import COLUMNS, SAMPLES, N, T

SUPPORT = Path(__file__).parents[1] / "support"
FILE = Path("/somewhere/a.h5")


@pytest.fixture(autouse=True)
def _found_by_name(monkeypatch):
    """Processes that begin in these tests find `misbehaving`; none comes back from a recording of another test.

    A recording that the collector of garbage takes away gives its process back, at any moment.
    """
    gc.collect()
    gc.disable()
    sandbox._end_all()
    known = os.environ.get("PYTHONPATH")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(SUPPORT), known])))
    yield
    sandbox._end_all()
    gc.enable()


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("crash", r"the reader crashed on it \(SIGSEGV\): the file is damaged"),
        ("leave", r"the reader crashed on it \(exit status 3\)"),
        ("gorge", "does not fit into the memory that a file may use"),
        ("recurse", r"damaged, or not what its suffix says \(RecursionError in misbehaving"),
        ("exit_politely", r"\(SystemExit in misbehaving"),
    ],
)
def test_what_goes_wrong_costs_the_question_alone_and_names_the_file(function, words):
    with pytest.raises(ForeignFileError, match=words) as refusal:
        apart(FILE, f"misbehaving:{function}")
    assert str(refusal.value).startswith(f"{FILE}: ")
    assert len(str(refusal.value).splitlines()) == 1
    assert apart(FILE, "misbehaving:well", 1) == 2


def test_a_hang_ends(monkeypatch):
    monkeypatch.setattr(sandbox, "TIME_S", 0.5)
    with pytest.raises(ForeignFileError, match="not read within"):
        apart(FILE, "misbehaving:hang")  # it sleeps for an hour


def test_a_refusal_comes_back_as_it_is_and_the_process_serves_on():
    first = apart(FILE, "misbehaving:who")
    with pytest.raises(SeqsweepError, match="no good"):
        apart(FILE, "misbehaving:refuse")
    assert apart(FILE, "misbehaving:who") == first
    with pytest.raises(ForeignFileError):
        apart(FILE, "misbehaving:recurse")
    assert apart(FILE, "misbehaving:who") != first  # who knows what it left behind


def test_libraries_that_leak_are_begun_anew(monkeypatch):
    monkeypatch.setattr(sandbox, "MOST_FILES", 2)
    assert len({apart(FILE, "misbehaving:who") for _ in range(4)}) == 2


def test_the_process_ends_with_its_host(tmp_path):
    code = (
        "from seqsweep.plant.foreign.sandbox import apart; from pathlib import Path; import os, signal\n"
        "print(apart(Path('a'), 'misbehaving:who'), flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    orphan = int(done.stdout)
    wait_for(lambda: not is_alive(orphan))


def test_several_recordings_are_open_at_once_each_in_its_process(tmp_path):
    paths = [files.text(tmp_path / f"{k}.csv", SAMPLES * (k + 1.0)) for k in range(3)]
    opened = [open_waveforms(path, "load") for path in paths]
    records = [one.record(0, N) for one in reversed(opened)]
    assert [round(float(np.max(np.abs(each.v)) / np.max(np.abs(records[-1].v)))) for each in records] == [3, 2, 1]


def test_more_channels_than_the_shared_memory_holds_come_in_pieces(tmp_path, monkeypatch):
    import pyarrow as pa
    import pyarrow.parquet as pq

    from seqsweep.plant.recordings.apart import read_recording_apart

    many = np.tile(SAMPLES, (1, 200)) * np.arange(1, 1201)
    pq.write_table(pa.table({"time": T, **{f"c{k}": x for k, x in enumerate(many.T)}}), tmp_path / "a.parquet")
    recording = read_recording_apart(tmp_path / "a.parquet")
    assert np.array_equal(recording.samples(range(1200), 0, N), many)


def test_a_crash_costs_its_own_file_and_no_other_of_the_call(tmp_path, monkeypatch):
    """The reader of one file dies while another is open."""
    good = open_waveforms(files.text(tmp_path / "a.csv", SAMPLES), "load")
    with pytest.raises(ForeignFileError):
        apart(FILE, "misbehaving:crash")
    assert len(good.record(0, N).v) == N


def holed(path):
    """An HDF5 recording whose last piece of a channel does not decompress."""
    with h5py.File(path, "w") as file:
        for name, x in {"time": T, **COLUMNS}.items():
            file.create_dataset(name, data=x, chunks=(500,), compression="gzip")
        at = file["Ic"].id.get_chunk_info(N // 500 - 1).byte_offset
    with open(path, "r+b") as file:
        file.seek(at)
        file.write(b"\xff" * 64)
    return path


def test_a_damaged_piece_is_told_with_the_file_and_leaves_no_process_behind(tmp_path):
    """Without waiting for the collector of garbage: the next file finds the process that the last one left."""
    first = apart(FILE, "misbehaving:who")
    for k in range(4):
        try:
            open_waveforms(holed(tmp_path / f"{k}.h5"), "load").record(0, N)
        except RecordingError as error:
            said = str(error)
        assert f"{k}.h5: Ic: damaged, cannot be read" in said
    assert apart(FILE, "misbehaving:who") == first
    assert len(sandbox._idle) == 1
