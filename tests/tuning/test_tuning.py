"""From a table to the decision: results, gain, JSON, the terminal, figures, and tables that are not in order."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from seqsweep.identify.fit.model import fit_response
from seqsweep.identify.fit.rational import evaluate_pn
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.format import TableError
from seqsweep.identify.table.read import read_table
from seqsweep.identify.table.write import write_table
from seqsweep.identify.views import style
from seqsweep.tuning.figures import bode_figure, locus_figure, plot_result, pole_figure, result_figure
from seqsweep.tuning.gain import first_gain, gain_for_margin, notch, predicted_crossing, reshaped, search_gain
from seqsweep.tuning.grid_check import grid_warnings, power_limits_w, source_voltage_v
from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.open import open_grid
from seqsweep.tuning.result import PointTuning, TuningResult, confirmed, schema, to_json, write_json
from seqsweep.tuning.siso import SeriesRL, parse_grid, siso
from seqsweep.tuning.text import format_table
from seqsweep.tuning.tune import tune, tune_point

from ..identify.test_fit import F1_HZ, F_HZ, U_V, circuit, turbine
from ..support import oracle

GRID = SeriesRL(0.0168, 0.35, F1_HZ)
"""1.4 Z of Table I."""

BASES = {"rated_voltage_v": U_V, "rated_power_va": 1.632e6}


def on_grid(power_w: float, noise: float = 0.0) -> FrequencyResponse:
    """The table's row block at the voltage that belongs to the grid, the source at 1 pu."""
    return turbine(power_w, oracle.terminal_voltage(power_w, GRID.r_ohm, GRID.l_h, U_V), noise=noise)


@pytest.fixture(scope="module")
def result() -> TuningResult:
    return tune([on_grid(p) for p in (0.3e6, 0.65e6, 0.5e6)], GRID, margin=1.4)


# The decision --------------------------------------------------------------------------------------------------------


def test_every_operating_point_is_judged_in_the_table_s_order(result: TuningResult) -> None:
    assert [p.op_id for p in result.points] == ["p300", "p650", "p500"]
    assert [p.verdict for p in result.points] == ["stable", "unstable", "stable"]
    assert [p.warnings for p in result.points] == [(), (), ()]


def test_worst_operating_point_is_searched_not_assumed(result: TuningResult) -> None:
    """Here it is the largest output; among stable points it is the one with the smallest m."""
    assert result.worst.op_id == "p650"
    rest = replace(result, points=tuple(p for p in result.points if p.verdict == "stable"))
    assert rest.worst.op_id == "p500"


def test_gain_is_the_paper_s_formula_at_the_critical_crossing(result: TuningResult) -> None:
    """The notation page: m0 = 0.90 at 0.65 MW, 1.4 Z, and k = 0.357 for m = 1.4."""
    point = result.point("p650")
    assert point.margin_m == pytest.approx(0.900, abs=1e-3)
    assert point.k == pytest.approx(0.357, abs=1e-3)
    assert point.f_r_hz == pytest.approx(76.26, abs=0.01)
    assert point.margin_m_with_k is None
    assert point.reached is None


def test_resonance_pair_is_that_of_the_linearisation(result: TuningResult) -> None:
    point = result.point("p650")
    exact = oracle.resonance_pole(
        oracle.closed_loop_poles(0.65e6, GRID.r_ohm, GRID.l_h, source_voltage_v=U_V),
    )
    assert point.resonance_hz is not None
    assert point.resonance_hz[1] - F1_HZ == pytest.approx(exact.imag / 2.0 / np.pi, abs=1e-5)
    assert sum(point.resonance_hz) == pytest.approx(2.0 * F1_HZ)


def test_critical_scr_needs_the_rating_and_gets_it_from_the_table(tmp_path: Path) -> None:
    assert tune_point(on_grid(0.5e6), GRID).critical_scr is None
    point = tune(read_table(table_file(tmp_path)), GRID).points[0]
    assert point.critical_scale is not None
    assert point.critical_scr == pytest.approx(
        U_V**2 / (1.632e6 * abs(complex(GRID.r_ohm, GRID.x_ohm)) * point.critical_scale)
    )


