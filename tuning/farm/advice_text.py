"""Advice on gains or powers as text for a terminal and as plain JSON values."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..layout import WIDTH, folded
from .restore import Advice, Choice


def advice_json(advice: Advice) -> dict[str, Any]:
    """Everything that was found."""
    return {
        "what": advice.what,
        "unit": advice.unit,
        "devices": list(advice.names),
        "slopes": [
            {
                "sigma_per_s": mode.pole.real,
                "f_dq_hz": mode.pole.imag / (2.0 * np.pi),
                "by_device": {
                    name: {"re_per_s": value.real, "im_per_s": value.imag}
                    for name, value in zip(advice.names, row, strict=True)
                },
            }
            for mode, row in zip(advice.base.judgement.modes, advice.slopes, strict=True)
        ],
        "demand": None if advice.demand is None else _demand_json(advice),
        "choices": [_choice_json(advice, choice) for choice in advice.choices],
    }


def _demand_json(advice: Advice) -> dict[str, Any]:
    assert advice.demand is not None
    return {"words": advice.demand.words, "probability": advice.demand.probability, "unit": advice.demand.unit}


def _choice_json(advice: Advice, choice: Choice) -> dict[str, Any]:
    critical = choice.farm.judgement.critical
    return {
        "way": choice.way,
        "holds": choice.holds,
        "excess": choice.excess if np.isfinite(choice.excess) else None,
        "changes": {name: float(x) for name, x in zip(advice.names, choice.changes, strict=True)},
        "sum": float(choice.changes.sum()),
        "norm": float(np.linalg.norm(choice.changes)),
        "verdict": choice.farm.judgement.verdict,
        "critical_sigma_per_s": None if critical is None else critical.pole.real,
        "critical_f_dq_hz": None if critical is None else critical.pole.imag / (2.0 * np.pi),
        "rounds": choice.rounds,
    }


def advice_text(advice: Advice) -> str:
    """Slopes of the critical mode by device, and the choices side by side, within 80 columns."""
    per = f"per {advice.unit}" if advice.unit else "per 1"
    modes = advice.base.judgement.modes
    critical = advice.base.judgement.critical
    if critical is None:
        return f"{advice.what}: there is no oscillating mode in the band to move"
    row = advice.slopes[[mode is critical for mode in modes].index(True)]
    width = max(6, *(len(name) for name in advice.names))
    heads = [f"d sigma {per}", *(choice.way for choice in advice.choices)]
    unit = f" ({advice.unit})" if advice.unit else ""
    lines = [f"{advice.what}{unit}, at {_place(advice)}:", "", f"{'device':<{width}}" + _cells(heads)]
    lines.append("-" * len(lines[-1]))
    for k, name in enumerate(advice.names):
        values = [f"{row[k].real:+.3f}", *(f"{choice.changes[k]:.3f}" for choice in advice.choices)]
        lines.append(f"{name:<{width}}" + _cells(values))
    if advice.choices:
        lines.append(f"{'sum':<{width}}" + _cells(["", *(f"{c.changes.sum():.3f}" for c in advice.choices)]))
        lines += ["", *(_said(advice, choice) for choice in advice.choices)]
    return folded("\n".join(lines), WIDTH)


def _cells(values: list[str]) -> str:
    return "".join(f"  {value:>16}" for value in values)


def _place(advice: Advice) -> str:
    critical = advice.base.judgement.critical
    assert critical is not None
    nu, f1 = critical.pole.imag / (2.0 * np.pi), advice.base.entry.f1_hz
    return f"the mode of {f1 - nu:.4g}/{f1 + nu:.4g} Hz (sigma {critical.pole.real:+.4g} 1/s)"


def _said(advice: Advice, choice: Choice) -> str:
    assert advice.demand is not None
    asked = f"{advice.demand.words} with probability {advice.demand.probability:g}"
    if choice.rounds == 0 and choice.holds:
        return f"{choice.way}: {asked} holds without any change"
    checked = "swept again" if not advice.unit else "at its new load flow"
    if choice.holds:
        return f"{choice.way}: {asked} holds, the farm {checked}"
    return f"{choice.way}: {asked} is not reached, by {choice.excess:.3g} {advice.demand.unit}; the farm {checked}"
