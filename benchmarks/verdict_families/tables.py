"""Tables as users have them: exact rows with noise, rows swept by the product's runner, imports of few digits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seqsweep.identify.response import FrequencyResponse

from .forming import Forming
from .linear import Linear
from .sampled_devices import Sampled
from .units import Unit

FOLLOWING = {
    **{"lf": "l_f_pu", "rf": "r_f_pu", "cf": "c_f_pu", "rc": "r_c_pu", "lg": "l_g_pu", "rg": "r_g_pu"},
    **{"kpc": "k_pc", "kic": "k_ic", "krd": "k_rd", "kff": "k_ff", "wff": "w_ff_rad_s", "kpp": "k_ppll"},
    **{"kip": "k_ipll", "kp": "k_p", "ki": "k_i", "kq": "k_q", "kiq": "k_iq", "wm": "w_m_rad_s"},
}
"""Fields of `Following` and what ``gfl-v1`` calls them."""

FORMING = {
    **{"lf": "l_f_pu", "rf": "r_f_pu", "cf": "c_f_pu", "lg": "l_g_pu", "rg": "r_g_pu", "kpv": "k_pv", "kiv": "k_iv"},
    **{"kffv": "k_ffv", "kffi": "k_ffi", "rv": "r_v_pu", "lv": "l_v_pu", "kpc": "k_pc", "kic": "k_ic", "kad": "k_ad"},
    **{"wad": "w_ad_rad_s", "kq": "k_q", "wf": "w_f_rad_s", "ta": "t_a_s", "kd": "k_d", "kw": "k_w"},
    **{"wlp": "w_lp_rad_s", "kpp": "k_ppll", "kip": "k_ipll"},
}
"""Fields of `Forming` and what ``gfm-v1`` calls them."""

T_PN = np.array([[1.0, 1j], [1.0, -1j]])
"""(d, q) to (positive sequence, conjugate of the mirror)."""


@dataclass(frozen=True)
class Spec:
    """How a table came about.

    Attributes
    ----------
    source : "exact", "swept" or "recorded"
        Rows by formula, by the product's runner, or by `identify` from recordings.
    spacing : "log", "both", "linear", "listed" or "adaptive"
        "both": logarithmic in f and in |f - f1|.
    f_hz : (n,) float
        Frequencies asked (Hz); of an adaptive table its band and the most points.
    f1_hz : float
        Fundamental (Hz).
    signal : "tone", "multisine" or "prbs"
        Of a sweep.
    amplitude_pu, bend : float
        Of its injection, and of the device's cubic nonlinearity.
    noise : float
        Relative to Y where rows are exact, rms over the rated peak of the waveforms where they are swept; 0: none.
    colour : "white" or "falling"
        Over frequency.
    covariance : "known", "estimated" or "none"
        What the rows say of it.
    float32, fact : bool
        Whether values passed through single precision; whether `stable_on` is known.
    cut : "", "gap", "f1" or "short"
        Whether rows are missing somewhere, around f1 (as in measurements in the field), or the band ends early.
    outliers : int
        Rows that are wrong by some tens of per cent.
    nonlinear : bool
        Whether the product's own nonlinear plant is swept, and not the linear one with a cubic part.
    """

    source: str
    spacing: str
    f_hz: np.ndarray
    f1_hz: float
    signal: str
    amplitude_pu: float
    bend: float
    noise: float
    colour: str
    covariance: str
    float32: bool
    fact: bool
    cut: str
    outliers: int = 0
    nonlinear: bool = False


def draw_spec(unit: Unit, rng: np.random.Generator, source: str) -> Spec:
    """A random way to get a table of the unit."""
    if source == "recorded":
        return _recorded_spec(unit, rng)
    swept = source == "swept"
    most = 60 if swept else 400
    points = int(np.exp(rng.uniform(np.log(15.0), np.log(most))))
    shapes = ["log", "both", "linear", "listed"] + (["adaptive"] if swept else [])
    spacing = str(rng.choice(shapes))
    f_hz, cut = _frequencies(rng, unit, points, spacing)
    noisy = rng.random() < (0.2 if swept else 0.65)
    level = 10.0 ** (rng.uniform(-5.5, -3.5) if swept else rng.uniform(-4.0, np.log10(0.03)))
    signals, chances = ["tone", "multisine", "prbs"], [0.8, 0.13, 0.07]
    free = spacing in ("log", "linear") and not cut and not (noisy and swept) and unit.family != "sampled"
    return Spec(
        source=source,
        spacing=spacing,
        f_hz=f_hz,
        f1_hz=unit.bases.f1_hz,
        signal=str(rng.choice(signals, p=chances)) if free else "tone",
        amplitude_pu=float(np.exp(rng.uniform(np.log(1e-4), np.log(1e-2)))),
        bend=float(np.exp(rng.uniform(np.log(0.03), np.log(3.0)))),
        noise=level if noisy and not (swept and unit.family in ("turbine", "sampled")) else 0.0,
        colour=str(rng.choice(["white", "falling"])),
        covariance=str(rng.choice(["known", "estimated", "none"], p=[0.5, 0.2, 0.3])),
        float32=bool(not swept and rng.random() < 0.15),
        fact=bool(rng.random() < 0.92),
        cut=cut,
        outliers=int(rng.integers(1, 4)) if noisy and not swept and rng.random() < 0.1 else 0,
        nonlinear=swept and not noisy and is_nonlinear(unit),
    )


def _recorded_spec(unit: Unit, rng: np.random.Generator) -> Spec:
    """Twelve to twenty-four tones, a grid that is dense around f1 too, loud against the noise."""
    f1_hz, points = unit.bases.f1_hz, int(rng.integers(6, 13))
    f = np.concatenate([np.geomspace(2.0, 900.0, points), f1_hz + np.geomspace(1.0, 0.8 * f1_hz, points)])
    f = np.unique(np.round(2.0 * f) / 2.0)
    f = f[np.abs(f - f1_hz) > 0.6]
    f = f[np.append(True, np.diff(f) > 0.9)]
    level, amplitude = float(10.0 ** rng.uniform(-5.0, -3.7)), float(rng.uniform(0.003, 0.01))
    return Spec("recorded", "listed", f, f1_hz, "tone", amplitude, 0.1, level, "white", "known", False, True, "")


def _frequencies(rng: np.random.Generator, unit: Unit, points: int, spacing: str) -> tuple[np.ndarray, str]:
    f1_hz = unit.bases.f1_hz
    low = float(rng.choice([1.0, 1.0, 1.0, 2.0, 5.0]))
    high = float(rng.choice([1000.0, 1000.0, 1000.0, 500.0, 2000.0, 300.0]))
    if isinstance(unit.device, Sampled):  # below half of its Nyquist frequency
        high = min(high, 0.25 / unit.device.control.t_s)
    if unit.family == "rational":  # its modes lie anywhere: the band holds them, unless it is cut short
        high = max(high, 1.3 * f1_hz + 1.5 * float(np.abs(unit.device.own_poles.imag).max()) / (2.0 * np.pi))
    cut = str(rng.choice(["", "gap", "f1", "short"], p=[0.78, 0.1, 0.04, 0.08]))
    if cut == "short":
        high = float(rng.uniform(1.3, 3.5)) * f1_hz
    if spacing == "adaptive":
        return np.array([low, high, float(max(points, 20))]), "" if cut in ("gap", "f1") else cut
    f = _spaced(rng, f1_hz, points, spacing, low, high)
    if cut == "gap":
        begin = np.exp(rng.uniform(np.log(low), np.log(high)))
        kept = f[(f < begin) | (f > begin * rng.uniform(1.2, 2.0))]
        f = kept if len(kept) >= 10 else f
    return f[np.abs(f - f1_hz) > (0.08 * f1_hz if cut == "f1" else 0.12)], cut


def _spaced(rng: np.random.Generator, f1_hz: float, points: int, spacing: str, low: float, high: float) -> np.ndarray:
    if spacing == "log":
        return np.geomspace(low, high, points)
    if spacing == "linear":
        return np.linspace(low, high, points)
    if spacing == "listed":
        return np.unique(np.round(np.exp(rng.uniform(np.log(low), np.log(high), points)), 1))
    near = np.geomspace(0.5, 0.9 * (f1_hz - low), points // 4)
    sides = rng.choice([-1.0, 1.0], len(near))
    return np.unique(np.round(np.concatenate([np.geomspace(low, high, points - len(near)), f1_hz + sides * near]), 2))


def exact_pn(unit: Unit, f_hz: np.ndarray) -> np.ndarray:
    """Sequence admittance (n, 2, 2) in S at frequencies f (Hz)."""
    return T_PN @ unit.device.admittance(f_hz - unit.bases.f1_hz) @ np.linalg.inv(T_PN)


def table_of(unit: Unit, spec: Spec, rng: np.random.Generator, cache: Path) -> FrequencyResponse:
    """The rows. A swept table is kept in the file ``cache``, and read from it another time."""
    rows = {"exact": _computed, "swept": _swept, "recorded": _recorded}[spec.source]
    response = rows(unit, spec, rng, cache)
    meta = {"op_id": "a", **dict(response.meta)}
    if not spec.fact:
        meta.pop("stable_on", None)
    elif "stable_on" not in meta:
        meta["stable_on"] = _fact(unit)
    return FrequencyResponse(
        response.f_hz,
        response.y,
        response.f1_hz,
        covariance=response.covariance,
        status=response.status,
        reason=response.reason,
        quality=response.quality,
        meta=meta,
    )


def _fact(unit: Unit) -> dict[str, Any]:
    """What the shots of a sweep prove of a device that came to rest; slow modes stay open."""
    grid: Any = "ideal" if unit.swept_on is None else {"r_ohm": unit.swept_on[0], "x_ohm": unit.swept_on[1]}
    return {"grid": grid, "basis": "shots", "growth_bound_per_s": 0.7, "disturbed_s": 1.0}


# Rows by formula


def _computed(unit: Unit, spec: Spec, rng: np.random.Generator, cache: Path) -> FrequencyResponse:
    y = exact_pn(unit, spec.f_hz)
    f1_hz, f_hz = unit.bases.f1_hz, spec.f_hz
    covariance = None
    if spec.noise > 0.0:
        std = _noise(y, spec, f_hz, f1_hz)
        y = y + std[:, :, None] * _circular(rng, y.shape)
        covariance = {"none": None, "known": _known(std), "estimated": _estimated(std, rng)}[spec.covariance]
    for row in rng.choice(len(y), spec.outliers, replace=False):
        y[row] *= 1.0 + rng.uniform(0.1, 0.5) * _circular(rng, (2, 2))
    if spec.float32:
        y = y.astype(np.complex64).astype(complex)
    return FrequencyResponse(f_hz, y, f1_hz, covariance=covariance)


def _noise(y: np.ndarray, spec: Spec, f_hz: np.ndarray, f1_hz: float) -> np.ndarray:
    """Standard deviations (n, 2) of the current at f and at the mirror per volt (S)."""
    size = np.linalg.norm(y, axis=(1, 2)) / 2.0
    if spec.colour == "white":
        return spec.noise * np.stack([size, size], axis=1)
    both = np.abs(np.stack([f_hz, 2.0 * f1_hz - f_hz], axis=1))
    return spec.noise * np.median(size) * np.sqrt(f1_hz / np.maximum(both, 1.0))


def _circular(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)


def _known(std: np.ndarray) -> np.ndarray:
    """(n, 8, 8) over (re, im) of pp, pn, np, nn: both experiments are as noisy."""
    variance = np.repeat(np.repeat(std**2 / 2.0, 2, axis=1), 2, axis=1)
    return variance[:, :, None] * np.eye(8)


def _estimated(std: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The same from the scatter of five windows, widened as Student would for so few."""
    from scipy.stats import chi2, f

    freedom = 8
    residual = std[:, None, :] * _circular(rng, (len(std), freedom, 2))
    gamma = np.einsum("nda,ndb->nab", residual, residual.conj()) / freedom
    gamma *= 2.0 * f.ppf(0.95, 2, 2 * freedom) / chi2.ppf(0.95, 2)
    whole = np.einsum("nac,bd->nabcd", gamma, np.eye(2)).reshape(len(std), 4, 4)
    blocks = np.array([[whole.real, -whole.imag], [whole.imag, whole.real]]) / 2.0
    return blocks.transpose(2, 3, 0, 4, 1).reshape(len(std), 8, 8)