def test_only_the_chosen_operating_points_are_tuned() -> None:
    responses = [on_grid(p) for p in (0.3e6, 0.5e6)]
    assert [p.op_id for p in tune(responses, GRID, op_ids=["p500"]).points] == ["p500"]
    with pytest.raises(ValueError, match="no operating point 'p900' in the table; it has p300, p500"):
        tune(responses, GRID, op_ids=["p900"])


def test_no_k_is_proposed_where_a_stronger_grid_is_the_trouble() -> None:
    """Stable behind 0.1 ohm, unstable by itself: on the grid of this test its negative resistance is too large."""
    response = circuit(lambda s: 1.0 / (-0.05 + s * 1e-3))
    stated = {"stable_on": {"grid": {"r_ohm": 0.1, "x_ohm": 0.25}, "basis": "stated"}}
    point = tune_point(replace(response, meta={**response.meta, **stated}), GRID)
    assert point.verdict == "unstable"
    assert point.k is None
    assert point.critical_scale == pytest.approx(0.05 / GRID.r_ohm)  # as much resistance as the device lacks
    assert any("so that none is proposed" in w for w in point.warnings)


def test_own_instability_that_nothing_proves_is_undecided_and_the_option_named() -> None:
    point = tune_point(circuit(lambda s: 1.0 / (-0.05 + s * 1e-3)), GRID)
    assert point.verdict == "undecided"
    assert "--stable-on" in point.reason


@pytest.mark.parametrize("text", ["0.012+0.25j", "0.012 + j0.25", "0.012+J0.25", "0.012+0.25i", "12e-3+j2.5e-1"])
def test_a_grid_is_read_as_it_is_printed_and_as_people_write_it(text: str) -> None:
    grid = parse_grid(text, F1_HZ)
    assert (grid.r_ohm, grid.x_ohm) == (0.012, 0.25)


def test_a_grid_in_milliohm_is_asked_about() -> None:
    bases = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}
    assert any("is that its unit?" in remark for remark in grid_warnings({}, bases, SeriesRL(12.0, 250.0, F1_HZ)))
    assert grid_warnings({}, bases, GRID) == ()


# Tables that are not in order ----------------------------------------------------------------------------------------


def test_failed_rows_are_counted_and_left_out() -> None:
    failed = np.arange(len(F_HZ)) % 10 == 0
    y = np.where(failed[:, None, None], np.nan, on_grid(0.65e6).y)
    status = np.where(failed, "failed", "ok")
    point = tune_point(FrequencyResponse(F_HZ, y, F1_HZ, status=status, meta={"op_id": "a"}), GRID)
    assert point.verdict == "unstable"
    assert point.warnings[0] == "10 of 100 rows are not ok and were left out (failed 10)"


def test_noisy_rows_count_for_what_their_covariance_says() -> None:
    """Every row of the resonance is noisy: left out, they would leave the verdict undecided."""
    rng = np.random.default_rng(5)
    about = np.abs(np.abs(F_HZ - F1_HZ) - 26.0) < 12.0
    y = on_grid(0.65e6).y
    std = np.where(about, 0.02, 0.001)[:, None, None] * np.linalg.norm(y, axis=(1, 2))[:, None, None] / 2.0
    y = y + std * (rng.normal(size=(*y.shape, 2)) @ [1.0, 1j]) * np.sqrt(0.5)
    covariance = 0.5 * std**2 * np.eye(8)
    status, reason = np.where(about, "noisy", "ok"), np.where(about, "2 %", "")
    told = FrequencyResponse(F_HZ, y, F1_HZ, covariance=covariance, status=status, reason=reason, meta={"op_id": "a"})
    point = tune_point(told, GRID)
    assert point.verdict == "unstable"
    assert f"{about.sum()} of 100 rows are noisier" in point.warnings[0]
    assert tune_point(replace(told, covariance=None), GRID).verdict == "undecided"


def test_operating_point_without_usable_rows_is_undecided_not_guessed() -> None:
    status = np.full(len(F_HZ), "not_settled")
    reason = np.full(len(F_HZ), "the PLL lost the grid")
    lost = np.full((100, 2, 2), np.nan)
    response = FrequencyResponse(F_HZ, lost, F1_HZ, status=status, reason=reason, meta={"op_id": "a"})
    result = tune([response], GRID)
    point = result.points[0]
    assert (point.verdict, point.probability, point.k, point.margin_m) == ("undecided", None, None, None)
    assert point.reason == "0 of 100 rows are usable, at least 8 are needed; not_settled: the PLL lost the grid"
    jsonschema.validate(to_json(result), schema())
    assert "undecided, 0 of 100 rows are usable" in format_table(result)


