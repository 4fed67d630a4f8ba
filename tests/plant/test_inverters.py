"""The inverters against published eigenvalues, against an oracle written afresh, and their promises as plants."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment, root

from seqsweep.plant.check import check_plant
from seqsweep.plant.inverters.grid_following import GridFollowing
from seqsweep.plant.inverters.grid_forming import GridForming
from seqsweep.plant.inverters.inverter import Inverter
from seqsweep.plant.inverters.parameters import FollowingParameters, FormingParameters
from seqsweep.plant.kernels import inverters as kernel
from seqsweep.plant.protocol import Compensation, Conditions, Injection, Job, NotSettled, OperatingPoint, Source, Tone
from seqsweep.plant.registry import make_plant
from seqsweep.plant.turbine.parameters import LINE_R_OHM, LINE_X_OHM, TABLE_I

from ..support import inverter_oracle as oracle
from ..support.machine_code import instructions

U = 690.0
DROOP = {"k_d": 0.0, "t_a_s": 1.0 / (0.05 * 2.0 * pi * 5.0)}
STIFF = {**DROOP, "l_g_pu": 0.1, "r_g_pu": 0.005, "l_v_pu": 0.0}
"""Droop behind a bare transformer of 10 %: unstable on every strong grid."""

# PowerSimulationsDynamics.jl (NREL), test/results/results_eigenvalues.jl (test08_eigvals, test23_eigvals); operating
# points of results_initial_conditions.jl. 60 Hz; the line is algebraic and stands on 100 MVA, the inverter on 2.75.
PUBLISHED_VSM = """
-2285.9589650663725-6825.3997886670795j -2095.818014258244-6533.140681149019j -1595.4562252195476-233.8877642497275j
-986.7365548177571 -500.00000000000034 -471.8999089077167 -220.89110522830256 -50.32121120551376 -50.245608339393456
-34.244848184557476-260.53071319880445j -11.303322380605753 -11.19036178279552
-7.691789694217273-28.802262759948757j -4.513698394541721
"""
PUBLISHED_DROOP = """
-2285.984972487398-6825.409970531314j -2095.8292998741636-6533.139948007082j -1596.153193009681-233.6009166562695j
-986.970453826522 -50.61566828819503 -50.24422063249634 -33.8405217631388-255.4659930547156j
-16.35252074296158-35.19268456048173j -11.402718862758675 -11.30330507373553
"""
KINDS = {"gfl-v1": "following", "gfm-v1": "forming"}
SOURCE_PU = 1.00001
ON_ITS_BASE = 2.75 / 100.0


def complex_numbers(text: str) -> np.ndarray:
    """The numbers of ``text`` and the conjugates of those that are not real."""
    given = np.array([complex(word) for word in text.split()])
    return np.concatenate([given, given[given.imag != 0.0].conj()])


def distance(found: np.ndarray, published: np.ndarray) -> float:
    """Largest distance of a published pole from the found one that is its own."""
    each = np.abs(found[:, None] - published[None])
    return float(each[linear_sum_assignment(each)].max())


def right_hand_side(plant: Inverter, point: OperatingPoint):
    """(f, x, n): the kernel's own derivatives of n states on an ideal source, and the equilibrium x."""
    state = plant.equilibrium(point, Source())
    p, references = plant.parameters, tuple(state.references)
    forming = plant.id == "gfm-v1"
    n = 20 if forming else 17

    def f(x: np.ndarray, v_s: complex) -> np.ndarray:
        slots = np.zeros(kernel.N_STATES * kernel.LANES)
        slots[: n * kernel.LANES : kernel.LANES] = x
        y = kernel._load_circuit(slots, 0)
        c = (kernel._load_forming if forming else kernel._load_following)(slots, 0)
        unit = (np.exp(1j * c[0]), np.exp(1j * c[5])) if forming else complex(np.exp(1j * c[0]))
        line = (0.0, p.w1_rad_s / p.l_g_pu)
        w = kernel._load_link(slots, 0, kernel.PRESENT)
        derive = kernel._forming_all if forming else kernel._following_all
        k, link, m, _ = derive(y, w, c, (), v_s, unit, (line, references, state.dc), (), p)
        flat = [part for value in (*k, *link, *m) for part in _parts(value)]
        return np.array(flat)

    return f, state.values[:n], state.v_source


