"""A farm is as sure as the least known of its devices: what its tables do not show withholds a verdict, or certainty.

Truth is the network's own impedance, a dense inverse beside the fast way through the tree, and `tune` for one device.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from seqsweep.identify.fit.rational import evaluate
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.farm import Farm, judged
from seqsweep.tuning.farm.pairs import inverse, to_dq
from seqsweep.tuning.farm.rest import Rest, Whole
from seqsweep.tuning.siso import SeriesRL
from seqsweep.tuning.text import CERTAIN
from seqsweep.tuning.tune import tune_point
from seqsweep.tuning.uncovered import ALLOWANCE

from ..support.farm_oracle import Star
from ..support.farms import document, table_of

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)
NU_HZ = np.array([0.0, 3.7, 25.0, 49.0, 180.0, 900.0])
GRID = SeriesRL(0.012, 0.25, 50.0)


def farm_with(tables: dict[str, SimpleNamespace], star: Star = STAR) -> Farm:
    return judged(farm_of(document(star, len(tables))), tables.__getitem__)


def alone(table: SimpleNamespace) -> Farm:
    """One device behind `GRID` and nothing else."""
    content = {
        "bus": [{"name": "pcc", "voltage_kv": 0.69}],
        "source": [{"bus": "pcc", "r_ohm": 0.012, "x_ohm": 0.25}],
        "device": [{"name": "wt", "bus": "pcc", "table": "t"}],
    }
    return judged(farm_of(content), {"t": table}.__getitem__)


def thinned(table: SimpleNamespace, keep: np.ndarray) -> SimpleNamespace:
    """The same table with the rows ``keep`` alone."""
    (whole,) = table.responses
    response = FrequencyResponse(whole.f_hz[keep], whole.y[keep], whole.f1_hz, meta=whole.meta)
    return SimpleNamespace(meta=table.meta, op_ids=table.op_ids, response=lambda op: response, responses=(response,))


@pytest.fixture(scope="module")
def tables():
    return {f"t{k}": table_of(p, 690.0) for k, p in enumerate((0.45e6, 0.6e6, 0.8e6))}


@pytest.fixture(scope="module")
def three(tables):
    return farm_with(tables)


def test_one_device_alone_sees_the_source(tables):
    farm = alone(tables["t1"])
    (unit,) = farm.units
    seen = Rest(Whole(farm.system), unit).impedance_dq(2j * np.pi * NU_HZ)
    c, s = np.cos(unit.angle_rad), np.sin(unit.angle_rad)
    turn = np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(turn @ seen @ turn.T, GRID.impedance_dq(2j * np.pi * NU_HZ), rtol=1e-9, atol=1e-12)


def test_the_way_through_the_tree_is_the_dense_inverse(three):
    """(Z^-1 + Y)^-1 over all ports, its blocks on the diagonal, is what a further device at each bus would see."""
    s = 2j * np.pi * NU_HZ
    z = three.system.impedance(s)
    dense = np.linalg.solve(np.eye(z.shape[1]) + z @ three.system.admittance(s), z)
    found = Whole(three.system).at(NU_HZ)
    for unit in three.units:
        at = three.system.place(unit)
        np.testing.assert_allclose(to_dq(inverse(found[unit.bus])), dense[:, at, at], rtol=1e-8, atol=1e-12)


def test_locus_of_the_farm_is_that_of_a_device_on_the_rest_times_that_of_the_rest(three):
    """det(1 + Y Z) over all ports = det(1 + Y_k Z_k) det(1 + Y Z without device k), Z_k what device k sees."""
    s = 2j * np.pi * NU_HZ
    z, y = three.system.impedance(s), three.system.admittance(s)
    whole = np.linalg.det(np.eye(z.shape[1]) + y @ z)
    for unit in three.units:
        others, at = y.copy(), three.system.place(unit)
        others[:, at, at] = 0.0
        own = evaluate(unit.model, s) @ Rest(Whole(three.system), unit).impedance_dq(s)
        product = np.linalg.det(np.eye(2) + own) * np.linalg.det(np.eye(z.shape[1]) + others @ z)
        np.testing.assert_allclose(product, whole, rtol=1e-8)


def test_well_swept_farm_is_certain(three):
    assert three.judgement.verdict == "stable"
    assert three.judgement.probability > CERTAIN
    assert three.judgement.uncovered == ""


@pytest.mark.parametrize(
    "keep",
    [lambda nu: nu > 25.0, lambda nu: nu < 60.0, lambda nu: (nu < 12.0) | (nu > 40.0)],
    ids=["nothing around f1", "band cut short", "a gap"],
)
def test_one_device_is_judged_as_tune_judges_it(tables, keep):
    table = thinned(tables["t1"], keep(tables["t1"].responses[0].f_hz - 50.0))
    farm, point = alone(table).judgement, tune_point(table.responses[0], GRID)
    assert farm.verdict == point.verdict
    assert (farm.probability > CERTAIN) == (point.probability > CERTAIN)
    if point.verdict != "undecided":
        assert farm.uncovered.removeprefix("wt: ") == point.stability.uncovered


def test_the_device_whose_rows_leave_it_open_is_named(tables):
    rows = tables["t1"].responses[0].f_hz - 50.0
    farm = farm_with({**tables, "t1": thinned(tables["t1"], rows > 25.0)})
    assert farm.judgement.probability <= 1.0 - ALLOWANCE
    assert "wt1: " in f"{farm.judgement.reason} {farm.judgement.uncovered}"


def test_unstable_farm_whose_mode_no_rows_surround_is_undecided(tables):
    weak = Star(STAR.z_t, STAR.c_f, 0.004 + 0.12j)
    whole = farm_with(tables, weak).judgement
    assert whole.verdict == "unstable"
    place = whole.critical.pole.imag / (2.0 * np.pi)
    rows = tables["t0"].responses[0].f_hz - 50.0
    keep = np.abs(np.log(rows / place)) > np.log(1.6)
    holed = farm_with({name: thinned(table, keep) for name, table in tables.items()}, weak).judgement
    assert holed.verdict == "undecided" or holed.uncovered
