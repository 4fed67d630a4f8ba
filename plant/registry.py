"""Plants by name.

A plant of ours has a versioned id such as ``branch-v1``. The rule: **changed physics, changed
version.** Whatever can move a number in the table (an equation, a default, the integrator, what the
power means) gets a new id, and the old one stays or is refused; it never answers with other numbers.
Corrections that leave every number where it was keep the id.

Other plants come in as ``python:package.module:factory``, as ``KIND:WHERE`` with a kind of `_KINDS`, or
by an entry point of the group ``seqsweep.plants`` whose name is the id. Nothing is imported before it is
asked for.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from .errors import SeqsweepError, in_words, is_without_room, nearest
from .protocol import OperatingRange, PhasorPlant, Plant, Rating

ENTRY_POINT_GROUP = "seqsweep.plants"

_KINDS = {
    "fmu": "seqsweep.plant.fmu.device:fmu_plant",
    "cigre": "seqsweep.plant.greybox.turbine:around_library",
    "process": "seqsweep.plant.boxes.program:process_plant",
}
"""Kinds of black boxes: what stands before the colon, and the factory that takes what stands behind it."""

_OF_A_CONTROLLER = ("controller", "inputs", "outputs", "settings", "sample_time_s", "delay_samples")
"""Parameters of a controller in a circuit, which no device has."""

_BLACK_BOXES: set[str] = set()
"""Registered ids whose plants load foreign code."""

_PROMISES = ("id", "f1_hz", "dt_s", "rating", "operating_range", "power_meaning", "settle", "run")

_targets: dict[str, str] = {}


class PlantError(SeqsweepError):
    """There is no such plant, or it cannot be made from these parameters."""


@dataclass(frozen=True, slots=True)
class PlantSpec:
    """What it takes to make a plant again: its id and its parameters, plain JSON values."""

    id: str
    parameters: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        try:
            own = json.loads(json.dumps(dict(self.parameters), allow_nan=False))
        except (TypeError, ValueError) as error:
            raise PlantError(f"parameters of {self.id} must be numbers, text, lists or tables: {error}") from None
        object.__setattr__(self, "parameters", own)

    def make(self) -> Plant:
        """The plant itself."""
        return make_plant(self.id, self.parameters)

    def to_json(self) -> str:
        """One line of JSON, the same for equal specs."""
        return json.dumps({"id": self.id, "parameters": self.parameters}, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> PlantSpec:
        """The spec that `to_json` wrote."""
        try:
            content = json.loads(text)
        except ValueError as error:
            raise PlantError(f"the text of a plant spec is not JSON: {error}") from None
        if not (
            isinstance(content, dict)
            and set(content) == {"id", "parameters"}
            and isinstance(content["id"], str)
            and isinstance(content["parameters"], dict)
        ):
            raise PlantError('a plant spec is {"id": text, "parameters": {...}}')
        return cls(content["id"], content["parameters"])


@dataclass(frozen=True, slots=True)
class PlantCard:
    """What a campaign must know of a plant that it does not hold: a plan can be made from it.

    Attributes
    ----------
    id, f1_hz, dt_s, rating, operating_range, power_meaning
        As in `Plant`.
    listens : bool
        Whether it is a `PhasorPlant`.
    releases_gil : bool
        Whether threads are worth while.
    fingerprint : mapping
        What the table remembers of it.
    ideal_only : str
        Why it stands on an ideal source only; empty where it does not.
    """

    id: str
    f1_hz: float
    dt_s: float
    rating: Rating
    operating_range: OperatingRange
    power_meaning: str
    listens: bool
    releases_gil: bool
    fingerprint: Mapping[str, Any]
    ideal_only: str = ""


def register(plant_id: str, target: str, *, black_box: bool = False) -> None:
    """Let ``plant_id`` name the factory at ``target``, a "module:attribute" that is imported when asked for.

    ``black_box`` says that the plant loads foreign code: it must run in a process of its own.

    Raises
    ------
    SeqsweepError
        If the id has no version, the target no colon, or the id names another target already.
    """
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*-v[0-9]+", plant_id):
        raise SeqsweepError(f"plant id {plant_id!r} must be small letters and a version, such as 'branch-v1'")
    if not re.fullmatch(r"[\w.]+:\w+", target):
        raise SeqsweepError(f"target {target!r} must read 'module:attribute'")
    if _targets.setdefault(plant_id, target) != target:
        raise SeqsweepError(f"{plant_id} is {_targets[plant_id]} already; changed physics get a new version")
    if black_box:
        _BLACK_BOXES.add(plant_id)


def registered_ids() -> list[str]:
    """Ids of the registered plants, sorted; entry points are not looked at."""
    return sorted(_targets)


def is_built_in(plant_id: str) -> bool:
    """Whether a plant is this package's own and nothing else; others are foreign and run isolated by default."""
    return _targets.get(plant_id, "").startswith(f"{__package__}.") and not is_black_box(plant_id)


