"""Grids of elements against a tableau of all voltages and currents, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from seqsweep.tuning.grids.document import KINDS as ELEMENT_KINDS
from seqsweep.tuning.grids.elements import CableGrid, ElementsGrid, elements_grid, strengths, varied
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.grids.promise import Grid
from tests.support.networks import KINDS, W1, impedance_of, random_document

F = np.geomspace(0.5, 4000.0, 40)
S = 2j * np.pi * F
TRANSFORMER = {"kind": "transformer", "sn_mva": 2.0, "vn_lv_kv": 0.69, "vn_hv_kv": 35.0, "vk_percent": 6.0}
SERIES = {"kind": "series", "r_ohm": 0.01, "x_ohm": 0.25}
CABLE = {"kind": "cable", "r_ohm_per_km": 0.05, "l_mh_per_km": 0.35, "c_nf_per_km": 250.0}
SOURCE = {"kind": "source", "s_sc_mva": 500.0, "r_over_x": 0.1}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_every_ladder_has_the_impedance_of_its_tableau(kind: str, seed: int) -> None:
    document = random_document(np.random.default_rng(seed), kind)
    grid = elements_grid(document, 50.0)
    assert isinstance(grid, ElementsGrid)
    assert isinstance(grid, Grid)
    np.testing.assert_allclose(grid.impedance(S), impedance_of(document, S), rtol=1e-9)
    np.testing.assert_allclose(grid.scaled(1.7).impedance(S), impedance_of(document, S, 1.7), rtol=1e-9)


def test_the_dq_impedance_is_that_of_the_phase_frame_turned_either_way() -> None:
    grid = elements_grid(random_document(np.random.default_rng(3), "all"), 50.0)
    z = grid.impedance_dq(S)
    np.testing.assert_allclose(z[:, 0, 0] + 1j * z[:, 1, 0], grid.impedance(S + 1j * W1), rtol=1e-12)
    np.testing.assert_allclose(z[:, 0, 0] - 1j * z[:, 1, 0], grid.impedance(S - 1j * W1), rtol=1e-9)
    step = 1e-4
    slope = (grid.impedance_dq(S + step) - grid.impedance_dq(S - step)) / (2.0 * step)
    np.testing.assert_allclose(grid.slope_dq(S), slope, atol=1e-7 * np.abs(slope).max())


def test_the_descriptor_and_the_impedance_are_one() -> None:
    grid = elements_grid(random_document(np.random.default_rng(5), "all"), 50.0).scaled(1.3)
    system = grid.descriptor()
    for s in S[::8]:
        v = system.c @ np.linalg.solve(s * system.e - system.a, system.b)
        np.testing.assert_allclose(-v, grid.impedance_dq(np.array([s]))[0], rtol=1e-8)


def test_a_series_capacitor_is_a_pole_on_the_axis_that_the_clearing_takes_out() -> None:
    grid = elements_grid({"element": [SERIES, {"kind": "series_capacitor", "x_ohm": 0.1}]}, 50.0)
    np.testing.assert_allclose(grid.axis_poles, [W1], rtol=1e-9)
    near = 1j * W1 + np.array([1e-3, 1e-4, 0.0])
    cleared = grid.clearing(near) * np.linalg.det(grid.impedance_dq(near))
    assert np.all(np.isfinite(cleared))
    np.testing.assert_allclose(cleared, cleared[0], rtol=1e-3)


def test_compensation_is_a_part_of_the_lines_reactance() -> None:
    """40 % of 0.25 ohm at the fundamental leave 0.15 ohm; the transformer's reactance is not counted."""
    line = {"element": [SERIES, {"kind": "series_capacitor", "compensation_percent": 40.0}]}
    assert elements_grid(line, 50.0).at_f1 == pytest.approx(0.01 + 0.15j)
    nothing = {"element": [SERIES, {"kind": "series_capacitor", "compensation_percent": 0.0}]}
    assert elements_grid(nothing, 50.0).at_f1 == pytest.approx(0.01 + 0.25j)


