"""Broadband perturbations: one real periodic signal, played along d in one experiment and along q in the other.

    u(t) = A b(t) exp(j (w1 t + angle)) (1 or 1j),    b(t) = Re sum_k c_k exp(2j pi nu_k t),    nu_k = k/T

nu is the frequency seen from the frame that rotates at f1: a line of b is heard at f1 + nu and, conjugated,
at the mirror f1 - nu. Along d the two components are equal, along q opposite (the second one referred to
the fundamental), so the two experiments are independent at every line whatever the phases of b are, the
peak of |u| is A times the peak of b, and one line serves the two points f1 + nu and f1 - nu.

Every signal is given by its lines within a band, so that whatever takes tones can play it. Binary sequences
are band-limited by that, and no longer binary.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, floor, inf, log2, pi
from typing import Literal

import numpy as np

from ...plant.protocol import Tone
from .binary_sequences import inverse_repeat, maximum_length, next_residue_length, quadratic_residue
from .crest_factor import low_crest_phases, samples
from .frequencies import coherent_block
from .odd_lines import SignalError

Kind = Literal["multisine", "prbs", "qrb", "chirp"]
Axis = Literal["d", "q"]
AXES: tuple[Axis, Axis] = ("d", "q")

USABLE = 0.44
"""Highest usable line of a binary sequence in parts of its clock: half the power of its lowest lines."""

PEAK_OVERSAMPLED = 16
"""Samples per half period of the highest line where a peak is looked for; it is missed by 0.2 % at most."""

STARTS = 1
"""Descents of a multisine; more of them win about a hundredth."""


@dataclass(frozen=True, slots=True)
class Signal:
    """A real periodic signal of peak one.

    Attributes
    ----------
    kind : str
        What it was made as.
    period_s : float
        Period T (s).
    cycles : (n,) int
        Whole cycles per period, ascending, above 0: nu_k = cycles / period_s.
    phasors : (n,) complex
        ``b(t) = Re sum phasors exp(2j pi nu t)``; the peak of ``|b|`` over a dense grid is one.
    raw_peak : float
        Peak before it was made one: of a binary sequence in parts of its level, of a chirp in parts of
        its amplitude, both band-limited.

    Raises
    ------
    SignalError
        If a line is at f1 (no cycle), or cycles do not ascend.
    """

    kind: Kind
    period_s: float
    cycles: np.ndarray
    phasors: np.ndarray
    raw_peak: float = 1.0

    def __post_init__(self) -> None:
        for name, dtype in (("cycles", int), ("phasors", complex)):
            values = np.array(getattr(self, name), dtype)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        if self.cycles.shape != self.phasors.shape or not len(self.cycles):
            raise SignalError(f"{len(self.cycles)} lines with {len(self.phasors)} phasors; at least one of each")
        if self.cycles[0] < 1:
            raise SignalError("a line without a whole cycle per period is f1 itself: lines begin at 1/T beside it")
        if np.any(np.diff(self.cycles) < 1):
            raise SignalError("cycles must ascend strictly: sort them and remove duplicates")

    @property
    def nu_hz(self) -> np.ndarray:
        """(n,) frequencies seen from the rotating frame (Hz), above 0."""
        return self.cycles / self.period_s

    @property
    def crest(self) -> float:
        """Peak over root mean square."""
        return float(1.0 / np.sqrt(0.5 * np.sum(np.abs(self.phasors) ** 2)))

    @property
    def weakest(self) -> float:
        """Amplitude of the weakest rotating tone, in parts of the peak of |u|."""
        return float(0.5 * np.min(np.abs(self.phasors)))


def wave(signal: Signal, time_s: np.ndarray) -> np.ndarray:
    """b (n,) at any times (n,), in s."""
    turns = np.multiply.outer(signal.nu_hz, time_s) % 1.0
    return np.sum((signal.phasors[:, None] * np.exp(2j * pi * turns)).real, axis=0)


def tones(signal: Signal, axis: Axis, f1_hz: float, amplitude: float, angle_rad: float = 0.0) -> tuple[Tone, ...]:
    """The rotating tones of ``amplitude * b(t) * exp(j (w1 t + angle))``, times 1j along q.

    Parameters
    ----------
    signal : Signal
        b.
    axis : "d" or "q"
        Along which axis of the frame that stands at ``angle_rad`` at time zero.
    f1_hz : float
        Fundamental frequency (Hz).
    amplitude : float
        Peak of the space vector (V or A, phase peak), above 0.
    angle_rad : float
        Angle of the frame's d axis at time zero (rad); with the angle of the fundamental voltage the
        two experiments are along its d and q axes.

    Returns
    -------
    tuple of Tone
        At f1 + nu and f1 - nu for every line, each of half the line's amplitude; signed frequencies.
    """
    if not 0.0 < amplitude < inf:
        raise SignalError(f"the peak of a perturbation is {amplitude:g}; a finite number above 0 is needed")
    axis_rad = angle_rad + (0.5 * pi if axis == "q" else 0.0)
    halves = 0.5 * amplitude * np.abs(signal.phasors)
    played = zip(signal.nu_hz.tolist(), halves.tolist(), np.angle(signal.phasors).tolist(), strict=True)
    return tuple(
        Tone(f1_hz + sign * nu, half, axis_rad + sign * phase) for nu, half, phase in played for sign in (1.0, -1.0)
    )


def negated(signal: Signal) -> Signal:
    """-b: the other half of a (+u, -u) pair, whose difference is free of even-order distortion."""
    return replace(signal, phasors=-signal.phasors)


# The four kinds


def multisine(
    cycles: np.ndarray, period_s: float, weights: np.ndarray | None = None, starts: int = STARTS, seed: int = 0
) -> Signal:
    """Cosines at chosen lines, with phases for a low crest factor; the same lines give the same signal.

    Parameters
    ----------
    cycles : (n,) int
        Lines, ascending: whole cycles per period. `lines.odd_lines` chooses some.
    period_s : float
        Period (s).
    weights : (n,) float, optional
        Relative amplitudes, above 0; equal by default.
    starts, seed : int
        Descents that are tried, and the seed of their phases.
    """
    lines = Signal("multisine", period_s, cycles, np.ones(len(cycles)) if weights is None else weights)
    if not np.all(lines.phasors.real > 0.0) or not np.all(np.isfinite(lines.phasors)):
        raise SignalError("weights of a multisine must be finite and above 0: leave a line out instead")
    amplitudes = lines.phasors.real
    phases = low_crest_phases(amplitudes, lines.cycles, starts, seed)
    return replace(_normalised("multisine", period_s, lines.cycles, amplitudes * np.exp(1j * phases)), raw_peak=1.0)


def prbs(order: int, clock_hz: float, band_hz: tuple[float, float], *, odd: bool = False) -> Signal:
    """A maximum-length binary sequence, held for a clock period each, within a band.

    Parameters
    ----------
    order : int
        Of the shift register: the sequence has N = 2**order - 1 bits, the signal a period of N/clock.
    clock_hz : float
        Bits per second.
    band_hz : (float, float)
        Lowest and highest nu (Hz): at least 1/T, at most 0.44 of the clock.
    odd : bool
        The inverse repeat: twice the period, odd lines only.
    """
    return _binary("prbs", maximum_length(order), clock_hz, band_hz, odd)


def qrb(length: int, clock_hz: float, band_hz: tuple[float, float], *, odd: bool = False) -> Signal:
    """A quadratic-residue binary sequence, held for a clock period each, within a band.

    As `prbs`, with many more lengths to choose from: ``length`` is any prime = 3 (mod 4).
    """
    return _binary("qrb", quadratic_residue(length), clock_hz, band_hz, odd)


def chirp(
    period_s: float, band_hz: tuple[float, float], spacing: Literal["linear", "log"] = "linear", *, odd: bool = False
) -> Signal:
    """A sweep through the band once per period, by its lines within that band.

    Parameters
    ----------
    period_s : float
        Period (s).
    band_hz : (float, float)
        Lowest and highest nu (Hz), the lowest at least 1/T.
    spacing : "linear" or "log"
        Equal amplitudes over nu, or amplitudes that fall with the root of nu.
    odd : bool
        A sweep through half the period, then the same with its sign turned: odd lines only.
    """
    cycles = _within(band_hz, period_s, inf, odd)
    low, high = (nu * period_s for nu in band_hz)
    if not high > low:
        raise SignalError(f"a chirp from {band_hz[0]:g} to {band_hz[1]:g} Hz does not sweep: give a wider band")
    n = 2 ** ceil(log2(2 * PEAK_OVERSAMPLED * high))
    swept = np.arange(n // 2 if odd else n) / n  # in periods
    rate = (2.0 if odd else 1.0) * (high - low)
    turns = low * swept + 0.5 * rate * swept**2
    if spacing == "log":
        steepness = np.log(high / low) * (2.0 if odd else 1.0)
        turns = low * np.expm1(steepness * swept) / steepness
    once = np.cos(2.0 * pi * turns)
    whole = np.concatenate([once, -once]) if odd else once
    return _normalised("chirp", period_s, cycles, 2.0 / n * np.fft.rfft(whole)[cycles])


def _binary(
    kind: Literal["prbs", "qrb"], once: np.ndarray, clock_hz: float, band_hz: tuple[float, float], odd: bool
) -> Signal:
    """The held sequence's lines in the band: the sequence's own, times those of one bit."""
    if not 0.0 < clock_hz < inf:
        raise SignalError(f"the clock of a binary sequence is {clock_hz:g} Hz; a finite number above 0 is needed")
    sequence = inverse_repeat(once) if odd else once
    n = len(sequence)
    cycles = _within(band_hz, n / clock_hz, clock_hz, odd)
    bit = np.sinc(cycles / n) * np.exp(-1j * pi * cycles / n)
    return _normalised(kind, n / clock_hz, cycles, 2.0 / n * np.fft.rfft(sequence)[cycles] * bit)


def _within(band_hz: tuple[float, float], period_s: float, clock_hz: float, odd: bool) -> np.ndarray:
    """Lines of a band, or a refusal of what cannot be resolved or is too weak."""
    low_hz, high_hz = band_hz
    if not low_hz > 0.0:
        raise SignalError(f"a band from {low_hz:g} Hz includes f1 itself: nu begins at 1/T, here {1 / period_s:g} Hz")
    if low_hz * period_s < 1.0 - 1e-9:
        raise SignalError(
            f"{low_hz:g} Hz is finer than a period of {period_s:g} s resolves: begin the band at {1 / period_s:g} Hz, "
            f"or take a period of at least {1 / low_hz:g} s"
        )
    if high_hz > USABLE * clock_hz * (1 + 1e-9):
        raise SignalError(
            f"{high_hz:g} Hz is above {USABLE:g} of the clock of {clock_hz:g} Hz, where a binary sequence has lost "
            f"half its power: end the band at {USABLE * clock_hz:g} Hz, or take a clock of {high_hz / USABLE:g} Hz"
        )
    first, last = ceil(low_hz * period_s - 1e-9), floor(high_hz * period_s + 1e-9)
    cycles = np.arange(first, last + 1)
    cycles = cycles[cycles % 2 == 1] if odd else cycles
    if not len(cycles):
        raise SignalError(
            f"no line between {low_hz:g} and {high_hz:g} Hz: a period of {period_s:g} s has one every "
            f"{(2 if odd else 1) / period_s:g} Hz; widen the band or lengthen the period"
        )
    return cycles


def _normalised(kind: Kind, period_s: float, cycles: np.ndarray, phasors: np.ndarray) -> Signal:
    raw_peak = float(np.max(np.abs(samples(phasors, cycles, PEAK_OVERSAMPLED))))
    return Signal(kind, period_s, cycles, phasors / raw_peak, raw_peak)


# What fits: periods, lengths, amplitudes


def coherent_blocks(signal: Signal, f1_hz: float, dt_s: float) -> int:
    """Blocks (`grid.coherent_block`) of one period, which must be whole steps and whole fundamental periods.

    Raises
    ------
    SignalError
        If the period is not whole blocks (names the nearest periods that are), or a tone is above the
        Nyquist frequency of the step.
    """
    block = coherent_block(f1_hz, dt_s)
    blocks = round(signal.period_s / block.duration_s)
    if blocks < 1 or abs(blocks * block.duration_s / signal.period_s - 1.0) > 1e-9:
        below = max(1, floor(signal.period_s / block.duration_s))
        around = " or ".join(f"{n * block.duration_s:.12g} s" for n in (below, below + 1))
        bits = " (the clock of a sequence of N bits is N over that)" if signal.kind in ("prbs", "qrb") else ""
        raise SignalError(
            f"a period of {signal.period_s:.12g} s is not whole periods of f1 = {f1_hz:g} Hz in whole steps of "
            f"{dt_s:g} s: take {around}{bits}"
        )
    highest, nyquist = f1_hz + signal.nu_hz[-1], 0.5 / dt_s
    if highest >= nyquist:
        raise SignalError(
            f"the tone at {highest:g} Hz must be below the Nyquist frequency of {nyquist:g} Hz (step {dt_s:g} s): "
            "lower the band or the plant's step"
        )
    return blocks


def require_amplitude(signal: Signal, amplitude: float, smallest: float) -> None:
    """Refuse a signal whose weakest tone is below ``smallest`` (V or A, like ``amplitude``, the peak of |u|)."""
    weakest = amplitude * signal.weakest
    if weakest < smallest:
        raise SignalError(
            f"a peak of {amplitude:g} leaves {weakest:.3g} for the weakest of {2 * len(signal.cycles)} tones; "
            f"{smallest:.3g} is needed: raise the peak to {smallest / signal.weakest:.3g}, or play fewer lines"
        )


def residue_length(period_s: float, nu_max_hz: float) -> int:
    """The shortest length of a `qrb` whose usable band reaches ``nu_max_hz``; its clock is length / period."""
    return next_residue_length(ceil(nu_max_hz * period_s / USABLE - 1e-9))


def register_order(period_s: float, nu_max_hz: float) -> int:
    """The lowest order of a `prbs` whose usable band reaches ``nu_max_hz``; its clock is (2**order - 1) / period."""
    return max(2, ceil(log2(nu_max_hz * period_s / USABLE + 1.0) - 1e-9))
