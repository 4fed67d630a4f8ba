"""Recordings to a table: files found and read in parallel, experiments paired, rows judged and written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...identify.operating_state import fundamental_facts, stated
from ...identify.recorded.points import SLIP, Experiment, Point, broadband_points, points_of, without_common_lines
from ...identify.response import FrequencyResponse
from ...identify.settling import STEADY_LIMIT, growth_bound
from ...identify.table.write import write_table
from ...plant.errors import SeqsweepError
from ...plant.protocol import Rating, SourceDirection
from ...plant.recordings.channels import parse_channels
from ...plant.recordings.read import recordings_in
from ...plant.recordings.recording import RecordingError
from ...plant.recordings.units import parse_units
from .listen import Fundamental, Listened, Task, listen
from .match import Told, match, read_manifest

POWER_MEANING = "active power out of the device at the PCC, of the fundamental, as recorded"

MOST_REFUSALS = 20
"""Reasons that an error lists where no recording could be used."""

TAKES_UP = 0.02
"""Active power into the device, relative to its apparent power, that is worth a word."""

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What the user asks.

    Attributes
    ----------
    files : tuple of Path
        Recordings, and folders of them.
    manifest : Path or None
        What was injected.
    direction : "load", "generator" or None
        Of the recorded current; None: the manifest says.
    channels : mapping
        Role to channel name.
    f1_hz, sample_rate_hz : float or None
        Overrule the estimate and the files (Hz).
    rating : Rating or None
        Bases; None: the manifest's, else what was recorded.
    op_id : str or None
        Name of the operating point.
    stable_on : mapping or None
        The source on which the device was recorded, as `operating_state.stated` gives it.
    units : mapping
        Unit of "voltage" and of "current"; it overrules the files.
    """

    files: tuple[Path, ...]
    manifest: Path | None = None
    direction: SourceDirection | None = None
    channels: Mapping[str, str] = field(default_factory=dict)
    f1_hz: float | None = None
    sample_rate_hz: float | None = None
    rating: Rating | None = None
    op_id: str | None = None
    stable_on: Mapping[str, Any] | None = None
    units: Mapping[str, str] = field(default_factory=dict)


class Outcome(NamedTuple):
    """Rows by status, and how many recordings gave nothing."""

    statuses: dict[str, int]
    left_out: int

    @property
    def all_ok(self) -> bool:
        return set(self.statuses) <= {"ok"} and not self.left_out


class IdentifyError(SeqsweepError):
    """Recordings out of which no table can be made, with the way out."""


def request_of(
    files: Sequence[Path],
    manifest: Path | None,
    channels: str,
    direction: str | None,
    f1: str,
    sample_rate_hz: float | None,
    rating: tuple[float | None, float | None],
    op_id: str | None,
    stable_on: str | None = None,
    units: tuple[str | None, str | None] = (None, None),
) -> Request:
    """The words of the command line as a `Request`; `IdentifyError` where one of them makes no sense."""
    if direction not in (None, "load", "generator"):
        raise IdentifyError(f"--direction {direction!r}: it is load (into the device) or generator (out of it)")
    if (rating[0] is None) != (rating[1] is None):
        raise IdentifyError("--rated-voltage-v and --rated-power-va go together")
    if any(x is not None and not x > 0.0 for x in (*rating, sample_rate_hz)):
        raise IdentifyError("ratings and sampling rate must be above 0")
    return Request(
        files=tuple(files),
        manifest=manifest,
        direction=direction,  # type: ignore[arg-type]
        channels=parse_channels(channels),
        f1_hz=_frequency(f1),
        sample_rate_hz=sample_rate_hz,
        rating=None if rating[0] is None or rating[1] is None else Rating(rating[0], rating[1]),
        op_id=op_id,
        stable_on=None if stable_on is None else stated(stable_on),
        units=parse_units(*units),
    )


def _frequency(text: str) -> float | None:
    """None for "auto", else Hz."""
    if text.strip().lower() == "auto":
        return None
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not value > 0.0:
        raise IdentifyError(f"--f1 {text!r}: it is auto, or a frequency above 0 in Hz")
    return value


def identify(request: Request, output: Path, *, jobs: int, say: Say = lambda text: None) -> Outcome:
    """Read recordings, identify the 2x2 admittance and write the table to ``output``.

    Parameters
    ----------
    request : Request
        Files and what is known about them.
    output : path
        The Parquet table.
    jobs : int
        Workers.
    say : callable
        Called with what a person should know: channels chosen, lies found, files left out.

    Raises
    ------
    IdentifyError, RecordingError, ManifestError
        If nothing can be identified.
    """
    found = identified(request, jobs=jobs, say=say)
    write_table(output, [found.response], found.meta)
    return found.outcome


class Identified(NamedTuple):
    """What recordings gave: the response, the metadata that `write_table` completes, and how it went."""

    response: FrequencyResponse
    meta: dict[str, Any]
    outcome: Outcome