def _parts(value):
    return (value.real, value.imag) if isinstance(value, complex) else (value,)


def kernel_model(plant: Inverter, point: OperatingPoint) -> oracle.Model:
    """A, B, C of the kernel's own equations, by central differences; the DC link's voltage is left out if it stands."""
    f, x, v_s = right_hand_side(plant, point)
    h = 1e-5
    a = np.array([(f(x + h * e, v_s) - f(x - h * e, v_s)) / (2.0 * h) for e in np.eye(len(x))]).T
    b = np.array([(f(x, v_s + h * e) - f(x, v_s - h * e)) / (2.0 * h) for e in (1.0, 1j)]).T
    keep = [k for k in range(len(x)) if k != kernel.V_DC or np.isfinite(plant.parameters.c_dc_s)]
    c = np.zeros((2, len(keep)))
    c[0, kernel.I_G] = c[1, kernel.I_G + 1] = 1.0
    return oracle.Model(a[np.ix_(keep, keep)], b[keep], c, x[keep])


@pytest.mark.parametrize(
    ("published", "parameters", "voltage", "x_flow", "n_poles"),
    [
        (PUBLISHED_VSM, {}, 0.9999994707586406 + 0.0010313084369410759j, 0.075005, 19),
        (PUBLISHED_DROOP, {**DROOP}, 0.9999994715292945 + 0.0010312396876354022j, 0.075, 15),
    ],
    ids=["virtual synchronous machine", "droop"],
)
def test_published_eigenvalues(published, parameters, voltage, x_flow, n_poles):
    """``x_flow``: reactance up to where the source's voltage stood in the load flow; its own 5e-6 counts or not."""
    power = voltage * ((voltage - SOURCE_PU) / (1j * x_flow * ON_ITS_BASE)).conjugate()
    plant = GridForming(w1_rad_s=2.0 * pi * 60.0, **parameters)
    s = plant.rating.power_va
    model = kernel_model(plant, OperatingPoint(power.real * s, abs(voltage) * U, power.imag * s))
    found = oracle.behind(plant.parameters, model, 0.075005j * ON_ITS_BASE, dynamic=False)
    expected = complex_numbers(published)
    assert len(expected) == n_poles
    assert distance(found, expected) < 1e-5


def paper_parameters(scale: float) -> dict[str, float]:
    """`gfl-v1` as the paper's grid side: its V_dc loop, no power loops, and the line as its grid-side inductance."""
    p = TABLE_I
    z_base, i_base = p.u_rated_v**2 / p.s_rated_va, p.s_rated_va / p.u_rated_v
    return {
        "l_f_pu": p.w1_rad_s * p.l_c_h / z_base,
        "r_f_pu": 0.0,
        "c_f_pu": p.w1_rad_s * p.c_f_f * z_base,
        "r_c_pu": p.r_f_ohm / z_base,
        "l_g_pu": scale * LINE_X_OHM / z_base,
        "r_g_pu": scale * LINE_R_OHM / z_base,
        "c_dc_s": p.c_dc_f * p.v_dc_ref_v**2 / p.s_rated_va,
        "k_ppll": p.k_pp * p.u_rated_v / p.w1_rad_s,
        "k_ipll": p.k_pi * p.u_rated_v / p.w1_rad_s,
        "c_p": 0.0,
        "c_dc": 1.0,
        "k_p": p.k_dcp * p.v_dc_ref_v / i_base,
        "k_i": p.k_dci * p.v_dc_ref_v / i_base,
        "k_q": 0.0,
        "k_iq": 0.0,
        "k_pc": p.k_p / z_base,
        "k_ic": p.k_i / z_base,
        "k_rd": p.k_rd_ohm / z_base,
    }


