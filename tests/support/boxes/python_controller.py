"""The controls of turbine_controller.c in Python, for exporters of FMUs that are not ours (PythonFMU, PythonFMU3).

The text is written for `pythonfmu`; that for `pythonfmu3` replaces its names. Limits and a delay are left out.
"""

from math import atan2, cos, pi, remainder, sin, sqrt

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

SCALE = sqrt(2.0 / 3.0)
TOLD = ("v_a", "v_b", "v_c", "i_a", "i_b", "i_c", "v_dc", "v_dc_ref")
GIVEN = ("u_a", "u_b", "u_c")


def axes(a, b, c):
    """Power-invariant space vector of three phases."""
    return complex(SCALE * (a - 0.5 * (b + c)), SCALE * 0.8660254037844386 * (b - c))


class Past:
    """The last two samples of a quantity."""

    def __init__(self, now):
        self.first = self.second = now

    def ahead(self, lead, now):
        """The parabola through now and both, ``lead`` samples ahead."""
        bend = now - 2.0 * self.first + self.second
        return now + lead * (1.5 * now - 2.0 * self.first + 0.5 * self.second) + 0.5 * lead * lead * bend

    def remember(self, now):
        self.first, self.second = now, self.first


class PythonController(Fmi2Slave):
    def __init__(self, **options):
        super().__init__(**options)
        self.lead, self.theta = 0.5, None
        for name in (*TOLD, *GIVEN):
            setattr(self, name, 0.0)
            causality = Fmi2Causality.input if name in TOLD else Fmi2Causality.output
            self.register_variable(Real(name, causality=causality))
        self.register_variable(Real("lead", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable))

    def begin(self, v, i):
        self.theta = atan2(v.imag, v.real)
        turn = complex(cos(self.theta), -sin(self.theta))
        i = turn * i
        self.x_pll, self.xi_dc = 0.0, i.real
        self.xi = turn * v - 0.0471j * i
        self.past_v, self.past_i, self.past_dc = Past(0.0), Past(i), Past(self.v_dc)

    def do_step(self, time, step):
        v, i = axes(self.v_a, self.v_b, self.v_c), axes(self.i_a, self.i_b, self.i_c)
        if self.theta is None:
            self.begin(v, i)
        turn = complex(cos(self.theta), -sin(self.theta))
        v_q, i = (turn * v).imag, turn * i
        lead, more = self.lead, step * (self.lead - 0.5)
        v_q_mid, i_there = self.past_v.ahead(0.5, v_q), self.past_i.ahead(lead, i)
        v_dc_there = self.past_dc.ahead(lead, self.v_dc)
        for past, now in ((self.past_v, v_q), (self.past_i, i), (self.past_dc, self.v_dc)):
            past.remember(now)

        self.x_pll += step * 32.0 * v_q
        speed = 314.15926535897931 + 0.085 * v_q_mid + self.x_pll
        angle = self.theta + lead * step * speed
        self.theta = remainder(self.theta + step * speed, 2.0 * pi)

        error, before = self.v_dc - self.v_dc_ref, self.xi_dc
        self.xi_dc += step * 5.0 * error
        i_ref = 0.5 * (v_dc_there - self.v_dc_ref) + self.xi_dc + more * 5.0 * error
        i_ref_now = 0.5 * error + 0.5 * (before + self.xi_dc)

        slope = 355.0 * (i_ref_now - i)
        self.xi += step * slope
        command = 0.25 * (i_ref - i_there) + self.xi + more * slope + 0.0471j * i_there
        command *= complex(cos(angle), sin(angle))
        self.u_a = SCALE * command.real
        self.u_b = SCALE * (-0.5 * command.real + 0.8660254037844386 * command.imag)
        self.u_c = SCALE * (-0.5 * command.real - 0.8660254037844386 * command.imag)
        return True