# Rows by the runner


def _swept(unit: Unit, spec: Spec, rng: np.random.Generator, cache: Path) -> FrequencyResponse:
    from .sweeping import swept

    return swept(_plant(unit, spec, int(rng.integers(2**31))), _campaign(unit, spec), cache)


def _recorded(unit: Unit, spec: Spec, rng: np.random.Generator, cache: Path) -> FrequencyResponse:
    from seqsweep.plant.protocol import Source

    from .recording import identified

    source = Source()
    if unit.swept_on is not None:
        source = Source("thevenin", unit.swept_on[0], unit.swept_on[1] / unit.bases.w1)
    return identified(_plant(unit, spec, int(rng.integers(2**31))), source, spec.f_hz, spec.amplitude_pu, cache)


def _plant(unit: Unit, spec: Spec, seed: int) -> Any:
    if unit.family == "turbine":
        from seqsweep.plant.turbine.reference import ReferenceTurbine

        return ReferenceTurbine()
    if spec.nonlinear:
        return _own_plant(unit)
    from .swept_plants import LinearPlant, NoisyPlant, SampledPlant

    if isinstance(unit.device, Sampled):
        return SampledPlant(unit.device)
    assert isinstance(unit.device, Linear)
    if spec.noise > 0.0:
        corner_hz = 1e5 if spec.colour == "white" else 300.0
        return NoisyPlant(unit.device, unit.bases, spec.bend, spec.noise, corner_hz, seed)
    return LinearPlant(unit.device, unit.bases, spec.bend)


