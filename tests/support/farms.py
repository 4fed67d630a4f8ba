"""Farms of reference turbines with exact tables: what the tests of farms begin with."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from seqsweep.identify.operating_state import fundamental_facts
from seqsweep.identify.response import FrequencyResponse
from seqsweep.tuning.farm.units import Library

from . import oracle
from .farm_oracle import Star, closed_loop

F_HZ = 50.0 + np.geomspace(0.4, 1200.0, 90)
RATED = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}


def table_of(power_w: float, voltage_v: float, **others: Any) -> SimpleNamespace:
    """Exact rows of one operating point, as a table offers them; ``others`` go into its metadata."""
    m = oracle.linearise(power_w, voltage_v)
    i = oracle.current(m.x, m.v_pcc)
    scale = np.sqrt(2.0 / 3.0)
    meta = {
        "op_id": "p",
        "active_power_mw": power_w / 1e6,
        "terminal_voltage_pu": voltage_v / 690.0,
        "stable_on": {"grid": "ideal", "basis": "shots"},
        "fundamental": fundamental_facts(complex(scale * voltage_v), complex(*i) * scale),
    }
    response = FrequencyResponse(F_HZ, oracle.admittance_pn(F_HZ, power_w, voltage_v), 50.0, meta=meta)
    return SimpleNamespace(
        meta={"f1_hz": 50.0, "bases": RATED, **others},
        op_ids=("p",),
        response=lambda op: response,
        responses=(response,),
    )


def library_of(star: Star, powers_w: list[float]) -> Library:
    """A table of every turbine of the star, at its own voltage."""
    _, v = closed_loop(star, powers_w)
    tables = {f"t{k}": table_of(p, abs(v[k])) for k, p in enumerate(powers_w)}
    return Library(tables.__getitem__)


def document(star: Star, n: int) -> dict:
    """The star as a farm file: everything on 690 V, transformers as series elements."""
    return {
        "bus": [{"name": "pcc", "voltage_kv": 0.69}, *({"name": f"t{k}", "voltage_kv": 0.69} for k in range(n))],
        "series": [
            {"name": f"z{k}", "from": f"t{k}", "to": "pcc", "r_ohm": star.z_t.real, "x_ohm": star.z_t.imag}
            for k in range(n)
        ],
        "shunt": [{"name": "c", "bus": "pcc", "kind": "shunt_capacitor", "c_uf": star.c_f * 1e6}],
        "source": [{"bus": "pcc", "r_ohm": star.z_s.real, "x_ohm": star.z_s.imag}],
        "device": [{"name": f"wt{k}", "bus": f"t{k}", "table": f"t{k}"} for k in range(n)],
    }
