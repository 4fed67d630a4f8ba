"""modelDescription.xml of the tests' FMUs, as FMI 2.0 and as FMI 3.0 have it."""

from __future__ import annotations

from typing import NamedTuple


class Variable(NamedTuple):
    """A variable; ``kind`` is "real", "whole" or "truth", ``initial`` and ``start`` are left out where None."""

    name: str
    reference: int
    causality: str
    variability: str = "continuous"
    start: float | None = 0.0
    initial: str | None = None
    unit: str | None = None
    width: int = 1
    kind: str = "real"


TYPES = {
    "2": {"real": "Real", "whole": "Integer", "truth": "Boolean"},
    "3": {"real": "Float64", "whole": "Int32", "truth": "Boolean"},
}


def description(
    model: str,
    variables: list[Variable],
    state: bool = False,
    version: str = "2.0",
    interface: str = "CoSimulation",
    step_s: float | None = None,
    **attributes: str,
) -> str:
    """The text; ``attributes`` are those of the interface, ``step_s`` is the default experiment's."""
    third = version.startswith("3")
    flags = {f"canGetAndSetFMU{'S' if third else 's'}tate": str(state).lower(), "modelIdentifier": model, **attributes}
    written = " ".join(f'{name}="{value}"' for name, value in flags.items())
    units = "".join(f'<Unit name="{unit}"/>' for unit in sorted({v.unit for v in variables if v.unit}))
    parts = [
        f"<{interface} {written}/>",
        f"<UnitDefinitions>{units}</UnitDefinitions>" if units else "",
        f'<DefaultExperiment startTime="0" stepSize="{step_s}"/>' if step_s else "",
        f"<ModelVariables>{''.join((_third if third else _second)(v) for v in variables)}{_TIME if third else ''}",
        f"</ModelVariables><ModelStructure>{(_outputs_3 if third else _outputs_2)(variables)}</ModelStructure>",
    ]
    token = "instantiationToken" if third else "guid"
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="{version}" modelName="{model}" '
        f'{token}="{{4711}}" version="3">{"".join(parts)}</fmiModelDescription>'
    )


_TIME = '<Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>'


def _second(v: Variable) -> str:
    assert v.width == 1
    return f"<ScalarVariable {_about(v)}><{TYPES['2'][v.kind]}{_value(v)}/></ScalarVariable>"


def _third(v: Variable) -> str:
    kind = TYPES["3"][v.kind]
    dimension = f'<Dimension start="{v.width}"/>' if v.width > 1 else ""
    return f"<{kind} {_about(v)}{_value(v)}>{dimension}</{kind}>"


def _about(v: Variable) -> str:
    about = f'name="{v.name}" valueReference="{v.reference}" causality="{v.causality}" variability="{v.variability}"'
    return f'{about} initial="{v.initial}"' if v.initial else about


def _value(v: Variable) -> str:
    start = "" if v.start is None else f' start="{" ".join([f"{v.start:g}"] * v.width)}"'
    return f'{start} unit="{v.unit}"' if v.unit else start


def _outputs_2(variables: list[Variable]) -> str:
    outputs = [(k + 1, v) for k, v in enumerate(variables) if v.causality == "output"]
    every, unknown = (
        "".join(f'<Unknown index="{k}"/>' for k, v in outputs if all_of or v.initial != "exact")
        for all_of in (True, False)
    )
    return f"<Outputs>{every}</Outputs>" + (f"<InitialUnknowns>{unknown}</InitialUnknowns>" if unknown else "")


def _outputs_3(variables: list[Variable]) -> str:
    return "".join(f'<Output valueReference="{v.reference}"/>' for v in variables if v.causality == "output")