def test_table_that_no_rational_model_describes_is_undecided() -> None:
    point = tune_point(turbine(noise=0.2), GRID)
    assert point.verdict == "undecided"
    assert "no rational model describes the table" in point.reason


def test_two_fundamentals_are_refused() -> None:
    other = FrequencyResponse(F_HZ, turbine().y, 60.0, meta={"op_id": "b"})
    with pytest.raises(ValueError, match=r"holds 2 fundamentals \(50, 60 Hz\)"):
        tune([turbine(), other], GRID)


def test_wrong_calls_are_refused() -> None:
    with pytest.raises(ValueError, match="no operating point"):
        tune([], GRID)
    with pytest.raises(ValueError, match="required margin m is 0; needed is a number above 0"):
        tune([turbine()], GRID, margin=0.0)
    with pytest.raises(ValueError, match="reads the pn frame"):
        tune([FrequencyResponse(F_HZ, turbine().y, F1_HZ, frame="dq")], GRID)
    with pytest.raises(ValueError, match="the table's fundamental is 50 Hz, the grid's 60 Hz"):
        tune([turbine()], SeriesRL(0.01, 0.2, 60.0))


def table_file(folder: Path, drop: str | None = None) -> Path:
    import pyarrow.parquet as pq

    response = on_grid(0.65e6)
    meta = {
        "f1_hz": F1_HZ,
        "bases": BASES,
        "power_meaning": "machine",
        "operating_points": [dict(response.meta)],
        "configuration": {},
        "plant": {"id": "dpmsg-v1"},
    }
    path = folder / "y.parquet"
    write_table(path, [response], meta)
    if drop is not None:
        kept = pq.read_metadata(path).metadata[b"seqsweep"]
        pq.write_table(pq.read_table(path).drop_columns([drop]).replace_schema_metadata({b"seqsweep": kept}), path)
    return path


def test_table_without_a_column_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="y_pn_re"):
        tune(read_table(table_file(tmp_path, drop="y_pn_re")), GRID)


def test_result_remembers_the_table_it_came_from(tmp_path: Path) -> None:
    table = read_table(table_file(tmp_path))
    provenance = to_json(tune(table, GRID))["provenance"]
    assert provenance["table"]["sha256"] == table.meta["sha256"]
    assert provenance["table"]["plant"] == {"id": "dpmsg-v1"}


# Table and grid that do not belong together --------------------------------------------------------------------------


def test_voltage_of_another_grid_is_warned_about_and_changes_nothing() -> None:
    response = turbine(0.65e6, 720.0)
    warned = tune_point(response, GRID, bases=BASES)
    assert any("takes a source of about 1.1" in w for w in warned.warnings)
    assert warned.verdict == tune_point(response, GRID).verdict


def test_grid_of_the_sweep_is_compared_with_the_grid_of_the_tuning() -> None:
    swept = {"grid": {"r_ohm": 0.012, "x_ohm": 0.25, "voltage_pu": 1.0, "scale": 1.4}}
    assert grid_warnings(swept, BASES, GRID) == ()
    (text,) = grid_warnings(swept, BASES, GRID.scaled(1.2 / 1.4))
    assert "belongs to 0.0168 + j0.35 ohm, not to 0.0144 + j0.3 ohm" in text


def test_grid_of_the_sweep_is_found_in_the_table_s_configuration(tmp_path: Path) -> None:
    table = read_table(table_file(tmp_path))
    at = {"id": "p650", "active_power_mw": 0.65, "grid": {"r_ohm": 0.012, "x_ohm": 0.25}}
    table = replace(table, meta={**table.meta, "configuration": {"operating_point": [at]}})
    (text,) = tune(table, GRID).points[0].warnings
    assert "belongs to 0.012 + j0.25 ohm, not to 0.0168 + j0.35 ohm" in text


