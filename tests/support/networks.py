"""The truth about a device on a network, by code of its own: a sparse tableau of every voltage and current.

Nothing is shared with the product but the documents. Unknowns are the node voltages and the voltage and the current of
every branch; Kirchhoff's laws and one equation per branch. The device is the oracle's linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import eig
from scipy.optimize import brentq

from . import oracle

F1_HZ = 50.0
W1 = 2.0 * np.pi * F1_HZ
J = np.array([[0.0, -1.0], [1.0, 0.0]])


@dataclass
class Tableau:
    """Branches (a, b, kind, value): "r" ohm, "l" H, "c" F; node 0 is ground, node 1 the PCC."""

    branches: list[tuple[int, int, str, float]] = field(default_factory=list)
    n: int = 1

    def node(self) -> int:
        """A new node."""
        self.n += 1
        return self.n

    def add(self, a: int, b: int, kind: str, value: float) -> None:
        """A branch of one element."""
        self.branches.append((a, b, kind, value))

    def chain(self, a: int, b: int, *parts: tuple[str, float]) -> None:
        """Elements in series, those of zero ohm and henry left out."""
        parts = tuple(part for part in parts if part[1] > 0.0)
        for k, (kind, value) in enumerate(parts):
            end = b if k == len(parts) - 1 else self.node()
            self.add(a, end, kind, value)
            a = end


def tableau_of(document: dict, scale: float = 1.0, f1_hz: float = F1_HZ) -> Tableau:
    """A ladder of series, shunt capacitor, single-tuned filter, series capacitor (x_ohm) and pi cables."""
    net, at, w1 = Tableau(), 1, 2.0 * np.pi * f1_hz
    entries = document["element"]
    last = max(k for k, e in enumerate(entries) if e["kind"] in ("series", "series_capacitor", "cable"))
    for k, e in enumerate(entries):
        kind = e["kind"]
        if kind == "shunt_capacitor":
            net.add(at, 0, "c", e["c_uf"] * 1e-6 / scale)
            continue
        if kind == "filter":
            c, w = e["c_uf"] * 1e-6, 2.0 * np.pi * e["tuned_hz"]
            net.chain(at, 0, ("r", scale / (w * c * e["quality"])), ("l", scale / (w**2 * c)), ("c", c / scale))
            continue
        end = 0 if k == last else net.node()
        if kind == "series":
            net.chain(at, end, ("r", scale * e["r_ohm"]), ("l", scale * e["x_ohm"] / w1))
        elif kind == "series_capacitor":
            net.add(at, end, "c", 1.0 / (w1 * e["x_ohm"] * scale))
        else:
            _pi(net, at, end, e, scale, w1)
        at = end
    return net


def _pi(net: Tableau, a: int, b: int, e: dict, scale: float, w1: float) -> None:
    n, part = e.get("sections", 1), e["length_km"] / e.get("sections", 1)
    half = 0.5 * e["c_nf_per_km"] * 1e-9 * part / scale
    for k in range(n):
        end = b if k == n - 1 else net.node()
        net.add(a, 0, "c", half)
        net.chain(a, end, ("r", scale * e["r_ohm_per_km"] * part), ("l", scale * e["x_ohm_per_km"] * part / w1))
        if end != 0:
            net.add(end, 0, "c", half)
        a = end


def tableau_pencil(net: Tableau) -> tuple[np.ndarray, np.ndarray, int]:
    """A and E of x = (v_1 ... v_n, u_b, i_b) in one phase, without the row of the PCC's current law, which is row 0."""
    n, m = net.n, len(net.branches)
    a, e = np.zeros((n + 2 * m, n + 2 * m)), np.zeros((n + 2 * m, n + 2 * m))
    for k, (p, q, kind, value) in enumerate(net.branches):
        u, i = n + k, n + m + k
        for node, sign in ((p, 1.0), (q, -1.0)):
            if node:
                a[node - 1, i] += sign  # current law: what leaves the node adds up to zero
                a[n + k, node - 1] += sign  # voltage law: u = v_p - v_q
        a[n + k, u] = -1.0
        row = n + m + k
        if kind == "r":
            a[row, u], a[row, i] = 1.0, -value
        elif kind == "l":
            e[row, i], a[row, u] = value, 1.0
        else:
            e[row, u], a[row, i] = value, 1.0
    return a, e, n + 2 * m


def poles_of(linear: oracle.Linear, net: Tableau, w1: float = W1) -> np.ndarray:
    """Closed-loop poles (rad/s, dq) of the linearised device and the network.

    The device is i = C x + D v + E v', x' = A x + B v; E is a number (F), zero where it has none.
    """
    a, e, n = tableau_pencil(net)
    a_dq = np.kron(a, np.eye(2)) - w1 * np.kron(e, J)
    e_dq = np.kron(e, np.eye(2))
    k = len(linear.A)
    big_a, big_e = np.zeros((k + 2 * n, k + 2 * n)), np.zeros((k + 2 * n, k + 2 * n))
    big_a[:k, :k], big_a[:k, k : k + 2], big_e[:k, :k] = linear.A, linear.B, np.eye(k)
    big_a[k:, k:], big_e[k:, k:] = a_dq, e_dq
    big_a[k : k + 2, :k] += linear.C  # what flows into the device leaves the PCC, too
    big_a[k : k + 2, k : k + 2] += linear.D
    big_e[k : k + 2, k : k + 2] -= getattr(linear, "E", 0.0) * np.eye(2)
    size = np.maximum(np.abs(big_a).max(axis=1), 300.0 * np.abs(big_e).max(axis=1))[:, None]
    values = eig(big_a / size, big_e / size, right=False)
    return values[np.isfinite(values) & (np.abs(values) < 1e7)]


