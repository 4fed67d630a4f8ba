"""Frames to and from a program that simulates, or is, a device: the other end of ``process:COMMAND``.

A frame is four letters, the length of what follows as an unsigned 32-bit number, little-endian, and that many
bytes. Every question is answered by a frame of the same four letters, or by ``FAIL`` and a text.

    HELO  {"version": 1, "parameters": {...}}    answered by the device's card, JSON
    ZERO  2 float64: active power (W), |v_pcc| (V, line-to-line RMS)    begin anew at time zero, cold
    STEP  n complex128 (float64 alpha, beta): v of n <= 4096 steps, each held for its step (V, phase peak)
          answered by n complex128: i at the ends of the steps (A, into the device)
    SAVE  nothing; answered by a snapshot, any bytes (only if the card says "snapshot": true)
    LOAD  a snapshot

ZERO and LOAD are answered by an empty frame. The end of the stream is the end of the program.
"""

from __future__ import annotations

import json
import os
import selectors
import shlex
import struct
import subprocess
import tempfile
import time
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import SeqsweepError
from ..protocol import OperatingPoint
from ..states.processes import die_with_parent, how_it_ended, last_words
from ..states.store import BoxLost

VERSION = 1
MOST_STEPS = 4096
"""Steps in one frame: a program in C may set aside 64 KiB and be done."""

MOST_BYTES = 1 << 26
"""Length of a snapshot or a card above which a frame is not believed."""

_HEAD = struct.Struct("<4sI")


class PeerError(BoxLost):
    """The program at the other end broke the protocol, or ended; the message says how."""


class Peer:
    """A running program and its frames.

    Parameters
    ----------
    command : str
        As in a shell, but without one: words and quotes, no redirections.
    answer_s : float
        Wall time (s) that an answer may take.

    Raises
    ------
    SeqsweepError
        If the command cannot be started.
    """

    def __init__(self, command: str, answer_s: float):
        self._command, self._answer_s = command, answer_s
        self._said = tempfile.NamedTemporaryFile(prefix="said-")  # noqa: SIM115 - lives as long as the program
        parent = os.getpid()
        try:
            words = shlex.split(command)
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                bufsize=0,
                preexec_fn=lambda: die_with_parent(parent),
            )
        except (OSError, ValueError, IndexError, subprocess.SubprocessError) as error:
            raise SeqsweepError(f"the command {command!r} cannot be started: {error}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        os.set_blocking(self._stdin.fileno(), False)
        os.set_blocking(self._stdout.fileno(), False)
        self._heard = bytearray()

    def ask(self, tag: str, content: bytes = b"", length: int | None = None) -> bytes:
        """The answer to a frame; ``length`` is that of the answer where it is known.

        Raises
        ------
        PeerError
            If the answer is late, no frame, of another length or a ``FAIL``, or if the program ends.
        """
        self._to_send = memoryview(_HEAD.pack(tag.encode(), len(content)) + content)
        until = time.monotonic() + self._answer_s
        head = self._read(_HEAD.size, tag, until)
        answered, n_bytes = _HEAD.unpack(head)
        if answered == b"FAIL":
            raise PeerError(f"the program says: {self._read(min(n_bytes, 500), tag, until).decode(errors='replace')}")
        if answered != tag.encode():
            raise PeerError(
                f"{tag} was answered by {bytes(head)!r}, which is no frame {tag}: standard output is for frames alone, "
                "print to standard error"
            )
        if n_bytes > MOST_BYTES or (length is not None and n_bytes != length):
            wanted = f"{length} bytes are" if length is not None else f"at most {MOST_BYTES} bytes are"
            raise PeerError(f"the answer to {tag} announces {n_bytes} bytes; {wanted} needed")
        return self._read(n_bytes, tag, until)

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.wait()
        self._stdin.close()
        self._stdout.close()
        self._said.close()

    def __del__(self) -> None:
        if hasattr(self, "_stdout") and not self._stdout.closed:
            self.close()

    def _read(self, n_bytes: int, tag: str, until: float) -> bytes:
        """The next bytes from the program; meanwhile it is sent what is left to send."""
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdout, selectors.EVENT_READ)
            if self._to_send:
                selector.register(self._stdin, selectors.EVENT_WRITE)
            while len(self._heard) < n_bytes:
                ready = selector.select(max(0.0, until - time.monotonic()))
                if not ready:
                    raise PeerError(self._late(tag))
                for key, _ in ready:
                    if key.fileobj is self._stdout:
                        self._hear(tag)
                    elif not self._send():
                        selector.unregister(self._stdin)
        taken = bytes(self._heard[:n_bytes])
        del self._heard[:n_bytes]
        return taken

    def _hear(self, tag: str) -> None:
        more = os.read(self._stdout.fileno(), 1 << 16)
        if not more:
            raise PeerError(f"the program ended before it answered {tag}: {self._ending()}")
        self._heard += more

    def _late(self, tag: str) -> str:
        """Why there is no answer: a program that ended may have left others behind, which hold its output open."""
        if self._process.poll() is not None:
            return f"the program ended before it answered {tag}: {self._ending()}"
        return f"no answer to {tag} within {self._answer_s:g} s (plant.parameters.answer_s)"

    def _send(self) -> bool:
        """Send some of what is left; False when there is no more to send."""
        try:
            sent = os.write(self._stdin.fileno(), self._to_send[: 1 << 16])
        except BrokenPipeError:  # it will be missed when its answer is read
            sent = len(self._to_send)
        self._to_send = self._to_send[sent:]
        return bool(self._to_send)

    def _ending(self) -> str:
        said = Path(self._said.name)
        try:
            return how_it_ended(self._process.wait(1.0), said)
        except subprocess.TimeoutExpired:
            return f"it closed its output, last words {last_words(said)!r}"


