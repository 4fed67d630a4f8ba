"""Many tones in the circuit of a sealed controller: a waveform in a table is their sum, from any step on."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from scipy.linalg import expm

from seqsweep.plant.controllers.signal_map import Map
from seqsweep.plant.greybox.circuit import _dynamics, forcing, moments, network
from seqsweep.plant.greybox.kernel_arguments import NO_WAVE, WAVES_KEPT, Signals, cells_of, port_of, wiring_of
from seqsweep.plant.injection import turns
from seqsweep.plant.kernels import grey as kernel
from seqsweep.plant.protocol import Compensation, Injection, Source, Tone
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I

DT_S = 1e-4
LINE = Source("thevenin", LINE_R_OHM, LINE_L_H)
SILENT = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(lambda argument: 0)


def forcing_of(source: Source, f_hz) -> np.ndarray:
    return forcing(moments(TABLE_I, source, DT_S), f_hz, DT_S)


def injection(tones) -> Injection:
    return Injection("series_voltage", tuple(Tone(f_hz, abs(volts), np.angle(volts)) for f_hz, volts in tones))


def ran(source: Source, tones, table, first_step: int, n_steps: int):
    """v_pcc and i_g of the circuit with a controller that does nothing."""
    cells = cells_of(np.zeros(8, np.uint8))
    addresses = np.array([ctypes.cast(SILENT, ctypes.c_void_p).value, 0], np.int64)
    port = port_of(Compensation(0.0, 0.0), TABLE_I.w1_rad_s, DT_S)
    box = kernel.Box(addresses, np.zeros(1), cells, cells, wiring_of(Map((), (), False, ())), port)
    phasors = kernel.Tones(
        np.array([phasor * turns(f_hz * first_step * DT_S) for f_hz, phasor in tones]),
        np.array([turns(f_hz * DT_S) for f_hz, _ in tones]),
        forcing_of(source, [f_hz for f_hz, _ in tones]),
        table,
    )
    store = kernel.Store(1.0, 0.0, DT_S, 0, 0.0, 0.0)
    v, i = np.empty(n_steps, complex), np.empty(n_steps, complex)
    x, quantities = np.zeros(6, complex), np.zeros(kernel.N_QUANTITIES)
    surroundings = network(TABLE_I, source, DT_S), store, first_step, quantities, x, np.array([1e6, kernel.DONE])
    kernel.advance_recording(box, phasors, *surroundings, v, i)
    return v, i


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
@pytest.mark.parametrize("first_step", [0, 12_345])
def test_a_waveform_is_the_sum_of_its_tones(source, first_step):
    rng = np.random.default_rng(3)
    tones = [(float(f_hz), complex(*rng.normal(size=2))) for f_hz in (*range(-90, 0, 6), *range(2, 400, 10))]
    fundamental = [(50.0, 560.0 + 0j)]
    played = Signals(50.0, DT_S).of(injection(tones), source, forcing_of)
    assert played.f_hz == [50.0]
    assert len(played.table) == 5000  # the grid of 2 Hz
    summed = ran(source, [*fundamental, *tones], NO_WAVE, first_step, 6000)
    tabled = ran(source, fundamental, played.table, first_step, 6000)
    for a, b in zip(summed, tabled, strict=True):
        assert np.max(np.abs(a - b)) < 1e-10 * np.max(np.abs(a))


@pytest.mark.parametrize(
    "tones",
    [[], [(77.0, 1.0)], [(10.0 * k + 0.001 * k**2, 1.0) for k in range(1, 30)]],
    ids=["none", "one", "on no grid"],
)
def test_few_tones_and_tones_on_no_grid_stay_sums(tones):
    played = Signals(50.0, DT_S).of(injection(tones), LINE, forcing_of)
    assert played.table is NO_WAVE
    assert played.f_hz == [50.0, *(f_hz for f_hz, _ in tones)]
    assert len(played.volts) == len(tones)
    assert played.forcing.shape == (1 + len(tones), 4)


def test_a_waveform_is_made_once_and_a_few_are_kept_beside_single_tones():
    signals, one = Signals(50.0, DT_S), injection([(77.0, 1.0)])
    many = [injection([(10.0 * k, 1.0 + 0.1j * n) for k in range(1, 20)]) for n in range(WAVES_KEPT + 1)]
    alone, *made = [signals.of(each, LINE, forcing_of) for each in (one, *many)]
    assert signals.of(many[-1], LINE, forcing_of) is made[-1]
    assert signals.of(one, LINE, forcing_of) is alone
    assert signals.of(many[0], LINE, forcing_of) is not made[0]
    assert signals.of(one, Source(), forcing_of) is not alone
    assert sum(len(played.table) > 0 for played in signals._kept.values()) == WAVES_KEPT


@pytest.mark.parametrize("source", [Source(), LINE], ids=["ideal", "line"])
@pytest.mark.parametrize("dt_s", [20e-6, 1e-3])
def test_steps_and_forcing_are_those_of_another_matrix_exponential(source, dt_s):
    """scipy's, of the whole system with one tone in it; up to half the sampling frequency."""
    a, _, driven = _dynamics(TABLE_I, source, 0.0)
    f_hz = np.array([-130.0, 1.0, 480.0, 0.49 / dt_s])
    found = forcing(moments(TABLE_I, source, dt_s), f_hz, dt_s)
    for at, row in zip(f_hz, found, strict=True):
        whole = np.zeros((5, 5), complex)
        whole[:3, :3], whole[3, 0], whole[:3, 4], whole[4, 4] = a, 1.0, driven, 2j * np.pi * at
        expected = expm(dt_s * whole)[:4]
        assert np.max(np.abs(row - expected[:, 4])) < 1e-13 * np.max(np.abs(expected[:, 4]))
        assert np.allclose(network(TABLE_I, source, dt_s).phi, expected[:, :3].real, rtol=1e-12, atol=1e-15)
