"""A controller that misbehaves costs its own points, with the reason in the table; nothing hangs or is left behind.

Every build goes wrong from 12 s on, when all but the slowest shots are over.
"""

from __future__ import annotations

import pyarrow.parquet as pq
import pytest

from ..support.commands import command, group_members, start, wait_for
from ..support.controllers import build, needs_compiler

pytestmark = needs_compiler

SLOW_HZ = 49.0
"""Its windows last 5 s, those of the others 0.4 s at most."""

CAMPAIGN = """\
[campaign]
name = "faults"

[plant]
id = "cigre:{library}"
timeout_s = {timeout_s}

[plant.parameters]
settings = {{ FaultTime = {fault_time} }}
inputs = {{ v_abc = "v_pcc_abc", i_abc = "i_l_abc", v_dc = "v_dc", v_dc_ref = 1200.0 }}
outputs = {{ v_conv_abc = "v_conv_abc" }}

[[operating_point]]
id = "p065"
active_power_mw = 0.65
terminal_voltage_pu = 1.0

[sweep]
f_hz = {f_hz}
"""


FINE_HZ = (20.0, 150.0, 400.0)


def campaign(folder, *switches, fault_time=12.0, f_hz=(*FINE_HZ, SLOW_HZ), timeout_s=30):
    path = folder / "campaign.toml"
    words = {"library": build(*switches), "fault_time": fault_time, "f_hz": sorted(f_hz), "timeout_s": timeout_s}
    path.write_text(CAMPAIGN.format(**words), "utf-8")
    return path


def rows_of(output):
    table = pq.read_table(output, columns=["f_hz", "status", "reason"]).to_pylist()
    return {row["f_hz"]: (row["status"], row["reason"]) for row in table}


FAULTS = [
    ("FAULT_ABORT", "SIGABRT"),
    pytest.param("FAULT_ERROR", "DC overvoltage, converter blocked", marks=pytest.mark.evidence),
    pytest.param("FAULT_NAN", "output port 'v_conv_abc' is not a finite number", marks=pytest.mark.evidence),
    pytest.param("FAULT_SEGV", "SIGSEGV", marks=pytest.mark.evidence),
    pytest.param("FAULT_EXIT", "exit status 7", marks=pytest.mark.evidence),
    pytest.param("FAULT_ABORT HIDDEN_STATES", "SIGABRT", marks=pytest.mark.evidence),
    pytest.param("FAULT_EXIT HIDDEN_STATES", "exit status 7", marks=pytest.mark.evidence),
]


@pytest.mark.parametrize(("switches", "reason"), FAULTS)
def test_a_bad_controller_costs_its_own_points(tmp_path, switches, reason):
    output = tmp_path / "y.parquet"
    done = command("run", campaign(tmp_path, *switches.split()), "-o", output, "--jobs", 1)
    assert done.returncode == 1, done.stderr
    rows = rows_of(output)
    assert {f for f, (status, _) in rows.items() if status == "ok"} == set(FINE_HZ)
    assert rows[SLOW_HZ][0] == "failed"
    assert reason in rows[SLOW_HZ][1]


@pytest.mark.parametrize("switches", [(), pytest.param(("HIDDEN_STATES",), marks=pytest.mark.evidence)], ids=str)
def test_a_controller_that_sleeps_is_ended_by_the_time_limit(tmp_path, switches):
    output = tmp_path / "y.parquet"
    process = start(
        "run", campaign(tmp_path, "FAULT_SLEEP", *switches, f_hz=(SLOW_HZ,), timeout_s=2), "-o", output, "--jobs", 1
    )
    process.communicate(timeout=600)
    assert process.returncode == 1
    status, reason = rows_of(output)[SLOW_HZ]
    assert status == "failed"
    assert "took longer than" in reason
    wait_for(lambda: not group_members(process.pid), 60.0)


@pytest.mark.parametrize("switch", ["FAULT_PRINT", "FAULT_MESSAGE", "FAULT_LEAK"])
@pytest.mark.evidence
def test_a_controller_that_only_talks_or_leaks_is_measured(tmp_path, switch):
    """A leak of a kilobyte a sample from 12 s on: hundreds of megabytes, gone with the child."""
    output = tmp_path / "y.parquet"
    done = command("run", campaign(tmp_path, switch), "-o", output, "--jobs", 1)
    assert done.returncode == 0, done.stderr
    assert {status for status, _ in rows_of(output).values()} == {"ok"}


def test_a_controller_that_never_works_leaves_a_table_of_reasons(tmp_path):
    output = tmp_path / "y.parquet"
    done = command("run", campaign(tmp_path, "FAULT_ERROR", fault_time=0.0), "-o", output, "--jobs", 1)
    assert done.returncode == 1, done.stderr
    assert {status for status, _ in rows_of(output).values()} == {"failed"}
    assert all("refuses at 0 s: DC overvoltage" in reason for _, reason in rows_of(output).values())