def test_a_grid_that_cannot_carry_the_power_has_no_operating_point_and_that_is_said() -> None:
    """|v| |v_g|/X is the most that a lossless line carries: 690^2/250 = 1.9 kW where milliohm were taken for ohm."""
    most = 690.0 * 720.0 / 0.5
    assert power_limits_w(690.0, 720.0, SeriesRL(0.0, 0.5, F1_HZ)) == pytest.approx((-most, most))
    point = {"active_power_mw": 0.65, "terminal_voltage_pu": 1.0}
    texts = grid_warnings(point, BASES, SeriesRL(12.0, 250.0, F1_HZ))
    assert any("is that its unit?" in text for text in texts)
    assert any("no operating point exists on this grid" in text and "0.00199 MW" in text for text in texts)
    assert not any("no operating point" in text for text in grid_warnings(point, BASES, GRID))
    least, most = power_limits_w(690.0, 690.0, GRID)
    for angle in np.linspace(0.0, 2.0 * np.pi, 400):
        current = (690.0 - 690.0 * np.exp(1j * angle)) / GRID.at_f1
        assert least - 1e-6 <= (690.0 * np.conj(current)).real <= most + 1e-6


def test_unknown_operating_point_is_no_reason_to_warn() -> None:
    assert grid_warnings({"active_power_mw": None, "terminal_voltage_pu": None}, BASES, GRID) == ()
    assert grid_warnings({}, {}, GRID) == ()


def test_source_voltage_is_that_of_the_phasor_diagram() -> None:
    """Without the shunt's reactive power: 4 % more than the true 690 V."""
    voltage = oracle.terminal_voltage(0.65e6, GRID.r_ohm, GRID.l_h, U_V)
    assert source_voltage_v(0.65e6, voltage, GRID) == pytest.approx(U_V, rel=0.05)


# The gain ------------------------------------------------------------------------------------------------------------


def test_formula_is_clipped_at_zero() -> None:
    assert gain_for_margin(0.7, 1.4) == pytest.approx(0.5)
    assert gain_for_margin(2.0, 1.4) == 0.0
    with pytest.raises(ValueError, match="needed is a number above 0"):
        gain_for_margin(0.9, 0.0)


def test_notch_is_zero_at_the_fundamental_and_one_elsewhere() -> None:
    h = notch(np.array([-50.0, 23.0, 50.0, 77.0]), F1_HZ)
    np.testing.assert_allclose(np.abs(h[[0, 2]]), 0.0, atol=1e-15)
    np.testing.assert_allclose(h[[1, 3]], 1.0, atol=0.03)


def test_reshaped_impedance_is_the_device_s_less_k_times_the_grid_s() -> None:
    """Paper eq. 11 read as impedances: 1/Y_re = 1/Y - k Z H_NF, element by element where there is no coupling."""

    def branch(f: np.ndarray) -> np.ndarray:
        y = np.zeros((len(f), 2, 2), dtype=complex)
        y[:, 0, 0] = 1.0 / (0.05 + 2j * np.pi * f * 1e-3)
        y[:, 1, 1] = 1.0 / (0.05 + 2j * np.pi * (f - 100.0) * 1e-3)
        return y

    f, k, f_r = np.array([23.0, 77.0]), 0.5, 77.0
    y_re = reshaped(branch, GRID, k, f_r)(f)
    z_r = k * (GRID.r_ohm + 2j * np.pi * f_r * GRID.l_h)
    np.testing.assert_allclose(1.0 / y_re[:, 0, 0], 1.0 / branch(f)[:, 0, 0] - z_r * notch(f, F1_HZ))
    mirrored = np.conj(z_r * notch(100.0 - f, F1_HZ))
    np.testing.assert_allclose(1.0 / y_re[:, 1, 1], 1.0 / branch(f)[:, 1, 1] - mirrored)


def test_prediction_gains_at_most_k(result: TuningResult) -> None:
    """1/Y_re = 1/Y - k Z gives m0 + k at best; the coupled device gives less, and the formula asks for more."""
    point = result.point("p650")
    assert point.k is not None
    assert point.margin_m is not None
    assert point.margin_m_predicted is not None
    assert point.margin_m < point.margin_m_predicted < point.margin_m + point.k < 1.4


def judged_on(elements: list[dict]) -> PointTuning:
    return tune_point(on_grid(0.65e6), elements_grid({"element": elements}, F1_HZ))


