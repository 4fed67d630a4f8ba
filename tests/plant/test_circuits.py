"""Networks in time by themselves: transients in closed form, what a switch keeps, what the pencil hides."""

from __future__ import annotations

from math import cos, exp, inf, pi, sin, sqrt

import numpy as np
import pytest

from seqsweep.plant.circuits.branches import GROUND, Branch
from seqsweep.plant.circuits.circuit import PCC, SOURCE, Circuit
from seqsweep.plant.circuits.dynamics import Dynamics, Fault, Memory, as_pairs, dynamics_of, from_pairs
from seqsweep.plant.circuits.feeding import feeding_of
from seqsweep.plant.circuits.stepping import Outputs, weights_of
from seqsweep.plant.errors import SeqsweepError

W1 = 100.0 * pi
H = 50e-6


def to_ground(name: str, node: str, r_ohm: float = 0.0, l_h: float = 0.0, c_f: float = inf) -> Branch:
    return Branch(name, {node: 1.0, GROUND: -1.0}, r_ohm, l_h, c_f)


def between(name: str, a: str, b: str, r_ohm: float = 0.0, l_h: float = 0.0, c_f: float = inf) -> Branch:
    return Branch(name, {a: 1.0, b: -1.0}, r_ohm, l_h, c_f)


def stepped(dynamics: Dynamics, currents: np.ndarray, h: float = H) -> np.ndarray:
    """Voltages (n,) of the only port at the start of each step under port currents (2 n + 1,) at half steps, from rest.

    The currents are a parabola over each step.
    """
    node = dynamics.system.at.node[dynamics.ports[0]]
    of_x = np.zeros((1, dynamics.system.at.n))
    of_x[0, node] = 1.0
    w = weights_of(dynamics, Outputs(of_x, np.zeros((1, 1))), h)
    xi, found = np.zeros(len(w.keep)), []
    for k in range((len(currents) - 1) // 2):
        u0, u1, u2 = (as_pairs(np.array([u])) for u in currents[2 * k : 2 * k + 3])
        found.append(from_pairs(w.seen[0] @ xi + w.direct @ u0)[0])
        xi = w.keep @ xi + w.start @ u0 + w.middle @ u1 + w.end @ u2
    return np.array(found)


def turned(x: np.ndarray, h: float = H) -> np.ndarray:
    """From the stationary frame, at half steps or steps from time zero on, into the dq frame."""
    return x * np.exp(-1j * W1 * h * np.arange(len(x)))


@pytest.mark.parametrize("zeta", [0.05, 3.0])
def test_step_response_of_rlc_is_the_closed_form(zeta):
    """A constant direct current into R + L parallel to C; the poles are fast beside the step (up to 2e5 rad/s)."""
    w0, c = 3e4, 20e-6
    l_h = 1.0 / (w0**2 * c)
    r = 2.0 * zeta * w0 * l_h
    network = dynamics_of((to_ground("rl", PCC, r, l_h), to_ground("c", PCC, c_f=c)), (PCC,), W1)
    n = 40
    direct = turned(np.full(2 * n + 1, 10.0 + 0j), 0.5 * H)
    # A current that stands still in the stationary frame turns in dq; a parabola follows it to (w1 h)^3.
    found = stepped(network, direct) * np.exp(1j * W1 * H * np.arange(n))
    t = H * np.arange(n)
    poles = np.roots([1.0, r / l_h, 1.0 / (l_h * c)])
    residues = [10.0 / c * (p + r / l_h) / (p * (p - poles[1 - k])) for k, p in enumerate(poles)]
    truth = 10.0 * r + sum(a * np.exp(p * t) for a, p in zip(residues, poles, strict=True))
    assert np.max(np.abs(found - truth)) < 2e-6 * np.max(np.abs(truth))


def test_ring_down_of_a_charged_capacitor_is_the_closed_form():
    r, l_h, c = 0.02, 0.5e-3, 300e-6
    network = dynamics_of((to_ground("rlc", "a", r, l_h, c), to_ground("r", "a", 1e-3)), ("a",), W1)
    memory = Memory(network.names, np.array([[0.0, 100.0], [0.0, 0.0]], dtype=complex))
    states = network.entered(memory.of(network.names), 0.0)
    w = weights_of(network, Outputs(np.zeros((1, network.system.at.n)), np.zeros((1, 1))), H)
    for _ in range(200):
        states = w.keep @ states
    x = network.left(states, np.zeros(1), 200 * H)
    held = network.remembered(x)[0] * np.exp(1j * W1 * 200 * H)
    alpha, w0 = 0.5 * (r + 1e-3) / l_h, 1.0 / sqrt(l_h * c)
    wd, t = sqrt(w0**2 - alpha**2), 200 * H
    v = 100.0 * exp(-alpha * t) * (cos(wd * t) + alpha / wd * sin(wd * t))
    i = -100.0 / (wd * l_h) * exp(-alpha * t) * sin(wd * t)
    assert held == pytest.approx(np.array([i, v], dtype=complex), rel=1e-10)


def test_inductors_in_one_cut_set_are_one_state():
    """A line in two pieces, nothing at the joint: the pencil hides it, the motion is that of the sum."""
    pieces = (between("a", PCC, "m", 0.1, 1e-3), between("b", "m", SOURCE, 0.2, 2e-3), to_ground("c", PCC, 5.0))
    whole = (between("ab", PCC, SOURCE, 0.3, 3e-3), to_ground("c", PCC, 5.0))
    rng = np.random.default_rng(3)
    currents = rng.normal(size=61) + 1j * rng.normal(size=61)
    one, two = (dynamics_of(branches, (PCC,), W1) for branches in (pieces, whole))
    assert len(one.finite.f) == 1
    assert stepped(one, currents) == pytest.approx(stepped(two, currents), rel=1e-9)


def test_a_network_of_a_line_alone_lets_everything_through_at_once():
    line = dynamics_of((between("l", PCC, SOURCE, 0.3, 3e-3),), (PCC,), W1)
    assert len(line.finite.f) == 0
    at = line.system.at.node[PCC]
    assert (line.finite.d[at, 0], line.finite.k[at, 0]) == pytest.approx((0.3, 3e-3))


def test_charge_is_shared_where_a_discharged_capacitor_is_switched_in():
    old = dynamics_of((to_ground("a", "n", c_f=300e-6), to_ground("r", "n", 1e3)), ("n",), W1)
    new = dynamics_of((*old.branches, to_ground("b", "n", c_f=100e-6)), ("n",), W1)
    before = Memory(old.names, old.remembered(np.array([80.0 + 0j])))
    x = new.left(new.entered(before.of(new.names), 0.0), np.zeros(1), 0.0)
    assert new.remembered(x)[[0, 2], 1] == pytest.approx([60.0, 60.0])


def test_flux_is_shared_where_two_currents_meet_in_one_cut_set():
    """A branch from the joint of two inductors is opened while it carries 5 A: L1 i1 + L2 i2 goes on."""
    l_1, l_2 = 1e-3, 3e-3
    branches = (between("1", SOURCE, "m", 0.1, l_1), between("2", "m", GROUND, 0.1, l_2))
    new = dynamics_of(branches, (), W1)
    before = Memory(("1", "2", "open"), np.array([[12.0, 0.0], [7.0, 0.0], [5.0, 0.0]], dtype=complex))
    x = new.left(new.entered(before.of(new.names), 0.0), np.zeros(0), 0.0)
    together = (l_1 * 12.0 + l_2 * 7.0) / (l_1 + l_2)
    assert new.remembered(x)[:, 0] == pytest.approx([together, together])


def test_an_equilibrium_stands_still_whatever_the_network():
    branches = (
        between("l", PCC, "b", 0.01, 0.3e-3),
        to_ground("cable", "b", c_f=40e-6),
        between("cs", "b", "s", c_f=8e-3),
        between("source", "s", SOURCE, 0.02, 0.7e-3),
        to_ground("shunt", PCC, 0.02, 0.0, 500e-6),
    )
    of = feeding_of(branches, (PCC,), ("shunt",), W1, H)
    v_source, current = 690.0 + 20.0j, np.array([900.0 - 100.0j])
    memory, u = of.at_rest(v_source, current), as_pairs(current)
    xi = of.entered(memory, of.forced(v_source), 0.0, v_source)
    w = of.weights
    shown = w.seen[0] @ xi + w.direct @ u
    halfway = w.seen[1] @ xi + w.by_start @ u + w.direct @ u
    at_end = w.seen[2] @ xi + w.by_whole @ u + w.direct @ u
    assert halfway == pytest.approx(shown, rel=1e-10)
    assert at_end == pytest.approx(shown, rel=1e-10)
    assert w.keep @ xi + (w.start + w.middle + w.end) @ u == pytest.approx(xi, rel=1e-9, abs=1e-9)
    again, _ = of.left(xi, current, of.forced(v_source), 0.0, v_source)
    assert np.max(np.abs(again.values - memory.values)) < 1e-9 * np.max(np.abs(memory.values))


def test_a_fault_between_two_phases_draws_what_kirchhoff_says():
    """The steady current of a resistive network, alpha and beta unlike: two real equations."""
    fault = Fault("n", (0.5, 0.1, 2.0))
    faulted = dynamics_of((between("r", "n", SOURCE, 4.0),), ("n",), W1, fault)
    (forward, backward) = faulted.by_source(100.0 + 0j)
    for t in (0.0, 1.3e-3, 7e-3):
        v = complex(forward.at(t)[0] + backward.at(t)[0]) * np.exp(1j * W1 * t)
        source = 100.0 * np.exp(1j * W1 * t)
        g = np.array([[0.5, 0.1], [0.1, 2.0]])
        truth = np.linalg.solve(np.eye(2) / 4.0 + g, np.array([source.real, source.imag]) / 4.0)
        assert (v.real, v.imag) == pytest.approx(tuple(truth))


def test_a_symmetric_fault_is_a_resistor():
    assert dynamics_of((between("r", "n", SOURCE, 4.0),), ("n",), W1, Fault("n", (2.0, 0.0, 2.0))).frame == "dq"


def test_impedance_and_no_load_gain_are_the_ladder_s():
    """Through a transformer of ratio 0.69/35, a shunt capacitor behind it, a line to the source at 35 kV."""
    n, s = 0.69 / 35.0, 1j * W1
    circuit = Circuit(
        (
            Branch("t", {PCC: 1.0, "hv": -n}, 0.002, 50e-6),
            to_ground("c", "hv", c_f=1e-6),
            between("l", "hv", SOURCE, 3.0, 0.1),
        ),
        35.0 / 0.69,
    )
    z_line = 3.0 + s * 0.1
    behind = 1.0 / (1.0 / z_line + s * 1e-6)
    z, gain = circuit.seen_at(s)
    assert z == pytest.approx(0.002 + s * 50e-6 + n**2 * behind)
    assert gain == pytest.approx(behind / z_line)
    double, _ = circuit.scaled(2.0).seen_at(s)
    assert double == pytest.approx(2.0 * z)


def test_a_node_that_nothing_holds_is_refused():
    with pytest.raises((SeqsweepError, np.linalg.LinAlgError)):
        dynamics_of((between("l", PCC, SOURCE, 0.1, 1e-3), between("x", "a", "b", 0.1, 1e-3)), (PCC,), W1)
