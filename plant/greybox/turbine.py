"""``dpmsg-grey-v1``: the circuit of the reference turbine around somebody else's controller.

Everything of the reference turbine but its grid-side control: machine side, DC link, converter, filter
Lc, shunt Rf-Cf, PCC, ideal or Thevenin source. The control is a sampled black box, called every sample
time; its outputs are held in between, late by a sample if asked. How it is wired is said by a signal
map (`wiring`). docs/cigre.md is the page for users.

The machine side answers to its rotor alone, whatever the grid side does: at a settled operating point
its power into the DC link is constant, and that is how it appears here.
"""

from __future__ import annotations

import shutil
import sys
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from inspect import signature
from math import isfinite
from pathlib import Path
from typing import Any

from ..boxes.opaque_plant import (
    Branched,
    BranchedState,
    Calm,
    Forwards,
    Listen,
    Rest,
    Run,
    Settle,
    Watch,
    is_whole,
    watch,
)
from ..controllers.interface import ControllerFault, Offer
from ..damping.control import checked_compensation
from ..errors import SeqsweepError, nearest
from ..protocol import (
    Conditions,
    Injection,
    Job,
    NotSettled,
    OperatingPoint,
    Phasors,
    Record,
    Source,
    Tone,
    Trace,
    Window,
)
from ..states.forks import BoxDied, Forks
from ..states.steady_state import Patience
from ..states.stores import Replays, SnapshotBox, Snapshots
from ..turbine.parameters import LINE_L_H, LINE_R_OHM, TABLE_I, TurbineParameters
from .kernel_arguments import warm_up
from .stepping import SampledTurbine

CIRCUIT = ("u_rated_v", "s_rated_va", "w1_rad_s", "l_c_h", "r_f_ohm", "c_f_f", "c_dc_f", "v_dc_ref_v")
"""Fields of `TurbineParameters` that belong to the circuit; ``v_dc_ref_v`` is where the DC link starts."""

SNAPSHOTS = ("auto", "states", "fork", "copy")
"""How a state is kept: found out, by the controller's own means, as a process, or by going again in a fresh copy."""

_FALLBACK = "fork" if sys.platform == "linux" else "copy"
"""What any controller stands."""

LONGEST_SAMPLE_S = 1e-3

PROBE_PU = 0.02
"""Peak of the perturbation that tells whether the declared states are all there are."""


