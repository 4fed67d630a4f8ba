"""A judged farm as text for a terminal and as plain JSON values."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...identify.views.html import MOST, html_table
from ..layout import WIDTH, folded, wrapped
from ..network.assembly import GROUND
from .advice_text import advice_json
from .dampers import Damper
from .doubt import doubt_of
from .farm import Farm
from .participation import ModeParts, ranked
from .restore import Advice
from .states import StateVerdict

FORMAT, VERSION = "seqsweep-farm", "1.1.0"

_SHOWN = 3  # modes that a terminal shows
_NAME = 17  # columns of a state's name beside its numbers
_Z95 = 1.959963984540054


def schema(of_states: bool = False) -> dict[str, Any]:
    """JSON Schema of the document of one farm, or of that of its switching states."""
    from importlib.resources import files

    name = f"{FORMAT}-states-1" if of_states else f"{FORMAT}-1"
    text = files("seqsweep.tuning").joinpath(f"schema/{name}.schema.json").read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def to_json(farm: Farm, advice: Sequence[Advice] = ()) -> dict[str, Any]:
    """Everything that was found; NaN and infinity are null."""
    judgement = farm.judgement
    return {
        "format": FORMAT,
        "version": VERSION,
        "farm": farm.entry.name,
        "f1_hz": farm.entry.f1_hz,
        "verdict": judgement.verdict,
        "reason": judgement.reason,
        "probability_stable": judgement.probability,
        "n_unstable_locus": judgement.n_unstable_locus,
        "n_unstable_poles": judgement.n_unstable_poles,
        "network": _network_json(farm),
        "devices": [_unit_json(farm, k) for k in range(len(farm.units))],
        "dampers": [_damper_json(damper) for damper in farm.dampers],
        "modes": [_mode_json(farm, mode) for mode in judgement.modes],
        "doubt": _doubt_json(farm),
        "advice": [advice_json(one) for one in advice],
        "warnings": list(farm.warnings),
    }


def _network_json(farm: Farm) -> dict[str, Any]:
    """What stands between the devices and the source, as a one-line diagram needs it."""
    entry = farm.entry
    return {
        "source_bus": entry.source_bus,
        "source_ohm": [entry.source_z_ohm.real, entry.source_z_ohm.imag],
        "buses_v": dict(entry.voltages_v),
        "branches": [
            {"name": branch.name, "ends": {node: ratio for node, ratio in branch.ends.items() if node != GROUND}}
            for branch in entry.network.branches
        ],
    }


def _doubt_json(farm: Farm) -> dict[str, Any] | None:
    """Which measurement the critical mode's error comes from."""
    mode = farm.judgement.critical
    if mode is None:
        return None
    doubt = doubt_of(farm.system, mode.pole)
    return {
        "sigma_std_per_s": doubt.std,
        "variance_by_table": doubt.by_table,
        "rows_hz": [list(band) for band in doubt.rows_hz],
        "variance_by_order": doubt.by_order,
        "measure": doubt.said(farm.entry.f1_hz),
    }


def _unit_json(farm: Farm, k: int) -> dict[str, Any]:
    unit = farm.units[k]
    return {
        "name": unit.name,
        "bus": unit.bus,
        "table": unit.key,
        "count": unit.count,
        "terminal_voltage_v": unit.voltage_v,
        "angle_deg": float(np.degrees(unit.angle_rad)),
        "active_power_out_w": -unit.power_va.real,
        "reactive_power_out_var": -unit.power_va.imag,
        "voltage_off_sweep": unit.off if np.isfinite(unit.off) else None,
        "own_unstable_modes": unit.n_unstable,
    }


def _damper_json(damper: Damper) -> dict[str, Any]:
    device = damper.device
    return {
        "name": damper.entry.name,
        "bus": damper.entry.bus,
        "share": damper.entry.share,
        "limit_a": device.limit_a if np.isfinite(device.limit_a) else None,
        "f_dq_hz": device.nu_rad_s / (2.0 * np.pi),
        "y_mode_s": [device.y_mode.real, device.y_mode.imag],
        "y_mirror_s": [device.y_mirror.real, device.y_mirror.imag],
        "bandwidth_rad_s": device.bandwidth_rad_s,
        "washout_rad_s": device.washout_rad_s,
        "lag_s": device.lag_s,
        "largest_admittance_s": damper.size_s,
    }


