"""What the kernel of the grey-box circuit takes: networks, ports and memories in its shape, and its compilation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache
from math import tan
from typing import Any

import numpy as np

from ..controllers.signal_map import Map
from ..damping.control import NOTCH_XI
from ..protocol import Compensation, Source
from ..turbine.parameters import TurbineParameters
from ..turbine.tone_table import Spectrum, common_period, waveform
from . import circuit

NO_WAVE = np.zeros((0, 5), complex)
"""The waveform of a source that is made of phasors alone."""


WAVES_KEPT = 4
"""Waveforms of injected signals that are kept: both axes of one, and their negatives."""


class Waves:
    """Many tones as a periodic waveform, kept: a signal is driven from many states, in many stretches.

    Parameters
    ----------
    dt_s : float
        Step (s).
    """

    def __init__(self, dt_s: float):
        self._rate_hz = 1.0 / dt_s
        self._kept: dict[tuple[tuple[tuple[float, complex], ...], Source], np.ndarray] = {}

    def of(self, tones: Spectrum, source: Source, forcing_of: Callable[[Source, float], np.ndarray]) -> np.ndarray:
        """The waveform as the kernel takes it, (n_rows, 5) complex; `NO_WAVE` where the tones are better summed.

        ``forcing_of`` gives for a source and a signed frequency (Hz) the (4,) complex that a tone adds in a step, per
        volt at its start. It is not kept: it is the plant's own, and would keep the plant.
        """
        key = tuple(tones), source
        if key not in self._kept:
            n_rows = common_period([tones], self._rate_hz) if tones else 0
            made = self._made(tones, source, forcing_of, n_rows) if n_rows else NO_WAVE
            self._kept = {key: made, **dict([*self._kept.items()][: WAVES_KEPT - 1])}
        return self._kept[key]

    def _made(
        self, tones: Spectrum, source: Source, forcing_of: Callable[[Source, float], np.ndarray], n_rows: int
    ) -> np.ndarray:
        added = [(f_hz, phasor * forcing_of(source, f_hz)) for f_hz, phasor in tones]
        columns = [tones, *([(f_hz, each[k]) for f_hz, each in added] for k in range(4))]
        return np.stack([waveform(column, self._rate_hz, n_rows, 0) for column in columns], axis=1)


@lru_cache(maxsize=64)
def cached_network(p: TurbineParameters, source: Source, dt_s: float) -> Any:
    """As `circuit.network`, without a fault."""
    return circuit.network(p, source, dt_s)


@lru_cache(maxsize=4096)
def cached_forcing(p: TurbineParameters, source: Source, f_hz: float, dt_s: float) -> np.ndarray:
    """As `circuit.forcing`, without a fault."""
    return circuit.forcing(p, source, f_hz, dt_s)


@lru_cache(maxsize=64)
def cached_fault(
    p: TurbineParameters, source: Source, f_hz: float, dt_s: float, fault_s: tuple[float, float, float]
) -> tuple[Any, np.ndarray, Any]:
    """As `circuit.faulted`."""
    return circuit.faulted(p, source, f_hz, dt_s, fault_s)


def port_of(block: Compensation, w1_rad_s: float, dt_s: float) -> Any:
    """The compensation as the kernel takes it: the notch by the bilinear rule, exact at its centre."""
    from ..kernels.grey import Port

    centre = tan(0.5 * w1_rad_s * dt_s)
    share = 1.0 / (1.0 + 2.0 * NOTCH_XI * centre + centre**2)
    return Port(
        block.r_ohm,
        block.x_ohm,
        2.0 * NOTCH_XI * centre * share,
        2.0 * (centre**2 - 1.0) * share,
        (1.0 - 2.0 * NOTCH_XI * centre + centre**2) * share,
    )


def cells_of(memory: np.ndarray) -> Any:
    """A stretch of memory, seen as each type."""
    from ..kernels.grey import CELL_TYPES, Cells

    return Cells(*(memory.view(kind) for kind in CELL_TYPES))


def wiring_of(signals: Map) -> Any:
    """The signal map as the kernel takes it."""
    from ..kernels import grey as kernel

    kinds = {name: kind for kind, name in enumerate(kernel.CELL_TYPES)}
    inputs, outputs = signals.inputs, signals.outputs
    return kernel.Wiring(
        np.array([kinds[part.type] for part in inputs], np.int64),
        np.array([part.cell for part in inputs], np.int64),
        np.array([getattr(kernel, part.quantity) for part in inputs], np.int64),
        np.array([part.gain for part in inputs], float).reshape(-1, 2),
        np.array([kinds[part.type] for part in outputs], np.int64),
        np.array([part.cell for part in outputs], np.int64),
        np.array([part.weight for part in outputs], complex),
        signals.modulated,
        np.array([kinds[part.type] for part in signals.gate], np.int64),
        np.array([part.first for part in signals.gate], np.int64),
    )


def warm_up() -> None:
    """Compile or load the kernels, by a controller that does nothing."""
    from ..kernels import grey as kernel

    nothing = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int64)(lambda argument: 0)
    cells, wiring = cells_of(np.zeros(8, np.uint8)), wiring_of(Map((), (), False, ()))
    addresses = np.array([ctypes.cast(nothing, ctypes.c_void_p).value, 0], np.int64)
    box = kernel.Box(addresses, np.zeros(1), cells, cells, wiring, kernel.Port(0.0, 0.0, 0.0, 0.0, 0.0))
    source = kernel.Tones(np.ones(1, complex), np.ones(1, complex), np.zeros((1, 4), complex), NO_WAVE)
    network, store = circuit.network(TurbineParameters(), Source(), 1e-4), kernel.Store(1.0, 0.0, 1e-4, 0, 0.0, 0.0)
    quantities, x = np.zeros(kernel.N_QUANTITIES), np.zeros(6, complex)
    kernel.inform(box, network, store, quantities, x, 0j, 1.0)
    common = (box, source, network, store, 0, quantities, x, np.array([1.0, kernel.DONE]))
    v, i, seen = np.zeros(1, complex), np.zeros(1, complex), np.zeros(2, complex)
    kernel.advance_recording(*common, v, i)
    for skew in (None, kernel.Skew(network, source.forcing, 1j)):
        kernel.advance_tracing(box, source, network, skew, *common[3:], v, i, np.zeros(1), seen, 1.0)
    lines = np.ones(2, complex)
    kernel.advance_blocks(*common, lines, lines, 1j, 1j, 1, np.zeros((1, 4), complex))