class GreyTurbine:
    """The reference turbine's circuit with a controller in it.

    Parameters
    ----------
    controller : str
        ``cigre:FILE``, a TB 958 library, or ``fmu:FILE``, an FMU for co-simulation; it is loaded into this process.
    inputs, outputs : mapping
        The signal map: what each port of the controller is; see `wiring`.
    settings : mapping
        Parameters of the controller by name; the others have its defaults.
    sample_time_s : float
        Sample time (s) of a controller that does not say its own; communication step of an FMU.
    delay_samples : 0 or 1
        Samples by which the converter follows late.
    patience_s, settle_tolerance : float
        Simulated time (s) that the search for a steady state may take, and the change from one period to the next, over
        the peak, that ends it.
    snapshot : "auto", "states", "fork" or "copy"
        How states are kept; see `SNAPSHOTS`.
    validate : bool
        Whether an FMU whose description breaks the standard is refused.
    damping_gain, damping_r_ohm, damping_l_h, damping_resonance_hz : float
        Damping control at the measurement port, as in `dpmsg.ReferenceTurbine`; sampled with the controller.
    **parameters : float
        Fields of `TurbineParameters` named in `CIRCUIT` to replace, e.g. ``l_c_h=0.2e-3``.

    Raises
    ------
    SeqsweepError
        If the controller cannot be used, the map does not fit its ports, or a parameter is unknown or out of its range.
    """

    id = SampledTurbine.id
    power_meaning = SampledTurbine.power_meaning
    _core_class: type[SampledTurbine] = SampledTurbine

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
        validate: bool = True,
        damping_gain: float = 0.0,
        damping_r_ohm: float = LINE_R_OHM,
        damping_l_h: float = LINE_L_H,
        damping_resonance_hz: float = 77.0,
        **parameters: float,
    ):
        if snapshot not in SNAPSHOTS:
            raise SeqsweepError(f"snapshot is {snapshot!r}; {self.id} has {', '.join(map(repr, SNAPSHOTS))}")
        if delay_samples not in (0, 1) or isinstance(delay_samples, bool):
            raise SeqsweepError(f"delay_samples is {delay_samples!r}; {self.id} takes 0 or 1")
        for name, table in {"settings": settings or {}, "inputs": inputs, "outputs": outputs}.items():
            if not isinstance(table, Mapping):
                raise SeqsweepError(f"{name} is {table!r}; {self.id} needs a table")
        offer = _offer(controller, settings or {}, outputs, sample_time_s, snapshot, validate)
        if offer.folder is not None:
            weakref.finalize(self, shutil.rmtree, offer.folder, ignore_errors=True)
        self._offer = offer
        self._build = partial(
            self._core_class,
            inputs=dict(inputs),
            outputs=dict(outputs),
            parameters=self._circuit(parameters),
            dt_s=offer.sample_time_s,
            delay=delay_samples,
            patience=Patience(*_positive(settle_tolerance=settle_tolerance, patience_s=patience_s)),
            block=checked_compensation(self.id, [damping_gain, damping_r_ohm, damping_l_h, damping_resonance_hz]),
        )
        self._core = core = self._build(offer.open)
        self.f1_hz, self.dt_s, self.rating, self.operating_range = (
            core.f1_hz,
            core.dt_s,
            core.rating,
            core.operating_range,
        )
        self.contents = {"controller": dict(offer.contents)}
        self._sure = snapshot != "auto" or not offer.states
        self._branched = self._branches(_kept(snapshot, offer, controller))
        self.compensation = core.compensation
        self._settled: dict[tuple[OperatingPoint, Source], Any] = {}
        self._at_rest: dict[tuple[OperatingPoint, Source], Any] = {}

    @staticmethod
    def _circuit(parameters: Mapping[str, Any]) -> Any:
        """The circuit with these parameters, each checked."""
        return _circuit(parameters)

    def settle(self, operating_point: OperatingPoint, source: Source) -> Any:
        """The periodic steady state, reached by running; certified by the change over its last periods.

        Raises
        ------
        SeqsweepError
            If the operating point is outside `operating_range`, or says |v_pcc| twice or not at all.
        NotSettled
            If the waveforms do not become periodic within ``patience_s``, or run away ("diverged").
        """
        key = operating_point, source
        if key not in self._settled:
            self._settled[key] = self._found(Settle(operating_point, source))
        return self._settled[key]

    def equilibrium(self, operating_point: OperatingPoint, source: Source) -> Any:
        """The periodic state, stable or not; see `MeasuredPlant.equilibrium`, and `SampledTurbine.equilibrium` for how.

        Raises
        ------
        SeqsweepError
            As `settle`.
        NotSettled
            If the controller comes to rest neither on an ideal source nor behind the grid.
        """
        key = operating_point, source
        if key not in self._at_rest:
            self._at_rest[key] = self._calmed(self._found(Rest(operating_point, source)))
        return self._at_rest[key]

    def trace(self, state: Any, conditions: Conditions, n_steps: int) -> tuple[Any, Trace]:
        """Go on under ``conditions``; see `MeasuredPlant.trace`, and `SampledTurbine.trace` for what is shown."""
        if isinstance(state, BranchedState):
            return self._go_on(state, watch(conditions, n_steps))
        return self._core.trace(state, conditions, n_steps)

    def run(self, jobs: Sequence[Job], n_steps: int) -> list[tuple[Any, Record]]:
        """Run every job ``n_steps`` further; see `Plant.run`."""
        return [
            self._go_on(job.state, Run(job.injection, n_steps))
            if isinstance(job.state, BranchedState)
            else self._core.run([job], n_steps)[0]
            for job in jobs
        ]

    def run_phasors(
        self, jobs: Sequence[Job], windows: Sequence[Window], block_steps: int, n_blocks: int
    ) -> list[tuple[Any, Phasors]]:
        """Run every job ``n_blocks`` blocks further, listening to one line each; see `PhasorPlant`."""
        return [
            self._go_on(job.state, Listen(job.injection, window, block_steps, n_blocks))
            if isinstance(job.state, BranchedState)
            else self._core.run_phasors([job], [window], block_steps, n_blocks)[0]
            for job, window in zip(jobs, windows, strict=True)
        ]

    def _go_on(self, state: BranchedState, action: Run | Listen | Watch | Calm) -> tuple[BranchedState, Any]:
        if not self._sure or self._branched is None:  # a state from another process, which knew more
            self._branched, self._sure = self._by_processes(), True
        return self._branched.go_on(state, action)

    def _calmed(self, state: Any) -> Any:
        """What ``state`` comes to by waiting; where the closed loop is unstable, ``state``."""
        try:
            return self._go_on(state, Calm())[0] if isinstance(state, BranchedState) else self._core.calmed(state)
        except (NotSettled, ControllerFault, RuntimeError, BoxDied):  # it may well give up where it swings up
            return state

    def _found(self, action: Settle | Rest) -> Any:
        """A steady state, once it is known whether the controller's own means keep all of it."""
        state = self._branched.begin(action) if self._branched else action.of(self._core)
        if self._sure:
            return state
        self._sure = True  # so that the question below is answered from the states in question
        if is_whole(self, state, self._probe):
            return state
        self._branched = self._by_processes()
        return self._branched.begin(action)

    def _probe(self, sign: float) -> Injection:
        return Injection("series_voltage", (Tone(1.7 * self.f1_hz, sign * PROBE_PU * self.rating.peak_voltage_v),))

    def _branches(self, kept: str) -> Branched | None:
        """What keeps the states, if they are not in hand."""
        if kept == "arrays":
            return None
        if kept == "snapshots":
            return Branched(Snapshots(partial(_going_back, partial(self._build, self._offer.open))))
        return self._by_forks() if kept == "fork" else self._by_copies()

    def _by_processes(self) -> Branched:
        """What keeps the states of any controller."""
        return self._by_forks() if _FALLBACK == "fork" else self._by_copies()

    def _by_forks(self) -> Branched:
        return Branched(Forks(partial(_forwards, partial(self._build, self._offer.open)), warm_up))

    def _by_copies(self) -> Branched:
        return Branched(Replays(partial(_forwards, partial(self._build, self._offer.open_copy))))