def _own_plant(unit: Unit) -> Any:
    """The product's own nonlinear inverter of the same parameters."""
    from seqsweep.plant.registry import make_plant

    g, bases = unit.parameters, unit.bases
    assert g is not None
    rating = {"u_rated_v": bases.voltage_v, "s_rated_va": bases.power_va, "w1_rad_s": bases.w1}
    if isinstance(g, Forming):
        return make_plant("gfm-v1", {**rating, **{theirs: getattr(g, ours) for ours, theirs in FORMING.items()}})
    weights = {"c_p": float(g.outer != "dc"), "c_dc": float(g.outer == "dc")}
    weights |= {"c_q": float(g.outer != "pv"), "c_v": float(g.outer == "pv")}
    dc = {"c_dc_s": g.c_dc_s} if g.outer == "dc" else {}
    return make_plant(
        "gfl-v1", {**rating, **weights, **dc, **{theirs: getattr(g, ours) for ours, theirs in FOLLOWING.items()}}
    )


def is_nonlinear(unit: Unit) -> bool:
    """Whether the product has a nonlinear plant for it: one inverter, LCL or forming, without a delay of its own."""
    g = unit.parameters
    if isinstance(g, Forming):
        return abs(complex(g.p, g.q)) < 1.0
    if g is None or g.filter != "LCL" or g.delay_s > 0.0 or g.outer == "current":
        return False
    return abs(complex(g.p, g.q)) < 1.0 and bool(g.kff == 0.0 or np.isfinite(g.wff))


