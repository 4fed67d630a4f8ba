"""Many tones in the circuit of a sealed controller: a waveform in a table is their sum, from any step on."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from seqsweep.plant.controllers.signal_map import Map
from seqsweep.plant.greybox.circuit import forcing, network
from seqsweep.plant.greybox.kernel_arguments import NO_WAVE, WAVES_KEPT, Waves, cells_of, port_of, wiring_of
from seqsweep.plant.injection import turns
from seqsweep.plant.kernels import grey as kernel
from seqsweep.plant.protocol import Compensation, Source
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I

DT_S = 1e-4
LINE = Source("thevenin", LINE_R_OHM, LINE_L_H)
SILENT = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(lambda argument: 0)


def forcing_of(source: Source, f_hz: float) -> np.ndarray:
    return forcing(TABLE_I, source, f_hz, DT_S)


def ran(source: Source, tones, wave, first_step: int, n_steps: int):
    """v_pcc and i_g of the circuit with a controller that does nothing."""
    cells = cells_of(np.zeros(8, np.uint8))
    addresses = np.array([ctypes.cast(SILENT, ctypes.c_void_p).value, 0], np.int64)
    port = port_of(Compensation(0.0, 0.0), TABLE_I.w1_rad_s, DT_S)
    box = kernel.Box(addresses, np.zeros(1), cells, cells, wiring_of(Map((), (), False, ())), port)
    phasors = kernel.Tones(
        np.array([phasor * turns(f_hz * first_step * DT_S) for f_hz, phasor in tones]),
        np.array([turns(f_hz * DT_S) for f_hz, _ in tones]),
        np.array([forcing_of(source, f_hz) for f_hz, _ in tones]),
        wave,
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
    wave = Waves(DT_S).of(tones, source, forcing_of)
    assert len(wave) == 5000  # the grid of 2 Hz
    summed = ran(source, [*fundamental, *tones], NO_WAVE, first_step, 6000)
    tabled = ran(source, fundamental, wave, first_step, 6000)
    for a, b in zip(summed, tabled, strict=True):
        assert np.max(np.abs(a - b)) < 1e-10 * np.max(np.abs(a))


def test_few_tones_and_tones_on_no_grid_stay_sums():
    waves = Waves(DT_S)
    assert waves.of([], LINE, forcing_of) is NO_WAVE
    assert waves.of([(77.0, 1.0 + 0j)], LINE, forcing_of) is NO_WAVE
    assert waves.of([(10.0 * k + 0.001 * k**2, 1.0 + 0j) for k in range(1, 30)], LINE, forcing_of) is NO_WAVE


def test_a_waveform_is_made_once_and_a_few_are_kept():
    waves = Waves(DT_S)
    signals = [[(10.0 * k, 1.0 + 0.1j * n) for k in range(1, 20)] for n in range(WAVES_KEPT + 1)]
    made = [waves.of(signal, LINE, forcing_of) for signal in signals]
    assert waves.of(signals[-1], LINE, forcing_of) is made[-1]
    assert waves.of(signals[0], LINE, forcing_of) is not made[0]
    assert len(waves._kept) == WAVES_KEPT