class GoingBack(Forwards):
    """A circuit whose controller takes snapshots of itself, and the state it is in.

    Parameters
    ----------
    plant : SampledTurbine
        Its controller stays the same one from run to run.
    """

    def __init__(self, plant: SampledTurbine):
        super().__init__(plant)
        self._controller: SnapshotBox = plant.controller  # type: ignore[assignment]  # as its `Offer` says

    def save(self) -> Any:
        """The circuit's state and the controller's snapshot."""
        return self.state, self._controller.save()

    def load(self, snapshot: Any) -> None:
        """Be as it was when ``snapshot`` was taken."""
        self.state, held = snapshot
        self._controller.load(held)

    def drop(self, snapshot: Any) -> None:
        """Give the controller's snapshot back to it."""
        self._controller.drop(snapshot[1])


def around_library(path: str, **parameters: Any) -> GreyTurbine:
    """``cigre:FILE``: `GreyTurbine` with that library; parameters pass through."""
    for name in ("inputs", "outputs"):
        if name not in parameters:
            raise SeqsweepError(f"{name} is missing: a signal map says what each port of {path} is; see docs/cigre.md")
    return GreyTurbine(f"cigre:{path}", **parameters)


def _forwards(build: Callable[[], SampledTurbine]) -> Forwards:
    return Forwards(build())


def _going_back(build: Callable[[], SampledTurbine]) -> GoingBack:
    return GoingBack(build())


def _offer(
    controller: str,
    settings: Mapping[str, Any],
    outputs: Mapping[str, Any],
    sample_time_s: float | None,
    snapshot: str,
    validate: bool,
) -> Offer:
    """The controller by its kind, read and ready to be opened."""
    kind, colon, rest = str(controller).partition(":")
    if not (colon and kind in ("cigre", "fmu") and rest):
        raise SeqsweepError(
            f"controller is {controller!r}; it must read cigre:FILE (a TB 958 library) or fmu:FILE (an FMU)"
        )
    if sample_time_s is not None and not (isinstance(sample_time_s, float) and 0.0 < sample_time_s <= LONGEST_SAMPLE_S):
        raise SeqsweepError(
            f"sample_time_s is {sample_time_s!r}; needed: a number above 0 and up to {LONGEST_SAMPLE_S:g}, in s"
        )
    if kind == "cigre":
        from ..controllers import cigre

        return cigre.offer(Path(rest), settings, sample_time_s)
    from ..controllers import fmu as fmu_controller

    by_snapshot = snapshot in ("auto", "states")
    return fmu_controller.offer(Path(rest), settings, sample_time_s, outputs, by_snapshot, validate)


def _kept(snapshot: str, offer: Offer, controller: str) -> str:
    """How states are kept at first."""
    if snapshot == "states" and not offer.states:
        raise SeqsweepError(
            f'snapshot = "states", but {controller} cannot get and set its state; "auto" takes what there is'
        )
    if snapshot in ("auto", "states"):
        return offer.states or _FALLBACK
    return snapshot


def _circuit(parameters: Mapping[str, Any]) -> TurbineParameters:
    unknown = sorted(set(parameters) - set(CIRCUIT))
    if unknown:
        known = [name for name, p in signature(GreyTurbine).parameters.items() if p.kind is not p.VAR_KEYWORD]
        hint = nearest(unknown[0], [*known, *CIRCUIT])
        raise SeqsweepError(
            f"{GreyTurbine.id} has no parameter {unknown[0]!r}{hint}; it has {', '.join(known)}, and for its circuit "
            f"{', '.join(CIRCUIT)}"
        )
    return TABLE_I._replace(**dict(zip(parameters, _positive(**parameters), strict=True)))


def _positive(**values: Any) -> list[float]:
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not (value > 0.0 and isfinite(value)):
            raise SeqsweepError(f"{name} is {value!r}; {GreyTurbine.id} needs a finite number above 0")
    return [float(value) for value in values.values()]
