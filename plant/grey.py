"""``dpmsg-grey-v1``: the circuit of the reference turbine around somebody else's controller.

Everything of the reference turbine but its grid-side control: machine side, DC link, converter, filter
Lc, shunt Rf-Cf, PCC, ideal or Thevenin source. The control is a sampled black box, called every sample
time; its outputs are held in between, late by a sample if asked. How it is wired is said by a signal
map (`wiring`). docs/cigre.md is the page for users.

The machine side answers to its rotor alone, whatever the grid side does: at a settled operating point
its power into the DC link is constant, and that is how it appears here.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

from .branched import Branched, BranchedState, Forwards, Listen, Run, is_whole
from .branches import Replays
from .cigre_abi import CigreError, Library
from .damping import checked_compensation
from .dpmsg_parameters import LINE_L_H, LINE_R_OHM, TABLE_I, TurbineParameters
from .forked import Forks
from .grey_core import SampledTurbine, warm_up
from .periodic import Patience
from .protocol import Injection, Job, OperatingPoint, Phasors, Record, Source, Tone, Window

CIRCUIT = ("u_rated_v", "s_rated_va", "w1_rad_s", "l_c_h", "r_f_ohm", "c_f_f", "c_dc_f", "v_dc_ref_v")
"""Fields of `TurbineParameters` that belong to the circuit; ``v_dc_ref_v`` is where the DC link starts."""

SNAPSHOTS = ("auto", "states", "fork", "copy")
"""How a state is kept: found out, as the declared arrays, as a process, or by going the way again in a fresh copy."""

POSITIONS_KEPT = 104
"""Processes at positions: one for each shot of the largest batch, and some to spare."""

PROBE_PU = 0.02
"""Peak of the perturbation that tells whether the declared states are all there are."""


class GreyTurbine:
    """The reference turbine's circuit with a real-code controller in it.

    Parameters
    ----------
    controller : str
        ``cigre:FILE``, a TB 958 library; it is loaded into this process.
    inputs, outputs : mapping
        The signal map: what each port of the controller is; see `wiring`.
    settings : mapping
        Parameters of the controller by name; the others have its defaults.
    sample_time_s : float
        Sample time (s) of a controller that does not say its own.
    delay_samples : 0 or 1
        Samples by which the converter follows late.
    patience_s, settle_tolerance : float
        Simulated time (s) that the search for a steady state may take, and the change from one period to the next, over
        the peak, that ends it.
    snapshot : "auto", "states", "fork" or "copy"
        How states are kept; see `SNAPSHOTS`.
    damping_gain, damping_r_ohm, damping_l_h, damping_resonance_hz : float
        Damping control at the measurement port, as in `dpmsg.ReferenceTurbine`; sampled with the controller.
    **parameters : float
        Fields of `TurbineParameters` named in `CIRCUIT` to replace, e.g. ``l_c_h=0.2e-3``.

    Raises
    ------
    ValueError
        If the library cannot be used, the map does not fit its ports, or a parameter is unknown or out of its range.
    """

    id = SampledTurbine.id
    power_meaning = SampledTurbine.power_meaning

    def __init__(
        self,
        controller: str,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        settings: Mapping[str, Any] | None = None,
        *,
        sample_time_s: float | None = None,
        delay_samples: int = 0,
        patience_s: float = 60.0,
        settle_tolerance: float = 1e-10,
        snapshot: str = "auto",
        damping_gain: float = 0.0,
        damping_r_ohm: float = LINE_R_OHM,
        damping_l_h: float = LINE_L_H,
        damping_resonance_hz: float = 77.0,
        **parameters: float,
    ):
        if snapshot not in SNAPSHOTS:
            raise ValueError(f"snapshot is {snapshot!r}; {self.id} has {', '.join(map(repr, SNAPSHOTS))}")
        if delay_samples not in (0, 1) or isinstance(delay_samples, bool):
            raise ValueError(f"delay_samples is {delay_samples!r}; {self.id} takes 0 or 1")
        for name, table in {"settings": settings or {}, "inputs": inputs, "outputs": outputs}.items():
            if not isinstance(table, Mapping):
                raise ValueError(f"{name} is {table!r}; {self.id} needs a table")
        path = _path(controller)
        library = Library(path)
        self._build = partial(
            SampledTurbine,
            path,
            dict(inputs),
            dict(outputs),
            dict(settings or {}),
            _circuit(parameters),
            _sample_time(library, sample_time_s),
            delay_samples,
            Patience(*_positive(settle_tolerance=settle_tolerance, patience_s=patience_s)),
            checked_compensation(self.id, [damping_gain, damping_r_ohm, damping_l_h, damping_resonance_hz]),
        )
        self._core = core = self._build()
        self.f1_hz, self.dt_s, self.rating, self.operating_range = (
            core.f1_hz,
            core.dt_s,
            core.rating,
            core.operating_range,
        )
        self.contents = {"controller": _fingerprint(library)}
        self._branched = None if snapshot in ("auto", "states") else self._branches(snapshot)
        self._sure = snapshot != "auto"
        self._settled: dict[tuple[OperatingPoint, Source], Any] = {}

    def settle(self, operating_point: OperatingPoint, source: Source) -> Any:
        """The periodic steady state, reached by running; certified by the change over its last periods.

        Raises
        ------
        ValueError
            If the operating point is outside `operating_range`, or says |v_pcc| twice or not at all.
        NotSettled
            If the waveforms do not become periodic within ``patience_s``, or run away ("diverged").
        """
        key = operating_point, source
        if key not in self._settled:
            self._settled[key] = self._found(operating_point, source)
        return self._settled[key]

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[Any, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [
            self._go_on(job, Run(job.injection, n_steps))
            if isinstance(job.state, BranchedState)
            else self._core.run([job], n_steps)[0]
            for job in jobs
        ]

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[Any, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        return [
            self._go_on(job, Listen(job.injection, window, block_steps, n_blocks))
            if isinstance(job.state, BranchedState)
            else self._core.run_phasors([job], [window], block_steps, n_blocks)[0]
            for job, window in zip(jobs, windows, strict=True)
        ]

    def _go_on(self, job: Job, action: Run | Listen) -> tuple[BranchedState, Any]:
        self._branched = self._branched or self._branches("fork")  # a state from another process
        return self._branched.go_on(job.state, action)

    def _found(self, operating_point: OperatingPoint, source: Source) -> Any:
        """A steady state, once it is known whether states can be kept as what the library declares."""
        if self._branched is None:
            state = self._core.settle(operating_point, source)
            if self._sure or is_whole(self._core, state, self._probe):
                self._sure = True
                return state
            self._branched = self._branches("fork" if sys.platform == "linux" else "copy")
        return self._branched.settle(operating_point, source)

    def _probe(self, sign: float) -> Injection:
        return Injection("series_voltage", (Tone(1.7 * self.f1_hz, sign * PROBE_PU * self.rating.peak_voltage_v),))

    def _branches(self, snapshot: str) -> Branched:
        if snapshot == "fork":
            return Branched(Forks(partial(_forwards, self._build), warm_up, POSITIONS_KEPT))
        return Branched(Replays(partial(_forwards, partial(self._build, fresh=True))))


def around_library(path: str, **parameters: Any) -> GreyTurbine:
    """``cigre:FILE``: `GreyTurbine` with that library; parameters pass through."""
    for name in ("inputs", "outputs"):
        if name not in parameters:
            raise ValueError(f"{name} is missing: a signal map says what each port of {path} is; see docs/cigre.md")
    return GreyTurbine(f"cigre:{path}", **parameters)


def _forwards(build: partial[SampledTurbine]) -> Forwards:
    return Forwards(build())


def _path(controller: str) -> Path:
    kind, colon, rest = str(controller).partition(":")
    if not (colon and kind == "cigre" and rest):
        raise CigreError(f"controller is {controller!r}; it must read cigre:FILE, the path of a TB 958 library")
    return Path(rest)


def _circuit(parameters: Mapping[str, Any]) -> TurbineParameters:
    unknown = sorted(set(parameters) - set(CIRCUIT))
    if unknown:
        raise ValueError(f"{GreyTurbine.id} has no parameter {unknown[0]!r}; its circuit has {', '.join(CIRCUIT)}")
    return TABLE_I._replace(**dict(zip(parameters, _positive(**parameters), strict=True)))


def _positive(**values: Any) -> list[float]:
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not (value > 0.0 and isfinite(value)):
            raise ValueError(f"{name} is {value!r}; {GreyTurbine.id} needs a finite number above 0")
    return [float(value) for value in values.values()]


def _fingerprint(library: Library) -> dict[str, str]:
    """What tells this controller from the next one under the same name."""
    digest = hashlib.sha256(library.path.read_bytes()).hexdigest()
    return {"name": library.info.name, "version": library.info.version, "sha256": digest}


def _sample_time(library: Library, given: float | None) -> float:
    own = library.info.sample_time_s
    if library.info.emt_rms == 2:
        raise CigreError(
            f"{library.path} is a model for RMS programs; its control cannot be sampled in a circuit in time"
        )
    if given is None and own == 0.0:
        raise CigreError(f"{library.path} names no sample time: give sample_time_s, in s")
    if given is None:
        return own
    if not (isinstance(given, float) and 0.0 < given <= 1e-3):
        raise CigreError(f"sample_time_s is {given!r}; needed: a number above 0 and up to 1e-3, in s")
    if own and abs(given - own) > 1e-9 * own:
        raise CigreError(f"sample_time_s is {given:g} s, but {library.path} is sampled every {own:g} s: leave it away")
    return given