def test_no_k_is_proposed_where_the_grid_is_capacitive_at_the_mode() -> None:
    """At 10 Hz the capacitor outweighs the line; no gain is due where m is large enough."""
    grid = elements_grid({"element": COMPENSATED}, F1_HZ)
    y = partial(evaluate_pn, fit_response(turbine()))
    refused = first_gain(y, grid, 0.9, 1.4, 10.0, (1.0, 1000.0))
    z = COMPENSATED[0]["r_ohm"] + 1j * (0.2 * COMPENSATED[0]["x_ohm"] - 5.0 * COMPENSATED[1]["x_ohm"])
    assert refused.k is None
    assert f"is capacitive ({z.real:.4g} - j{-z.imag:.4g} ohm)" in refused.refused
    assert first_gain(y, grid, 1.5, 1.4, 10.0, (1.0, 1000.0)).k == 0.0


def test_no_k_is_proposed_that_is_predicted_to_lower_m() -> None:
    """The paper's formula on a compensated line with m far below one: with its k another crossing has a smaller m."""
    point = judged_on(COMPENSATED)
    assert point.critical_crossing is not None
    k = gain_for_margin(point.critical_crossing.m, 1.4)
    assert point.model is not None
    assert point.grid is not None
    y = partial(evaluate_pn, point.model)
    after = predicted_crossing(y, point.grid, k, point.f_r_hz, (1.0, 1000.0))
    assert after.m < point.margin_m < 1.0
    assert point.k is None
    assert f"m is predicted to go from {point.margin_m:.3g} to {after.m:.3g}" in point.no_k
    assert point.no_k in point.warnings
    assert to_json(TuningResult(point.grid, 1.4, (point,), {}))["operating_points"][0]["missing"]["k"] == point.no_k


COMPENSATED = [
    {"kind": "series", "r_ohm": 0.0317, "x_ohm": 0.4143},
    {"kind": "series_capacitor", "x_ohm": 0.2316},
]


def test_damping_control_is_set_to_the_mode_that_m_speaks_of_where_the_resonance_is_the_grid_s() -> None:
    """Of `examples/grids/long-line.toml` the least damped mode is the line's own, at 3.3 Hz, and capacitive."""
    grid = open_grid(str(Path(__file__).parents[2] / "examples/grids/long-line.toml"), F1_HZ)
    point = tune_point(turbine(0.65e6, U_V), grid)
    assert point.resonance_hz[0] < 5.0
    assert point.f_r_hz == pytest.approx(76.2, abs=0.5)
    assert point.margin_m < point.margin_m_predicted
    assert any("the mode of the critical crossing, and not to the resonance" in text for text in point.warnings)


def test_damping_without_gain_changes_nothing() -> None:
    model = fit_response(turbine())
    f = np.array([23.0, 77.0])
    same = reshaped(lambda x: evaluate_pn(model, x), GRID, 0.0, 77.0)(f)
    np.testing.assert_allclose(siso(f, same, GRID).y1, siso(f, evaluate_pn(model, f), GRID).y1)


def re_swept(k: float) -> float:
    """m of the reference turbine re-swept with damping, as on the notation page (0.65 MW, 1.4 Z), and beyond."""
    return float(np.interp(k, [0.0, 0.357, 0.5, 0.9, 1.1, 2.0], [0.9, 1.0, 1.05, 1.2, 1.29, 1.6]))


def test_search_finds_the_smallest_gain_that_holds() -> None:
    search = search_gain(re_swept, 1.4, 0.357)
    assert search.reached
    assert 1.4 <= search.margin_m <= 1.4 * 1.006
    assert len(search.trials) <= 8


def test_search_reports_the_best_gain_where_the_margin_cannot_be_reached() -> None:
    search = search_gain(lambda k: 1.2 - (k - 0.8) ** 2, 1.4, 0.3)
    assert not search.reached
    assert search.margin_m == max(m for _, m in search.trials)


def test_search_stops_at_zero_where_no_damping_is_needed() -> None:
    assert search_gain(lambda k: 2.0 + k, 1.4, 0.0).trials == ((0.0, 2.0),)
    assert search_gain(lambda k: 2.0 + k, 1.4, 0.5).k == 0.0


def test_search_survives_gains_that_cannot_be_measured() -> None:
    search = search_gain(lambda k: re_swept(k) if k < 0.6 else float("nan"), 1.4, 0.357)
    assert not search.reached
    assert np.isfinite(search.margin_m)


