"""Files damaged at random, and what their readers make of them: run as a script, for a crash must not be ours.

    python tests/support/mutations.py KIND FOLDER SEED COUNT

mutates the files of ``FOLDER`` (one of them at a time, the others stay whole), opens the result as ``KIND`` asks and
prints one line of JSON: how many were read, how many refused, and what went wrong: an exception that is no refusal, a
refusal of several lines or without the file's name or without a cause, a time beyond `SLOW_S`.
"""

from __future__ import annotations

import json
import random
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

SLOW_S = 60.0
"""Wall time that counts as a hang of the runner; a hanging reader is ended before."""

LISTENED = 25
"""Every so many recordings are listened to as `identify` does; the others are opened and read."""

NUMBERS = [b"nan", b"inf", b"-1", b"0", b"1e308", b"-1e-320", b"99999999999999999999", b"1,5", b"", b"0x7f", b"1D400"]
SIGNS = [b"\0", b"\xff\xfe", b"\xe9", b'"', b"'", b",", b";;", b"\t", b"\r", b"[", b"{", b"(", b"#", b"\\", b"=="]
INTEGERS = [0, 1, 0x7F, 0x80, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF, 0x100000000]


# Damage


def damaged(raw: bytes, rng: random.Random) -> bytes:
    """The bytes with one to four kinds of damage."""
    kinds = rng.choice([DAMAGES, IN_PLACE])  # what keeps the length gets past the first checks of a binary format
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        raw = rng.choice(kinds)(raw, rng) if raw else raw
    return raw


def _place(raw: bytes, rng: random.Random) -> int:
    """Anywhere, but half of the time near an end, where headers are."""
    near = rng.choice([len(raw), len(raw), 64, 600, 4000])
    at = rng.randrange(max(1, min(near, len(raw))))
    return at if rng.random() < 0.8 else len(raw) - 1 - at


def _flip(raw: bytes, rng: random.Random) -> bytes:
    at = _place(raw, rng)
    return raw[:at] + bytes([raw[at] ^ 1 << rng.randrange(8)]) + raw[at + 1 :]


def _overwrite(raw: bytes, rng: random.Random) -> bytes:
    at, n = _place(raw, rng), rng.choice([1, 2, 4, 16, 200])
    return raw[:at] + rng.randbytes(n) + raw[at + n :]


def _integer(raw: bytes, rng: random.Random) -> bytes:
    at, n = _place(raw, rng), rng.choice([1, 2, 4, 8])
    value = rng.choice(INTEGERS) & (1 << 8 * n) - 1
    return raw[:at] + value.to_bytes(n, rng.choice(["little", "big"])) + raw[at + n :]


def _delete(raw: bytes, rng: random.Random) -> bytes:
    at, n = _place(raw, rng), rng.choice([1, 3, 50, 2000])
    return raw[:at] + raw[at + n :]


def _insert(raw: bytes, rng: random.Random) -> bytes:
    at = _place(raw, rng)
    return raw[:at] + rng.choice([*SIGNS, *NUMBERS, rng.randbytes(rng.choice([1, 40]))]) + raw[at:]


def _truncate(raw: bytes, rng: random.Random) -> bytes:
    return raw[: _place(raw, rng)]


def _repeat(raw: bytes, rng: random.Random) -> bytes:
    at, to, n = _place(raw, rng), _place(raw, rng), rng.choice([8, 100, 5000])
    return raw[:to] + raw[at : at + n] + raw[to:]


def _number(raw: bytes, rng: random.Random) -> bytes:
    """One number of a text replaced; of binary data as good as any damage."""
    start = _place(raw, rng)
    found = re.compile(rb"[-+]?\d+(?:\.\d+)?").search(raw, start) or re.compile(rb"\d+").search(raw)
    if found is None:
        return _overwrite(raw, rng)
    return raw[: found.start()] + rng.choice(NUMBERS) + raw[found.end() :]


def _line(raw: bytes, rng: random.Random) -> bytes:
    """A line left out, doubled, or put elsewhere."""
    lines = raw.split(b"\n")
    k = min(rng.randrange(len(lines)), rng.choice([len(lines), 20, 5]))
    k = min(k, len(lines) - 1)
    line = lines.pop(k)
    for _ in range(rng.choice([0, 1, 2])):
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


IN_PLACE = [_flip, _overwrite, _integer]
DAMAGES: list[Callable[[bytes, random.Random], bytes]] = [
    *(_flip, _overwrite, _integer, _delete, _insert, _truncate, _repeat, _number, _line),
]


# Readers