def _mode_json(farm: Farm, mode: ModeParts) -> dict[str, Any]:
    nu = mode.pole.imag / (2.0 * np.pi)
    return {
        "sigma_per_s": mode.pole.real,
        "sigma_half_95_per_s": _Z95 * mode.std.real,
        "f_dq_hz": nu,
        "f_half_95_hz": _Z95 * mode.std.imag / (2.0 * np.pi),
        "seen_at_hz": [farm.entry.f1_hz - nu, farm.entry.f1_hz + nu],
        "damping": -mode.pole.real / abs(mode.pole),
        "devices": {
            unit.name: {"share": float(share), "re_per_s": value.real, "im_per_s": value.imag}
            for unit, share, value in zip(farm.system.units, mode.shares, mode.devices, strict=True)
        },
        "buses": {
            bus: {"re_per_s_per_s": value.real, "im_per_s_per_s": value.imag}
            for bus, value in zip(farm.system.ports, mode.buses, strict=True)
        },
        "branches": {
            branch.name: {"re_per_s": value.real, "im_per_s": value.imag}
            for branch, value in zip(farm.system.network.branches, mode.branches, strict=True)
        },
    }


def states_json(name: str, states: Sequence[StateVerdict]) -> dict[str, Any]:
    """Every switching state of a farm and what it comes to."""
    return {
        "format": f"{FORMAT}-states",
        "version": VERSION,
        "farm": name,
        "states": [_state_json(found) for found in states],
    }


def _state_json(found: StateVerdict) -> dict[str, Any]:
    farm, state = found.farm, found.state
    return {
        "name": state.name,
        "out": list(state.out),
        "source_scale": state.source_scale,
        "devices": [] if farm is None else [{"name": unit.name, "count": unit.count} for unit in farm.units],
        "verdict": None if farm is None else farm.judgement.verdict,
        "reason": found.reason,
        "probability_stable": None if farm is None else farm.judgement.probability,
        "n_unstable": None if farm is None else farm.judgement.n_unstable_poles,
        "margin_m": None if found.crossing is None else found.crossing.m,
        "crossing_hz": None if found.crossing is None else found.crossing.f_hz,
        "damping_control_may_stop": found.cause_gone,
        "modes": [] if farm is None else [_mode_json(farm, mode) for mode in farm.judgement.modes],
    }


def states_text(states: Sequence[StateVerdict]) -> str:
    """States by verdict as a table, within `WIDTH` columns; a name that has no room stands above its numbers."""
    width = min(_NAME, max(5, *(len(found.state.name) for found in states)))
    head = f"{'state':<{width}}    n  verdict    mode Hz        sigma 1/s  zeta %      m  stop"
    lines = [head, "-" * len(head), *(line for found in states for line in _state_lines(found, width))]
    counts = [f"{sum(s.verdict == kind for s in states)} {kind}" for kind in dict.fromkeys(s.verdict for s in states)]
    legend = (
        "n: devices; mode: the critical one; m: Bode margin at the source's bus; stop: whether damping control may stop"
    )
    return "\n".join([*lines, "", ", ".join(counts), *wrapped(legend, WIDTH)])


def _state_lines(found: StateVerdict, width: int) -> list[str]:
    name = found.state.name
    above, beside = (wrapped(name, WIDTH), "") if len(name) > width else ([], name)
    return [*above, f"{beside:<{width}}  {_state_numbers(found)}"]


def _state_numbers(found: StateVerdict) -> str:
    if found.farm is None:
        return f"     {found.verdict}"
    n = sum(unit.count for unit in found.farm.units)
    mode, m = found.farm.judgement.critical, "-" if found.crossing is None else f"{found.crossing.m:.3f}"
    place, sigma, damping = "-", "-", "-"
    if mode is not None:
        nu, f1 = mode.pole.imag / (2.0 * np.pi), found.farm.entry.f1_hz
        place, sigma = f"{f1 - nu:.4g}/{f1 + nu:.4g}", f"{mode.pole.real:+.3f}"
        damping = f"{-100.0 * mode.pole.real / abs(mode.pole):.2f}"
    stop = "yes" if found.cause_gone else "no"
    return f"{n:3d}  {found.verdict:<9}  {place:<13}  {sigma:>9}  {damping:>6}  {m:>5}  {stop:>4}"