def is_black_box(plant_id: str) -> bool:
    """Whether a plant loads foreign native code, or starts it: never done in the runner."""
    return plant_id in _BLACK_BOXES or plant_id.partition(":")[0] in _KINDS


def runs_isolated(plant_id: str, wish: bool | None) -> bool:
    """Whether a plant runs in a process of its own; ``wish`` is what the campaign says, None nothing.

    Raises
    ------
    PlantError
        If a black box is wished into the runner.
    """
    if is_black_box(plant_id) and wish is False:
        raise PlantError(f"plant.isolate = false: {plant_id} is foreign code, which is never loaded in the runner")
    return not is_built_in(plant_id) if wish is None else wish


def refuse_unknown_id(plant_id: str) -> None:
    """Raise `PlantError` if there is no such plant, as far as can be seen without importing anything."""
    _target(plant_id)


def make_plant(plant_id: str, parameters: Mapping[str, Any] | None = None) -> Plant:
    """The plant named ``plant_id``, made from ``parameters``.

    Parameters
    ----------
    plant_id : str
        A registered id, the name of an entry point, or ``python:package.module:factory``; for the
        last the current directory is searched first, as ``python -m`` does.
    parameters : mapping, optional
        Keyword arguments of the factory.

    Raises
    ------
    PlantError
        If there is no such plant, a parameter is unknown or refused, or what comes out is no plant.
    OSError
        If the disk is full.
    """
    factory = _find(plant_id)
    arguments = dict(parameters or {})
    _refuse_unfit(plant_id, factory, arguments)
    try:
        plant = factory(**arguments)
    except Exception as error:
        if is_without_room(error):
            raise
        raise PlantError(_refusal(plant_id, arguments, error)) from error
    missing = [name for name in _PROMISES if not hasattr(plant, name)]
    if missing:
        raise PlantError(f"{plant_id} made a {type(plant).__name__}, which is no plant: it lacks {', '.join(missing)}")
    return plant


def card_of(plant: Plant, spec: PlantSpec) -> PlantCard:
    """The card of a plant that ``spec`` made: plain values, whatever the plant made them of."""
    power, voltage = plant.operating_range.active_power_w, plant.operating_range.terminal_voltage_v
    reactive = getattr(
        plant.operating_range, "reactive_power_var", (0.0, 0.0)
    )  # a foreign plant may have its own class
    return PlantCard(
        id=str(plant.id),
        f1_hz=float(plant.f1_hz),
        dt_s=float(plant.dt_s),
        rating=Rating(float(plant.rating.voltage_v), float(plant.rating.power_va)),
        operating_range=OperatingRange(*((float(low), float(high)) for low, high in (power, voltage, reactive))),
        power_meaning=str(plant.power_meaning),
        listens=isinstance(plant, PhasorPlant),
        releases_gil=releases_gil(plant),
        fingerprint=json.loads(json.dumps(fingerprint(plant, spec))),
        ideal_only=str(getattr(plant, "ideal_only", "")),
    )


def releases_gil(plant: Plant | PlantCard) -> bool:
    """Whether the plant's class declares ``releases_gil = True``: worth running in threads."""
    return bool(getattr(plant, "releases_gil", False))


def fingerprint(plant: Plant, spec: PlantSpec) -> dict[str, Any]:
    """What the table remembers of the plant; JSON values only.

    A plant that is more than its parameters, such as the content of a file, says what in ``contents``.
    """
    return {
        "id": spec.id,
        "parameters": dict(spec.parameters),
        "dt_s": plant.dt_s,
        "f1_hz": plant.f1_hz,
        "rating": {"voltage_v": plant.rating.voltage_v, "power_va": plant.rating.power_va},
        "power_meaning": plant.power_meaning,
        **getattr(plant, "contents", {}),
    }


# ---------------------------------------------------------------------- from the id to the factory


def _find(plant_id: str) -> Any:
    kind, _, rest = plant_id.partition(":")
    target = _target(plant_id)
    if kind == "python" and os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    importlib.invalidate_caches()
    factory = _load(plant_id, target)
    return partial(factory, rest) if kind in _KINDS else factory


