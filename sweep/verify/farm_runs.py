"""A farm in time: every turbine by itself, without and with damping, and one aggregated turbine beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from ...plant.circuits.branches import Branch
from ...plant.circuits.circuit import SOURCE, Circuit, scaled_branch
from ...plant.damping.control import THRESHOLD, DampingSettings
from ...plant.damping.farm_events import (
    BusFault,
    CauseGone,
    DevicePower,
    FarmControl,
    FarmEvent,
    FarmScenario,
    FarmTrajectory,
    NetworkStep,
    simulate_farm,
)
from ...plant.errors import in_words
from ...plant.protocol import FarmConditions, FarmPlant, Member, NotSettled, Together
from ...plant.registry import make_plant
from ...tuning.farm.document import farm_of
from ...tuning.farm.entries import DeviceEntry, FarmEntry, NoLoadFlow
from ...tuning.farm.farm import Farm, judged, judged_with
from ...tuning.farm.loadflow import load_flow
from ...tuning.farm.states import State, farm_in, judge_state
from ...tuning.farm.units import Library, units_of
from ...tuning.gain import series_of
from ...tuning.network.assembly import Network, port_impedance
from ...tuning.siso import SeriesRL
from .farm_story import FarmFault, FarmPower, FarmStory, FarmSwitch, SourceStep, check_name
from .reading import RunReport, report
from .tuned import VerifyError

AGGREGATE = "aggregate"

TOGETHER = "dpmsg-v1"
"""The plants that can be stepped together on one network."""

_INSTEAD = (
    "Their verdict does not need that: seqsweep farm FILE judges any devices together; and one device is simulated "
    "behind its grid by seqsweep tune, then verify"
)


class Stage(NamedTuple):
    """A farm between two switchings: when it begins, what is out of service, the source's scale, and why."""

    time_s: float
    out: frozenset[str]
    scale: float
    what: str