def test_confirmation_replaces_k_and_says_what_was_not_reached(result: TuningResult) -> None:
    done = confirmed(result, result.point("p650"), search_gain(re_swept, 1.4, 0.357))
    assert done.point("p650").reached is True
    assert done.point("p650").margin_m_with_k == pytest.approx(1.4, rel=6e-3)
    assert done.point("p300") == result.point("p300")
    failed = confirmed(result, result.point("p650"), search_gain(lambda k: 0.9 + 0.1 * k, 1.4, 0.357))
    assert failed.point("p650").reached is False
    assert "m = 1.4 cannot be reached" in failed.point("p650").warnings[-1]
    jsonschema.validate(to_json(failed), schema())


# What is written -----------------------------------------------------------------------------------------------------


def test_json_conforms_to_its_schema_and_has_the_promised_fields(result: TuningResult, tmp_path: Path) -> None:
    path = tmp_path / "tuning.json"
    write_json(result, path)
    written = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema())
    jsonschema.validate(written, schema())
    assert written["format"] == "seqsweep-tuning"
    assert written["worst"] == "p650"
    promised = {
        *("op_id", "verdict", "probability", "winding", "margin_m", "resonance_hz"),
        *("critical_scale", "poles", "k", "margin_m_with_k", "bode", "warnings"),
    }
    for point in written["operating_points"]:
        assert promised <= set(point)
        assert sum(pole["kind"] == "resonance" for pole in point["poles"]) == 1
        assert sum(pole["kind"] == "slow" for pole in point["poles"]) == 1  # the DC link's


def test_json_is_the_same_bytes_for_the_same_table(result: TuningResult) -> None:
    again = tune([on_grid(p) for p in (0.3e6, 0.65e6, 0.5e6)], GRID, margin=1.4)
    assert json.dumps(to_json(again)) == json.dumps(to_json(result))


@pytest.mark.parametrize("width", [50, 60, 80, 100, 160])
def test_table_fits_the_terminal(result: TuningResult, width: int) -> None:
    text = format_table(result, width)
    assert max(len(line) for line in text.splitlines()) <= width
    for word in ("verdict", "unstable", "0.357", "worst operating point: p650"):
        assert word in text


def test_false_alarm_of_the_bode_criterion_is_told_in_the_terminal() -> None:
    grid = SeriesRL(0.0144, 0.3, F1_HZ)
    voltage = oracle.terminal_voltage(0.65e6, grid.r_ohm, grid.l_h, U_V)
    text = format_table(tune([turbine(0.65e6, voltage)], grid))
    assert "The Bode criterion alarms on Y1 at 23.12 Hz (m = 0.33)" in " ".join(text.split())


def test_unknown_operating_point_of_a_result_is_named(result: TuningResult) -> None:
    with pytest.raises(ValueError, match="no operating point 'x' in the tuning result; it has p300, p650, p500"):
        result.point("x")


# Figures -------------------------------------------------------------------------------------------------------------


def texts_of(figure) -> list[str]:
    """Every text of a figure: titles, labels, legends."""
    from matplotlib.text import Text

    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def test_bode_figure_marks_every_crossing(result: TuningResult) -> None:
    point = result.point("p650")
    axes = bode_figure(point).axes
    assert [a.get_xlabel() for a in axes] == ["", "", "f (Hz)", "f (Hz)"]
    assert point.stability is not None
    marked = sum(line.get_marker() == "o" for a in axes for line in a.lines)
    assert marked == len(point.stability.crossings)
    assert axes[0].get_title() == "$Y_1$: m = 0.90 at 75.69 Hz"
    rows = next(line for line in axes[0].lines if line.get_marker() == ".")
    np.testing.assert_allclose(rows.get_ydata(), np.abs(siso(F_HZ, point.response.y, GRID).y1))  # the dots are the rows


def test_locus_is_smooth_with_the_rows_on_it_and_its_turns_are_those_of_the_verdict(result: TuningResult) -> None:
    """dB along the rays: read back, the drawn line is det(1 + Y Z), and turns about zero as often as is printed."""
    point = result.point("p650")
    (axes,) = locus_figure(point).axes
    lines = {line.get_label(): np.asarray(line.get_xdata()) + 1j * np.asarray(line.get_ydata()) for line in axes.lines}
    line, rows = lines["rising f, f > f1"], lines["rows"]
    line = line[np.isfinite(line)]
    assert np.max(np.abs(np.angle(line[1:] / line[:-1]))) < np.radians(8.0)
    assert max(np.min(np.abs(line - row)) for row in rows) < 1.0  # rows lie on the line, within a dB
    assert "winding number \N{MINUS SIGN}2" in axes.get_title()
    assert point.stability is not None
    assert f"winding number {point.stability.winding.number}" in point.reason