def rightmost(linear: oracle.Linear, document: dict, scale: float, f1_hz: float = F1_HZ) -> float:
    """Largest real part of the poles (rad/s)."""
    return float(poles_of(linear, tableau_of(document, scale, f1_hz), 2.0 * np.pi * f1_hz).real.max())


def impedance_of(document: dict, s: np.ndarray, scale: float = 1.0, f1_hz: float = F1_HZ) -> np.ndarray:
    """z (n,) in ohm at complex s (rad/s) of the phase frame, from the tableau."""
    a, e, n = tableau_pencil(tableau_of(document, scale, f1_hz))
    drawn = np.eye(n)[0]  # one ampere out of the PCC
    return np.array([-np.linalg.solve(x * e - a, drawn)[0] for x in np.asarray(s)])


@dataclass(frozen=True)
class NearCritical:
    """A random grid whose rightmost pole with the device is near the axis."""

    document: dict
    kind: str
    scale: float
    poles: np.ndarray

    @property
    def stable(self) -> bool:
        """What is true."""
        return bool(self.poles.real.max() < 0.0)

    @property
    def critical(self) -> complex:
        """The rightmost pole, upper half."""
        upper = self.poles[self.poles.imag >= 0.0]
        return complex(upper[np.argmax(upper.real)])


KINDS = ("series_capacitor", "shunt_capacitor", "cable", "filter", "all")


def random_document(rng: np.random.Generator, kind: str) -> dict:
    """Elements at 690 V in the way of the prototype: about 0.25 ohm of reactance and what the kind adds."""
    x = 0.25 * rng.uniform(0.7, 1.5)
    r = x * rng.uniform(0.03, 0.12)
    at_low = (0.69 / 35.0) ** 2
    element: list[dict] = []
    if kind in ("shunt_capacitor", "all"):
        element.append({"kind": "shunt_capacitor", "c_uf": float(10.0 ** rng.uniform(1.5, 2.9))})
    if kind in ("filter", "all"):
        tuned = float(rng.choice([250.0, 350.0, 550.0]))
        c_uf, quality = float(10.0 ** rng.uniform(1.7, 2.8)), float(rng.uniform(10.0, 60.0))
        element.append({"kind": "filter", "c_uf": c_uf, "tuned_hz": tuned, "quality": quality})
    element.append({"kind": "series", "r_ohm": 0.4 * r, "x_ohm": 0.4 * x})
    if kind in ("cable", "all"):
        cable = {"r_ohm_per_km": 0.13 * at_low, "x_ohm_per_km": 0.119 * at_low, "c_nf_per_km": 190.0 / at_low}
        length = {"length_km": float(rng.uniform(5.0, 60.0)), "model": "pi", "sections": int(rng.integers(1, 4))}
        element.append({"kind": "cable", **cable, **length})
    if kind in ("series_capacitor", "all"):
        element.append({"kind": "series_capacitor", "x_ohm": float(rng.uniform(0.1, 0.7)) * x})
    element.append({"kind": "series", "r_ohm": 0.6 * r, "x_ohm": 0.6 * x})
    return {"element": element}


def near_critical(rng: np.random.Generator, linear: oracle.Linear, kind: str) -> NearCritical:
    """A random grid of a kind, scaled until its rightmost pole lies 0.1 to 5 rad/s from the axis, on either side."""
    return next(found for _ in iter(int, 1) if (found := near_critical_once(rng, linear, kind)) is not None)


def near_critical_once(
    rng: np.random.Generator, linear: oracle.Linear, kind: str, size: float = 1.0, f1_hz: float = F1_HZ
) -> NearCritical | None:
    """As `near_critical`, of an impedance about 0.25 ohm times ``size``; None where this one has no edge there."""
    document = random_document(rng, kind)
    scales = size * np.geomspace(0.3, 3.0, 9)
    values = [rightmost(linear, document, s, f1_hz) for s in scales]
    at = [k for k in range(8) if values[k] < 0.0 < values[k + 1]]
    if not at:
        return None
    target = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-1.0, np.log10(5.0)))
    ends = scales[at[0]], scales[at[0] + 1]
    if (values[at[0]] - target) * (values[at[0] + 1] - target) >= 0.0:
        return None
    scale = brentq(lambda s: rightmost(linear, document, s, f1_hz) - target, *ends, xtol=1e-6 * size)
    poles = poles_of(linear, tableau_of(document, scale, f1_hz), 2.0 * np.pi * f1_hz)
    return NearCritical(document, kind, scale, poles)
