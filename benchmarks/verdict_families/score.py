"""The score: every bar with its figure, tables by family and condition, the worst cases with what reproduces them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .cases import Case

FAR = 0.03
"""Relative distance of the edge from which on a verdict is expected."""

QUIET, NOISY = 1.001e-3, 1.001e-2
"""Noise of Y up to which the first and the second bar for "undecided" count."""

LIGHT = 0.1
"""Damping below which a mode must be named as the resonance."""

NEAR_HZ = 0.5
"""How near its frequency must be where the noise is at most 0.1 %."""

CHI2 = 5.991464547107979
"""95 % of two degrees of freedom."""

SPURIOUS = 0.05
"""A pole farther than this part of its size from every exact one is none; half a hertz and four of its own standard
errors are allowed as well."""


@dataclass(frozen=True)
class Bar:
    """A figure and what it must be; ``of`` is the number of cases it rests on."""

    what: str
    value: float
    low: float
    high: float
    of: int
    unit: str = "%"

    @property
    def met(self) -> bool:
        """Whether it is within its limits; a figure that rests on nothing is not."""
        return bool(self.of > 0 and self.low <= self.value <= self.high)

    def row(self) -> str:
        """A row of a Markdown table."""
        limit = f"<= {self.high:g}" if self.low <= 0.0 else f">= {self.low:g}"
        limit = f"{self.low:g} to {self.high:g}" if self.low > 0.0 and np.isfinite(self.high) else limit
        value = "-" if self.of == 0 else f"{self.value:.3g} {self.unit}".strip()
        return f"| {self.what} | {self.of:,} | {value} | {limit} {self.unit} | {self._judgement()} |"

    def _judgement(self) -> str:
        if self.of == 0:
            return "no case"
        return "met" if self.met else "**missed**"


def bars(cases: Sequence[Case]) -> list[Bar]:
    """Every bar of the benchmark."""
    counted = [c for c in cases if not c.truth.hidden]
    light = [c for c in cases if resonance_is_asked(c)]
    noisy = [c for c in cases if c.spec.source == "exact" and c.noise >= 1e-4 and names_the_critical_mode(c)]
    quiet = [c for c in cases if is_asked_sharply(c)]
    named = [c for c in cases if np.isfinite(c.said.resonance.real)]
    return [
        _share("wrong", counted, lambda c: c.wrong, 0.1),
        _share("wrong, and stated as certain", counted, lambda c: c.wrong and c.certain, 0.0),
        _share("no answer but an exception", cases, lambda c: c.said.verdict == "crash", 0.0),
        _share(
            "undecided, covered, edge > 3 % away, noise <= 0.1 %",
            [c for c in cases if is_due(c, QUIET)],
            undecided,
            2.0,
        ),
        _share(
            "the same, or without rows where the device is faintly active",
            [c for c in cases if is_nearly_due(c, QUIET)],
            undecided,
            2.0,
        ),
        _share(
            "undecided, covered, edge > 3 % away, noise up to 1 %",
            [c for c in cases if is_due(c, NOISY) and not is_due(c, QUIET)],
            undecided,
            10.0,
        ),
        _at_least("resonance named where its mode is covered and damped < 10 %", light, resonance_is_right, 95.0),
        _share("resonances that are none", named, is_phantom, 0.0),
        _between("exact pole within the 95 % ellipse, noise >= 0.01 %", noisy, in_ellipse, 93.0, 97.0),
        _largest("largest error of the pole, noise-free rows", quiet, pole_error, 2e-3),
    ]


def _share(what: str, some: Sequence[Case], is_so: Callable[[Case], bool], most: float) -> Bar:
    return Bar(what, 100.0 * float(np.mean([is_so(c) for c in some])) if some else np.nan, 0.0, most, len(some))


def _at_least(what: str, some: Sequence[Case], is_so: Callable[[Case], bool], least: float) -> Bar:
    return Bar(what, 100.0 * float(np.mean([is_so(c) for c in some])) if some else np.nan, least, np.inf, len(some))


def _between(what: str, some: Sequence[Case], is_so: Callable[[Case], bool], low: float, high: float) -> Bar:
    return Bar(what, 100.0 * float(np.mean([is_so(c) for c in some])) if some else np.nan, low, high, len(some))


def _largest(what: str, some: Sequence[Case], of: Callable[[Case], float], most: float) -> Bar:
    return Bar(what, max((of(c) for c in some), default=np.nan), 0.0, most, len(some), "rad/s")


# What the bars count


def undecided(case: Case) -> bool:
    """Whether no verdict was given."""
    return case.said.verdict in ("undecided", "crash")


def is_due(case: Case, noise: float) -> bool:
    """Whether a verdict can be expected: the fact is known, rows cover the question, the edge is not near."""
    return case.truth.covered and is_nearly_due(case, noise)


def is_nearly_due(case: Case, noise: float) -> bool:
    """The same, or rows are missing only where the device is faintly active."""
    return bool(
        case.spec.fact
        and not case.spec.float32
        and case.spec.outliers == 0
        and case.truth.nearly_covered
        and case.truth.distance > FAR
        and case.noise <= noise
    )


def damping(pole: complex) -> float:
    """-Re/|pole|."""
    return float(-pole.real / abs(pole))


def resonance_is_asked(case: Case) -> bool:
    """Whether the exact critical mode is covered and lightly damped."""
    critical = case.truth.critical
    return bool(
        np.isfinite(critical.real)
        and case.truth.critical_covered
        and damping(critical) < LIGHT
        and case.noise <= NOISY
        and not case.spec.float32
        and case.spec.outliers == 0
    )


def resonance_is_right(case: Case) -> bool:
    """Whether the exact critical mode, or one damped as lightly to within a hundredth, is named."""
    said, critical = case.said.resonance, case.truth.critical
    if not np.isfinite(said.real):
        return False
    upper = case.truth.poles[case.truth.poles.imag > 0.0]
    alike = [p for p in upper if damping(p) < damping(critical) + 0.01]
    return any(_is_named(case, said, complex(p)) for p in alike)


def _is_named(case: Case, said: complex, exact: complex) -> bool:
    off_hz = abs(said.imag - exact.imag) / (2.0 * np.pi)
    if off_hz <= NEAR_HZ:
        return True
    return bool(case.noise > QUIET and off_hz <= 1.96 * np.sqrt(case.said.covariance[1, 1]) / (2.0 * np.pi))


def names_the_critical_mode(case: Case) -> bool:
    """Whether it is the exact critical mode that is named: then its errors can be judged."""
    if not (resonance_is_asked(case) and np.isfinite(case.said.resonance.real)) or case.family == "sampled":
        return False
    nearest = case.truth.poles[np.argmin(np.abs(case.truth.poles - case.said.resonance))]
    return bool(nearest == case.truth.critical and abs(case.said.resonance - nearest) < 0.05 * abs(nearest))


def is_phantom(case: Case) -> bool:
    """Whether no exact pole is near the one that is named."""
    said = case.said.resonance
    std = np.sqrt(max(float(np.trace(np.nan_to_num(case.said.covariance))), 0.0))
    nearest = float(np.abs(case.truth.poles - said).min())
    allowed = (SPURIOUS + 0.1 * max(damping(said), 0.0)) * abs(said)  # a well damped mode is not known as sharply
    return bool(nearest > max(2.0 * np.pi * NEAR_HZ, 4.0 * std, allowed))


def in_ellipse(case: Case) -> bool:
    """Whether the 95 % ellipse of the pole holds the exact one."""
    error = case.said.resonance - case.truth.critical
    off = np.array([error.real, error.imag])
    try:
        return bool(off @ np.linalg.solve(case.said.covariance, off) <= CHI2)
    except np.linalg.LinAlgError:
        return False


def pole_error(case: Case) -> float:
    """|error| of the pole that is named, against the nearest exact one (rad/s)."""
    return float(np.abs(case.truth.poles - case.said.resonance).min())


def is_asked_sharply(case: Case) -> bool:
    """Whether rows without noise cover the question, and its exact critical mode is named."""
    noise_free = case.spec.source == "exact" and case.noise == 0.0 and not case.spec.float32
    return noise_free and case.truth.nearly_covered and names_the_critical_mode(case)


def count_is_right(case: Case) -> bool:
    """Whether as many unstable poles are counted as there are."""
    return case.said.n_unstable == case.truth.n_unstable


# Tables

CONDITIONS: dict[str, Callable[[Case], bool]] = {
    "all": lambda c: True,
    "turbine": lambda c: c.family == "turbine",
    "grid-following": lambda c: c.family == "following",
    "grid-forming": lambda c: c.family == "forming",
    "random devices": lambda c: c.family == "rational",
    "sampled controllers": lambda c: c.family == "sampled",
    "with unstable poles of its own": lambda c: c.own_unstable > 0,
    "rows by formula": lambda c: c.spec.source == "exact",
    "rows swept by `run`": lambda c: c.spec.source == "swept",
    "of them of nonlinear plants": lambda c: c.spec.nonlinear or (c.spec.source == "swept" and c.family == "turbine"),
    "rows of recordings": lambda c: c.spec.source == "recorded",
    "up to 30 rows": lambda c: c.n_rows <= 30,
    "31 to 100 rows": lambda c: 30 < c.n_rows <= 100,
    "more than 100 rows": lambda c: c.n_rows > 100,
    "adaptive": lambda c: c.spec.spacing == "adaptive",
    "multisine or PRBS": lambda c: c.spec.signal != "tone" and c.spec.source == "swept",
    "a gap in the rows": lambda c: c.spec.cut == "gap",
    "nothing around f1": lambda c: c.spec.cut == "f1",
    "outlying rows": lambda c: c.spec.outliers > 0,
    "band cut short": lambda c: c.spec.cut == "short",
    "no noise": lambda c: c.spec.noise == 0.0,
    "noise up to 0.1 %": lambda c: c.spec.noise > 0.0 and c.noise <= QUIET,
    "noise 0.1 to 1 %": lambda c: QUIET < c.noise <= NOISY,
    "noise above 1 %": lambda c: c.noise > NOISY,
    "noise, no covariance": lambda c: c.spec.noise > 0.0 and c.spec.source == "exact" and c.spec.covariance == "none",
    "single precision": lambda c: c.spec.float32,
    "`stable_on` not known": lambda c: not c.spec.fact,
    "covered": lambda c: c.truth.covered,
    "covered but for faint activity": lambda c: c.truth.nearly_covered and not c.truth.covered,
    "not covered": lambda c: not c.truth.nearly_covered,
    "edge within 1 %": lambda c: c.truth.distance <= 0.01,
    "edge 1 to 3 % away": lambda c: 0.01 < c.truth.distance <= FAR,
    "edge farther away": lambda c: c.truth.distance > FAR,
}
"""Rows of the table of conditions."""

HEAD = (
    "| cases | number | wrong | of them certain | nothing could tell | undecided | count of unstable poles right | "
    "resonance right |"
)


def conditions(cases: Sequence[Case]) -> str:
    """Markdown table: wrong, certain, undecided, counts and resonances by family and condition."""
    rows = [HEAD, "|---" * 8 + "|"]
    for name, belongs in CONDITIONS.items():
        some = [c for c in cases if belongs(c)]
        if some:
            rows.append(_condition_row(name, some))
    return "\n".join(rows)


def _condition_row(name: str, some: Sequence[Case]) -> str:
    wrong = [c for c in some if c.wrong and not c.truth.hidden]
    decided = [c for c in some if not undecided(c)]
    light = [c for c in some if resonance_is_asked(c)]
    return (
        f"| {name} | {len(some):,} | {len(wrong)} | {sum(c.certain for c in wrong)} | "
        f"{sum(c.wrong and c.truth.hidden for c in some)} | {_percent(some, undecided)} | "
        f"{_percent(decided, count_is_right)} | {_percent(light, resonance_is_right)} |"
    )


def _percent(some: Sequence[Case], is_so: Callable[[Case], bool]) -> str:
    return f"{100.0 * np.mean([is_so(c) for c in some]):.1f} %" if some else "-"


def certain_shares(cases: Sequence[Case]) -> str:
    """How many of the verdicts that were given are stated as certain, in a sentence."""
    given = [c for c in cases if not undecided(c)]
    covered = [c for c in given if c.truth.covered]
    return (
        f"Of {len(given):,} verdicts given {_percent(given, _is_certain)} are stated as certain, of the "
        f"{len(covered):,} whose rows cover the question {_percent(covered, _is_certain)}."
    )


def _is_certain(case: Case) -> bool:
    return case.certain


def seconds(cases: Sequence[Case]) -> str:
    """CPU time of a verdict."""
    if not cases:
        return "no time"
    times = np.array([c.said.seconds for c in cases])
    return f"{np.median(times):.2f} s (median; {np.quantile(times, 0.95):.2f} s at the 95th percentile)"


def worst(cases: Sequence[Case], most: int = 25) -> list[str]:
    """One line each: wrong verdicts first, then crashes, phantoms, resonances missed and verdicts withheld."""
    kinds: list[tuple[str, Callable[[Case], bool]]] = [
        ("WRONG", lambda c: c.wrong and not c.truth.hidden),
        ("crash", lambda c: c.said.verdict == "crash"),
        ("phantom", lambda c: bool(np.isfinite(c.said.resonance.real)) and is_phantom(c)),
        ("resonance missed", lambda c: resonance_is_asked(c) and not resonance_is_right(c)),
        ("withheld", lambda c: is_nearly_due(c, NOISY) and undecided(c)),
        (
            "pole off",
            lambda c: is_asked_sharply(c) and pole_error(c) > 2e-3,
        ),
    ]
    return [f"{kind}: {line_of(c)}" for kind, belongs in kinds for c in [c for c in cases if belongs(c)][:most]]


_COVERED = {(True, True): ", covered", (False, True): ", covered but for faint activity", (False, False): ""}


def line_of(case: Case) -> str:
    """Everything needed to see and to reproduce one case."""
    spec, truth, said = case.spec, case.truth, case.said
    flags = "".join(
        (
            f" {spec.covariance}" if spec.noise else "",
            " float32" if spec.float32 else "",
            " nonlinear" if spec.nonlinear else "",
            f" {spec.cut}" if spec.cut else "",
            f" {spec.outliers} outliers" if spec.outliers else "",
            "" if spec.fact else " no fact",
        )
    )
    on = "ideal" if case.swept_on is None else f"{case.swept_on[0]:.4g}+{case.swept_on[1]:.4g}j ohm"
    return (
        f"{case.name} (grid {case.grid_number}) {case.family}: {case.text}; "
        f"{spec.source} {spec.spacing} {spec.signal}, {case.n_rows} rows, noise {spec.noise:.1e}{flags}, "
        f"error {case.error:.1e}, swept on {on}; grid {case.r_ohm:.6g}+{case.x_ohm:.6g}j ohm, SCR {case.scr:.3g}, edge "
        f"{truth.distance:.2%} away{_COVERED[truth.covered, truth.nearly_covered]}; "
        f"truth {truth.n_unstable} unstable ({case.own_unstable} own), critical {truth.critical:.4g}; "
        f"said {said.verdict}, P(stable) {said.probability:.4g}, {said.n_unstable} unstable ({said.own_unstable} own), "
        f"resonance {said.resonance:.4g}; {said.reason[:160]}"
    )
