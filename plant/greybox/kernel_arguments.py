"""What the kernel of the grey-box circuit takes: networks, ports and memories in its shape, and its compilation."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial
from math import tan
from typing import Any, NamedTuple

import numpy as np

from ..controllers.signal_map import Map
from ..damping.control import NOTCH_XI
from ..injection import series_tones, turns
from ..kernels.compiled import Fixed
from ..protocol import Compensation, Injection, Source
from ..turbine.parameters import TurbineParameters
from ..turbine.tone_table import Spectrum, common_period, waveform
from . import circuit

NO_WAVE = np.zeros((0, 5), complex)
"""The waveform of a source that is made of phasors alone."""

ForcingOf = Callable[[Source, Any], np.ndarray]

WAVES_KEPT, TONES_KEPT = 4, 128
"""Injected signals that are kept: waveforms (both axes of one, and their negatives), and those of few tones (one for
each shot of the largest batch)."""


class Played(NamedTuple):
    """What a source plays, the fundamental first, as the kernel takes it but for where the phasors stand.

    Attributes
    ----------
    f_hz : (n,) list of float
        Signed frequencies (Hz).
    volts : (n - 1,) list of complex
        Phasors at time zero (V) of all but the fundamental.
    rotations : (n,) complex
        Turns per step.
    forcing : (n, 4) complex
        What a tone adds in a step, per volt at its start.
    table : (n_rows, 5) complex
        Further tones as a periodic waveform; `NO_WAVE` where all are among the above.
    """

    f_hz: list[float]
    volts: list[complex]
    rotations: np.ndarray
    forcing: np.ndarray
    table: np.ndarray


class Signals:
    """Injections behind a source, kept: each is driven from many states, in many stretches.

    Parameters
    ----------
    f1_hz, dt_s : float
        Fundamental (Hz) and step (s).
    """

    def __init__(self, f1_hz: float, dt_s: float):
        self._f1_hz, self._dt_s = f1_hz, dt_s
        self._kept: dict[tuple[Injection | None, Source], Played] = {}

    def of(self, injection: Injection | None, source: Source, forcing_of: ForcingOf) -> Played:
        """What ``source`` plays with ``injection``.

        ``forcing_of`` gives for a source and signed frequencies (n,) (Hz) the (n, 4) complex that tones add in a step,
        per volt at its start. It is not kept: it is the plant's own, and would keep the plant.
        """
        key = injection, source
        if key not in self._kept:
            self._keep(key, self._made(injection, source, partial(forcing_of, source)))
        return self._kept[key]

    def _keep(self, key: tuple[Injection | None, Source], made: Played) -> None:
        has_table = len(made.table) > 0
        alike = [other for other, played in self._kept.items() if (len(played.table) > 0) == has_table]
        for oldest in alike[: max(0, 1 + len(alike) - (WAVES_KEPT if has_table else TONES_KEPT))]:
            del self._kept[oldest]
        self._kept[key] = made

    def _made(self, injection: Injection | None, source: Source, forcing_of: Callable[[Any], np.ndarray]) -> Played:
        tones = list(series_tones(injection, source, partial(circuit.impedance, source)))
        n_rows = common_period([tones], 1.0 / self._dt_s) if tones else 0
        summed = [] if n_rows else tones
        f_hz = [self._f1_hz, *(f_hz for f_hz, _ in summed)]
        rotations = np.array([turns(f * self._dt_s) for f in f_hz])
        table = self._table(tones, forcing_of, n_rows) if n_rows else NO_WAVE
        return Played(f_hz, [volts for _, volts in summed], rotations, forcing_of(f_hz), table)

    def _table(self, tones: Spectrum, forcing_of: Callable[[Any], np.ndarray], n_rows: int) -> np.ndarray:
        added = forcing_of([f_hz for f_hz, _ in tones])
        columns = [(f_hz, volts * np.array([1.0, *row])) for (f_hz, volts), row in zip(tones, added, strict=True)]
        return waveform(columns, 1.0 / self._dt_s, n_rows, 0)


@lru_cache(maxsize=64)
def cached_network(p: TurbineParameters, source: Source, dt_s: float) -> Fixed:
    """As `circuit.network`, without a fault."""
    return Fixed(circuit.network(p, source, dt_s))


@lru_cache(maxsize=64)
def cached_moments(p: TurbineParameters, source: Source, dt_s: float) -> np.ndarray:
    """As `circuit.moments`, without a fault."""
    return circuit.moments(p, source, dt_s)


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