def text_of(farm: Farm) -> str:
    """Load flow, verdict and the modes with who takes part in them, within 80 columns."""
    judgement = farm.judgement
    chance = "" if judgement.probability is None else f" (probability of being stable {judgement.probability:.3g})"
    lines = [
        f"{farm.entry.name}: {len(farm.units)} devices, source {farm.entry.source_voltage_v:.5g} V behind "
        f"{farm.entry.source_z_ohm.real:.4g} + j{farm.entry.source_z_ohm.imag:.4g} ohm",
        "",
        *_flow_lines(farm),
        *_damper_lines(farm),
        "",
        f"{judgement.verdict}{chance}: {judgement.reason}",
    ]
    for mode in _shown(farm):
        lines += ["", *_mode_lines(farm, mode)]
    if len(judgement.modes) > _SHOWN:
        lines += ["", f"{len(judgement.modes) - _SHOWN} further modes are in the JSON (-o)."]
    lines += [f"warning: {text}" for text in farm.warnings]
    return folded("\n".join(lines), WIDTH)


def _shown(farm: Farm) -> list[ModeParts]:
    """The first modes, the critical one always among them."""
    first, critical = list(farm.judgement.modes[:_SHOWN]), farm.judgement.critical
    told = critical is None or any(mode is critical for mode in first)
    return first if told or critical is None else [critical, *first[:-1]]


def as_html(farm: Farm) -> str:
    """Verdict and modes as a small HTML table, for a notebook."""
    judgement, f1 = farm.judgement, farm.entry.f1_hz
    rows = []
    for mode in judgement.modes[:MOST]:
        nu = mode.pole.imag / (2.0 * np.pi)
        most = ranked(list(mode.shares))[:3]
        rows.append(
            (
                f"{f1 - nu:.4g}/{f1 + nu:.4g}",
                f"{mode.pole.real:+.4g}",
                f"{-100.0 * mode.pole.real / abs(mode.pole):.2f}",
                ", ".join(f"{farm.system.units[k].name} {100.0 * mode.shares[k]:.0f} %" for k in most),
            )
        )
    title = f"{farm.entry.name}, {len(farm.units)} devices: {judgement.verdict}, {judgement.reason}"
    heads = ("mode (Hz)", "real part (1/s)", "damping (%)", "takes part")
    return html_table(title, heads, rows, len(judgement.modes))


def _flow_lines(farm: Farm) -> list[str]:
    width = max(6, *(len(unit.name) for unit in farm.units))
    head = f"{'device':<{width}}  {'P out MW':>9}  {'Q out Mvar':>10}  {'|v| V':>8}  {'angle deg':>9}"
    rows = [
        f"{u.name:<{width}}  {-u.power_va.real / 1e6:9.4f}  {-u.power_va.imag / 1e6:10.4f}  {u.voltage_v:8.2f}  "
        f"{np.degrees(u.angle_rad):9.3f}"
        for u in farm.units
    ]
    return [head, "-" * len(head), *rows]


def _damper_lines(farm: Farm) -> list[str]:
    return [
        f"{damper.entry.name}: grid-side damper at {damper.entry.bus}, set to {farm.entry.f1_hz - nu:.4g}/"
        f"{farm.entry.f1_hz + nu:.4g} Hz with {damper.size_s:.3g} S, at most {damper.device.limit_a:.4g} A"
        for damper in farm.dampers
        for nu in (damper.device.nu_rad_s / (2.0 * np.pi),)
    ]


def _mode_lines(farm: Farm, mode: ModeParts) -> list[str]:
    nu = mode.pole.imag / (2.0 * np.pi)
    head = (
        f"mode at {farm.entry.f1_hz - nu:.4g}/{farm.entry.f1_hz + nu:.4g} Hz: sigma {mode.pole.real:+.4g} "
        f"+- {_Z95 * mode.std.real:.2g} 1/s, damping {-100.0 * mode.pole.real / abs(mode.pole):.2f} %"
    )
    most = ranked(list(mode.shares))[:5]
    parts = ", ".join(f"{farm.system.units[k].name} {100.0 * mode.shares[k]:.0f} %" for k in most)
    worse = [farm.system.units[k].name for k in most if mode.devices[k].real > 0.0]
    growing = f"; more of {', '.join(worse)} makes it less damped" if worse else ""
    return [head, f"  takes part: {parts}{growing}"]
