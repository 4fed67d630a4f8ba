"""The tutorial's own converter is run, and its edge of stability is the one that the page shows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import seqsweep as ss

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial-converter.md").read_text("utf-8")
CONVERTER, *_ = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
ROW = re.compile(r"^p100 +(\d) +(\w+) +([\d.]+) .* x([\d.]+) ", re.MULTILINE)
ROWS = {float(scale): (verdict, float(m), float(edge)) for scale, verdict, m, edge in ROW.findall(PAGE)}
pytestmark = pytest.mark.filterwarnings("ignore:the voltage of a step")


@pytest.fixture(scope="module")
def device():
    names: dict = {}
    exec(compile(CONVERTER, "converter.py", "exec"), names)
    return names["device"]()


def test_the_verdicts_are_those_of_the_page(device):
    """Fewer rows than on the page, for time's sake; the margins are the same."""
    y = ss.sweep(device, active_power_mw=1.0, f_hz=ss.log_grid(8, 900, 18), progress=False)
    assert list(ROWS) == [1.0, 2.0, 3.0]
    for scale, (verdict, margin, _) in ROWS.items():
        tuning = ss.tune(y, grid="0.01+0.15j", scale=scale)
        assert tuning.verdict == verdict
        assert tuning.margin_m == pytest.approx(margin, abs=2e-3)


def test_the_device_itself_comes_to_rest_below_the_edge_and_not_above(device):
    edge = ROWS[1.0][2]
    for scale, expected in ((0.98 * edge, "ok"), (1.02 * edge, "diverged")):
        grid = {"kind": "thevenin", "r_ohm": 0.01 * scale, "x_ohm": 0.15 * scale}
        y = ss.sweep(device, active_power_mw=1.0, f_hz=[80.0], source=grid, progress=False)
        assert list(y.status) == [expected]
