"""The answer of a report in sentences that a manager understands."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from .bank import VERDICTS
from .bank import sentence_of as bank_sentence
from .inputs import Inputs

RANK = {name: k for k, name in enumerate(VERDICTS)}
"""Verdicts from the worst to the best."""

_SAID = {
    "unstable": "Unstable",
    "stable": "Stable",
    "undecided": "Not decided",
}


def worst_verdict(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> str:
    """The worst verdict of cases, bank and farm; empty where none was asked for."""
    found = [point["verdict"] for point in points]
    if "bank" in inputs.results:
        found += list(inputs.results["bank"].counts)
    if "farm" in inputs.results:
        found.append(inputs.results["farm"]["verdict"])
    return min(found, key=lambda verdict: RANK.get(verdict, 1), default="")


def sentences(inputs: Inputs, points: Sequence[Mapping[str, Any]]) -> list[str]:
    """The whole answer, the decisive sentence first.

    Parameters
    ----------
    inputs : Inputs
        What the report rests on.
    points : sequence of mapping
        Cases of the tuning result, the worst first.
    """
    found: list[str] = []
    if points:
        found += _cases(points)
    if "bank" in inputs.results:
        found.append(bank_sentence(inputs.results["bank"]))
    found += farm_sentences(inputs.results)
    if not found:
        return ["This report holds the measured admittance; no verdict on a grid was asked for."]
    if "verification" in inputs.results:
        found.append(_in_time(inputs.results["verification"]))
    return [_ended(text) for text in found]


def farm_sentences(results: Mapping[str, Any]) -> list[str]:
    """The farm's verdict, and how many of its switching states are what."""
    found = []
    if "farm" in results:
        found.append(f"The farm is {_word(results['farm']['verdict'])}: {results['farm']['reason']}")
    if "states" in results:
        states = results["states"]["states"]
        counts = Counter(
            _word(state["verdict"]) if state["verdict"] else "without an operating point" for state in states
        )
        found.append(f"Of {len(states)} switching states {', '.join(f'{n} {word}' for word, n in counts.items())}")
    return [_ended(text) for text in found]


def _cases(points: Sequence[Mapping[str, Any]]) -> list[str]:
    worst = points[0]
    if len(points) == 1:
        return [sentence_of(worst), *_with_k(worst)]
    counts = Counter(point["verdict"] for point in points)
    parts = [f"{counts[name]} {_word(name)}" for name in VERDICTS if counts[name]]
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    if len(parts) == 1:
        listed = f"all {listed}"
    return [f"Of {len(points)} cases {listed}.", f"The worst: {sentence_of(worst)}", *_with_k(worst)]


def sentence_of(point: Mapping[str, Any]) -> str:
    """One case: its verdict, the oscillation and the margin."""
    scale = "" if point["scale"] == 1.0 else f" on {point['scale']:g} times the grid impedance"
    text = f"{_SAID.get(point['verdict'], point['verdict'])} at operating point {point['op_id']}{scale}"
    return f"{text}{_why(point)}."


def _why(point: Mapping[str, Any]) -> str:
    if point["verdict"] == "undecided":
        return f"; the data do not carry a verdict: {point.get('reason', '').rstrip('.')}"
    return _mode(point) + _margin(point)


def _mode(point: Mapping[str, Any]) -> str:
    """What the resonance does, in words."""
    pair = point.get("resonance_hz")
    if not pair:
        return ""
    where = f"an oscillation at {pair[0]:.3g} and {pair[1]:.3g} Hz"
    rate = next((p["re_rad_s"] for p in point.get("poles") or [] if p["kind"] == "resonance"), None)
    if rate is None or rate == 0.0:
        return f": {where}"
    time = f"{math.log(2.0) / abs(rate):.2g} s"
    return f": {where} doubles every {time}" if rate > 0.0 else f": {where} dies out, halving every {time}"


def _margin(point: Mapping[str, Any]) -> str:
    m = point.get("margin_m")
    if m is None:
        return ""
    return f"; the margin m is {m:.3g}, and the required one is {'met' if point.get('margin_met') else 'not met'}"


def _with_k(point: Mapping[str, Any]) -> list[str]:
    """What `tune --confirm` measured with damping control in place; nothing where it was not asked."""
    confirmed, k, margin = (point.get(key) for key in ("with_k", "k", "margin_m_with_k"))
    if not confirmed or k is None:
        return []
    reached = "" if margin is None else f", with a margin of {margin:.3g}"
    return [f"With damping gain k = {k:.3g} in place the device was swept again: {confirmed['verdict']}{reached}."]


def _in_time(verification: Mapping[str, Any]) -> str:
    runs = "; ".join(f"{name} damping control: {run['outcome']}" for name, run in verification["runs"].items())
    return f"Confirmed in time at {verification['op_id']}: {runs}"


def _word(verdict: str) -> str:
    return _SAID.get(verdict, verdict).lower()


def _ended(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