@pytest.mark.parametrize(
    ("scale", "sigma", "hertz"), [(1.0, -13.447, 25.590), (1.2, -4.742, 26.142), (1.4, 9.572, 26.255)]
)
def test_closed_loop_of_the_paper(scale, sigma, hertz):
    """On the 690 V source with the line as its own inductance, its poles are the paper's closed loop at 0.65 MW."""
    plant = GridFollowing(**paper_parameters(scale))
    s = plant.rating.power_va

    def misses(x: np.ndarray) -> list[float]:
        """Bridge power of 0.65 MW, and no current i_q* in the PLL's frame."""
        state = plant.equilibrium(OperatingPoint(x[0] * s, U, x[1] * s), Source())
        return [state.dc[0] - 0.65e6 / s, state.values[kernel.S_Q]]

    found = root(misses, [0.398, 0.1], tol=1e-14)
    point = OperatingPoint(found.x[0] * s, U, found.x[1] * s)
    poles = np.linalg.eigvals(kernel_model(plant, point).a)
    resonance = poles[np.argmin(np.abs(poles - complex(sigma, 2.0 * pi * hertz)))]
    assert resonance.real == pytest.approx(sigma, abs=1e-3)
    assert resonance.imag / (2.0 * pi) == pytest.approx(hertz, abs=1e-3)
    if scale == 1.0:
        assert distance(poles, np.array([-0.858 + 4.018j, -0.858 - 4.018j])) < 1e-3


