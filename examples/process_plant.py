"""An R-L branch as a program: the whole protocol of ``process:COMMAND``, with snapshots.

From the top folder of the project: seqsweep check "process:python3 examples/process_plant.py"
"""

import json
import struct
import sys
from cmath import exp

R_OHM, L_H, DT_S, i = 0.1, 1e-3, 50e-6, 0j
DECAY = exp(-R_OHM * DT_S / L_H).real
CARD = {"version": 1, "f1_hz": 50, "dt_s": DT_S, "voltage_v": 690, "power_va": 1e6, "snapshot": True, "name": "R-L"}

while head := sys.stdin.buffer.read(8):
    tag, n_bytes = struct.unpack("<4sI", head)
    content, answer = sys.stdin.buffer.read(n_bytes), b""
    if tag == b"HELO":
        answer = json.dumps(CARD).encode()
    elif tag == b"ZERO":
        i = 0j
    elif tag == b"STEP":
        for alpha, beta in struct.iter_unpack("<2d", content):
            i = DECAY * i + (1 - DECAY) / R_OHM * complex(alpha, beta)
            answer += struct.pack("<2d", i.real, i.imag)
    elif tag == b"SAVE":
        answer = struct.pack("<2d", i.real, i.imag)
    elif tag == b"LOAD":
        i = complex(*struct.unpack("<2d", content))
    sys.stdout.buffer.write(struct.pack("<4sI", tag, len(answer)) + answer)
    sys.stdout.buffer.flush()