@dataclass(frozen=True, slots=True, eq=False)
class FarmRun:
    """One run: how, what happened, and what it says of the line and of each device."""

    title: str
    trajectory: FarmTrajectory
    line: RunReport
    devices: tuple[RunReport, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FarmVerification:
    """All runs of a farm.

    Attributes
    ----------
    farm : Farm
        Judged as its file has it: the pencil's modes.
    last : Farm or None
        Judged as the last change of the story leaves it; None where it then has no load flow. A device of one operating
        point keeps that, whatever power the story gives it.
    names : tuple of str
        Devices.
    story : FarmStory
        What happened.
    settings : tuple of DampingSettings or None
        Of each device.
    runs : tuple of FarmRun
        Without damping; with it, if any is asked for; the aggregate's without and with.
    words : tuple of str
        The events.
    """

    farm: Farm
    last: Farm | None
    names: tuple[str, ...]
    story: FarmStory
    settings: tuple[DampingSettings | None, ...]
    runs: tuple[FarmRun, ...]
    words: tuple[str, ...]


def verify_farm(document: Mapping[str, Any], library: Library, story: FarmStory) -> FarmVerification:
    """Simulate a farm file through a story.

    Raises
    ------
    VerifyError
        If its devices cannot be simulated together, or it has no state to begin from.
    """
    setting = _Setting(document, library, story)
    individual, scenario = setting.together(False)
    control = setting.control(individual)
    runs = [_run("without damping", individual, scenario, None, story)]
    if control is not None:
        gone = setting.cause_gone(scenario, False)
        runs.append(_run("with damping", individual, scenario, control, story, gone))
    if story.aggregate and len(individual.members) > 1:
        one, alone = setting.together(True)
        runs.append(_run("aggregate without damping", one, alone, None, story))
        if control is not None:
            gone = setting.cause_gone(alone, True)
            runs.append(_run("aggregate with damping", one, alone, setting.control(one), story, gone))
    names = tuple(member.name for member in individual.members)
    settings = control.devices if control is not None else (None,) * len(names)
    words = tuple(stage.what for stage in setting.stages[1:]) + tuple(_word(e) for e in story.events if _word(e))
    return FarmVerification(setting.farm, setting.last(), names, story, settings, tuple(runs), words)


class _Setting:
    """The farm file under a story: its stages, the plant of its devices, its judgement as it is written."""

    def __init__(self, document: Mapping[str, Any], library: Library, story: FarmStory):
        self.story = story
        self.document = _with_switched(document, story)
        begun = _out_at_first(document, story)
        everything = farm_of(self.document)
        self.devices = everything.devices
        self.plant = _plant_of(self.devices, library)
        self.farm = judged(farm_of(document), library)
        self.library = library
        self.stages = _stages(begun, story)
        self._check_names(everything)

    def _check_names(self, everything: FarmEntry) -> None:
        known = [device.name for device in everything.devices]
        for event in self.story.events:
            if isinstance(event, FarmPower):
                check_name(event.device, known, "device")
            if isinstance(event, FarmFault):
                check_name(event.bus, list(everything.voltages_v), "bus")
        for name in self.story.k if isinstance(self.story.k, Mapping) else ():
            check_name(name, known, "device")

    def entry_at(self, stage: Stage) -> FarmEntry:
        """The farm of a stage, its source scaled."""
        entry = farm_of(self.document, sorted(stage.out))
        *others, source = entry.network.branches
        network = Network((*others, scaled_branch(source, stage.scale)))
        return replace(entry, network=network, source_z_ohm=stage.scale * entry.source_z_ohm)

    def last(self) -> Farm | None:
        """The farm as the last change leaves it, its dampers set as the file's; None where it has no load flow."""
        entry = self.entry_at(self.stages[-1])
        events = (event for event in self.story.events if isinstance(event, FarmPower))
        asked = {e.device: e.active_power_w / 1e6 for e in sorted(events, key=lambda event: event.time_s)}
        known = [device.active_power_mw is not None and device.name in asked for device in entry.devices]
        changed = [
            replace(device, active_power_mw=asked[device.name]) if told else device
            for device, told in zip(entry.devices, known, strict=True)
        ]
        entry = replace(entry, devices=tuple(changed))
        try:
            return judged_with(entry, units_of(entry, self.library)[0], self.farm.dampers)
        except NoLoadFlow:
            return None

    def together(self, aggregated: bool) -> tuple[Together, FarmScenario]:
        """The devices, or one for all of them, and the scenario."""
        members = [self._member(device) for device in self.devices]
        entries = [self.entry_at(stage) for stage in self.stages]
        if aggregated:
            members = [_aggregate(members, entries[0])]
            entries = [_in_step(entry) for entry in entries]
        farm = self.plant.together(members, [(d.entry.bus, d.device) for d in self.farm.dampers])
        steps = [self._step(farm, stage, entry, aggregated) for stage, entry in zip(self.stages, entries, strict=True)]
        entry, first = entries[0], steps[0]
        peak_v = sqrt(2.0 / 3.0) * entry.voltages_v[entry.source_bus]
        line = entry.source_bus, entry.network.branches[len(entry.network.branches) - 1 - aggregated].name
        events = (*steps[1:], *self._others(farm, aggregated))
        scenario = FarmScenario(
            first.circuit, entry.source_voltage_v, first.connected, first.voltages_v, line, peak_v, events
        )
        return farm, scenario

    def _step(self, farm: Together, stage: Stage, entry: FarmEntry, aggregated: bool) -> NetworkStep:
        """What a stage is to the simulation; its load flow puts every device where it stands."""
        names = [device.name for device in entry.devices]
        connected = tuple(aggregated or member.name in names for member in farm.members)
        size = sum(d.factor for d in entry.devices) / farm.members[0].factor if aggregated else 1.0
        voltages = _voltages(farm, entry, connected, size)
        sizes = (size,) if aggregated else ()
        return NetworkStep(stage.time_s, _circuit(entry), connected, voltages, stage.what, sizes)

    def _others(self, farm: Together, aggregated: bool) -> list[FarmEvent]:
        """Faults, and powers of devices; of the aggregate its part of the sum."""
        found: list[FarmEvent] = []
        names = [device.name for device in self.devices]
        for event in self.story.events:
            if isinstance(event, FarmFault):
                found.append(BusFault(event.time_s, event.duration_s, event.bus, event.kind, event.r_ohm))  # type: ignore[arg-type]
            if isinstance(event, FarmPower) and not aggregated:
                found.append(DevicePower(event.time_s, names.index(event.device), event.active_power_w))
        if aggregated:
            times = {e.time_s for e in (*self.stages[1:], *self.story.events) if isinstance(e, Stage | FarmPower)}
            found += [DevicePower(time_s, 0, self._mean_power_w(time_s)) for time_s in sorted(times)]
        return found

    def _mean_power_w(self, time_s: float) -> float:
        """Of one device by the ratings: of those in service at a time, with the powers that are asked for then."""
        out = max((stage for stage in self.stages if stage.time_s <= time_s), key=lambda stage: stage.time_s).out
        members = [self._member(device) for device in self.devices if device.name not in out]
        powers = {member.name: member.active_power_w for member in members}
        asked = (e for e in self.story.events if isinstance(e, FarmPower) and e.time_s <= time_s)
        powers |= {event.device: event.active_power_w for event in sorted(asked, key=lambda event: event.time_s)}
        return sum(m.factor * powers[m.name] for m in members) / sum(m.factor for m in members)

    def _member(self, device: DeviceEntry) -> Member:
        power_mw, reactive_mvar = device.active_power_mw, device.reactive_power_mvar
        if power_mw is None:
            table = self.library.table(device.table)
            meta = table.response(device.op or table.op_ids[0]).meta
            power_mw = float(meta["active_power_mw"])
        return Member(device.name, device.bus, power_mw * 1e6, reactive_mvar * 1e6, device.factor)

    def control(self, farm: Together) -> FarmControl | None:
        """Damping control as the story asks for it; None where nothing is asked for."""
        gains = [self.story.k_of(member.name) for member in farm.members]
        if [member.name for member in farm.members] == [AGGREGATE]:
            of = [(self.story.k_of(d.name), d.factor) for d in self.devices]
            gains = [sum(k * size for k, size in of) / sum(size for _, size in of)]
        if not any(gains) and not self.farm.dampers:
            return None
        behind = seen_in_step(self.farm.entry)
        settings = tuple(
            DampingSettings(k, behind.r_ohm, behind.l_h, self._resonance_hz(), f1_hz=farm.f1_hz) if k else None
            for k in gains
        )
        return FarmControl(settings, len(self.farm.dampers), self.story.on_from_s)

    def cause_gone(self, scenario: FarmScenario, aggregated: bool) -> CauseGone | None:
        """Where all damping may stop, by the farm's topology and the tables of its devices; None: nowhere.

        The aggregate, whose one power is that of no device, keeps its damping where powers change.
        """
        margin = self.story.stop_margin
        if margin is None or (aggregated and any(isinstance(e, FarmPower) for e in self.story.events)):
            return None
        steps = [event for event in scenario.events if isinstance(event, NetworkStep)]
        begun = (scenario.circuit, scenario.connected, ())
        switched = [begun, *((step.circuit, step.connected, step.sizes) for step in steps)]
        stage_of = dict(zip(switched, self.stages, strict=True))

        def gone(conditions: FarmConditions) -> bool:
            stage = stage_of[conditions.circuit, conditions.connected, conditions.sizes]
            power = {} if aggregated else self._changed_power(conditions)
            return self._gone_in(stage, power, margin)

        return gone

    def _changed_power(self, conditions: FarmConditions) -> dict[str, float]:
        """Factors on the powers of devices that have another one than at the beginning."""
        pairs = zip(self.devices, conditions.power_scale, strict=True)
        return {device.name: scale for device, scale in pairs if scale != 1.0}

    def _gone_in(self, stage: Stage, power: Mapping[str, float], margin: float) -> bool:
        """The deactivation criterion in a stage; a power that the tables do not know leaves damping on."""
        content = {key: value for key, value in self.document.items() if key not in ("damper", "state")}
        devices = [dict(device) for device in content["device"]]
        for device in devices:
            if (scale := power.get(device.get("name", ""), 1.0)) != 1.0:
                if "active_power_mw" not in device:
                    return False
                device["active_power_mw"] *= scale
        state = State(stage.what, tuple(sorted(stage.out)), source_scale=stage.scale)
        entry = farm_in({**content, "device": devices}, state)
        return judge_state(entry, state, self.library, margin).cause_gone

    def _resonance_hz(self) -> float | None:
        """Of the file; else that of the critical mode above f1, if there is one."""
        critical = self.farm.judgement.critical
        if self.farm.entry.damping.resonance_hz is not None or critical is None:
            return self.farm.entry.damping.resonance_hz
        return self.farm.entry.f1_hz + critical.pole.imag / (2.0 * pi)


def seen_in_step(entry: FarmEntry) -> SeriesRL:
    """What a gain multiplies: as the file says, or what a device sees at f1 if all change their current in step."""
    if entry.damping.x_ohm is not None:
        return SeriesRL(entry.damping.r_ohm or 0.0, entry.damping.x_ohm, entry.f1_hz)
    z = port_impedance(entry.network, [d.bus for d in entry.devices], np.array([2j * np.pi * entry.f1_hz]))[0]
    sizes = np.array([device.factor for device in entry.devices])
    seen = complex(sizes @ (z @ sizes) / sizes.sum())
    return series_of(seen, entry.f1_hz)


# ---------------------------------------------------------------------- stages


def _with_switched(document: Mapping[str, Any], story: FarmStory) -> dict[str, Any]:
    """The document with everything in service that the story puts in."""
    put_in = {name for event in story.events if isinstance(event, FarmSwitch) for name in event.names}
    return {
        section: [_in_service(entry, put_in) for entry in entries] if isinstance(entries, list) else entries
        for section, entries in document.items()
    }


def _in_service(entry: Any, names: set[str]) -> Any:
    return {**entry, "in_service": True} if isinstance(entry, Mapping) and entry.get("name") in names else entry


def _out_at_first(document: Mapping[str, Any], story: FarmStory) -> frozenset[str]:
    """Names that are out of service at the beginning: by the story, or by the file though the story switches them."""
    by_file = {
        entry["name"]
        for entries in document.values()
        for entry in (entries if isinstance(entries, list) else [])
        if isinstance(entry, Mapping) and entry.get("in_service", True) is False and "name" in entry
    }
    put_in = {name for event in story.events if isinstance(event, FarmSwitch) for name in event.names}
    return frozenset((by_file & put_in) | set(story.out))


def _stages(begun: frozenset[str], story: FarmStory) -> list[Stage]:
    """The farm from each switching of network or devices on."""
    stages = [Stage(0.0, begun, story.source_scale, "as it begins")]
    switching = [event for event in story.events if isinstance(event, SourceStep | FarmSwitch)]
    for event in sorted(switching, key=lambda each: each.time_s):
        last = stages[-1]
        if isinstance(event, SourceStep):
            stages.append(Stage(event.time_s, last.out, event.scale, f"source x {event.scale:g} at {event.time_s:g} s"))
            continue
        out = last.out - set(event.names) if event.in_service else last.out | set(event.names)
        how = "in" if event.in_service else "out"
        stages.append(Stage(event.time_s, out, last.scale, f"{', '.join(event.names)} {how} at {event.time_s:g} s"))
    return stages


def _word(event: Any) -> str:
    if isinstance(event, FarmFault):
        return f"fault {event.kind} at {event.bus} at {event.time_s:g} s for {1e3 * event.duration_s:g} ms"
    if isinstance(event, FarmPower):
        return f"{event.device} to {event.active_power_w / 1e6:g} MW at {event.time_s:g} s"
    return ""


def _plant_of(devices: Sequence[DeviceEntry], library: Library) -> FarmPlant:
    """The one plant that all tables were swept of."""
    sections = {}
    for device in devices:
        section = library.table(device.table).meta.get("configuration", {}).get("plant")
        if section is None:
            raise VerifyError(
                f"{device.name}: {device.table} names no campaign, so that its device cannot be simulated"
            )
        sections[device.table] = section
    first, *others = sections.values()
    if any(other != first for other in others):
        raise VerifyError(
            f"the tables are of different devices ({_named_apart(sections)}); simulated together are devices of one "
            f"plant with one set of parameters, {TOGETHER}. {_INSTEAD}"
        )
    plant = make_plant(first["id"], first.get("parameters", {}))
    if not isinstance(plant, FarmPlant):
        raise VerifyError(
            f"{first['id']} ({', '.join(sections)}) is a device that is driven alone: many on one network are "
            f"simulated of {TOGETHER}. {_INSTEAD}"
        )
    return plant


def _named_apart(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """Tables with the plant that each was swept of."""
    return ", ".join(f"{table}: {section['id']}" for table, section in sections.items())


def _circuit(entry: FarmEntry) -> Circuit:
    """The network with its ideal source as a node."""
    branches = tuple(
        replace(branch, ends={entry.source_bus: 1.0, SOURCE: -1.0}) if _is_source(branch, entry) else branch
        for branch in entry.network.branches
    )
    return Circuit(branches, label=entry.name)


def _is_source(branch: Branch, entry: FarmEntry) -> bool:
    last = [b for b in entry.network.branches if not b.name.startswith(f"{AGGREGATE} ")][-1]
    return branch is last


def _voltages(farm: Together, entry: FarmEntry, connected: tuple[bool, ...], size: float) -> tuple[complex, ...]:
    """Terminal voltages (V) by a load flow; of devices that are not connected the rated one."""
    rated = complex(farm.rating.voltage_v)
    places = [k for k, on in enumerate(connected) if on]

    def drawn(voltage_v: np.ndarray) -> np.ndarray:
        everybody = np.full(len(farm.members), farm.rating.voltage_v)
        everybody[places] = voltage_v
        found: np.ndarray = size * farm.drawn(everybody)[places]
        return found

    flow = load_flow(entry, drawn)
    found = [rated] * len(farm.members)
    for place, voltage in zip(places, flow.voltage_v, strict=True):
        found[place] = complex(voltage)
    return tuple(found)


# ---------------------------------------------------------------------- one for all


def _aggregate(members: Sequence[Member], entry: FarmEntry) -> Member:
    """One turbine of the mean power that stands for those in service at the beginning."""
    names = [device.name for device in entry.devices]
    inside = [member for member in members if member.name in names]
    size = sum(member.factor for member in inside)
    power, reactive = (
        sum(member.factor * getattr(member, key) for member in inside) / size
        for key in ("active_power_w", "reactive_power_var")
    )
    return Member(AGGREGATE, AGGREGATE, power, reactive, size)


def _in_step(entry: FarmEntry) -> FarmEntry:
    """The network as one device sees it that stands for all: they feed in step, it meets their mean voltage."""
    sizes: dict[str, float] = {}
    for device in entry.devices:
        sizes[device.bus] = sizes.get(device.bus, 0.0) + device.factor
    total = sum(sizes.values())
    ends = {AGGREGATE: 1.0, **{bus: -size / total for bus, size in sizes.items()}}
    network = Network((*entry.network.branches, Branch(f"{AGGREGATE} in step", ends)))
    one = replace(entry.devices[0], name=AGGREGATE, bus=AGGREGATE, rating=total, count=1)
    return replace(entry, network=network, devices=(one,))


# ---------------------------------------------------------------------- a run


def _run(
    title: str,
    farm: Together,
    scenario: FarmScenario,
    control: FarmControl | None,
    story: FarmStory,
    cause_gone: CauseGone | None = None,
) -> FarmRun:
    try:
        found = simulate_farm(farm, scenario, control, story.duration_s, cause_gone)
    except NotSettled as refusal:
        raise VerifyError(f"the farm has no state to begin from: {in_words(refusal)}") from None
    line = report(found.line, scenario.events, THRESHOLD)
    devices = tuple(report(each, scenario.events, THRESHOLD) for each in found.devices)
    return FarmRun(title, found, line, devices)