CASES = {
    "vsm": (GridForming, {}, 0.5, 0.0, 1.0),
    "droop, consuming": (GridForming, DROOP, -0.4, 0.2, 1.02),
    "forming, every gain": (GridForming, {"k_ffv": 0.3, "k_ffi": 0.4, "r_v_pu": 0.02, "r_c_pu": 0.05}, 0.3, -0.1, 0.97),
    "following": (GridFollowing, {}, 0.8, 0.0, 1.0),
    "following, consuming": (GridFollowing, {}, -0.5, -0.3, 0.95),
    "voltage and feed-forward": (GridFollowing, {"c_q": 0.0, "c_v": 1.0, "k_ff": 0.5}, 0.4, 0.1, 1.03),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_kernel_and_closed_form_are_the_oracles(case):
    """The same eigenvalues and admittance from equations written twice, and from two ways to the equilibrium."""
    cls, parameters, p, q, v = case
    plant = cls(**parameters)
    s = plant.rating.power_va
    own = kernel_model(plant, OperatingPoint(p * s, v * U, q * s))
    truth = oracle.linearise(plant.parameters, KINDS[plant.id], complex(p, q), v)
    assert distance(np.linalg.eigvals(own.a), np.linalg.eigvals(truth.a)) < 1e-3
    f = np.array([2.0, 35.0, 77.0, 400.0, 1000.0])
    assert oracle.admittance_pn(own, f) == pytest.approx(oracle.admittance_pn(truth, f), rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("law", ["constant_power", "photovoltaic", "battery"])
def test_dc_link_follows_its_law(law):
    """An array at its maximum power point and a constant power are the same thing in the small signal."""
    plant = GridFollowing(c_p=0.0, c_dc=1.0, k_p=0.25, k_i=2.5, c_dc_s=0.13, dc_source=law, dc_resistance_pu=0.02)
    model = kernel_model(plant, OperatingPoint(0.5 * plant.rating.power_va, U))
    truth = oracle.linearise(plant.parameters, "following", 0.5, 1.0, 0.02 if law == "battery" else "power")
    assert distance(np.linalg.eigvals(model.a), np.linalg.eigvals(truth.a)) < 1e-3


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
@pytest.mark.parametrize("source", [Source(), Source("thevenin", 0.01, 0.1 / (2.0 * pi * 50.0))], ids=lambda s: s.kind)
def test_poles_of_the_stepper_are_the_oracles_behind_a_line(case, source):
    cls, parameters, p, q, v = case
    plant = cls(**parameters)
    s = plant.rating.power_va
    state = plant.equilibrium(OperatingPoint(p * s, v * U, q * s), source)
    truth = oracle.linearise(plant.parameters, KINDS[plant.id], complex(p, q), v)
    z = complex(source.r_ohm, 2.0 * pi * 50.0 * source.l_h) / plant.base_impedance_ohm
    expected = oracle.behind(plant.parameters, truth, z)
    slow = expected[np.abs(expected) < 2000.0]
    assert distance(plant.linearise(state), slow) < 2e-3 * np.abs(slow).max()


@pytest.mark.parametrize("plant_id", ["gfl-v1", "gfm-v1"])
@pytest.mark.parametrize("source", [Source(), Source("thevenin", 0.01, 0.1 / (2.0 * pi * 50.0))], ids=lambda s: s.kind)
def test_keeps_every_promise_of_a_plant(plant_id, source):
    plant = make_plant(plant_id)
    for point in (None, OperatingPoint(-0.4 * plant.rating.power_va, 0.98 * U, 0.2 * plant.rating.power_va)):
        findings = check_plant(plant, point, source)
        assert [f for f in findings if not f.passed] == []


@pytest.mark.parametrize("plant_id", ["gfl-v1", "gfm-v1"])
def test_operating_point_is_what_was_asked(plant_id):
    plant = make_plant(plant_id)
    s = plant.rating.power_va
    for source in (Source(), Source("thevenin", 0.004, 0.04 / (2.0 * pi * 50.0), angle_rad=0.7)):
        state = plant.settle(OperatingPoint(0.6 * s, 0.97 * U, -0.2 * s), source)
        ((_, record),) = plant.run([Job(state, None)], 400)
        power = -1.5 * record.v * record.i.conj()
        assert power == pytest.approx(np.full(400, complex(0.6, -0.2) * s), rel=1e-9)
        assert np.abs(record.v) == pytest.approx(np.full(400, 0.97 * plant.rating.peak_voltage_v), rel=1e-9)
    source = Source("thevenin", 0.004, 0.04 / (2.0 * pi * 50.0), voltage_v=1.02 * U, angle_rad=0.7)
    state = plant.settle(OperatingPoint(0.6 * s, None, -0.2 * s), source)
    ((_, record),) = plant.run([Job(state, None)], 1)
    v_source = record.v[0] + complex(0.004, 0.04) * record.i[0]
    assert abs(v_source) == pytest.approx(1.02 * plant.rating.peak_voltage_v, rel=1e-9)
    assert np.angle(v_source) == pytest.approx(0.7, abs=1e-9)


def test_idle_device_settles():
    for plant in (GridFollowing(), GridForming()):
        plant.settle(OperatingPoint(0.0, U), Source())


def test_what_hates_an_ideal_source_says_where_to_settle_it():
    plant = GridForming(**STIFF)
    s, z = plant.rating.power_va, 0.1 * plant.base_impedance_ohm
    with pytest.raises(NotSettled, match=r"on an ideal source the equilibrium is unstable: \+17 rad/s.*thevenin"):
        plant.settle(OperatingPoint(0.5 * s, U), Source())
    plant.settle(OperatingPoint(0.5 * s, U), Source("thevenin", 0.1 * z, z / (2.0 * pi * 50.0)))


def test_more_current_than_the_limit_is_refused_by_name():
    plant = GridFollowing()
    with pytest.raises(NotSettled, match=r"would need 1\.\d+ pu of current; its limit is 1.2 pu"):
        plant.settle(OperatingPoint(plant.rating.power_va, 0.85 * U, 0.5 * plant.rating.power_va), Source())
    with pytest.raises(ValueError, match=r"reactive power of 2 Mvar is outside the range of gfl-v1"):
        plant.settle(OperatingPoint(0.0, U, 2e6), Source())


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"l_g": 0.1}, "gfm-v1 has no parameter 'l_g'"),
        ({"l_g_pu": 0.0}, "l_g_pu is 0; gfm-v1 needs a value above 0"),
        ({"dt_s": 1e-3}, "needs a step above 0 and up to 0.0001 s"),
        ({"damping_gain": 11.0}, "damping_gain is 11; gfm-v1 takes -10 to 10"),
        ({"dc_source": "coal"}, "dc_source is 'coal'"),
        ({"dc_resistance_pu": 0.0}, "a battery needs a resistance above 0"),
    ],
)
def test_wrong_parameters_are_refused(parameters, words):
    with pytest.raises(ValueError, match=words):
        GridForming(**parameters)