def test_short_circuit_power_transformer_and_tap_are_those_of_a_data_sheet() -> None:
    """At 0.69 kV: 500 MVA at 35 kV is 2.45 ohm, seen through (0.69/35)^2; 6 % of 0.69^2/2 ohm in front."""
    transformer = {"kind": "transformer", "sn_mva": 2.0, "vn_lv_kv": 0.69, "vn_hv_kv": 35.0, "vk_percent": 6.0}
    document = {"voltage_kv": 0.69, "element": [{**transformer, "vkr_percent": 0.6}, SOURCE]}
    z_t = 0.69**2 / 2.0 * (0.006 + 1j * np.sqrt(0.06**2 - 0.006**2))
    z_s = 35.0**2 / 500.0 * (0.1 + 1j) / np.sqrt(1.01)
    ratio = 0.69 / 35.0
    assert elements_grid(document, 50.0).at_f1 == pytest.approx(z_t + ratio**2 * z_s)
    tapped = varied(document, 0, "tap_percent", 5.0)
    assert elements_grid(tapped, 50.0).at_f1 == pytest.approx(z_t + (ratio / 1.05) ** 2 * z_s)


def test_a_short_circuit_ratio_is_that_power_over_the_rating() -> None:
    document = {
        "voltage_kv": 0.69,
        "rated_power_mw": 2.0,
        "element": [{"kind": "source", "scr": 4.0, "x_over_r": 10.0}],
    }
    z = elements_grid(document, 50.0).at_f1
    assert abs(z) == pytest.approx(0.69**2 / 8.0)
    assert z.imag / z.real == pytest.approx(10.0)


def test_a_filter_gives_its_reactive_power_at_the_fundamental_and_is_smallest_where_it_is_tuned() -> None:
    entry = {"kind": "filter", "q_mvar": 0.3, "tuned_hz": 250.0, "quality": 1e6}
    weak = {"kind": "series", "x_ohm": 1e6}
    grid = elements_grid({"voltage_kv": 0.69, "element": [entry, weak]}, 50.0)
    assert grid.at_f1.imag == pytest.approx(-(0.69**2) / 0.3, rel=1e-3)
    assert abs(grid.impedance(np.array([2j * np.pi * 250.0]))[0]) < 1e-3


@pytest.mark.parametrize("length_km", [20.0, 60.0, 150.0, 300.0])
def test_a_distributed_cable_follows_its_closed_form(length_km: float) -> None:
    document = {"element": [{"kind": "series", "r_ohm": 0.1, "x_ohm": 2.0}, {**CABLE, "length_km": length_km}, SERIES]}
    grid = elements_grid(document, 50.0)
    assert isinstance(grid, CableGrid)
    x = length_km * np.sqrt((0.05 + S * 0.35e-3) * S * 0.25e-6)
    zc = np.sqrt((0.05 + S * 0.35e-3) / (S * 0.25e-6))
    behind = 0.01 + S * 0.25 / W1
    expected = 0.1 + S * 2.0 / W1 + zc * (behind + zc * np.tanh(x)) / (zc + behind * np.tanh(x))
    np.testing.assert_allclose(grid.impedance(S), expected, rtol=1e-7)
    assert np.all(grid.phase_modes.real < 0.0)


@pytest.mark.parametrize("seed", [0, 2, 3, 5, *(pytest.param(k, marks=pytest.mark.evidence) for k in (1, 4))])
def test_no_network_with_long_cables_is_refused_for_its_resonances(seed: int) -> None:
    """Two cables of up to 300 km beside whatever else stands in a grid: the states give the closed form."""
    rng = np.random.default_rng(seed)
    lengths = rng.uniform(20.0, 300.0, 2).tolist()
    others = [{"kind": "shunt_capacitor", "c_uf": 2.0}, {"kind": "series_capacitor", "x_ohm": 1.0}]
    others.append({"kind": "filter", "c_uf": 0.5, "tuned_hz": 350.0, "quality": 30.0})
    cables = [{**CABLE, "length_km": length} for length in lengths[: 1 + seed % 2]]
    grid = elements_grid({"element": [SERIES, others[seed % 3], *cables, {**SERIES, "x_ohm": 2.0}]}, 50.0)
    assert isinstance(grid, CableGrid)
    np.testing.assert_allclose(grid.impedance(S), grid.closed_form(S), rtol=1e-7)


def test_nodes_make_a_ring_of_two_parallel_lines() -> None:
    line = {"kind": "series", "r_ohm": 0.02, "x_ohm": 0.5, "from": "pcc", "to": "bus"}
    document = {"element": [line, dict(line), {**SERIES, "from": "bus", "to": "source"}]}
    assert elements_grid(document, 50.0).at_f1 == pytest.approx(0.02 + 0.5j)