class PeerBox:
    """The device behind a program's frames: a `driven.Box`, and a `branches.SnapshotBox` if its card says so."""

    def __init__(self, command: str, answer_s: float, parameters: Mapping[str, Any]):
        self.peer = Peer(command, answer_s)
        hello = {"version": VERSION, "parameters": dict(parameters)}
        self.card = _card(self.peer.ask("HELO", json.dumps(hello).encode()))

    def start(self, operating_point: OperatingPoint) -> None:
        """Begin at time zero, cold."""
        voltage_v = operating_point.terminal_voltage_v or float("nan")
        self.peer.ask("ZERO", struct.pack("<2d", operating_point.active_power_w, voltage_v), 0)

    def advance(self, v: np.ndarray) -> np.ndarray:
        """Currents (n,) at the ends of n steps under voltages (n,)."""
        parts = [self._step(v[k : k + MOST_STEPS]) for k in range(0, len(v), MOST_STEPS)]
        return np.concatenate(parts)

    def save(self) -> bytes:
        """A snapshot, as the program made it."""
        return self.peer.ask("SAVE")

    def load(self, snapshot: bytes) -> None:
        """Be as it was when ``snapshot`` was taken."""
        self.peer.ask("LOAD", snapshot, 0)

    def drop(self, snapshot: bytes) -> None:
        """Nothing: a snapshot is kept here, not there."""

    def _step(self, v: np.ndarray) -> np.ndarray:
        return np.frombuffer(self.peer.ask("STEP", v.astype("<c16").tobytes(), 16 * len(v)), "<c16")


def _card(content: bytes) -> dict[str, Any]:
    """What the program says of itself, checked.

    Raises
    ------
    PeerError
        With the key, what was given and what is needed.
    """
    try:
        given = json.loads(content)
    except ValueError:
        raise PeerError(f"the card is not JSON: {content[:80]!r}") from None
    if not isinstance(given, dict):
        raise PeerError(f"the card is a {type(given).__name__}, not an object")
    if given.get("version") != VERSION:
        raise PeerError(f"the card's version is {given.get('version')!r}; this protocol is version {VERSION}")
    known = {**_NEEDED, **_OPTIONAL}
    for key in given:
        if key != "version" and key not in known:
            raise PeerError(f"the card has an unknown key {key!r}; known are version, {', '.join(known)}")
    card = {**_DEFAULTS, **given}
    for key, (is_right, wanted) in known.items():
        if not (key in card and is_right(card[key])):
            shown = f"given {card[key]!r}" if key in card else "missing"
            raise PeerError(f"the card's {key}: {shown}; needed: {wanted}")
    return card


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def _positive(value: Any) -> bool:
    return _number(value) and value > 0


def _interval(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_number, value)) and value[0] <= value[1]


def _text(value: Any) -> bool:
    return isinstance(value, str) and bool(value)


_NEEDED = {
    "f1_hz": (_positive, "a number above 0, in Hz"),
    "dt_s": (_positive, "a number above 0, in s"),
    "voltage_v": (_positive, "the rated line-to-line RMS voltage, in V"),
    "power_va": (_positive, "the rated apparent power, in VA"),
}
_OPTIONAL = {
    "active_power_w": (_interval, "two numbers, [lowest, highest], in W"),
    "terminal_voltage_pu": (_interval, "two numbers, [lowest, highest], in pu"),
    "power_meaning": (_text, "a sentence"),
    "name": (_text, "a text: what it is, and which version"),
    "snapshot": (lambda value: isinstance(value, bool), "true or false"),
}
_DEFAULTS = {
    "active_power_w": [-1e15, 1e15],
    "terminal_voltage_pu": [0.5, 1.5],
    "power_meaning": "as the program takes it",
    "name": "a program without a name",
    "snapshot": False,
}
