"""What an FMU declares of its variables counts: units are converted, constants and bounds are kept."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from seqsweep.plant.fmu.units import scale_of
from seqsweep.plant.fmu.variables import Contents, FmuError, find_settable, setting


def variable(name="v", **said):
    """A variable as fmpy describes it."""
    blank = {
        **{"type": "Real", "causality": "input", "variability": "continuous", "initial": "exact", "shape": ()},
        **{"unit": None, "min": None, "max": None, "declaredType": None, "valueReference": 1},
    }
    return SimpleNamespace(name=name, **{**blank, **said})


def contents(*variables, units=()):
    """An FMU of variables and of units by name, factor and exponents of kg, m, s, A."""
    definitions = [
        SimpleNamespace(name=name, baseUnit=SimpleNamespace(kg=kg, m=m, s=s, A=a, factor=factor))
        for name, factor, (kg, m, s, a) in units
    ]
    described = SimpleNamespace(unitDefinitions=definitions)
    return Contents("b.fmu", described, 2, {each.name: each for each in variables})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("quantity", "unit", "factor"),
    [
        ("voltage", "kV", 1e3),
        ("voltage", "V", 1.0),
        ("voltage", None, 1.0),
        ("current", "kA", 1e3),
        ("current", "mA", 1e-3),
        ("power", "MW", 1e6),
    ],
)
def test_a_declared_unit_is_converted(quantity, unit, factor):
    assert scale_of(contents(), "key", quantity, [variable(unit=unit), variable("w", unit=unit)], None) == factor


def test_the_definition_of_a_unit_counts_before_its_name():
    own = contents(units=[("U", 690.0, (1, 2, -3, -1)), ("I", 2.0, (0, 0, 0, 1))])
    assert scale_of(own, "voltage", "voltage", [variable(unit="U")], None) == 690.0
    with pytest.raises(FmuError, match="is in 'I', which is no unit of a voltage known here: give voltage_unit_v"):
        scale_of(own, "voltage", "voltage", [variable(unit="I")], None)


def test_the_unit_of_a_declared_type_counts_too():
    typed = variable(declaredType=SimpleNamespace(unit="kV", items=[], min=None, max=None))
    assert scale_of(contents(), "voltage", "voltage", [typed], None) == 1e3


def test_what_the_campaign_says_overrules_and_contradictions_are_refused():
    mixed = [variable(unit="kV"), variable("w", unit="V")]
    assert scale_of(contents(), "voltage", "voltage", mixed, 5.0) == 5.0
    with pytest.raises(FmuError, match="its variables are in V and kV; needed: one unit, or voltage_unit_v"):
        scale_of(contents(), "voltage", "voltage", mixed, None)
    with pytest.raises(FmuError, match="is in 'pu', which is no unit of a current"):
        scale_of(contents(), "current", "current", [variable(unit="pu")], None)


def test_a_constant_cannot_be_set():
    gain = variable("gain", causality="local", variability="constant")
    with pytest.raises(FmuError, match="is a constant: no campaign can set it"):
        find_settable(contents(gain), "start", "gain")


ITEMS = SimpleNamespace(items=[SimpleNamespace(name=n, value=v) for n, v in (("low", "1"), ("high", "3"))], unit=None)


def test_an_enumeration_takes_its_items_alone():
    mode = variable("mode", type="Enumeration", declaredType=ITEMS)
    assert setting("start", mode, 3).values == (3,)
    with pytest.raises(FmuError, match=r"variable 'mode' has the items 1 \(low\), 3 \(high\); given 2"):
        setting("start", mode, 2)


@pytest.mark.parametrize("value", [0.5, 2.5])
def test_a_value_beyond_its_bounds_is_refused(value):
    bounded = variable("k", min="1.0", max="2.0")
    assert setting("start", bounded, 1.5).values == (1.5,)
    with pytest.raises(FmuError, match="variable 'k' lies between 1 and 2; given"):
        setting("start", bounded, value)
