"""Tables of Z(f): every way of writing one, the fit behind them, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from seqsweep.tuning.grids.elements import elements_grid
from seqsweep.tuning.grids.errors import GridError
from seqsweep.tuning.grids.open import open_grid
from seqsweep.tuning.grids.rational import RationalGrid
from seqsweep.tuning.grids.scalar_fit import fit_impedance
from seqsweep.tuning.grids.series import SeriesRL
from seqsweep.tuning.grids.tables import table_grid
from tests.support.networks import KINDS, impedance_of, random_document

F = np.geomspace(1.0, 2500.0, 60)
DENSE = np.geomspace(1.5, 2400.0, 1500)
DOCUMENT = random_document(np.random.default_rng(11), "all")
Z = impedance_of(DOCUMENT, 2j * np.pi * F)


def lines(header: str, *columns: np.ndarray, sep: str = ",") -> str:
    rows = [sep.join(f"{float(x):.15g}" for x in row) for row in zip(*columns, strict=True)]
    return "\n".join([header, *rows]) + "\n"


def degrees(z: np.ndarray) -> np.ndarray:
    return np.degrees(np.angle(z))


TEXTS = {
    "plain.csv": lines("f [Hz],R [ohm],X [ohm]", F, Z.real, Z.imag),
    "units.csv": lines("frequency [kHz];Re(Z) [mohm];Im(Z) [mohm]", F / 1e3, 1e3 * Z.real, 1e3 * Z.imag, sep=";"),
    "polar.txt": lines("f_hz\t|Z| [ohm]\tangle(Z) [deg]", F, np.abs(Z), degrees(Z), sep="\t"),
    "decibel.csv": lines("Frequency (Hz),Mag (dB),Phase (deg)", F, 20.0 * np.log10(np.abs(Z)), degrees(Z)),
    "radians.csv": lines("omega [rad/s],abs Z [ohm],arg Z [rad]", 2 * np.pi * F, np.abs(Z), np.angle(Z)),
    "order.csv": lines(
        "harmonic order,R1 [ohm],X1 [ohm],R0 [ohm],X0 [ohm]", F / 50, Z.real, Z.imag, Z.real, 3 * Z.imag
    ),
    "pscad.txt": lines("F(Hz)  |Z+|(ohms)  /_Z+(deg)  |Z0|(ohms)", F, np.abs(Z), degrees(Z), 9 * F, sep="  "),
    "words.csv": lines("Frequency in Hz;Impedance, Magnitude in Ohm;Angle in deg", F, np.abs(Z), degrees(Z), sep=";"),
    "milli.csv": lines("f_kHz,real(Z)_mohm,imag(Z)_mohm", F / 1e3, 1e3 * Z.real, 1e3 * Z.imag),
    "signs.csv": lines("f [Hz],R+,X+,R-,X-", F, Z.real, Z.imag, Z.real, Z.imag),
    "negative.csv": lines("f [Hz],R2 [ohm],X2 [ohm]", F, Z.real, Z.imag),
    "both.csv": lines("f [Hz],R1 [ohm],X1 [ohm],R2 [ohm],X2 [ohm]", F, Z.real, Z.imag, Z.real, Z.imag),
    "complex.txt": "\n".join(f"{f:.12g} {z.real:.12g}{z.imag:+.12g}j" for f, z in zip(F, Z, strict=True)) + "\n",
    "commas.csv": lines("f [Hz];R [Ohm];X [Ohm]", F, Z.real, Z.imag, sep=";").replace(".", ","),
}


@pytest.mark.parametrize("name", TEXTS)
def test_every_way_of_writing_a_table_gives_the_same_grid(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(TEXTS[name], "utf-8")
    grid = table_grid(tmp_path / name, 50.0)
    exact = impedance_of(DOCUMENT, 2j * np.pi * DENSE)
    assert np.abs(grid.impedance(2j * np.pi * DENSE) / exact - 1.0).max() < 1e-6


def test_a_touchstone_one_port_is_read_and_a_two_port_refused(tmp_path: Path) -> None:
    s = (Z - 50.0) / (Z + 50.0)
    text = "# Hz S RI R 50\n" + "".join(f"{f:.12g} {x.real:.15g} {x.imag:.15g}\n" for f, x in zip(F, s, strict=True))
    (tmp_path / "z.s1p").write_text(text)
    np.testing.assert_allclose(table_grid(tmp_path / "z.s1p", 50.0).impedance(2j * np.pi * F), Z, rtol=1e-7)
    two = "# Hz S RI R 50\n" + "".join(f"{f:.12g} 0 0 1 0 1 0 0 0\n" for f in F)
    (tmp_path / "z.s2p").write_text(two)
    with pytest.raises(GridError, match="has 2 ports"):
        table_grid(tmp_path / "z.s2p", 50.0)


def test_a_mat_file_and_what_seqsweep_grid_writes_are_read(tmp_path: Path) -> None:
    savemat(tmp_path / "z.mat", {"f": F, "Z": Z, "note": "x"})
    np.testing.assert_allclose(table_grid(tmp_path / "z.mat", 50.0).impedance(2j * np.pi * F), Z, rtol=1e-7)
    signed = np.concatenate([-F[10:30], F])
    z = np.concatenate([Z[10:30].conj(), Z])
    entries = [
        {"f_hz": f, "r_ohm": x.real, "x_ohm": x.imag, "z_std_ohm": 1e-6 * abs(x)}
        for f, x in zip(signed, z, strict=True)
    ]
    (tmp_path / "grid.json").write_text(json.dumps({"operating_points": [{"op_id": "a", "lines": entries}]}))
    grid = table_grid(tmp_path / "grid.json", 50.0)
    assert len(grid.rows_hz) == len(F)
    np.testing.assert_allclose(grid.impedance(2j * np.pi * F), Z, rtol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rows", [40, 100])
def test_a_noise_free_table_is_its_network_between_the_rows_too(kind: str, rows: int) -> None:
    """Order and poles are found, not given; a straight line between 40 rows is off by tens of percent."""
    for seed in range(3):
        document = random_document(np.random.default_rng([seed, rows]), kind)
        f = np.geomspace(1.0, 2500.0, rows)
        grid = fit_impedance(f, impedance_of(document, 2j * np.pi * f), 50.0)
        exact = impedance_of(document, 2j * np.pi * DENSE)
        assert np.abs(grid.impedance(2j * np.pi * DENSE) / exact - 1.0).max() < 1e-5
        assert np.all(grid.poles.real <= 0.0)


def test_a_long_cable_is_fitted_over_the_plateau_of_its_resonances() -> None:
    """300 km to 2.5 kHz: the misfit stays at tens of percent until the last resonance has its pair."""
    document = {"element": [{"kind": "series", "r_ohm": 0.1, "x_ohm": 2.0}, _cable(300.0)]}
    cable = elements_grid(document, 50.0)
    f = np.unique(np.concatenate([np.geomspace(1.0, 500.0, 60), np.arange(520.0, 2500.0, 20.0)]))
    grid = fit_impedance(f, cable.closed_form(2j * np.pi * f), 50.0)
    exact = cable.closed_form(2j * np.pi * DENSE)
    assert np.abs(grid.impedance(2j * np.pi * DENSE) / exact - 1.0).max() < 1e-4


def _cable(length_km: float) -> dict:
    per_km = {"r_ohm_per_km": 0.05, "l_mh_per_km": 0.35, "c_nf_per_km": 250.0}
    return {"kind": "cable", "length_km": length_km, **per_km}


def test_a_series_capacitor_gets_its_pole_at_zero() -> None:
    document = random_document(np.random.default_rng(2), "series_capacitor")
    grid = fit_impedance(F, impedance_of(document, 2j * np.pi * F), 50.0)
    assert np.any(grid.poles == 0.0)
    np.testing.assert_allclose(grid.axis_poles, [100.0 * np.pi], rtol=1e-12)


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_noise_is_explained_and_its_errors_cover_the_truth(noise: float) -> None:
    """The difference to the truth, in standard errors of both parts, is a chi-squared of two: 95 % below 5.99."""
    rng = np.random.default_rng(5)
    inside = []
    for k in range(24):
        document = random_document(rng, KINDS[k % 4])
        z = impedance_of(document, 2j * np.pi * F)
        size = noise * np.abs(z)
        measured = z + size / np.sqrt(2.0) * (rng.standard_normal(len(F)) + 1j * rng.standard_normal(len(F)))
        grid = fit_impedance(F, measured, 50.0, std=size)
        nu = np.array([30.0, 90.0, 200.0])
        weight = np.broadcast_to(np.eye(2), (3, 2, 2)) / 2.0
        errors = grid.spread_dq(2j * np.pi * nu, weight)
        off = np.trace(grid.impedance_dq(2j * np.pi * nu), axis1=1, axis2=2) / 2.0
        off = off - sum(impedance_of(document, 2j * np.pi * (nu + d)) for d in (50.0, -50.0)) / 2.0
        for error, difference in zip(errors, off, strict=True):
            root = np.stack([error.real, error.imag])
            both = np.array([difference.real, difference.imag])
            inside.append(both @ np.linalg.solve(root @ root.T, both) < 5.991)
    assert np.mean(inside) > 0.85


def test_the_states_of_a_fit_are_the_fit() -> None:
    grid = fit_impedance(F, Z, 50.0).scaled(0.7)
    system = grid.descriptor()
    for s in (2j * np.pi * np.array([3.0, 77.0, 900.0]) - 5.0).tolist():
        v = system.c @ np.linalg.solve(s * system.e - system.a, system.b)
        np.testing.assert_allclose(-v, grid.impedance_dq(np.array([s]))[0], rtol=1e-8)


BAD = {
    "no_rows.csv": (lines("f [Hz],R [ohm],X [ohm]", F[:4], Z.real[:4], Z.imag[:4]), "at least 8"),
    "turned.csv": (lines("f [Hz],R [ohm],X [ohm]", F, -Z.real, Z.imag), "resistance is negative"),
    "zero.csv": (lines("f [Hz],R0 [ohm],X0 [ohm]", F, Z.real, Z.imag), "only the zero sequence"),
    "unlike.csv": (lines("f [Hz],R1,X1,R2,X2", F, Z.real, Z.imag, 2 * Z.real, 2 * Z.imag), "differ by"),
    "bare.csv": ("\n".join(lines("", F, Z.real, Z.imag).splitlines()[1:]) + "\n", "without headings"),
    "per_unit.csv": (lines("f [Hz],R [pu],X [pu]", F, Z.real, Z.imag), "the base is not in the table"),
    "unit.csv": (lines("f [Hz],R [furlong],X [furlong]", F, Z.real, Z.imag), "is not known; known are ohm"),
    "angle.csv": (lines("f [Hz],|Z| [ohm],angle", F, np.abs(Z), np.angle(Z)), "name their unit"),
    "words.csv": ("f [Hz],R [ohm],X [ohm]\nall,is,well\n", "no rows of numbers"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_grid_is_refused_with_the_way_out(name: str, tmp_path: Path) -> None:
    text, words = BAD[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=words):
        table_grid(tmp_path / name, 50.0)


def test_rows_that_are_there_twice_count_once_and_contradictions_are_refused(tmp_path: Path) -> None:
    f, z = np.append(F, F[20]), np.append(Z, Z[20])
    (tmp_path / "twice.csv").write_text(lines("f [Hz],R [ohm],X [ohm]", f, z.real, z.imag))
    grid = table_grid(tmp_path / "twice.csv", 50.0)
    assert any("there twice" in note for note in grid.notes)
    z = np.append(Z, 2.0 * Z[20])
    (tmp_path / "twice.csv").write_text(lines("f [Hz],R [ohm],X [ohm]", f, z.real, z.imag))
    with pytest.raises(GridError, match="contradict each other"):
        table_grid(tmp_path / "twice.csv", 50.0)


def test_of_several_measured_grids_one_is_named_or_the_first_is_taken_and_that_is_said(tmp_path: Path) -> None:
    points = []
    for name, scale in (("near", 1.0), ("far", 2.0)):
        entries = [
            {"f_hz": f, "r_ohm": scale * x.real, "x_ohm": scale * x.imag, "z_std_ohm": 1e-6 * abs(x)}
            for f, x in zip(F, Z, strict=True)
        ]
        points.append({"op_id": name, "lines": entries})
    place = tmp_path / "grid.json"
    place.write_text(json.dumps({"operating_points": points}))
    first, far = open_grid(str(place), 50.0), open_grid(f"{place}#far", 50.0)
    assert far.at_f1 == pytest.approx(2.0 * first.at_f1, rel=1e-4)
    assert any("grid.json holds the grids of near, far: taken was near" in note for note in first.notes)
    assert not any("taken was" in note for note in far.notes)
    with pytest.raises(GridError, match=r"no operating point 'x' in .*it has near, far"):
        open_grid(f"{place}#x", 50.0)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.csv", lines("f [Hz],R [pu],X [pu]", F, Z.real, Z.imag), "a.csv: a column in 'pu'"),
        ("b.csv", lines("f [Hz],R [ohm],X [ohm]", F[:1], Z.real[:1], Z.imag[:1]), "b.csv: .*one usable row;"),
        ("c.s1p", "# Hz S RI R 50\n10 0.1\n20 0.2\n", "c.s1p: no Touchstone file of one port"),
    ],
)
def test_a_refusal_names_the_file_and_what_it_needs(tmp_path: Path, name: str, content: str, words: str) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(GridError, match=words):
        table_grid(tmp_path / name, 50.0)


@pytest.mark.parametrize("text", ["scan.xlsx", "nowhere/grid", "0.012+0.25j.toml"])
def test_what_looks_like_a_file_and_is_none_is_told_as_one(text: str) -> None:
    with pytest.raises(GridError, match="no such file"):
        open_grid(text, 50.0)


def test_rows_missing_around_a_mode_are_named() -> None:
    f = F[(F < 60.0) | (F > 140.0)]
    grid = fit_impedance(f, impedance_of(DOCUMENT, 2j * np.pi * f), 50.0)
    low, high = grid.missing_rows(40.0, 0.5)
    assert low < 90.0 < high
    assert grid.missing_rows(300.0, 0.5) is None


def test_what_a_person_writes_opens_the_right_kind(tmp_path: Path) -> None:
    assert isinstance(open_grid("0.012+0.25j", 50.0, 1.4), SeriesRL)
    (tmp_path / "z.csv").write_text(TEXTS["plain.csv"])
    assert isinstance(open_grid(str(tmp_path / "z.csv"), 50.0), RationalGrid)
    (tmp_path / "g.toml").write_text('[[element]]\nkind = "series"\nr_ohm = 0.01\nx_ohm = 0.25\n')
    assert open_grid(str(tmp_path / "g.toml"), 50.0, 2.0).at_f1 == pytest.approx(0.02 + 0.5j)
    with pytest.raises(ValueError, match="no such file"):
        open_grid(str(tmp_path / "nothing.toml"), 50.0)
    (tmp_path / "g.toml").write_text("[[element\n")
    with pytest.raises(ValueError, match="not TOML"):
        open_grid(str(tmp_path / "g.toml"), 50.0)


@pytest.mark.parametrize("digits", [3, 5])
def test_the_last_digits_of_a_table_are_no_resonances(digits: int) -> None:
    """A series R-L-C written with a few digits keeps its one mode, at zero, and is passive."""
    f = np.geomspace(1.0, 2500.0, 100)
    for seed in range(4):
        z = impedance_of(random_document(np.random.default_rng(seed), "series_capacitor"), 2j * np.pi * f)
        rounded = [complex(float(f"{x.real:.{digits}g}"), float(f"{x.imag:.{digits}g}")) for x in z]
        grid = fit_impedance(f, np.array(rounded), 50.0)
        assert np.any(grid.poles == 0.0)
        light = grid.poles[(np.abs(grid.poles.real) < 1e-3 * np.abs(grid.poles)) & (grid.poles != 0.0)]
        assert len(light) == 0


@pytest.mark.parametrize(
    ("lowest_hz", "x_c", "digits"), [(1.0, 0.0, 5), (100.0, 0.0, 8), (100.0, 0.1, 8), (1.0, 0.003, 5)]
)
def test_a_pole_at_zero_is_a_capacitor_s_and_not_of_the_last_digits(lowest_hz: float, x_c: float, digits: int) -> None:
    """0.012 + 0.25j ohm in so many digits, also where the scan begins far above 0 Hz."""
    f = np.geomspace(lowest_hz, 2500.0, 40)
    z = 0.012 + 1j * (0.25 * f / 50.0 - x_c * 50.0 / f)
    rounded = np.array([complex(float(f"{v.real:.{digits}g}"), float(f"{v.imag:.{digits}g}")) for v in z])
    assert bool(np.any(fit_impedance(f, rounded, 50.0).phase_modes == 0.0)) == (x_c > 0.0)