def test_what_is_out_of_service_does_not_count() -> None:
    shunt = {"kind": "shunt_capacitor", "c_uf": 300.0, "in_service": False}
    assert elements_grid({"element": [shunt, SERIES]}, 50.0).at_f1 == pytest.approx(0.01 + 0.25j)


def test_every_kind_says_what_of_it_can_be_varied() -> None:
    document = {"element": [{"kind": "shunt_capacitor", "c_uf": 300.0}, SERIES]}
    assert strengths(document, 50.0) == {
        "shunt_capacitor1": (0, "c_uf", 300.0),
        "series1": (1, "x_ohm", 0.25),
    }
    assert all(kind.strength for kind in ELEMENT_KINDS.values())


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({}, "needs at least one"),
        ({"element": []}, "needs at least one"),
        ({"elements": []}, "did you mean 'element'"),
        ({"f1_hz": 60.0, "element": [SERIES]}, "fundamental is 50 Hz"),
        ({"element": [{"kind": "reactor"}]}, "known are series"),
        ({"element": [{"kind": "series", "r_ohms": 0.1, "x_ohm": 1.0}]}, "did you mean 'r_ohm'"),
        ({"element": [{"kind": "series", "r_ohm": -0.1, "x_ohm": 1.0}]}, "not negative"),
        ({"element": [{"kind": "series"}]}, "above 0"),
        ({"element": [{"kind": "source", "s_sc_mva": 10.0}]}, "give voltage_kv"),
        ({"element": [{"kind": "source", "scr": 3.0}], "voltage_kv": 0.69}, "rated_power_mw"),
        ({"element": [{**SERIES, "in_service": False}]}, "no grid left"),
        ({"element": [SERIES, {"kind": "shunt_capacitor", "c_uf": 1.0}]}, "no effect"),
        ({"element": [{"kind": "shunt_capacitor", "c_uf": 1.0, "q_mvar": 1.0}, SERIES]}, "exactly one"),
        ({"element": [{"kind": "series_capacitor", "compensation_percent": 20.0}]}, "no line"),
        ({"element": [SERIES, {"kind": "series_capacitor", "compensation_percent": 120.0}]}, "at most 100"),
        ({"element": [{**TRANSFORMER, "vn_hv_kv": 35e3}, SERIES], "voltage_kv": 0.69}, "V and kV mixed up"),
        ({"element": [TRANSFORMER, SERIES], "voltage_kv": 690.0}, "stands where the voltage is 690 kV"),
        ({"element": [SERIES, TRANSFORMER], "voltage_kv": 690.0}, "stands where the voltage is 690 kV"),
        ({"element": [{**SERIES, "in_service": "no"}]}, "in_service = 'no'; needed is true or false"),
        ({"element": [SERIES, {**SERIES, "in_service": 0}]}, "element 2: in_service = 0; needed is true or false"),
        ({"element": [{**SERIES, "l_mh": 0.3}]}, "x_ohm and l_mh say the same quantity"),
        ({"element": [{**SOURCE, "x_over_r": 9.0}], "voltage_kv": 0.69}, "r_over_x and x_over_r say the same"),
        ({"element": [{**CABLE, "length_km": 1.0, "x_ohm_per_km": 0.1}]}, "l_mh_per_km say the same"),
        ({"element": [{"r_ohm": 0.1, "x_ohm": 1.0}]}, "element 1 has no kind"),
        ({"element": [{"kind": "source", "scr": 3.0, "rated_power_mw": 2.0}]}, "stands at the top of the document"),
        ({"element": [{**CABLE, "length_km": 20000.0}]}, "a wave takes 187 ms through .* cable1 of 20000 km"),
        ({"element": [{**CABLE, "length_km": 0.0}]}, "above 0"),
        ({"element": [{**SERIES, "name": "a"}, {**SERIES, "name": "a"}]}, "two elements"),
        ({"element": [{**SERIES, "from": "a", "to": "b"}]}, "not connected|'pcc'"),
    ],
)
def test_a_document_that_is_no_grid_is_refused_with_the_way_out(document: dict, words: str) -> None:
    with pytest.raises(GridError, match=words):
        elements_grid(document, 50.0)
