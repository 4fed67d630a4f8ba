"""Parts of a tuning result as plain JSON values."""

from __future__ import annotations

from typing import Any

from ..identify.fit.rational import RationalModel
from .intervals import Interval
from .verdict import Stability


def interval_json(name: str, interval: Interval | None) -> dict[str, Any]:
    """Standard error and 95 % interval under names that begin with ``name``."""
    if interval is None:
        return {f"{name}_std": None, f"{name}_interval": None}
    return {f"{name}_std": interval.std, f"{name}_interval": [interval.low, interval.high]}


def stability_json(stability: Stability | None) -> dict[str, Any]:
    """Winding number, poles, crossings and what rests on the fit."""
    if stability is None:
        return {"winding": None, "n_open_loop_unstable": None, "poles": [], "bode": None, "extrapolation": None}
    winding = stability.winding
    return {
        "winding": winding.number,
        "n_open_loop_unstable": stability.n_open_loop_unstable,
        "poles": _poles_json(stability),
        "bode": {
            "stable": stability.bode_stable,
            "note": stability.bode_note,
            "crossings": [crossing._asdict() for crossing in stability.crossings],
        },
        "extrapolation": {
            "text": stability.extrapolation,
            "below_deg": winding.inside_deg,
            "above_deg": winding.beyond_deg,
        },
    }


def _poles_json(stability: Stability) -> list[dict[str, Any]]:
    """Upper halves of the pairs, dq frame; "kind" is resonance (the critical one), slow or other."""
    loop = stability.closed_loop
    slow = set(loop.slow.tolist())
    kinds = dict.fromkeys(slow, "slow") | ({loop.critical: "resonance"} if loop.critical is not None else {})
    return [
        {
            "re_rad_s": float(pole.real),
            "im_rad_s": float(pole.imag),
            "re_std_rad_s": float(std.real),
            "im_std_rad_s": float(std.imag),
            "re_im_cov_rad2_s2": float(loop.covariance[k, 0, 1]),
            "f_hz": float(loop.f_hz[k]),
            "damping": float(loop.damping[k]),
            "kind": kinds.get(k, "other"),
        }
        for k, (pole, std) in enumerate(zip(loop.poles, loop.std, strict=True))
    ]


def fit_json(model: RationalModel | None) -> dict[str, Any] | None:
    """Order, misfit and poles of the fit."""
    if model is None:
        return None
    upper = model.poles.imag >= 0.0
    return {
        "order": model.order,
        "bic": model.bic,
        "residual": model.residual,
        "weighting": model.weighting,
        "poles": [[float(p.real), float(p.imag)] for p in model.poles[upper]],
        "ranks": model.ranks[upper].tolist(),
        "remarks": list(model.remarks),
    }
