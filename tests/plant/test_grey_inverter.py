"""Sealed controllers in the general inverter circuit: the circuit, the operating point, the start-up, and the draft."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from seqsweep.plant.controllers.cigre_abi import DataType, Port
from seqsweep.plant.controllers.draft import Rating, given_as, told_as
from seqsweep.plant.greybox.circuit import forcing
from seqsweep.plant.greybox.inverter_circuit import InverterCircuit, at_rest, moments, network
from seqsweep.plant.protocol import Conditions, Job, NotSettled, OperatingPoint, Source
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.file import parse

from ..support.commands import command
from ..support.controllers import (
    BATTERY_MAP,
    FOLLOWING_MAP,
    FORMING_MAP,
    INVERTER_CIRCUIT,
    build_inverter,
    needs_compiler,
)
from ..support.sweeps import planned, rows_of, y_of

U, S, W1 = 600.0, 1e6, 2.0 * pi * 60.0
P, Q = 0.4e6, 0.1e6
GRID = Source("thevenin", 0.0072, 0.072 / W1)


def inverter(*switches: str, signals, **more):
    parameters = {"controller": f"cigre:{build_inverter(*switches)}", **signals, **INVERTER_CIRCUIT}
    return make_plant("inverter-grey-v1", {**parameters, "settle_tolerance": 1e-8, "patience_s": 20.0, **more})


def power_of(plant, state) -> complex:
    """P + jQ out of the device over three periods."""
    ((_, record),) = plant.run([Job(state, None)], round(3.0 / 60.0 / plant.dt_s))
    return complex(np.mean(-1.5 * record.v * record.i.conj()))


# ---------------------------------------------------------------------- the circuit


@pytest.mark.parametrize("source", [Source(), GRID], ids=lambda source: source.kind)
@pytest.mark.parametrize("r_p_ohm", [2.0, 1e9], ids=["with R across C", "without"])
def test_step_of_the_circuit_is_its_impedances(source, r_p_ohm):
    """With the bridge shorted, a rotating source voltage sees the ladder network, exactly at every frequency."""
    p = InverterCircuit(r_p_ohm=r_p_ohm)
    dt_s, z = 2e-4, source.r_ohm + 0j
    for f_hz in (-50.0, 3.0, 50.0, 777.0, 2100.0):
        s = 2j * pi * f_hz
        step, driven = network(p, source, dt_s), forcing(moments(p, source, dt_s), f_hz, dt_s)
        x = np.linalg.solve(np.exp(s * dt_s) * np.eye(3) - step.phi[:3], driven[:3])
        shunt = 1.0 / (p.r_c_ohm + 1.0 / (s * p.c_f_f)) + 1.0 / p.r_p_ohm + 1.0 / (p.r_f_ohm + s * p.l_f_h)
        z = source.r_ohm + s * source.l_h
        inside = p.r_g_ohm + s * p.l_g_h + 1.0 / shunt
        i_in = 1.0 / (inside + z)
        assert step.i_states @ x == pytest.approx(-i_in, rel=1e-9)
        assert step.v_states @ x + step.v_source == pytest.approx(i_in * inside, rel=1e-9)
        assert step.f_states @ x == pytest.approx(i_in / shunt, rel=1e-9)


def test_circuit_at_rest_gives_the_power_that_was_asked():
    p = InverterCircuit(r_p_ohm=3.0)
    rest = at_rest(p, complex(P, Q), U)
    assert rest.v_pcc * rest.i_g.conjugate() == pytest.approx(complex(P, Q))
    lost = (
        p.r_f_ohm * abs(rest.i_l) ** 2 + p.r_g_ohm * abs(rest.i_g) ** 2 + abs(_node(p, rest)) ** 2 / p.r_p_ohm
    ) + p.r_c_ohm * abs(rest.i_l - rest.i_g - _node(p, rest) / p.r_p_ohm) ** 2
    assert (rest.v_conv * rest.i_l.conjugate()).real == pytest.approx(P + lost)


def _node(p, rest):
    return rest.v_pcc + complex(p.r_g_ohm, p.w1_rad_s * p.l_g_h) * rest.i_g


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"l_g_h": 0.0}, "l_g_h is 0.0; inverter-grey-v1 needs a finite number above 0"),
        ({"r_g_ohm": -1.0}, "needs a finite number of at least 0"),
        ({"lg_h": 1e-4}, "has no parameter 'lg_h'.*l_g_h"),
        ({"believed_from_s": -1.0}, "needs a time of at least 0"),
    ],
)
@needs_compiler
def test_wrong_parameters_are_refused(parameters, words):
    with pytest.raises(ValueError, match=words):
        inverter("FORMING", signals=FORMING_MAP, **parameters)


# ---------------------------------------------------------------------- controllers in it


@needs_compiler
@pytest.mark.parametrize("source", [Source(), GRID], ids=lambda source: source.kind)
@pytest.mark.parametrize(
    ("switches", "signals"),
    [((), FOLLOWING_MAP), (("FORMING",), FORMING_MAP), (("BATTERY",), BATTERY_MAP)],
    ids=["15 in, 15 out", "12 in, 12 out", "arrays, hidden statics, gate"],
)
def test_ports_of_public_controllers_settle_at_their_operating_point(switches, signals, source):
    plant = inverter(*switches, signals=signals)
    state = plant.settle(OperatingPoint(P, U, Q), source)
    ((_, record),) = plant.run([Job(state, None)], round(3.0 / 60.0 / plant.dt_s))
    assert np.abs(record.v) * 1.5**0.5 == pytest.approx(np.full(len(record.v), U), rel=1e-4)
    assert np.mean(-1.5 * record.v * record.i.conj()).real == pytest.approx(P, rel=0.02)


@needs_compiler
def test_admittance_behind_a_grid_is_that_on_an_ideal_source():
    plant = inverter("FORMING", signals=FORMING_MAP)
    point = {"active_power_mw": P / 1e6, "reactive_power_mvar": Q / 1e6, "terminal_voltage_pu": 1.0}
    f_hz = [10.0, 45.0, 90.0, 400.0]
    tables = [
        y_of(rows_of(plant, planned(plant, f_hz=f_hz, point=point, source=source)))
        for source in ({"kind": "ideal"}, {"kind": "thevenin", "r_ohm": 0.0072, "x_ohm": 0.072})
    ]
    apart = np.linalg.norm(tables[0] - tables[1], axis=(1, 2)) / np.linalg.norm(tables[0], axis=(1, 2))
    assert apart.max() < 1e-3  # what is held for 10 us moves differently behind an inductance


@needs_compiler
def test_a_blocked_bridge_is_no_rest():
    signals = {**BATTERY_MAP, "inputs": {**BATTERY_MAP["inputs"], "enable": 0}}
    plant = inverter("BATTERY", signals=signals, snapshot="copy")
    with pytest.raises(NotSettled, match=r"keeps its bridge blocked .output 'pwm_enable' is 0"):
        plant.settle(OperatingPoint(P, U), Source())


@needs_compiler
def test_nothing_is_believed_before_the_start_up_is_over():
    """Without the word for it a device that waits counts as settled, at no power."""
    early = inverter(signals=FOLLOWING_MAP, settings={"StartUp": 1.5})
    late = inverter(signals=FOLLOWING_MAP, settings={"StartUp": 1.5}, believed_from_s=1.6)
    assert abs(power_of(early, early.settle(OperatingPoint(P, U), Source())).real) < 0.05 * P
    assert power_of(late, late.settle(OperatingPoint(P, U), Source())).real == pytest.approx(P, rel=0.02)


@needs_compiler
def test_a_battery_feeds_the_dc_link():
    plant = inverter(signals=FOLLOWING_MAP, c_dc_f=0.02, r_dc_ohm=0.05)
    behind = plant.settle(OperatingPoint(P, U), GRID)
    _, trace = plant.trace(behind, Conditions(GRID.r_ohm, GRID.l_h), 400)
    e_v = 1200.0 + 0.05 * P / 1200.0
    power = np.mean(trace.v_dc_v * (e_v - trace.v_dc_v) / 0.05)
    assert power == pytest.approx(power_of(plant, behind).real, rel=0.02)
    with pytest.raises(ValueError, match="no fault at the PCC"):
        plant.trace(behind, Conditions(GRID.r_ohm, GRID.l_h, fault_s=(1.0, 0.0, 1.0)), 1)


@needs_compiler
def test_two_gates_are_refused():
    outputs = {**FORMING_MAP["outputs"], "Idref": "gate", "Iqref": "gate"}
    with pytest.raises(ValueError, match="'gate' belongs to one port of one number"):
        inverter("FORMING", signals={**FORMING_MAP, "outputs": outputs})


# ---------------------------------------------------------------------- the draft


RATING = Rating(690.0, 2e6, 50.0, 1200.0)
DOUBLE = DataType("real64", "f8", "real64")


@pytest.mark.parametrize(
    ("name", "unit", "width", "others", "signal"),
    [
        ("Vta", "kV", 1, (), '"v_f_a"'),
        ("v_ac", "V", 3, (), '"v_f_abc"'),
        ("I1b", "kA", 1, (), '"i_l_b"'),
        ("I2c", "kA", 1, (), '"i_g_c"'),
        ("IaL1", "kA", 1, ("Ia",), '"i_l_a"'),
        ("Ia", "kA", 1, ("IaL1",), '"i_g_a"'),
        ("Ia", "A", 1, ("Va",), '"i_l_a"'),
        ("Vdc_meas", "kV", 1, (), '"v_dc"'),
        ("VdcMPPT", "kV", 1, (), "{ value = 1.2 }"),
        ("Idc", "kA", 1, (), '"i_dc"'),
        ("Pref", "pu", 1, (), '{ signal = "p_ref", base = 2e+06 }'),
        ("Q_request", "var", 1, (), '"q_ref"'),
        ("Vref", "pu", 1, (), '{ signal = "v_ref", base = 690 }'),
        ("P_lim_low", "MW", 1, (), "{ value = -2.4 }"),
        ("enable", "", 1, (), "{ value = 1 }"),
        ("temperature", "C", 1, (), "{ value = 0.0 }"),
    ],
)
def test_ports_are_guessed_from_name_and_unit(name, unit, width, others, signal):
    assert told_as(Port(name, "", unit, DOUBLE, width), [name, *others], RATING) == signal


@pytest.mark.parametrize(
    ("name", "unit", "width", "signal"),
    [
        ("m_a", "", 1, '"m_conv_a"'),
        ("Eb", "kV", 1, '"v_conv_b"'),
        ("v_bridge", "V", 3, '"v_conv_abc"'),
        ("pwm_enable", "", 1, '"gate"'),
        ("Pout", "MW", 1, ""),
    ],
)
def test_outputs_are_guessed_too(name, unit, width, signal):
    assert given_as(Port(name, "", unit, DOUBLE, width)) == signal


@needs_compiler
@pytest.mark.parametrize(
    ("switches", "signals"),
    [((), FOLLOWING_MAP), (("FORMING",), FORMING_MAP), (("BATTERY",), BATTERY_MAP)],
    ids=["15 in, 15 out", "12 in, 12 out", "arrays"],
)
def test_a_drafted_campaign_is_swept_as_it_is(tmp_path, switches, signals):
    library = build_inverter(*switches)
    campaign, table = tmp_path / "drafted.toml", tmp_path / "y.parquet"
    made = command("init", "--plant", library, "-o", campaign)
    assert made.returncode == 0, made.stderr
    drafted = parse(campaign.read_text(), campaign)["plant"]["parameters"]
    assert set(drafted["inputs"]) == set(signals["inputs"])
    assert set(drafted["outputs"]) == set(signals["outputs"])
    short = ["--set", "sweep.f_hz=[12.0, 40.0, 200.0]"]
    text = campaign.read_text()
    campaign.write_text(
        text.replace("f_min_hz = 1.0\n", "").replace("f_max_hz = 1000.0\n", "").replace("points = 60\n", "")
    )
    swept = command("run", campaign, "-o", table, *short)
    assert swept.returncode == 0, swept.stderr
    assert "3 ok" in swept.stdout + swept.stderr


def test_only_a_real_code_controller_is_drafted(tmp_path):
    other = tmp_path / "plant.py"
    other.write_text("x = 1\n")
    for given in (other, tmp_path / "none.so"):
        refused = command("init", "--plant", given, "-o", tmp_path / "c.toml")
        assert refused.returncode == 2
        assert "--plant" in refused.stderr
        assert not (tmp_path / "c.toml").exists()
