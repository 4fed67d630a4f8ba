"""The branch of `step_plants` as a program that misbehaves as its parameters say, once it was stepped often enough.

Called by tests as ``process:python boxes/peer.py``. Parameters: ``faults``, of which the active power in MW picks one
(from 1; at 0 all is well); ``after``, in steps since the cold start; ``hello``, a fault before all that; ``card``.
"""

import json
import math
import os
import struct
import sys
import time

R_OHM, L_H, DT_S = 0.1, 1e-3, 50e-6
DECAY = math.exp(-R_OHM * DT_S / L_H)
CARD = {"version": 1, "f1_hz": 50, "dt_s": DT_S, "voltage_v": 690, "power_va": 1e6}


sys.path.insert(0, os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
from manners import MANNERS  # noqa: E402


def send(tag, answer=b""):
    sys.stdout.buffer.write(struct.pack("<4sI", tag, len(answer)) + answer)
    sys.stdout.buffer.flush()


def misbehave(fault, answer):
    if fault == "garbage":
        sys.stdout.buffer.write(os.urandom(64))
        sys.stdout.buffer.flush()
    elif fault == "prints":
        print("entering step 4711", flush=True)
    elif fault == "silence":
        time.sleep(600)
    elif fault == "exit":
        print("licence expired", file=sys.stderr, flush=True)
        os._exit(3)
    elif fault == "segfault":
        os.kill(os.getpid(), 11)
    elif fault == "huge":
        sys.stdout.buffer.write(struct.pack("<4sI", b"STEP", 0xFFFFFFFF))
        sys.stdout.buffer.flush()
    elif fault == "short":
        send(b"STEP", answer[:-16])
    elif fault == "fail":
        send(b"FAIL", b"theta left the circle")
    elif fault in MANNERS:
        MANNERS.pop(fault)()
    elif fault == "nan":
        return struct.pack("<2d", math.nan, math.nan) * (len(answer) // 16)
    return answer


def main():
    i, steps, parameters, fault = 0j, 0, {}, ""
    while head := sys.stdin.buffer.read(8):
        tag, n_bytes = struct.unpack("<4sI", head)
        content, answer = sys.stdin.buffer.read(n_bytes), b""
        if tag == b"HELO":
            parameters = json.loads(content)["parameters"]
            answer = json.dumps({**CARD, **parameters.get("card", {})}).encode()
            answer = misbehave(parameters.get("hello", ""), answer)
        elif tag == b"ZERO":
            i, steps = 0j, 0
            power_w, _ = struct.unpack("<2d", content)
            fault = dict(enumerate(parameters.get("faults", []), 1)).get(power_w / 1e6, "")
        elif tag == b"STEP":
            for alpha, beta in struct.iter_unpack("<2d", content):
                i = DECAY * i + (1 - DECAY) / R_OHM * complex(alpha, beta)
                steps += 1
                answer += struct.pack("<2d", i.real, i.imag)
            if steps > parameters.get("after", 0):
                answer = misbehave(fault, answer)
        elif tag == b"SAVE":
            answer = struct.pack("<2dI", i.real, i.imag, steps)
        elif tag == b"LOAD":
            *parts, steps = struct.unpack("<2dI", content)
            i = complex(*parts)
        send(tag, answer)


main()
