"""Metrics against direct linearisations with P and Q as outputs, and their errors against draws."""

from __future__ import annotations

import json
from math import pi

import jsonschema
import numpy as np
import pytest

from seqsweep.identify.response import FrequencyResponse
from seqsweep.plant.inverters.parameters import FollowingParameters, FormingParameters
from seqsweep.tuning.metrics import MetricsError, Response, Swing, fit_swing, metrics
from seqsweep.tuning.metrics_figure import plot_metrics
from seqsweep.tuning.metrics_report import format_report, schema, to_json
from seqsweep.tuning.siso import parse_grid

from ..support import inverter_oracle as oracle

F1 = 50.0
DROOP = FormingParameters(k_d=0.0, t_a_s=1.0 / (0.05 * 2.0 * pi * 5.0))
STIFF = DROOP._replace(l_g_pu=0.1, r_g_pu=0.005, l_v_pu=0.0)
VSM, FOLLOWING = FormingParameters(), FollowingParameters()
NU = np.array([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.0, 7.0, 10.0, 20.0, 35.0, 80.0, 400.0])
POINTS = ((0.5, 0.0, 1.0), (-0.4, 0.3, 1.05), (0.7, -0.2, 0.93))
DEVICES = {"vsm": (VSM, "forming"), "droop": (DROOP, "forming"), "stiff": (STIFF, "forming")}
DEVICES |= {"following": (FOLLOWING, "following")}
U, S = 690.0, 2e6


def response_of(p, kind, point, nu_hz=NU, below=False, covariance=None) -> FrequencyResponse:
    """Exact rows above f1, or at the mirror frequencies below it."""
    power, q, v = point
    f_hz = np.sort(F1 - nu_hz[nu_hz < F1] if below else F1 + nu_hz)
    model = oracle.linearise(p, kind, complex(power, q), v)
    y = oracle.admittance_pn(model, f_hz) * S / U**2
    fundamental = {
        "active_power_into_device_w": -power * S,
        "reactive_power_into_device_var": -q * S,
        "voltage_v": v * U,
    }
    return FrequencyResponse(f_hz, y, F1, covariance=covariance, meta={"op_id": "x", "fundamental": fundamental})


def direct(p, kind, point, nu_hz=NU) -> np.ndarray:
    """d(P, Q)/d(theta, V) (n, 2, 2) from the state space with inputs theta, V of v_pcc and outputs P, Q."""
    power, q, v = point
    m = oracle.linearise(p, kind, complex(power, q), v)
    b = m.b @ np.array([[0.0, 1.0], [v, 0.0]])  # v_pcc = (V + dV) (cos theta, sin theta)

    def outputs(x, theta, size):
        v_d, v_q, i_d, i_q = size * np.cos(theta), size * np.sin(theta), x[4], x[5]
        return np.array([v_d * i_d + v_q * i_q, v_q * i_d - v_d * i_q])

    h = oracle.COMPLEX_STEP
    c = np.array([outputs(x, 0.0, v).imag / h for x in m.x + 1j * h * np.eye(len(m.x))]).T
    d = np.stack([outputs(m.x, 1j * h, v).imag / h, outputs(m.x, 0.0, v + 1j * h).imag / h], axis=1)
    eye = np.eye(len(m.a))
    return np.array([c @ np.linalg.solve(2j * pi * nu * eye - m.a, b) + d for nu in nu_hz])