def identified(request: Request, *, jobs: int, say: Say = lambda text: None) -> Identified:
    """`identify` without a file."""
    manifest = read_manifest(request.manifest) if request.manifest else None
    tasks, words = _tasks(request, manifest)
    for word in words:
        say(word)
    results = _listen_all(tasks, jobs)
    _check_any_heard(results)
    for word in dict.fromkeys(word for result in results for word in _words(result)):
        say(word)
    experiments, unused = without_common_lines([each for result in results for each in result.experiments])
    for word in unused:
        say(word)
    seen = [each for result in results for each in result.fundamentals]
    if word := _taking_up(seen, tasks[0].direction):
        say(word)
    f1_hz = _f1_of_table(seen, experiments, manifest)
    points = _completed(points_of(experiments, f1_hz), manifest, experiments)
    points = _joined(points, broadband_points([r.broadband for r in results if r.broadband], f1_hz))
    rating = request.rating or (manifest.rating if manifest else _recorded_rating(seen, say))
    op_id = request.op_id or (manifest.op_id if manifest else "recorded")
    response = _response(points, f1_hz, {"op_id": op_id, **_operating_state(request, points, seen)})
    left_out = sum(result.refusal is not None for result in results)
    return Identified(
        response,
        _metadata(request, manifest, tasks, response, rating, seen),
        Outcome(dict(Counter(point.status for point in points)), left_out),
    )


# What to read


def _tasks(request: Request, manifest: Told | None) -> tuple[list[Task], list[str]]:
    files = [each for path in request.files for each in _existing(path)]
    if not files:
        raise IdentifyError(f"{', '.join(map(str, request.files))}: no recordings there")
    direction = request.direction or (manifest.direction if manifest else None)
    if direction is None:
        raise IdentifyError(
            "in which direction was the current recorded? --direction load: positive into the device; "
            "--direction generator: positive out of it, towards the grid"
        )
    rating = request.rating or (manifest.rating if manifest else None)
    blank = Task(
        files[0],
        direction,
        channels=dict(request.channels),
        f1_hz=request.f1_hz,
        sample_rate_hz=request.sample_rate_hz,
        units=dict(request.units),
        base=None if rating is None else (rating.peak_voltage_v, rating.peak_current_a),
    )
    if manifest is None:
        return [replace(blank, path=path) for path in files], []
    pairs, words = match(manifest, files)
    quiet_s = {path: min(e.start_s for other, e in pairs if other == path) for path, _ in pairs}
    tasks = [
        replace(blank, path=p, experiment=e, amplitude_base=manifest.amplitude_base, quiet_until_s=quiet_s[p])
        for p, e in pairs
    ]
    return tasks, words


def _existing(path: Path) -> list[Path]:
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    return recordings_in(path)


def _recorded_rating(seen: Sequence[Fundamental], say: Say) -> Rating:
    """One per unit is what was recorded, where nobody says more."""
    voltage_v = float(np.median([each.line_voltage_v for each in seen]))
    power_va = float(np.median([each.apparent_va for each in seen]))
    say(
        f"no rating given: per unit is what was recorded, {voltage_v:.6g} V and {power_va:.6g} VA "
        "(--rated-voltage-v, --rated-power-va)"
    )
    return Rating(voltage_v, power_va)


def _taking_up(seen: Sequence[Fundamental], direction: SourceDirection) -> str:
    """What to say where power flows into the device: true of a load, of a generator the wrong direction."""
    power_w = float(np.median([each.power_w for each in seen]))
    if not power_w < -TAKES_UP * float(np.median([each.apparent_va for each in seen])):
        return ""
    other = {"load": "generator", "generator": "load"}[direction]
    return (
        f"the device takes up {-power_w / 1e6:.4g} MW when its current counts as --direction {direction} says; if it "
        f"generates, it was recorded the other way: --direction {other}"
    )


def _listen_all(tasks: Sequence[Task], jobs: int) -> list[Listened]:
    """Every recording, in order; several workers where there are several recordings."""
    if jobs == 1 or len(tasks) == 1:
        return [listen(task) for task in tasks]
    from joblib import Parallel, delayed

    return list(Parallel(n_jobs=min(jobs, len(tasks)))(delayed(listen)(task) for task in tasks))


def _check_any_heard(results: Sequence[Listened]) -> None:
    """Refuse where every recording was left out: the error then has the reasons, each once."""
    if any(result.fundamentals for result in results):
        return
    refusals = list(dict.fromkeys(f"{result.name}: {result.refusal}" for result in results))
    more = [f"and {len(refusals) - MOST_REFUSALS} more"] if len(refusals) > MOST_REFUSALS else []
    raise IdentifyError("\n".join(["no recording could be used:", *refusals[:MOST_REFUSALS], *more]))


def _words(result: Listened) -> list[str]:
    """What a person should know of a recording; experiments of one file say the same of it."""
    if result.refusal is not None:
        return [f"{result.name}: left out: {result.refusal}"]
    return [f"{result.name}: {note}" for note in result.notes]


# Rows