def _recording(path: Path, number: int) -> None:
    from seqsweep.plant.recordings.recording import RecordingError
    from seqsweep.plant.recordings.waveforms import open_waveforms
    from seqsweep.sweep.recorded.listen import Task, listen

    if number % LISTENED == 1:
        heard = listen(Task(path, "load"))
        if heard.refusal is not None:
            raise RecordingError(f"{path}: {heard.refusal}")
        return
    waveforms = open_waveforms(path, "load")
    waveforms.record(0, min(waveforms.n_samples, 1 << 20))


def _table(path: Path, number: int) -> None:
    from seqsweep.identify.table.read import read_table

    read_table(path)


def _manifest(path: Path, number: int) -> None:
    from seqsweep.sweep.recorded.match import read_manifest

    read_manifest(path)


def _tuning(path: Path, number: int) -> None:
    from seqsweep.sweep.verify.tuned import read_tuning

    read_tuning(path)


def _campaign(path: Path, number: int) -> None:
    from seqsweep.sweep.config.sections import load_config

    load_config(path)


def _scenario(path: Path, number: int) -> None:
    from seqsweep.sweep.verify.scenario import read_story

    read_story(path)


def _import(path: Path, number: int) -> None:
    from seqsweep.identify.exchange.convert import to_table
    from seqsweep.sweep.cli.exchange import format_of, read_apart

    given = {
        **{"frame": "pn", "direction": "load", "f1_hz": 50.0, "quantity": "admittance", "unit": "S"},
        **{"frequency_unit": "Hz", "rated_voltage_v": 690.0, "rated_power_va": 1.6e6},
    }
    kind = format_of(path, None, reading=True)
    if kind == "touchstone":
        given = {key: given[key] for key in ("frame", "direction", "f1_hz", "rated_voltage_v", "rated_power_va")}
    to_table(read_apart(path, kind, given), path)


def _fmu(path: Path, number: int) -> None:
    from seqsweep.plant.fmu.variables import contents_of

    contents_of(path, True)


READERS: dict[str, Callable[[Path, int], None]] = {
    **{"recording": _recording, "table": _table, "manifest": _manifest, "tuning": _tuning, "campaign": _campaign},
    **{"scenario": _scenario, "import": _import, "fmu": _fmu},
}


# Judging


def outcome(kind: str, folder: Path, seed: int, count: int) -> dict[str, Any]:
    """What became of ``count`` damaged copies of the files in a folder; the first by name is the one that is opened."""
    originals = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    opened = next(iter(originals))
    READERS[kind](folder / opened, 0)  # whole files are read: their damage is what is judged
    found: dict[str, Any] = {"read": 0, "refused": 0, "problems": [], "slowest_s": 0.0}
    with tempfile.TemporaryDirectory() as name:
        for number in range(count):
            place = Path(name) / "files"
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir()
            rng = random.Random(seed * 1_000_003 + number)
            victim = rng.choice(list(originals))
            for each, raw in originals.items():
                (place / each).write_bytes(damaged(raw, rng) if each == victim else raw)
            _judge(READERS[kind], place / opened, number, found)
    usage = (resource.getrusage(who).ru_maxrss / 1024 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return {**found, "memory_mb": max(usage)}


def _judge(read: Callable[[Path, int], None], path: Path, number: int, found: dict[str, Any]) -> None:
    from seqsweep.plant.errors import SeqsweepError

    began = time.perf_counter()
    try:
        read(path, number)
        found["read"] += 1
    except SeqsweepError as error:
        found["refused"] += 1
        if problem := _wrong_refusal(str(error), path):
            found["problems"].append(f"{number}: {problem}: {str(error)[:300]!r}")
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        words = f"{type(error).__name__}: {str(error)[:200]} ({Path(last.filename).name}:{last.lineno})"
        found["problems"].append(f"{number}: {words}")
    took = time.perf_counter() - began
    found["slowest_s"] = max(found["slowest_s"], took)
    if took > SLOW_S:
        found["problems"].append(f"{number}: took {took:.0f} s")


def _wrong_refusal(text: str, path: Path) -> str:
    """What is wrong with a refusal: it names the file and the cause, each problem on a line of its own."""
    lines = text.splitlines()
    if path.stem not in text:
        return "the file is not named"
    if len(lines) > 1 and path.suffix != ".toml":
        return "several lines"
    cause = text.replace(str(path), "").replace(path.name, "").strip(": ")
    return "" if len(cause) >= 8 else "no cause"


if __name__ == "__main__":  # seed, count, then a kind and a folder, again and again; a line of JSON for each
    warnings.simplefilter("ignore")
    seed, count, *subjects = sys.argv[1:]
    for kind, place in zip(subjects[::2], subjects[1::2], strict=True):
        print(json.dumps(outcome(kind, Path(place), int(seed), int(count))), flush=True)