def _target(plant_id: str) -> str:
    """The "module:attribute" behind an id; it is not imported."""
    kind, colon, rest = plant_id.partition(":")
    if colon and kind == "python":
        if not re.fullmatch(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*", rest):
            raise PlantError(f"{plant_id} must read python:package.module:factory")
        return rest
    if colon and kind in _KINDS:
        if not rest:
            raise PlantError(f"{plant_id} must name something behind the colon")
        return _KINDS[kind]
    if colon:
        raise PlantError(f"{plant_id}: unknown kind of plant {kind!r}{nearest(kind, ['python', *_KINDS])}")
    if plant_id in _targets:
        return _targets[plant_id]
    from importlib.metadata import entry_points

    offered = {point.name: point.value for point in entry_points(group=ENTRY_POINT_GROUP)}
    if plant_id in offered:
        return offered[plant_id]
    known = sorted({*_targets, *offered})
    kinds = ", ".join(["python:package.module:factory", *(f"{kind}:..." for kind in _KINDS)])
    raise PlantError(f"unknown plant {plant_id!r}{nearest(plant_id, known)}; known are {', '.join(known)}, {kinds}")


def _load(plant_id: str, target: str) -> Any:
    module_name, _, attribute = target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        raise PlantError(f"{plant_id}: module {module_name} cannot be imported: {in_words(error)}") from error
    if not hasattr(module, attribute):
        raise PlantError(f"{plant_id}: module {module_name} has no {attribute!r}{nearest(attribute, dir(module))}")
    factory = getattr(module, attribute)
    if not callable(factory):
        raise PlantError(f"{plant_id}: {attribute} of {module_name} is a {type(factory).__name__}, not a factory")
    return factory


# ---------------------------------------------------------------------- errors that help


def _refuse_unfit(plant_id: str, factory: Any, arguments: Mapping[str, Any]) -> None:
    """Refuse what the factory's signature does not have, and what it needs and is not given."""
    try:
        signature = inspect.signature(factory).parameters
    except (TypeError, ValueError):
        return
    by_name = {name: p for name, p in signature.items() if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)}
    if not any(p.kind is p.VAR_KEYWORD for p in signature.values()):  # one with ``**`` judges for itself
        _refuse_unknown(plant_id, list(by_name), arguments)
    missing = [name for name, p in by_name.items() if p.default is p.empty and name not in arguments]
    if missing:
        what = "a parameter that is" if len(missing) == 1 else "parameters that are"
        where = "it goes" if len(missing) == 1 else "they go"
        raise PlantError(
            f"{plant_id} needs {what} missing: {', '.join(missing)}; {where} under [plant.parameters] of a campaign, "
            "which seqsweep check CAMPAIGN.toml drives"
        )


def _refuse_unknown(plant_id: str, known: Sequence[str], arguments: Iterable[str]) -> None:
    for name in arguments:
        if name in _OF_A_CONTROLLER and plant_id.startswith("fmu:") and name not in known:
            raise PlantError(
                f"{plant_id} is a whole device and has no parameter {name!r}; a controller goes into "
                f'the turbine\'s circuit: id = "dpmsg-grey-v1", and controller = "{plant_id}" among its parameters'
            )
        if name not in known:
            raise PlantError(
                f"{plant_id} has no parameter {name!r}{nearest(name, known)}; it has {', '.join(known) or 'none'}"
            )


def _refusal(plant_id: str, arguments: Mapping[str, Any], error: Exception) -> str:
    """The factory's own words, with the nearest of the names it mentions where a parameter is unknown to it."""
    words = in_words(error)
    accused = [name for name in arguments if repr(name) in words]
    mentioned = set(re.findall(r"\w+", words)) - set(arguments)
    hint = nearest(accused[0], mentioned) if accused else ""
    head = "" if words.startswith(plant_id) else f"{plant_id} cannot be made: "
    return f"{head}{words}{hint}"


register("branch-v1", "seqsweep.plant.rl_branch:RLBranch")
register("gfl-v1", "seqsweep.plant.inverters.grid_following:GridFollowing")
register("gfm-v1", "seqsweep.plant.inverters.grid_forming:GridForming")
register("dpmsg-v1", "seqsweep.plant.turbine.reference:ReferenceTurbine")
register("inverter-grey-v1", "seqsweep.plant.greybox.inverter:GreyInverter", black_box=True)
register("dpmsg-grey-v1", "seqsweep.plant.greybox.turbine:GreyTurbine", black_box=True)