def test_pole_map_spans_the_swept_band_and_says_what_decides(result: TuningResult) -> None:
    figure = pole_figure(result.points)
    (axes,) = figure.axes
    assert axes.get_ylim()[1] == pytest.approx(1.1 * 950.0)
    assert any("p650: unstable, +9.57 rad/s" in text for text in texts_of(figure))
    assert sum("damping" in text for text in texts_of(figure)) == len(result.points)


@pytest.mark.parametrize("scale", [1.0, pytest.param(1.2, marks=pytest.mark.evidence), 1.4])
def test_nothing_is_printed_over_anything(scale: float) -> None:
    """Titles, labels and legends of the page keep apart, and stay inside it; README's own scales."""
    line = SeriesRL(0.012, 0.25, F1_HZ)
    voltage = oracle.terminal_voltage(0.65e6, scale * line.r_ohm, scale * line.l_h, U_V)
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with matplotlib.rc_context(style._RC):
        figure = result_figure(tune([turbine(0.65e6, voltage)], line, scales=(scale,)))
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        boxes = [(text.get_text(), text.get_window_extent(canvas.get_renderer())) for text in drawn_texts(figure)]
    assert len(boxes) > 30
    for k, (text, box) in enumerate(boxes):
        assert figure.bbox.x0 - 1 <= box.x0, text
        assert box.x1 <= figure.bbox.x1 + 1, text
        for other, other_box in boxes[:k]:
            apart = min(box.x1, other_box.x1) - max(box.x0, other_box.x0) < 1.0
            assert apart or min(box.y1, other_box.y1) - max(box.y0, other_box.y0) < 3.0, (text, other)
    assert any("rad/s" in text and ("\N{MINUS SIGN}" in text or "+" in text) for text, _ in boxes)


def drawn_texts(figure):
    """Texts that a page shows: titles, labels, legends, annotations, and the tick labels within the limits."""
    parts = [figure, *figure.subfigs, *(inner for part in figure.subfigs for inner in part.subfigs)]
    texts = [text for part in parts for text in part.texts]
    texts += [text for part in parts for legend in part.legends for text in legend.get_texts()]
    if figure._suptitle is not None:
        texts.append(figure._suptitle)
    for axes in figure.axes:
        texts += [axes.title, *axes.texts]
        if axes.axison:
            texts += [axes.xaxis.label, axes.yaxis.label]
            for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
                places = zip(axis.get_ticklocs(), axis.get_ticklabels(), strict=False)  # shared axes have none
                texts += [label for at, label in places if low <= at <= high and label.get_visible()]
    return [text for text in dict.fromkeys(texts) if text.get_text().strip()]


def test_page_of_figures_is_written(result: TuningResult, tmp_path: Path) -> None:
    plot_result(result, tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 20_000


def test_operating_point_without_a_fit_cannot_be_drawn(tmp_path: Path) -> None:
    status = np.full(len(F_HZ), "failed")
    result = tune([FrequencyResponse(F_HZ, turbine().y, F1_HZ, status=status, meta={"op_id": "a"})], GRID)
    with pytest.raises(ValueError, match="'a' has no fit to draw: 0 of 100 rows are usable"):
        plot_result(result, tmp_path / "a.png")


# Speed ---------------------------------------------------------------------------------------------------------------


def test_tuning_imports_nothing_heavy() -> None:
    code = (
        "import sys, seqsweep.tuning.tune, seqsweep.tuning.figures, seqsweep.tuning.result\n"
        "print(*{m.partition('.')[0] for m in sys.modules})"
    )
    loaded = set(
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    )
    assert not loaded & {"scipy", "matplotlib", "pandas", "pyarrow", "joblib", "numba"}


@pytest.mark.evidence
def test_thousand_operating_points_take_less_than_a_minute() -> None:
    responses = [on_grid(p, noise=1e-3) for p in np.linspace(0.05e6, 0.68e6, 1000)]
    start = time.perf_counter()
    result = tune(responses, GRID)
    seconds = time.perf_counter() - start
    print(f"1000 operating points of 100 frequencies: {seconds:.1f} s on one core")
    assert len(result.points) == 1000
    assert seconds < 60.0