def test_notch_at_the_port_is_the_equations():
    """A compensated device sees v - (R + j X) H_NF i_g: poles against the oracle's, with the notch added by hand."""
    gain, r_ohm, l_h, hz = -0.7, 0.01, 2e-4, 77.0
    plant = GridForming(**DROOP, damping_gain=gain, damping_r_ohm=r_ohm, damping_l_h=l_h, damping_resonance_hz=hz)
    assert plant.compensation == Compensation(gain * r_ohm, gain * 2.0 * pi * hz * l_h)
    s = plant.rating.power_va
    source = Source("thevenin", 0.002, 0.02 / (2.0 * pi * 50.0))
    free, held = (p.equilibrium(OperatingPoint(0.5 * s, U), source) for p in (GridForming(**DROOP), plant))
    assert free.values[:20] == pytest.approx(held.values[:20], abs=1e-12)
    ((end, _),) = plant.run([Job(held, None)], 800)
    assert end.values == pytest.approx(held.values, abs=1e-12)
    assert len(plant.linearise(held)) == len(GridForming(**DROOP).linearise(free)) + 4


def test_trace_goes_on_as_run_does_and_steps_the_grid():
    plant = GridForming(**DROOP)
    s, w1 = plant.rating.power_va, 2.0 * pi * 50.0
    source = Source("thevenin", 0.002, 0.02 / w1)
    state = plant.settle(OperatingPoint(0.5 * s, U), source)
    later, trace = plant.trace(state, Conditions(0.002, 0.02 / w1), 5000)
    ((end, record),) = plant.run([Job(state, None)], 5000)
    assert trace.record.i == pytest.approx(record.i, abs=1e-6)
    assert later.values == pytest.approx(end.values, abs=1e-10)
    assert trace.rotor_rad_s == pytest.approx(np.full(5000, w1), rel=1e-12)
    assert trace.sync_rad == pytest.approx(np.full(5000, trace.sync_rad[0]), abs=1e-9)
    _, stepped = plant.trace(state, Conditions(0.004, 0.04 / w1, power_scale=0.5), 40000)
    power = -1.5 * (stepped.record.v * stepped.record.i.conj()).real
    assert stepped.record.i[0] == pytest.approx(trace.record.i[0], abs=1e-6)
    assert power[-1] == pytest.approx(0.25 * s, rel=0.02)


def test_trace_refuses_what_the_device_has_not():
    plant = GridFollowing()
    behind = plant.settle(OperatingPoint(0.5e6, U), Source("thevenin", 0.002, 1e-4))
    ideal = plant.settle(OperatingPoint(0.5e6, U), Source())
    for state, conditions, words in (
        (ideal, Conditions(0.002, 1e-4), "needs a state behind a thevenin source"),
        (behind, Conditions(0.002, 1e-4, fault_s=(1.0, 0.0, 1.0)), "has no fault at the PCC"),
        (behind, Conditions(0.002, 1e-4, wind_m_s=9.0), "has no wind"),
    ):
        with pytest.raises(ValueError, match=words):
            plant.trace(state, conditions, 10)


def test_many_tones_come_from_a_table_as_from_a_sum():
    plant = GridFollowing()
    state = plant.settle(OperatingPoint(0.5e6, U), Source())
    tones = tuple(Tone(f, 0.5, 0.1 * f) for f in np.arange(1, 30, 2) * 10.0)
    many = Injection("series_voltage", tones)
    ((_, together),) = plant.run([Job(state, many)], 2000)
    v = np.sum([t.amplitude * np.exp(1j * (2.0 * pi * t.f_hz * together.time_s + t.phase_rad)) for t in tones], axis=0)
    unperturbed = plant.run([Job(state, None)], 2000)[0][1].v
    assert together.v - unperturbed == pytest.approx(v, abs=1e-8)


def test_kernels_are_vector_code():
    """LLVM gives up vectors silently: ymm or zmm registers in the code, and hardly a scalar product."""
    for name, p in (("forming", FormingParameters()), ("following_linked_compensated", FollowingParameters())):
        x, kept = np.zeros(kernel.array_slots(1) * kernel.LANES), np.empty((1, 8, kernel.LANES))
        table, advance = np.zeros((0, 2, kernel.LANES)), getattr(kernel, f"advance_{name}")
        code = instructions(advance, table, x, 1, p, 25e-6, 1, kernel.SUM_V, kept)
        vector = code.count("zmm") + code.count("ymm")
        scalar = sum(code.count(word) for word in ("vmulsd", "vaddsd", "vfmadd213sd", "vfmadd231sd"))
        assert vector > 1000
        assert scalar < 0.1 * vector
