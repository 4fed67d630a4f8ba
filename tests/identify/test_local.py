"""One broadband record, from cold: the local polynomial method against the exact response of a sampled linear model."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from seqsweep.identify.recorded.local_polynomial import local_polynomials
from seqsweep.identify.recorded.tones import HearingError
from seqsweep.identify.table.read import read_table, validate_table

from ..support import by_hand, oracle
from ..support import recording_files as files
from ..support.by_hand import POWER_W, VOLTAGE_V, Stretch
from ..support.commands import command
from .test_hear import F1, noisy, relative_norms

DT = 2e-4
DISTANCES_HZ = np.concatenate([-np.geomspace(3.0, 200.0, 25)[::-1], np.geomspace(3.0, 200.0, 25)])


@njit(cache=True)
def states(a, b, u):
    """x[k + 1] = A x[k] + B u[k] from rest."""
    x = np.zeros((len(u), len(a)))
    for k in range(len(u) - 1):
        x[k + 1] = a @ x[k] + b @ u[k]
    return x


class Sampled:
    """The turbine's linearisation under voltages that are constant between samples: its response is known exactly."""

    def __init__(self):
        self.p, _, _ = by_hand.at_rest(F1)
        self.at = oracle.linearise(POWER_W, VOLTAGE_V, self.p)
        from scipy.signal import cont2discrete  # takes long, and every worker collects all files

        a, b, self.c, self.d, _ = cont2discrete((self.at.A, self.at.B, self.at.C, self.at.D), DT)
        self.a, self.b = np.ascontiguousarray(a), np.ascontiguousarray(b)

    def y(self, distances_hz):
        """Admittance (n, 2, 2) in S."""
        z = np.exp(2j * np.pi * distances_hz * DT)
        dq = np.array([self.c @ np.linalg.solve(each * np.eye(15) - self.a, self.b) + self.d for each in z])
        return oracle.T_PN @ dq @ np.linalg.inv(oracle.T_PN)

    def record(self, length_s, seed=0, level=0.01, cut_hz=np.inf):
        """A random binary voltage on both axes, 500 changes a second, from cold; lowered beyond ``cut_hz``."""
        n = round(length_s / DT)
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(n // 10, 2))
        spectrum = np.fft.rfft(signs.repeat(10, axis=0) * VOLTAGE_V * level, axis=0)
        spectrum[np.fft.rfftfreq(n, DT) > cut_hz] *= 1e-4
        u = np.ascontiguousarray(np.fft.irfft(spectrum, n, axis=0))
        i = states(self.a, self.b, u) @ self.c.T + u @ self.d.T + oracle.current(self.at.x, self.at.v_pcc, self.p)
        turn = np.sqrt(2.0 / 3.0) * np.exp(1j * (2.0 * np.pi * F1 * DT * np.arange(len(u)) + 0.3))
        return Stretch((VOLTAGE_V + u @ [1.0, 1.0j]) * turn, (i @ [1.0, 1.0j]) * turn, DT)


SAMPLED = Sampled()


@pytest.mark.parametrize(("noise", "median"), [(0.0, 2e-4), (1e-3, 3e-2)])
def test_one_record_from_cold_gives_the_2x2_and_how_well_it_is_known(noise, median):
    stretch = SAMPLED.record(20.0)
    stretch = noisy(stretch, noise, np.random.default_rng(1)) if noise else stretch
    found = local_polynomials(by_hand.Heard(stretch), DISTANCES_HZ)
    error = relative_norms(found.y - SAMPLED.y(found.distance_hz), SAMPLED.y(found.distance_hz))
    expected = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2)) / np.linalg.norm(found.y, axis=(1, 2))
    assert len(error) > 40
    assert np.median(error) < median  # published: 2-5e-4 without noise, 1-5 % at 0.1 %
    assert 0.5 < np.median(error / expected) < 1.5
    assert np.mean(error < 2.5 * expected) > 0.9


def test_frequencies_that_are_not_excited_are_left_out():
    found = local_polynomials(by_hand.Heard(SAMPLED.record(20.0, cut_hz=30.0)), DISTANCES_HZ)
    assert np.max(np.abs(found.distance_hz)) < 31.0


def test_missing_samples_and_no_fundamental_are_refused():
    stretch = SAMPLED.record(2.0)
    stretch.v[100] = np.nan
    with pytest.raises(HearingError, match="missing samples"):
        local_polynomials(by_hand.Heard(stretch), DISTANCES_HZ)
    with pytest.raises(HearingError, match="no fundamental"):
        local_polynomials(by_hand.Heard(Stretch(np.zeros(5000) + 0j, np.zeros(5000) + 0j, DT)), DISTANCES_HZ)


def test_a_broadband_file_becomes_a_table_and_says_how(tmp_path):
    files.comtrade(tmp_path / "prbs", files.six(SAMPLED.record(20.0)), form="FLOAT32", rate_hz=1.0 / DT)
    done = command("identify", tmp_path / "prbs.cfg", "--direction", "load", "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert "taken as a broadband record" in done.stderr
    assert done.returncode in (0, 1)  # rows next to f1, where 20 s do not resolve the device, may be noisy
    assert validate_table(tmp_path / "y.parquet") == []
    response = read_table(tmp_path / "y.parquet").responses[0]
    truth = SAMPLED.y(response.f_hz - response.f1_hz)
    assert np.median(relative_norms(response.y - truth, truth)[response.ok]) < 5e-4
    assert np.count_nonzero(response.ok) > 60
