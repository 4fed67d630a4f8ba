"""Rounds of a region as `run` would leave them, from the exact linearisation of the turbine."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.surrogate.region import AXES
from seqsweep.identify.table.write import write_table
from seqsweep.plant.turbine.parameters import TABLE_I
from seqsweep.sweep.config.sections import Config

from . import oracle
from .regions import BASES, F_HZ, U_V, facts


def exact_round(config: Config, path: Path) -> None:
    """The listed operating points with the parameters of the campaign, at the frequencies of `regions`."""
    given = TABLE_I._replace(**config.plant.parameters)
    responses, listed = [], []
    for asked in config.operating_point:
        point = np.array([asked.active_power_mw, asked.reactive_power_mvar or 0.0, asked.terminal_voltage_pu])
        y = oracle.admittance_pn(F_HZ, point[0] * 1e6, point[2] * U_V, given, q_var=point[1] * 1e6)
        size = np.linalg.norm(y, axis=(1, 2))[:, None, None]
        covariance = 1e-24 / 8.0 * size**2 * np.eye(8)
        responses.append(FrequencyResponse(F_HZ, y, 50.0, covariance=covariance, meta={"op_id": asked.id}))
        where = dict(zip(AXES, map(float, point), strict=True))
        listed.append({"op_id": asked.id, **where, "fundamental": {**facts(point), "angle_rad": 0.0}})
    meta = {"f1_hz": 50.0, "bases": BASES, "power_meaning": "machine", "operating_points": listed}
    plant = {"id": config.plant.id, "parameters": dict(config.plant.parameters)}
    write_table(path, responses, {**meta, "configuration": config.to_dict(), "plant": plant})