def _f1_of_table(seen: Sequence[Fundamental], experiments: Sequence[Experiment], manifest: Told | None) -> float:
    """Median of what the records have; the manifest's where the records cannot tell the two apart."""
    found = float(np.median([each.f1_hz for each in seen]))
    if manifest is None or not experiments:
        return found
    window_s = max(e.heard.window_s for e in experiments)
    return manifest.f1_hz if abs(found - manifest.f1_hz) * window_s < SLIP else found


def _completed(points: list[Point], manifest: Told | None, experiments: Sequence[Experiment]) -> list[Point]:
    """A manifest's points that have no experiment at all are rows too."""
    if manifest is None:
        return points
    served = {round(e.serves_hz, 6) for e in experiments if e.serves_hz is not None}
    asked = {round(shot.f_hz, 6) for e in manifest.experiments for shot in e.shots}
    missing = [_lost(f) for f in sorted(asked - served)]
    return sorted([*points, *missing], key=lambda point: point.f_hz)


def _joined(points: list[Point], more: list[Point]) -> list[Point]:
    """Rows of tones, and those of broadband records beside them."""
    taken = np.array([point.f_hz for point in points])
    fresh = [point for point in more if not len(taken) or np.min(np.abs(taken - point.f_hz)) > 1e-6]
    return sorted([*points, *fresh], key=lambda point: point.f_hz)


def _lost(f_hz: float) -> Point:
    nothing = np.full((2, 2), complex(nan, nan))
    reason = "none of its experiments could be used: see what was said about their recordings"
    return Point(f_hz, nothing, np.full((8, 8), nan), "failed", reason, nan, nan, nan, nan, nan)


def _operating_state(request: Request, points: Sequence[Point], seen: Sequence[Fundamental]) -> dict[str, Any]:
    """The fundamental that the records have, and where they prove the device to be stable."""
    v1 = np.median([abs(each.v1) for each in seen])  # the angle of a record's clock says nothing
    i1 = np.array([each.i1 * abs(each.v1) / each.v1 for each in seen])
    state: dict[str, Any] = {
        "fundamental": fundamental_facts(complex(v1), complex(np.median(i1.real), np.median(i1.imag)))
    }
    if request.stable_on is not None:
        state["stable_on"] = {**request.stable_on, **_proof(points)}
    return state


def _proof(points: Sequence[Point]) -> dict[str, Any]:
    """How fast a mode may grow without the records showing it; nothing where none of them is steady."""
    farthest_rad_s = 4.0 * pi * max(point.f_hz for point in points)
    bounds = [
        (growth_bound(STEADY_LIMIT * point.residual, 0.5 * point.window_s, point.window_s, farthest_rad_s), point)
        for point in points
        if point.status in ("ok", "noisy") and STEADY_LIMIT * point.residual < 0.5
    ]
    if not bounds:
        return {}
    bound, at = min(bounds, key=lambda each: each[0])
    return {"basis": "recordings", "growth_bound_per_s": bound, "disturbed_s": at.window_s}


def _response(points: Sequence[Point], f1_hz: float, meta: dict[str, Any]) -> FrequencyResponse:
    if not points:
        raise IdentifyError("no point above 0 Hz was found")
    return FrequencyResponse(
        f_hz=np.array([p.f_hz for p in points]),
        y=np.array([p.y for p in points]),
        f1_hz=f1_hz,
        covariance=np.array([p.covariance for p in points]),
        status=np.array([p.status for p in points]),
        reason=np.array([p.reason for p in points]),
        quality={
            name: np.array([getattr(p, name) for p in points])
            for name in ("amplitude_pu", "n_periods", "window_s", "cond_v", "residual")
        },
        meta=meta,
    )


def _metadata(
    request: Request,
    manifest: Told | None,
    tasks: Iterable[Task],
    response: FrequencyResponse,
    rating: Rating,
    seen: Sequence[Fundamental],
) -> dict[str, Any]:
    voltage_v = float(np.median([each.line_voltage_v for each in seen]))
    paths = dict.fromkeys(task.path for task in tasks)
    files = [{"name": path.name, "bytes": path.stat().st_size} for path in paths]
    direction = request.direction or (manifest.direction if manifest else None)
    return {
        "f1_hz": response.f1_hz,
        "bases": {"rated_voltage_v": rating.voltage_v, "rated_power_va": rating.power_va},
        "power_meaning": POWER_MEANING,
        "operating_points": [
            {
                "op_id": response.meta["op_id"],
                "active_power_mw": float(np.median([each.power_w for each in seen])) / 1e6,
                "terminal_voltage_pu": voltage_v / rating.voltage_v,
            }
        ],
        "configuration": {
            "recordings": {
                "files": files,
                "channels": dict(request.channels),
                "units": dict(request.units),
                "f1_hz": request.f1_hz,
                "sample_rate_hz": request.sample_rate_hz,
                "manifest": manifest.content if manifest else None,
            }
        },
        "plant": {"id": "recordings", "source_direction": direction, "n_recordings": len(files)},
    }