def _campaign(unit: Unit, spec: Spec) -> dict[str, Any]:
    power, voltage = unit.point if unit.family == "turbine" else (0.5 * unit.bases.power_va / 1e6, 1.0)
    point = {"id": "a", "active_power_mw": power, "terminal_voltage_pu": voltage}
    if spec.nonlinear:
        assert unit.parameters is not None
        g, rated_mva = unit.parameters, unit.bases.power_va / 1e6
        point |= {
            "active_power_mw": g.p * rated_mva,
            "reactive_power_mvar": g.q * rated_mva,
            "terminal_voltage_pu": g.v,
        }
    source = {"kind": "ideal"}
    if unit.swept_on is not None:
        source = {"kind": "thevenin", "r_ohm": unit.swept_on[0], "x_ohm": unit.swept_on[1]}
    return {
        "campaign": {"name": "verdict families"},
        "plant": {"id": "dpmsg-v1" if unit.family == "turbine" else "branch-v1"},
        "operating_point": [point],
        "sweep": {**_grid_section(spec), "max_simulated_s": 8.0 if spec.noise else 60.0, **_agreement(spec)},
        "injection": {"signal": spec.signal, "amplitude_pu": spec.amplitude_pu},
        "source": source,
    }


def _grid_section(spec: Spec) -> dict[str, Any]:
    if spec.spacing == "adaptive":
        low, high, points = spec.f_hz
        return {"f_min_hz": low, "f_max_hz": high, "points": int(points), "spacing": "adaptive"}
    if spec.spacing in ("log", "linear") and not spec.cut:
        return {
            "f_min_hz": float(spec.f_hz[0]),
            "f_max_hz": float(spec.f_hz[-1]),
            "points": len(spec.f_hz),
            "spacing": spec.spacing,
        }
    f1_hz = round(float(spec.f1_hz))
    return {"f_hz": sorted({round(2.0 * float(f)) / 2.0 for f in spec.f_hz} - {0.0, float(f1_hz)})}  # windows of 2 s


def _agreement(spec: Spec) -> dict[str, Any]:
    """Loud broadband signals meet the device's nonlinearity: they agree less well."""
    return {"tolerance": 1e-4} if spec.signal != "tone" and spec.amplitude_pu > 2e-3 else {}