@pytest.mark.parametrize("device", DEVICES.values(), ids=DEVICES)
@pytest.mark.parametrize("point", POINTS, ids=str)
@pytest.mark.parametrize("below", [False, True], ids=["above f1", "below f1"])
def test_jacobian_is_the_direct_linearisation(device, point, below):
    found = metrics(response_of(*device, point, below=below), (U, S))
    truth = direct(*device, point, found.nu_hz)
    for of, row, column in ((found.p_theta, 0, 0), (found.p_v, 0, 1), (found.q_theta, 1, 0), (found.q_v, 1, 1)):
        assert of.value == pytest.approx(truth[:, row, column], rel=1e-9, abs=1e-9)
    assert found.nfp.value == pytest.approx(truth[:, 0, 0] * F1 / (1j * found.nu_hz), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("device", [DEVICES["droop"], DEVICES["following"]], ids=["droop", "following"])
def test_behind_a_grid_it_is_the_device_with_the_line_as_part_of_it(device):
    """The line added to the grid-side inductance, linearised with the source's angle and voltage as inputs."""
    p, kind = device
    z = 0.02 + 0.15j
    power, q, v = POINTS[2]
    i_out = complex(power, -q) / v
    source = v - z * i_out
    at_source = source * i_out.conjugate()
    longer = p._replace(l_g_pu=p.l_g_pu + z.imag, r_g_pu=p.r_g_pu + z.real)
    truth = direct(longer, kind, (at_source.real, at_source.imag, abs(source)))
    base = U**2 / S
    grid = parse_grid(f"{z.real * base}+{z.imag * base}j", F1, 1.0)
    found = metrics(response_of(p, kind, POINTS[2]), (U, S), grid)
    assert found.point == pytest.approx((at_source.real, at_source.imag, abs(source)), rel=1e-12)
    for of, row, column in ((found.p_theta, 0, 0), (found.p_v, 0, 1), (found.q_theta, 1, 0), (found.q_v, 1, 1)):
        assert of.value == pytest.approx(truth[:, row, column], rel=1e-9, abs=1e-9)


def test_passivity_is_the_least_power_that_any_voltage_is_given():
    found = metrics(response_of(*DEVICES["droop"], POINTS[0]), (U, S))
    y = oracle.admittance_dq(oracle.linearise(DROOP, "forming", 0.5, 1.0), NU)
    angle = np.linspace(0.0, pi, 181)
    phase = np.linspace(0.0, 2.0 * pi, 361)
    v = np.stack(np.broadcast_arrays(np.cos(angle)[:, None], np.sin(angle)[:, None] * np.exp(1j * phase)), -1)
    least = np.einsum("abi,nij,abj->nab", v.conj(), y, v).real.min(axis=(1, 2))
    assert np.all(found.passivity <= least + 1e-9)
    assert found.passivity == pytest.approx(least, rel=2e-3, abs=2e-3)
    (low, high), *_ = found.passive_bands_hz
    assert found.passivity[found.nu_hz < low].max() < 0.0
    assert high <= NU[-1]


def test_droop_is_a_swing_and_its_constants_come_back():
    found = metrics(response_of(*DEVICES["droop"], POINTS[0]), (U, S)).swing
    assert isinstance(found, Swing)
    assert found.is_swing
    assert found.m_s == pytest.approx(0.63662, rel=0.03)
    assert found.d == pytest.approx(20.0, rel=0.03)


def test_vsm_damped_by_its_pll_is_no_swing_and_nothing_is_said_of_m_and_d():
    m = metrics(response_of(*DEVICES["vsm"], POINTS[0], np.geomspace(0.3, 20.0, 25)), (U, S))
    assert isinstance(m.swing, Swing)
    assert m.swing.misfit > 0.2
    assert "withheld: the misfit is" in format_report(m)
    assert "m_s" not in to_json([m], {"f1_hz": F1})["operating_points"][0]["swing"]


def test_forming_and_following_are_told_apart_by_more_than_ten():
    forming, following = (
        metrics(response_of(*DEVICES[name], POINTS[0]), (U, S)).p_stiffness for name in ("droop", "following")
    )
    assert forming is not None
    assert following is not None
    assert forming.value > 10.0 * following.value


def test_exact_swing_comes_back_exactly():
    nu = np.geomspace(0.1, 30.0, 40)
    s, k, m, d = 2j * pi * nu, 1.7, 4.0, 25.0
    g = -1.0 / (s / (k * 2.0 * pi * F1) + 1.0 / (m * s + d))
    found = fit_swing(nu, Response(g, np.zeros((40, 2, 2))), F1)
    assert isinstance(found, Swing)
    assert (found.k, found.m_s, found.d) == pytest.approx((k, m, d), rel=1e-6)


def noisy(exact: FrequencyResponse, level: float, rng) -> tuple[FrequencyResponse, np.ndarray]:
    """Rows with independent errors of a relative level, and the covariance (n, 8, 8) they were drawn with."""
    size = np.linalg.norm(exact.y, axis=(1, 2)) * level / 8.0**0.5
    covariance = size[:, None, None] ** 2 * np.eye(8)
    parts = size[:, None] * rng.normal(size=(len(exact), 8))
    y = exact.y + (parts[:, ::2] + 1j * parts[:, 1::2]).reshape(-1, 2, 2)
    return FrequencyResponse(exact.f_hz, y, F1, covariance=covariance, meta=exact.meta), covariance


@pytest.mark.parametrize("behind", [None, "0.01+0.05j"], ids=["terminals", "behind a grid"])
def test_95_percent_regions_hold_95_percent_of_the_truth(behind):
    """1 % noise; the errors of moduli, phases, passivity and stiffness are those stated."""
    rng = np.random.default_rng(18)
    grid = None if behind is None else parse_grid(behind, F1, 1.0)
    exact = response_of(*DEVICES["droop"], POINTS[1], np.array([0.7, 3.0, 8.0, 15.0, 60.0]))
    exact = FrequencyResponse(
        np.concatenate([[38.0, 47.0], exact.f_hz]),
        np.concatenate([response_of(*DEVICES["droop"], POINTS[1], np.array([3.0, 12.0]), below=True).y, exact.y]),
        F1,
        meta=exact.meta,
    )
    truth = metrics(exact, (U, S), grid)
    inside = {"modulus": [], "phase": [], "passivity": []}
    for _ in range(150):
        m = metrics(noisy(exact, 0.01, rng)[0], (U, S), grid)
        for name in ("p_theta", "p_v", "q_theta", "q_v"):
            of, to = getattr(m, name), getattr(truth, name)
            inside["modulus"].append(np.abs(np.abs(of.value) - np.abs(to.value)) < 1.96 * of.magnitude_std)
            turned = np.degrees(np.angle(of.value / to.value))
            inside["phase"].append(np.abs(turned) < 1.96 * of.phase_std_deg)
        inside["passivity"].append(np.abs(m.passivity - truth.passivity) < 1.96 * m.passivity_std)
    for name, hits in inside.items():
        share = float(np.mean(np.concatenate(hits)))
        print(f"\n  {name}: {share:.3f}", end="")
        assert 0.93 <= share <= 0.97, name


def test_regions_of_swing_and_stiffness_hold_the_truth():
    rng = np.random.default_rng(7)
    exact = response_of(*DEVICES["droop"], POINTS[0], np.geomspace(0.5, 25.0, 24))
    truth = metrics(exact, (U, S))
    hits = []
    for _ in range(120):
        m = metrics(noisy(exact, 0.01, rng)[0], (U, S))
        if m.swing.n_rows == truth.swing.n_rows:  # another peak, another set of rows
            found = np.array([m.swing.k, m.swing.m_s, m.swing.d])
            hits.append(np.abs(found - [truth.swing.k, truth.swing.m_s, truth.swing.d]) < 1.96 * m.swing.std)
    share = np.mean(hits, axis=0)
    print(f"\n  K, M, D: {share}, {len(hits)} draws", end="")
    assert len(hits) > 60
    assert np.all(share > 0.88)


def test_too_few_rows_say_where_more_are_needed():
    m = metrics(response_of(*DEVICES["droop"], POINTS[0], np.array([1.0, 5.0, 20.0, 60.0])), (U, S))
    assert "2 rows lie below the peak" in m.swing
    assert "sweep more frequencies within 5 Hz of f1" in m.swing
    assert "not fitted" in format_report(m)
    assert metrics(response_of(*DEVICES["droop"], POINTS[0], np.array([60.0, 70.0])), (U, S)).p_stiffness is None


def test_a_table_without_its_operating_point_is_refused_with_the_way_out():
    bare = FrequencyResponse([60.0], np.ones((1, 2, 2)), F1, meta={"op_id": "p"})
    with pytest.raises(MetricsError, match=r"does not say at which P, Q and \|v\| 'p' was measured.*sweep or identify"):
        metrics(bare, (U, S))
    failed = FrequencyResponse([60.0], np.full((1, 2, 2), np.nan), F1, status=["failed"], meta={"op_id": "p"})
    with pytest.raises(MetricsError, match="no row to take metrics from"):
        metrics(failed, (U, S))


def test_document_keeps_its_schema_and_the_picture_is_drawn(tmp_path):
    found = [
        metrics(response_of(*DEVICES[name], POINTS[0]), (U, S), grid)
        for name in DEVICES
        for grid in (None, parse_grid("0.01+0.05j", F1, 1.0))
    ]
    document = json.loads(json.dumps(to_json(found, {"f1_hz": F1}), allow_nan=False))
    jsonschema.Draft202012Validator.check_schema(schema())
    jsonschema.validate(document, schema())
    plot_metrics(found[2], tmp_path / "m.png")
    assert (tmp_path / "m.png").stat().st_size > 20_000
