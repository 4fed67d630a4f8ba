"""Tables as other tools and their users really write them: the same device comes out, or the cause is named."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seqsweep.identify.exchange.facts import ExchangeError
from seqsweep.identify.exchange.headers import column_of
from seqsweep.identify.frames import dq_to_pn

from .test_exchange import F1_HZ, F_HZ, GIVEN, YDQ, Y, Z, assert_close, db, degrees, imported, names, parts, text

PN = f"f [Hz],{names('pp pn np nn', 'Y{}_re [S]', 'Y{}_im [S]')}"
COLUMNS = [F_HZ, *parts(Y, np.real, np.imag)]
ROWS = [",".join(f"{value:.17e}" for value in row) for row in zip(*COLUMNS, strict=True)]


def written(path: Path, *lines: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return path


TEXTS: dict[str, Any] = {
    "a title above the header": lambda p: written(p, "Scan of 3 March, bench 2", "", PN, *ROWS),
    "savetxt": lambda p: written(p, f"# {PN}", *ROWS),
    "D exponents": lambda p: written(p, PN, *(row.replace("e", "D") for row in ROWS)),
    "decimal commas": lambda p: written(
        p, PN.replace(",", ";"), *(row.replace(",", ";").replace(".", ",") for row in ROWS)
    ),
    "decimal commas in quotes": lambda p: written(
        p, PN, *(",".join('"' + cell.replace(".", ",") + '"' for cell in row.split(",")) for row in ROWS)
    ),
    "UTF-16": lambda p: written(p, PN, *ROWS, encoding="utf-16"),
    "a row of units": lambda p: written(
        p, PN.replace(" [Hz]", "").replace(" [S]", ""), "Hz" + 8 * ",S", *ROWS
    ),
    "a comma after every row": lambda p: written(p, PN, *(f"{row}," for row in ROWS)),
    "aligned with blanks": lambda p: written(
        p,
        " ".join(f"{head.replace(' ', ''):>26}" for head in PN.split(",")),
        *(" ".join(f"{cell:>26}" for cell in row.split(",")) for row in ROWS),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
def test_a_text_of_any_kind_means_the_same_device(tmp_path: Path, kind: str) -> None:
    assert_close(imported(TEXTS[kind](tmp_path / "y.csv"), **GIVEN).responses[0].y, Y)


def test_words_that_are_glued_together_are_taken_apart(tmp_path: Path) -> None:
    header = f"freq (Hz),{names('dd dq qd qq', 'MagY{} (dB)', 'PhaY{} in degrees')}"
    path = text(tmp_path / "y.csv", header, [F_HZ - F1_HZ, *parts(YDQ, db, degrees)])
    assert_close(imported(path, **GIVEN, unit="S").responses[0].y, Y)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("MagYdd (dB)", ("dd", "mag", "dB", "admittance")),
        ("PhaYdd in degrees", ("dd", "phase", "deg", None)),
        ("ReZ12 [ohm]", ("12", "re", "ohm", "impedance")),
        ("Zdev_dq_21_pha_rad", ("21", "phase", "rad", "impedance")),
        ("Y_dq_dd_im", ("dd", "im", None, "admittance")),
        ("Magnitude of Ypn in dB", ("pn", "mag", "dB", "admittance")),
    ],
)
def test_a_header_of_many_words_is_understood(header: str, expected: tuple[Any, ...]) -> None:
    found = column_of(header)
    assert (found.element, found.part, found.unit) == expected[:3]
    assert found.quantity in (expected[3], "admittance")


SIX = ("re", "im", "abs", "dB", "pha_rad", "pha_deg")


def six(prefix: str, z: np.ndarray, order: tuple[str, ...] = SIX) -> tuple[str, list[Any]]:
    """Header and columns of every element six times over, as a public scanning toolbox writes it."""
    of = {"re": np.real, "im": np.imag, "abs": np.abs, "dB": db, "pha_rad": np.angle, "pha_deg": degrees}
    header = names("11 12 21 22", *(f"{prefix}_{{}}_{part}" for part in order))
    return header, parts(z, *(of[part] for part in order))


@pytest.mark.parametrize("order", [SIX, SIX[::-1], SIX[2:]])
def test_redundant_columns_are_read_and_held_against_each_other(tmp_path: Path, order: tuple[str, ...]) -> None:
    header, columns = six("Zdev_dq", np.linalg.inv(YDQ), order)
    more = {"unit": "ohm", "frequency_unit": "Hz"}
    path = text(tmp_path / "z.csv", f"f,{header}", [F_HZ - F1_HZ, *columns])
    assert_close(imported(path, **GIVEN, **more).responses[0].y, Y)
    columns[1][2] = 1.1 * columns[1][2] + 0.01
    path = text(tmp_path / "bad.csv", f"f,{header}", [F_HZ - F1_HZ, *columns])
    with pytest.raises(ExchangeError, match="contradicts the others in row 3"):
        imported(path, **GIVEN, **more)


def test_terminals_side_by_side_or_one_below_the_other_are_said_and_chosen(tmp_path: Path) -> None:
    one, other = np.linalg.inv(YDQ), np.linalg.inv(3.0 * YDQ)
    (head, columns), (more_head, more_columns) = six("Zbus1_dq", one), six("Zbus2_dq", other)
    wide = text(tmp_path / "wide.csv", f"f,{head},{more_head}", [F_HZ - F1_HZ, *columns, *more_columns])
    pn = [["A"] * len(F_HZ) + ["B"] * len(F_HZ), *(2 * list(column) for column in [F_HZ, *parts(Y, np.real, np.imag)])]
    pn[2:] = [[*column[: len(F_HZ)], *(3.0 * np.array(column[len(F_HZ) :]))] for column in pn[2:]]
    long = text(tmp_path / "long.csv", f"terminal,{PN}", pn)
    given = {**GIVEN, "unit": "ohm", "frequency_unit": "Hz"}
    with pytest.raises(ExchangeError, match="several terminals: --terminal Zbus1 or Zbus2"):
        imported(wide, **given)
    with pytest.raises(ExchangeError, match="several terminals: --terminal A or B"):
        imported(long, **GIVEN)
    with pytest.raises(ExchangeError, match="has no terminal 'C'; it has A, B"):
        imported(long, **GIVEN, terminal="C")
    assert_close(imported(wide, **given, terminal="Zbus2").responses[0].y, 3.0 * Y)
    assert_close(imported(long, **GIVEN, terminal="A").responses[0].y, Y)
    assert_close(imported(long, **GIVEN, terminal="B").responses[0].y, 3.0 * Y)


# Touchstone


def touchstone(path: Path, f_hz: np.ndarray) -> Path:
    return written(path, "# Hz S RI R 1", *(f"{f} 0.1 0.2 0.3 0.1 0 0.1 0.2 0.3" for f in f_hz))


@pytest.mark.parametrize("order", [[0, 1, 3, 2, 4], [0, 1, 2, 0, 1, 2], [0, 1, 1, 2]])
def test_touchstone_frequencies_that_do_not_ascend_are_refused(tmp_path: Path, order: list[int]) -> None:
    path = touchstone(tmp_path / "y.s2p", np.array([2.0, 5.0, 10.0, 20.0, 40.0])[order])
    with pytest.raises(ExchangeError, match=r"row \d.; needed: ascending frequencies"):
        imported(path, **GIVEN, frame="pn")


def test_noise_data_below_touchstone_are_left_out(tmp_path: Path) -> None:
    path = touchstone(tmp_path / "y.s2p", F_HZ)
    path.write_text(path.read_text() + "1 0.5 0.1 20 0.2\n2 0.5 0.1 20 0.2\n")
    assert len(imported(path, **GIVEN, frame="pn").responses[0]) == len(F_HZ)


# MATLAB


@pytest.mark.parametrize("inner", [{"Y": np.moveaxis(Y, 0, -1), "f": F_HZ}, {"Y": np.moveaxis(Y, 0, -1)}])
def test_a_matrix_within_a_structure_is_read_with_what_stands_beside_it(tmp_path: Path, inner: dict[str, Any]) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "m.mat", {"scan": {"A": inner, "note": "x"}, **({} if "f" in inner else {"f": F_HZ})})
    more = {**GIVEN, "frame": "pn", "unit": "S", "frequency_unit": "Hz"}
    assert_close(imported(tmp_path / "m.mat", **more).responses[0].y, Y)
    assert_close(imported(tmp_path / "m.mat", **more, variable="scan.A.Y").responses[0].y, Y)


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_an_object_within_a_structure_is_chosen_by_its_path(tmp_path: Path, version: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        matio = pytest.importorskip("matio")
    from matio.utils.matclass import MatlabOpaque

    def frd(y: np.ndarray) -> Any:
        data = {"Response": np.moveaxis(y, 0, -1), "Frequency": (F_HZ - F1_HZ)[:, None], "FreqUnits": np.array(["Hz"])}
        return MatlabOpaque({"Data_": MatlabOpaque(data, classname="ltipack.frddata")}, classname="frd")

    matio.save_to_mat(str(tmp_path / "m.mat"), {"Z": {"ZDQ": frd(YDQ), "ZPN": frd(2.0 * YDQ)}}, version=version)
    more = {**GIVEN, "frame": "dq", "unit": "S", "quantity": "admittance"}
    with pytest.raises(ExchangeError, match=r"several 2x2xN matrices or frd objects among Z, Z.ZDQ, Z.ZPN"):
        imported(tmp_path / "m.mat", **more)
    assert_close(imported(tmp_path / "m.mat", **more, variable="Z.ZDQ").responses[0].y, Y)


# Two-sided


def device(f_hz: np.ndarray) -> np.ndarray:
    """Ypn (n, 2, 2) of an R-L branch with a lag in dd and qq, exact at any frequency."""
    s = 2j * np.pi * (f_hz - F1_HZ)
    w1 = 2.0 * np.pi * F1_HZ
    z = np.empty((len(f_hz), 2, 2), dtype=complex)
    z[:, 0, 0] = 0.3 + 2e-3 * s + 0.8 / (1.0 + 4e-3 * s)
    z[:, 1, 1] = 0.3 + 2e-3 * s
    z[:, 0, 1], z[:, 1, 0] = -w1 * 2e-3, w1 * 2e-3
    return dq_to_pn(np.linalg.inv(z))


@pytest.mark.parametrize("f_hz", [np.arange(-195.0, 200.0, 10.0), np.arange(-50.0, 200.0, 7.0)])
def test_rows_below_zero_stand_at_their_mirrors(tmp_path: Path, f_hz: np.ndarray) -> None:
    path = text(tmp_path / "y.csv", PN, [f_hz, *parts(device(f_hz), np.real, np.imag)])
    found = imported(path, **GIVEN).responses[0]
    assert_close(found.y, device(found.f_hz))
    assert found.f_hz[0] > 0.0
    assert found.f_hz[-1] > 2.0 * F1_HZ


def test_a_dq_table_may_be_two_sided(tmp_path: Path) -> None:
    f_hz = np.arange(-205.0, 206.0, 10.0)
    y = device(f_hz + F1_HZ)
    header = f"f [Hz],{names('dd dq qd qq', 'Y{}_re [S]', 'Y{}_im [S]')}"
    from seqsweep.identify.frames import pn_to_dq

    found = imported(text(tmp_path / "y.csv", header, [f_hz, *parts(pn_to_dq(y), np.real, np.imag)]), **GIVEN)
    assert_close(found.responses[0].y, device(found.responses[0].f_hz))


def test_rows_below_zero_that_mean_something_else_are_refused(tmp_path: Path) -> None:
    f_hz = np.array([-20.0, -10.0, 10.0, 2.0 * F1_HZ + 10.0, 2.0 * F1_HZ + 20.0])
    y = device(np.abs(f_hz))
    with pytest.raises(ExchangeError, match=r"the rows of -20 Hz and of its mirror .* contradict each other"):
        imported(text(tmp_path / "y.csv", PN, [f_hz, *parts(y, np.real, np.imag)]), **GIVEN)


# Direction


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_generator_that_holds_its_power_tells_a_wrong_direction(tmp_path: Path, sign: float) -> None:
    power_w, voltage_v = 0.65e6, 690.0
    f_hz = np.array([4.0, 6.0, 9.0, 13.0, 20.0, 30.0, 50.0])
    y = np.zeros((len(f_hz), 2, 2), dtype=complex)
    y[:, 0, 0], y[:, 1, 1] = sign * power_w / voltage_v**2 / (1.0 + 0.8j * f_hz) + 0.01j * f_hz, 0.4
    header = f"f [Hz],{names('dd dq qd qq', 'Y{}_re [S]', 'Y{}_im [S]')}"
    path = text(tmp_path / "y.csv", header, [f_hz, *parts(y, np.real, np.imag)])
    more = {**GIVEN, "active_power_mw": 0.65, "terminal_voltage_pu": 1.0}
    if sign > 0.0:
        assert len(imported(path, **more).responses[0]) == len(f_hz)
        return
    with pytest.raises(ExchangeError, match=r"that holds its power has \+1: --direction generator"):
        imported(path, **more)
    assert len(imported(path, **{**more, "direction": "generator"}).responses[0]) == len(f_hz)
    assert len(imported(path, **{**more, "active_power_mw": -0.65}).responses[0]) == len(f_hz)


# Workbooks


def workbook(path: Path, **sheets: list[list[Any]]) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def test_a_sheet_of_a_workbook_is_a_table(tmp_path: Path) -> None:
    rows = [PN.split(","), *(list(map(float, row)) for row in zip(*COLUMNS, strict=True))]
    path = workbook(tmp_path / "y.xlsx", About=[["made by hand"]], Scan=[["Bench 2"], [], *rows])
    assert_close(imported(path, **GIVEN).responses[0].y, Y)
    doubled = [rows[0], *([row[0], *(2 * x for x in row[1:])] for row in rows[1:])]
    two = workbook(tmp_path / "two.xlsx", One=rows, Two=doubled)
    with pytest.raises(ExchangeError, match="several sheets hold tables: One, Two; --variable NAME"):
        imported(two, **GIVEN)
    assert_close(imported(two, **GIVEN, variable="Two").responses[0].y, 2.0 * Y)


def test_what_is_no_workbook_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    with pytest.raises(ExchangeError, match="damaged, or not a workbook"):
        imported(written(tmp_path / "y.xlsx", "hello"), **GIVEN)
    with pytest.raises(ExchangeError, match="no sheet holds a table"):
        imported(workbook(tmp_path / "z.xlsx", A=[["only words"]]), **GIVEN)


def test_impedances_are_read_like_admittances(tmp_path: Path) -> None:
    header = PN.replace("Y", "Z").replace("[S]", "[ohm]")
    assert_close(
        imported(text(tmp_path / "z.csv", header, [F_HZ, *parts(Z, np.real, np.imag)]), **GIVEN).responses[0].y, Y
    )
