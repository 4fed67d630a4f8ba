"""The farm in a report: load flow, modes, one-line diagram, advice, switching states; also as a report of its own.

A farm names its tables itself and has many, so that its JSON needs no table beside it: everything shown stands in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from .inputs import ALONE, FarmInputs
from .repeat import farm_commands
from .svg import Picture, drawn, points_under
from .words import farm_sentences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pictures import Hover

Content = Mapping[str, Any]


def farm_content(results: Mapping[str, Any]) -> dict[str, Any]:
    """What the farm's part of a page is made of; keys are None where there is nothing."""
    farm, states = results.get("farm"), results.get("states")
    return {
        "farm": farm,
        "farm_diagram": _diagram(farm) if farm and farm.get("network") else None,
        "farm_advice": [_advice(each) for each in farm.get("advice", [])] if farm else [],
        "farm_states": states,
    }


def alone_content(inputs: FarmInputs) -> dict[str, Any]:
    """What a page of the farm alone is made of, besides its looks."""
    farm, states = (inputs.results.get(kind) for kind in ALONE)
    name = (farm or states or {}).get("farm", "farm")
    verdicts = [farm["verdict"]] if farm else [str(state["verdict"]) for state in states["states"]] if states else []
    return {
        **farm_content(inputs.results),
        "title": f"Farm: {name}",
        "worst": next((verdict for verdict in ("unstable", "undecided", "stable") if verdict in verdicts), "undecided"),
        "sentences": farm_sentences(inputs.results),
        "files": inputs.files,
        "tables": sorted({device["table"] for device in farm["devices"]}) if farm else [],
        "commands": farm_commands(inputs),
    }


def _diagram(farm: Content) -> Picture:
    return drawn(
        "one-line",
        lambda: _drawn(farm),
        f"One-line diagram of {farm['farm']}: {len(farm['devices'])} devices on their buses, with their shares in the "
        "critical mode.",
        "One-line diagram with the critical mode: the area of a device is its share, red where more of it makes the "
        "mode less damped; a branch is as wide as the mode moves with its impedance.",
    )


def _drawn(farm: Content) -> tuple[Figure, Hover]:
    from ..farm_diagram import critical_of, devices_of, diagram_figure, laid_out

    figure = diagram_figure(farm)
    placed = devices_of(farm, laid_out(farm), critical_of(farm))
    x, y = [each.x for each in placed], [each.y for each in placed]
    return figure, lambda: points_under(figure.axes[0], x, y, [each.text for each in placed])


def _advice(advice: Content) -> dict[str, Any]:
    """Slopes of the critical mode and the changes of every choice, by device."""
    slopes = max(advice["slopes"], key=lambda each: float(each["sigma_per_s"]), default=None)
    rows = [
        {
            "name": name,
            "slope": None if slopes is None else slopes["by_device"][name]["re_per_s"],
            "changes": [choice["changes"][name] for choice in advice["choices"]],
        }
        for name in advice["devices"]
    ]
    unit = f" ({advice['unit']})" if advice["unit"] else ""
    heads = [f"{choice['way'].capitalize()}{unit}" for choice in advice["choices"]]
    return {**advice, "rows": rows, "heads": heads, "said": [_said(advice, choice) for choice in advice["choices"]]}


def _said(advice: Content, choice: Content) -> str:
    asked = f"{advice['demand']['words']} with probability {advice['demand']['probability']:g}"
    if not choice["holds"]:
        missed = "" if choice["excess"] is None else f", by {choice['excess']:.3g} {advice['demand']['unit']}"
        return f"{choice['way']}: {asked} is not reached{missed}"
    unchanged = " without any change" if not any(choice["changes"].values()) else ""
    return f"{choice['way']}: {asked} holds{unchanged}"
