"""Tables out and in: what goes out is read by others as we mean it, what comes in is what they meant."""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from seqsweep.identify.exchange import mat as exchange_mat
from seqsweep.identify.exchange.convert import to_table
from seqsweep.identify.exchange.facts import OPTIONS, ExchangeError
from seqsweep.identify.exchange.headers import column_of
from seqsweep.identify.exchange.objects import to_control, to_network, to_xarray
from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.format import TableError
from seqsweep.identify.table.read import Table, read_table, validate_table
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.cli.exchange import export_table, import_file, read_file

from ..support.commands import command

F1_HZ = 49.97
BASES = {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6}
F_HZ = np.array([1.5, 23.7, 76.3, 2.0 * F1_HZ, 150.0, 999.5])
GIVEN: dict[str, Any] = {"f1_hz": F1_HZ, "direction": "load", **BASES}

# Elements differ by six orders at most, 1 S is near 1/z0 = 3.4 S: double precision keeps 1e-12 of the norm.
number = st.floats(0.01, 100.0).flatmap(lambda size: st.sampled_from([size, -size]))


def matrices(n: int) -> st.SearchStrategy[np.ndarray]:
    return st.lists(number, min_size=8 * n, max_size=8 * n).map(
        lambda values: np.array(values).reshape(n, 2, 2, 2) @ np.array([1.0, 1j])
    )


def random_y(n: int = len(F_HZ), seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 2, 2)) + 1j * rng.normal(size=(n, 2, 2))


def response(y: np.ndarray, f_hz: np.ndarray = F_HZ, op_id: str = "p065", **more: Any) -> FrequencyResponse:
    return FrequencyResponse(f_hz, y, F1_HZ, meta={"op_id": op_id}, **more)


def written(path: Path, *responses: FrequencyResponse) -> Path:
    points = [{"op_id": one.meta["op_id"], "active_power_mw": 0.65, "terminal_voltage_pu": None} for one in responses]
    meta = {
        **{"f1_hz": F1_HZ, "bases": BASES, "power_meaning": "at the PCC, out of the device", "plant": {"id": "x-v1"}},
        **{"operating_points": points, "configuration": {"plant": {"id": "x-v1"}}},
    }
    write_table(path, responses, meta)
    return path


def imported(path: Path, **given: Any) -> Table:
    """The table of a foreign file; it conforms."""
    kind = {".mat": "mat", ".s2p": "touchstone", ".xlsx": "xlsx"}.get(path.suffix, "csv")
    out = path.with_name("imported.parquet")
    import_file(path, out, kind, given)
    assert validate_table(out) == []
    return read_table(out)


def assert_close(found: np.ndarray, y: np.ndarray) -> None:
    """Every 2x2 to 1e-12 of its norm."""
    error = np.linalg.norm(found - y, axis=(1, 2)) / np.linalg.norm(y, axis=(1, 2))
    assert error.max() <= 1e-12


# Round trips


@pytest.mark.parametrize(
    ("name", "frame"), [("y.csv", "pn"), ("y.csv", "dq"), ("y.mat", "pn"), ("y.mat", "dq"), ("y.s2p", "pn")]
)
def test_what_goes_out_comes_back(tmp_path_factory: pytest.TempPathFactory, name: str, frame: Any) -> None:
    folder = tmp_path_factory.mktemp("trip")

    @settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.large_base_example])
    @given(y=matrices(len(F_HZ)))
    def trip(y: np.ndarray) -> None:
        table = written(folder / "y.parquet", response(y))
        kind = {"csv": "csv", "mat": "mat", "s2p": "touchstone"}[name[-3:]]
        export_table(table, folder / name, kind, frame=frame)
        found = imported(folder / name)
        np.testing.assert_allclose(found.responses[0].f_hz, F_HZ, rtol=1e-12)
        assert_close(found.responses[0].y, y)
        assert found.meta["f1_hz"] == F1_HZ
        assert {key: found.meta["bases"][key] for key in BASES} == BASES
        assert found.meta["operating_points"][0] == {
            "op_id": "p065", "active_power_mw": 0.65, "terminal_voltage_pu": None,
        }  # fmt: skip

    trip()


@pytest.mark.parametrize("name", ["y.csv", "y.mat"])
def test_in_the_pn_frame_text_and_matlab_keep_every_bit(tmp_path: Path, name: str) -> None:
    y = random_y() * 10.0 ** np.arange(-3, 3)[:, np.newaxis, np.newaxis]
    table = written(tmp_path / "y.parquet", response(y))
    export_table(table, tmp_path / name, name[-3:])
    found = imported(tmp_path / name).responses[0]
    np.testing.assert_array_equal(found.y, y)
    np.testing.assert_array_equal(found.f_hz, F_HZ)


@pytest.mark.parametrize("name", ["y.csv", "y.mat", "y.s2p"])
@pytest.mark.parametrize("n", [1, 2])
def test_one_row_and_two_come_back_too(tmp_path: Path, name: str, n: int) -> None:
    table = written(tmp_path / "y.parquet", response(random_y(n), F_HZ[:n]))
    export_table(table, tmp_path / name, {"csv": "csv", "mat": "mat", "s2p": "touchstone"}[name[-3:]])
    assert_close(imported(tmp_path / name).responses[0].y, random_y(n))


def test_a_single_matrix_without_a_third_dimension_is_read(tmp_path: Path) -> None:
    """MATLAB drops the last dimension where it is one."""
    from scipy.io import savemat

    savemat(tmp_path / "m.mat", {"Y": random_y(1)[0], "f_hz": 23.7})
    found = imported(tmp_path / "m.mat", **GIVEN, frame="pn", unit="S")
    assert_close(found.responses[0].y, random_y(1))


@pytest.mark.parametrize("name", ["y.csv", "y.mat"])
def test_failed_rows_keep_their_status_and_reason(tmp_path: Path, name: str) -> None:
    y = random_y()
    y[2] = complex(np.nan, np.nan)
    status, reason = ["ok"] * 6, [""] * 6
    status[2], reason[2] = "failed", "the plant said nein, ä"
    quality = {"cond_v": np.arange(1.0, 7.0)}
    one = response(y, status=np.array(status), reason=np.array(reason), quality=quality)
    export_table(written(tmp_path / "y.parquet", one), tmp_path / name, name[-3:])
    found = imported(tmp_path / name).responses[0]
    assert np.asarray(found.status).tolist() == status
    assert np.asarray(found.reason).tolist() == reason
    np.testing.assert_array_equal(found.quality["cond_v"], quality["cond_v"])
    np.testing.assert_array_equal(np.isnan(found.y), np.isnan(y))


def test_touchstone_keeps_a_name_beyond_ascii(tmp_path: Path) -> None:
    export_table(written(tmp_path / "y.parquet", response(random_y(), op_id="Süd")), tmp_path / "y.s2p", "touchstone")
    assert imported(tmp_path / "y.s2p").op_ids == ("Süd",)


@pytest.mark.parametrize("name", ["y.csv", "y.mat"])
def test_odd_names_and_reasons_survive(tmp_path: Path, name: str) -> None:
    y = random_y()
    y[2] = complex(np.nan, np.nan)
    status, reason = ["ok"] * 6, [""] * 6
    status[2], reason[2] = "failed", 'a "quote", a comma;\n# and a line'
    one = response(y, op_id="#1, odd", status=np.array(status), reason=np.array(reason))
    export_table(written(tmp_path / "y.parquet", one), tmp_path / name, name[-3:])
    found = imported(tmp_path / name)
    assert found.op_ids == ("#1, odd",)
    expected = " ".join(reason[2].split()) if name == "y.csv" else reason[2]  # one row of text is one line
    assert np.asarray(found.responses[0].reason)[2] == expected


def test_standard_deviations_go_out(tmp_path: Path) -> None:
    import pandas
    from scipy.io import loadmat

    variances = np.arange(1.0, 9.0) * 1e-6
    covariance = np.tile(np.diag(variances), (6, 1, 1))
    table = written(tmp_path / "y.parquet", response(random_y(), covariance=covariance))
    std = np.sqrt(variances[0::2] + variances[1::2])
    export_table(table, tmp_path / "y.csv", "csv")
    frame = pandas.read_csv(tmp_path / "y.csv", comment="#")
    np.testing.assert_allclose(frame["y_pn_std [S]"], std[1], rtol=1e-14)
    export_table(table, tmp_path / "y.mat", "mat")
    np.testing.assert_allclose(loadmat(tmp_path / "y.mat")["Y_std"][:, :, 3], std.reshape(2, 2), rtol=1e-14)


def test_nothing_that_is_ok_is_nothing_to_hand_on() -> None:
    y = np.full((6, 2, 2), complex(np.nan, np.nan))
    one = response(y, status=np.full(6, "failed"), reason=np.full(6, "why"))
    for hand_on in (to_control, to_network):
        with pytest.raises(ExchangeError, match="p065: no row is ok"):
            hand_on(one)


def test_touchstone_says_that_rows_were_left_out(tmp_path: Path) -> None:
    y = random_y()
    y[2] = complex(np.nan, np.nan)
    status = np.array(["ok", "ok", "failed", "ok", "ok", "ok"])
    one = response(y, status=status, reason=np.where(status == "ok", "", "why"))
    said = export_table(written(tmp_path / "y.parquet", one), tmp_path / "y.s2p", "touchstone")
    assert "1 rows that are not ok left out" in said
    assert len(imported(tmp_path / "y.s2p").responses[0]) == 5


def test_several_operating_points_travel_in_one_text_and_are_chosen_for_the_rest(tmp_path: Path) -> None:
    table = written(tmp_path / "y.parquet", response(random_y(seed=1)), response(random_y(seed=2), op_id="p130"))
    export_table(table, tmp_path / "y.csv", "csv")
    assert imported(tmp_path / "y.csv").op_ids == ("p065", "p130")
    with pytest.raises(TableError, match="choose with --op ID: p065, p130"):
        export_table(table, tmp_path / "y.mat", "mat")
    export_table(table, tmp_path / "y.mat", "mat", op_id="p130")
    np.testing.assert_array_equal(imported(tmp_path / "y.mat").response("p130").y, random_y(seed=2))


def test_the_same_table_gives_the_same_bytes(tmp_path: Path) -> None:
    table = written(tmp_path / "y.parquet", response(random_y()))
    for name, kind in (("csv", "csv"), ("mat", "mat"), ("s2p", "touchstone")):
        for number in range(2):
            export_table(table, tmp_path / f"{number}.{name}", kind)
        assert (tmp_path / f"0.{name}").read_bytes() == (tmp_path / f"1.{name}").read_bytes()


# What others read


def test_pandas_reads_our_text(tmp_path: Path) -> None:
    import pandas

    y = random_y()
    export_table(written(tmp_path / "y.parquet", response(y)), tmp_path / "y.csv", "csv")
    frame = pandas.read_csv(tmp_path / "y.csv", comment="#")
    np.testing.assert_array_equal(frame["f [Hz]"], F_HZ)
    np.testing.assert_array_equal(frame["y_np_re [S]"] + 1j * frame["y_np_im [S]"], y[:, 1, 0])


def test_matlab_gets_what_frd_wants(tmp_path: Path) -> None:
    """`frd(Y, 2*pi*f_hz)` takes outputs x inputs x frequencies and a column; scipy reads the file on its own."""
    from scipy.io import loadmat

    y = random_y()
    export_table(written(tmp_path / "y.parquet", response(y)), tmp_path / "y.mat", "mat")
    content = loadmat(tmp_path / "y.mat")
    assert content["Y"].shape == (2, 2, len(F_HZ))
    assert content["f_hz"].shape == (len(F_HZ), 1)
    for k in range(len(F_HZ)):
        np.testing.assert_array_equal(content["Y"][:, :, k], y[k])
    assert content["frame"] == ["pn"]


def test_scikit_rf_reads_our_touchstone(tmp_path: Path) -> None:
    """S by its textbook definition for one reference impedance, not by the package that wrote it."""
    import skrf

    y = random_y()
    export_table(written(tmp_path / "y.parquet", response(y)), tmp_path / "y.s2p", "touchstone", z0_ohm=0.5)
    network = skrf.Network(str(tmp_path / "y.s2p"))
    identity = np.eye(2)
    s = np.array([(identity - 0.5 * one) @ np.linalg.inv(identity + 0.5 * one) for one in y])
    np.testing.assert_allclose(network.s, s, rtol=0.0, atol=1e-13)  # |S| of order one, ten operations
    np.testing.assert_array_equal(network.f, F_HZ)
    assert np.all(network.z0 == 0.5)


def test_python_control_evaluates_the_response_where_it_was_measured() -> None:
    y = random_y()
    model = to_control(response(y))
    for k, f_hz in enumerate(F_HZ):
        np.testing.assert_array_equal(model.eval(2.0 * np.pi * f_hz), y[k])
    assert model.input_labels == ["v_p", "v_n_conj"]


def test_python_control_takes_the_dq_frame_with_its_negative_frequencies() -> None:
    from seqsweep.identify.frames import to_frame

    dq = to_frame(response(random_y()), "dq")
    model = to_control(dq)
    assert model.omega[0] < 0.0
    np.testing.assert_array_equal(np.moveaxis(model.frdata, -1, 0), dq.y)


def test_a_network_has_the_admittance_it_was_made_of() -> None:
    y = random_y()
    network = to_network(response(y), z0_ohm=0.3)
    assert_close(network.y, y)
    with pytest.raises(ExchangeError, match=r"lose .* choose a reference impedance near the device's own"):
        to_network(response(y * 1e-9), z0_ohm=1.0)


def test_xarray_selects_by_name() -> None:
    y = random_y()
    table = Table({"f1_hz": F1_HZ, "direction": "load"}, (response(y),))
    data = to_xarray(table)
    assert complex(data.y.sel(op_id="p065", f_hz=150.0, row="n", column="p")) == y[4, 1, 0]
    other = response(random_y(3), F_HZ[:3], "p130")
    with pytest.raises(ExchangeError, match="different frequencies"):
        to_xarray(Table(table.meta, (response(y), other)))


# What others write


def dq_of(y: np.ndarray) -> np.ndarray:
    """Ydq of Ypn, element by element, from x_p = x_d + j x_q and x_n* = x_d - j x_q: no matrix of ours."""
    (pp, pn), (np_, nn) = y
    return 0.5 * np.array(
        [[pp + pn + np_ + nn, 1j * (pp - pn + np_ - nn)], [-1j * (pp + pn - np_ - nn), pp - pn - np_ + nn]]
    )


def text(path: Path, header: str, columns: list[Any], separator: str = ",") -> Path:
    rows = [separator.join(str(value) for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n", "utf-8")
    return path


Y = random_y()
YDQ = np.array([dq_of(one) for one in Y])
Z = np.linalg.inv(Y)


def parts(y: np.ndarray, *of: Any) -> list[Any]:
    """Columns of ``of`` for each element, row after row."""
    return [[float(f(value)) for value in y.reshape(-1, 4)[:, k]] for k in range(4) for f in of]


def names(elements: str, *templates: str) -> str:
    return ",".join(template.format(element) for element in elements.split() for template in templates)


def db(value: complex) -> float:
    return 20.0 * np.log10(abs(value))


def degrees(value: complex) -> float:
    return float(np.degrees(np.angle(value)))


FOREIGN: dict[str, tuple[str, list[Any], dict[str, Any]]] = {
    "re, im": (f"f [Hz],{names('pp pn np nn', 're_{} [S]', 'im_{} [S]')}", [F_HZ, *parts(Y, np.real, np.imag)], {}),
    "milli": (
        f"freq (kHz),{names('pp pn np nn', 'Y{}_real (mS)', 'Y{}_imag (mS)')}",
        [F_HZ / 1e3, *parts(1e3 * Y, np.real, np.imag)],
        {},
    ),
    "magnitude": (
        f"frequency [Hz],{names('pp pn np nn', '|Y{}| [S]', 'phase(Y{}) [deg]')}",
        [F_HZ, *parts(Y, abs, degrees)],
        {},
    ),
    "decibel": (f"f_hz,{names('pp pn np nn', 'Y_{}_dB', 'Y_{}_deg')}", [F_HZ, *parts(Y, db, degrees)], {}),
    "radians": (
        f"omega,{names('pp pn np nn', 'mag_{} [S]', 'angle_{} [rad]')}",
        [2.0 * np.pi * F_HZ, *parts(Y, abs, np.angle)],
        {},
    ),
    "impedance": (
        f"f [Hz],{names('pp pn np nn', 'Re(Z{}) [ohm]', 'Im(Z{}) [ohm]')}",
        [F_HZ, *parts(Z, np.real, np.imag)],
        {},
    ),
    "per unit": (
        f"f [Hz],{names('pp pn np nn', 're_{}', 'im_{}')}",
        [F_HZ, *parts(Y * 690.0**2 / 1.632e6, np.real, np.imag)],
        {"unit": "pu"},
    ),
    "generator": (
        f"f [Hz],{names('pp pn np nn', 're_{} [S]', 'im_{} [S]')}",
        [F_HZ, *parts(-Y, np.real, np.imag)],
        {"direction": "generator"},
    ),
    "dq": (
        f"f [Hz],{names('dd dq qd qq', 're_{} [S]', 'im_{} [S]')}",
        [F_HZ - F1_HZ, *parts(YDQ, np.real, np.imag)],
        {},
    ),
    "numbered": (
        f"f [Hz],{names('11 12 21 22', 'Y{}_re [S]', 'Y{}_im [S]')}",
        [F_HZ - F1_HZ, *parts(YDQ, np.real, np.imag)],
        {"frame": "dq"},
    ),
    "q lags d": (
        f"f [Hz],{names('dd dq qd qq', 're_{} [S]', 'im_{} [S]')}",
        [F_HZ - F1_HZ, *parts(YDQ * np.array([[1, -1], [-1, 1]]), np.real, np.imag)],
        {"q_axis": "lagging"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FOREIGN)
def test_the_text_of_others_means_the_same_device(tmp_path: Path, case: str) -> None:
    header, columns, more = FOREIGN[case]
    quantity = {} if "Z" in header or "Y" in header else {"quantity": "admittance"}
    found = imported(text(tmp_path / "foreign.csv", header, columns), **{**GIVEN, **quantity, **more})
    assert_close(found.responses[0].y, Y)
    np.testing.assert_allclose(found.responses[0].f_hz, F_HZ, rtol=1e-13)
    assert np.all(np.isnan(np.asarray(found.responses[0].covariance)))
    assert found.meta["configuration"]["imported"]["file"] == "foreign.csv"


@pytest.mark.parametrize("separator", ["\t", ";", " "])
def test_the_separator_is_found(tmp_path: Path, separator: str) -> None:
    header, columns, _ = FOREIGN["decibel"]
    path = text(tmp_path / "foreign.txt", header.replace(",", separator), columns, separator)
    assert_close(imported(path, **GIVEN).responses[0].y, Y)


def test_complex_strings_under_two_variables_are_read(tmp_path: Path) -> None:
    """As numpy writes them: a header with the names of the two variables, the matrix row after row."""
    path = tmp_path / "scan#Y_AC#VSC-1#.txt"
    data = np.column_stack([F_HZ - F1_HZ, YDQ.reshape(-1, 4)])
    np.savetxt(path, data, delimiter="\t", header="f\tVSC-1_d\tVSC-1_q", comments="")
    more = {"quantity": "admittance", "unit": "S", "frequency_unit": "Hz"}
    found = imported(path, **GIVEN, **more)
    assert_close(found.responses[0].y, Y)
    path.write_text(path.read_text().replace("-", "+-", 1), "utf-8")  # the sign of older versions
    assert_close(imported(path, **GIVEN, **more).responses[0].y, Y)


def test_a_dq_import_is_tuned_like_the_pn_original(tmp_path: Path) -> None:
    """The exact linearisation of the turbine; of the dq file only what other tools have, f above zero."""
    from seqsweep.tuning.siso import parse_grid
    from seqsweep.tuning.tune import tune

    from ..support.oracle import admittance_pn

    f_hz = np.concatenate([np.geomspace(2.0, 45.0, 25), np.geomspace(55.0, 1000.0, 30)])
    y = admittance_pn(f_hz, 0.65e6, 690.0)
    above = f_hz > 50.0
    y_dq = np.array([dq_of(one) for one in y[above]])
    path = text(tmp_path / "dq.csv", FOREIGN["dq"][0], [f_hz[above] - 50.0, *parts(y_dq, np.real, np.imag)])
    given = {**GIVEN, "f1_hz": 50.0, "quantity": "admittance", "op_id": "p065", "terminal_voltage_pu": 1.0}
    found = imported(path, **given, active_power_mw=0.65)
    whole = FrequencyResponse(f_hz, y, 50.0, meta=found.meta["operating_points"][0])
    grid = parse_grid("0.012+0.25j", 50.0, 1.2)
    one, other = (tune(table, grid).points[0] for table in (found, Table(found.meta, (whole,))))
    assert one.verdict == other.verdict == "stable"
    assert one.margin_m == pytest.approx(other.margin_m, rel=1e-3)  # what the fit's 55 and 30 points differ by
    assert one.critical_scale == pytest.approx(other.critical_scale, rel=1e-3)


HEADERS = {
    "f [Hz]": ("f", "", "", "Hz"),
    "Frequency (rad/s)": ("f", "", "", "rad/s"),
    "f_mirror [Hz]": ("other", "", "", None),
    "y_pp_re [S]": ("value", "pp", "re", "S"),
    "y_pp_std [S]": ("other", "", "", None),
    "|Ydq| (dB)": ("value", "dq", "mag", "dB"),
    "∠Zqd [°]": ("value", "qd", "phase", "deg"),
    "Im(Y12) [mS]": ("value", "12", "im", "mS"),
    "imag_nn": ("value", "nn", "im", None),
    "Ynp_phase_deg": ("value", "np", "phase", "deg"),
    "amplitude_pu": ("amplitude_pu", "", "", None),
    "comment": ("other", "", "", None),
    "Re(Ypp)": ("value", "pp", "re", None),
    "Ypp_re_S": ("value", "pp", "re", "S"),
    "Zdd_re [MΩ]": ("value", "dd", "re", "MΩ"),
    "Zdd_re [mΩ]": ("value", "dd", "re", "mohm"),
    "HZ": ("f", "", "", "Hz"),
}


@pytest.mark.parametrize("header", HEADERS)
def test_a_header_says_what_its_column_is(header: str) -> None:
    found = column_of(header)
    assert (found.what, found.element, found.part, found.unit) == HEADERS[header]


def saved_frd(path: Path, version: str, delay_s: float = 0.0) -> Path:
    """An object built like MATLAB's: an frd whose data are an object inside it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import matio
    from matio.utils.matclass import MatlabOpaque

    inner = {
        "Response": np.moveaxis(YDQ, 0, -1),
        "Frequency": 2.0 * np.pi * (F_HZ - F1_HZ)[:, np.newaxis],
        "FreqUnits": np.array(["rad/s"]),
        "Ts": np.array([[0.0]]),
        "Delay": {"Input": np.array([[0.0], [delay_s]]), "Output": np.array([[0.0], [0.0]])},
    }
    data = MatlabOpaque(inner, classname="ltipack.frddata")
    outer = MatlabOpaque({"Data_": data, "IOSize_": np.array([[2.0, 2.0]])}, classname="frd")
    matio.save_to_mat(str(path), {"G": outer, "note": np.array([[1.0]])}, version=version)
    return path


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_a_saved_frd_object_is_read(tmp_path: Path, version: str) -> None:
    path = saved_frd(tmp_path / "g.mat", version)
    found = imported(path, **GIVEN, frame="dq", quantity="admittance", unit="S")
    assert_close(found.responses[0].y, Y)
    np.testing.assert_allclose(found.responses[0].f_hz, F_HZ, rtol=1e-12)


def test_an_frd_object_that_keeps_its_delays_apart_is_refused(tmp_path: Path) -> None:
    path = saved_frd(tmp_path / "g.mat", "v7", delay_s=1e-4)
    with pytest.raises(ExchangeError, match=r"save absorbDelay\(G\)"):
        imported(path, **GIVEN, frame="dq", quantity="admittance", unit="S")


def test_a_matrix_with_the_frequency_first_is_read(tmp_path: Path) -> None:
    from scipy.io import savemat

    savemat(tmp_path / "m.mat", {"Ztot": Z, "w": 2.0 * np.pi * F_HZ, "other": np.ones((3, 3))})
    found = imported(tmp_path / "m.mat", **GIVEN, frame="pn", unit="ohm")
    assert_close(found.responses[0].y, Y)


def test_a_matrix_of_version_73_is_read(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import matio
    matio.save_to_mat(str(tmp_path / "m.mat"), {"Y": np.moveaxis(Y, 0, -1), "f_hz": F_HZ[:, np.newaxis]})
    assert_close(imported(tmp_path / "m.mat", **GIVEN, frame="pn", unit="S").responses[0].y, Y)


# Refusals

BASE_HEADER = f"f [Hz],{names('pp pn np nn', 'Y{}_re [S]', 'Y{}_im [S]')}"
BASE = [F_HZ.copy(), *parts(Y, np.real, np.imag)]


def changed(row: int, column: int, value: Any) -> list[Any]:
    columns = [list(map(str, column)) for column in BASE]
    columns[column][row] = str(value)
    return columns


REFUSED: dict[str, tuple[str, list[Any], dict[str, Any], str]] = {
    "no f1": (BASE_HEADER, BASE, {"f1_hz": None}, "does not say its f1_hz: give --f1 HZ"),
    "no direction": (BASE_HEADER, BASE, {"direction": None}, "give --direction load|generator"),
    "no rating": (BASE_HEADER, BASE, {"rated_power_va": None}, "give --rated-power-va VA"),
    "no unit": (BASE_HEADER.replace(" [S]", ""), BASE, {}, "give --unit"),
    "no frame": (
        f"f [Hz],{names('11 12 21 22', 'Y{}_re [S]', 'Y{}_im [S]')}", BASE, {}, "give --frame pn|dq",
    ),
    "no quantity": (BASE_HEADER.replace("Y", ""), BASE, {}, "give --quantity admittance|impedance"),
    "no frequency unit": (BASE_HEADER.replace(" [Hz]", ""), BASE, {}, "give --frequency-unit"),
    "no phase unit": (
        f"f [Hz],{names('pp pn np nn', 'Y{}_mag [S]', 'Y{}_phase')}", BASE, {}, "give --phase-unit deg|rad",
    ),
    "contradiction": (BASE_HEADER, BASE, {"frame": "dq"}, "says frame = pn; that contradicts --frame dq"),
    "odd direction": (BASE_HEADER, BASE, {"direction": "motor"}, "needed: load or generator"),
    "odd f1": (BASE_HEADER, BASE, {"f1_hz": -50.0}, "needed: a number above 0"),
    "odd unit": (BASE_HEADER.replace("[S]", "[ohm]"), BASE, {}, "unit 'ohm' of an admittance; known are S"),
    "mega is not milli": (BASE_HEADER.replace("[S]", "[MS]"), BASE, {}, "unit 'MS' of an admittance; known are S"),
    "phase in percent": (
        f"f [Hz],{names('pp pn np nn', 'Y{}_mag [S]', 'Y{}_phase [%]')}", BASE, {}, "a phase in '%'; known are deg",
    ),
    "imaginary": (BASE_HEADER, changed(1, 0, "23.7+1j"), {}, "a frequency has an imaginary part"),
    "missing column": (BASE_HEADER, BASE, {}, "element nn or qq or 22: re found; needed: re and im"),
    "no frequency": (BASE_HEADER.replace("f [Hz]", "g [Hz]"), BASE, {}, "no column of frequencies"),
    "mixed frames": (BASE_HEADER.replace("pn", "dq"), BASE, {}, "columns of dq and pn in one file"),
    "f1 itself": (BASE_HEADER, changed(2, 0, F1_HZ), {}, "49.97 Hz is f1 itself"),
    "twice": (BASE_HEADER, changed(2, 0, 23.7), {}, "23.7 Hz is there twice"),
    "unsorted": (BASE_HEADER, changed(2, 0, 12.0), {}, "12 Hz follows 23.7 Hz; needed: ascending"),
    "zero": (BASE_HEADER, changed(0, 0, 0.0), {}, "a table holds frequencies above 0"),
    "NaN": (BASE_HEADER, changed(1, 3, "nan"), {}, "1 rows hold NaN or infinity, the first at 23.7 Hz"),
    "NaN frequency": (BASE_HEADER, changed(1, 0, "nan"), {}, "frequency of row 2 is not a finite number"),
    "no number": (BASE_HEADER, changed(1, 3, "a lot"), {}, "row 2, column 'Ypn_re [S]': 'a lot' is not a number"),
    "singular": (
        BASE_HEADER.replace("Y", "Z").replace("[S]", "[ohm]"), [F_HZ, *[[1.0] * 6] * 8], {}, "matrix is singular",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_missing_or_wrong_is_named(tmp_path: Path, case: str) -> None:
    header, columns, more, words = REFUSED[case]
    if case == "missing column":
        header, columns = header.rpartition(",")[0], columns[:-1]
    path = text(tmp_path / "foreign.csv", header, columns)
    with pytest.raises(ExchangeError) as refusal:
        imported(path, **{**GIVEN, **more})
    assert words in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1
    assert not (tmp_path / "imported.parquet").exists()


def test_everything_that_is_missing_is_named_at_once(tmp_path: Path) -> None:
    """Text with no unit and no rating; the same as a matrix of MATLAB; and a wrong header is said before."""
    from scipy.io import savemat

    path = text(tmp_path / "bare.csv", f"f,{names('11 12 21 22', '{}_mag', '{}_phase')}", BASE)
    with pytest.raises(ExchangeError) as refusal:
        imported(path)
    options = [option for option in OPTIONS.values() if not option.startswith("--q-axis")]
    assert all(option in str(refusal.value) for option in options)
    savemat(tmp_path / "m.mat", {"Ztot": Z, "freq": F_HZ})
    with pytest.raises(ExchangeError) as refusal:
        imported(tmp_path / "m.mat")
    known = ("--quantity", "--phase-unit", "--q-axis")
    assert all(option in str(refusal.value) for option in OPTIONS.values() if not option.startswith(known))
    path = text(tmp_path / "headless.csv", "g,h,k", [F_HZ, F_HZ, F_HZ])
    with pytest.raises(ExchangeError, match="no column of frequencies"):
        imported(path)


def test_zero_in_the_dq_frame_is_f1_and_said_so(tmp_path: Path) -> None:
    path = text(tmp_path / "f.csv", FOREIGN["dq"][0], [[-1, 0, 1, 2, 3, 4], *FOREIGN["dq"][1][1:]])
    with pytest.raises(ExchangeError, match=r"0 Hz in the dq frame is f1 = 49\.97 Hz itself"):
        imported(path, **GIVEN, quantity="admittance")


MAT_HEAD = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"

GARBAGE: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "is empty"),
    "binary.csv": (b"\x00\x01" * 100, "not a text file"),
    "only a header.csv": (BASE_HEADER.encode(), "a header, and no rows"),
    "odd fact.csv": (b"# unit: [1]\n" + BASE_HEADER.encode() + b"\n1,1,1,1,1,1,1,1,1\n", "unit is [1]; needed: a text"),
    "contradiction.csv": (
        b'# frame: "dq"\n' + BASE_HEADER.encode() + b"\n1,1,1,1,1,1,1,1,1\n",
        "says frame = pn; that contradicts --frame dq",
    ),
    "odd name.csv": (
        b'# operating_points: [{"op_id": [1]}]\n' + BASE_HEADER.encode() + 2 * b"\n50,1,1,1,1,1,1,1,1",
        "50 Hz is there twice",
    ),
    "odd point.csv": (
        b'# operating_points: [{"op_id": "", "active_power_mw": "much"}]\n' + BASE_HEADER.encode() + b"\n1" + b",1" * 8,
        "operating_points[0].active_power_mw: 'much' is not of type",
    ),
    "novel.csv": (
        b"status," + BASE_HEADER.encode() + b"\n" + b"x" * 2000 + b",1" * 9,
        "a text of more than 1000 characters",
    ),
    "blank.csv": (b"\n\n", "no lines: the file is empty"),
    "ragged.csv": (BASE_HEADER.encode() + b"\n1,2,3\n", "the headings have 9 cells, the rows 3"),
    "quote.csv": (BASE_HEADER.encode() + b'\n"1"2' + b",1" * 8 + b"\n", "not comma-separated"),
    "text.mat": (b"not matlab" * 60, "not a .mat file"),
    "truncated.mat": (MAT_HEAD + struct.pack("<II", 15, 4000) + b"x", "truncated"),
    "no matrix.s2p": (b"hello\n", "no option line"),
    "admittance.s2p": (b"# Hz Y RI R 50\n1 1 0 0 0 0 0 1 0\n", "holds Y-parameters"),
    "short.s2p": (b"# Hz S RI R 50\n1 1 0 0\n2 x\n", "scikit-rf cannot read it"),
}  # fmt: skip


@pytest.mark.parametrize("case", GARBAGE)
def test_garbage_gets_one_clear_message(tmp_path: Path, case: str) -> None:
    content, words = GARBAGE[case]
    path = tmp_path / case.replace(" ", "_")
    path.write_bytes(content)
    with pytest.raises(ExchangeError) as refusal:
        imported(path, **GIVEN)
    assert words in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


def test_touchstone_of_another_number_of_ports_is_refused(tmp_path: Path) -> None:
    (tmp_path / "y.s1p").write_text("# Hz S RI R 50\n1 0.5 0\n2 0.5 0.1\n")
    with pytest.raises(ExchangeError, match="has 1 ports; needed: 2"):
        read_file(tmp_path / "y.s1p", "touchstone", GIVEN)


def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    for name in ("y.csv", "y.mat", "y.s2p"):
        with open(tmp_path / name, "wb") as file:
            file.truncate(20 * 2**30)  # sparse: nothing is on the disk
        with pytest.raises(ExchangeError, match="has 20480 MiB; at most 128 MiB are read"):
            imported(tmp_path / name, **GIVEN)


def test_a_bomb_is_refused_before_it_goes_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchange_mat, "MAX_BYTES", 2**20)
    bomb = zlib.compress(bytes(3 * 2**20))
    (tmp_path / "bomb.mat").write_bytes(MAT_HEAD + struct.pack("<II", 15, len(bomb)) + bomb)
    with pytest.raises(ExchangeError, match="inflates to more than 1 MiB"):
        read_file(tmp_path / "bomb.mat", "mat", GIVEN)


def test_a_bomb_of_version_73_is_refused_before_it_goes_off(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "bomb.mat", "w") as file:
        file.create_dataset("Y", (2**40,), "f4", chunks=(1024,), compression="gzip")  # nothing is on the disk
    with pytest.raises(ExchangeError, match="holds 4194304 MiB; at most 128 MiB"):
        imported(tmp_path / "bomb.mat", **GIVEN)


@pytest.mark.parametrize("kind", ["csv", "mat", "touchstone"])
def test_a_damaged_file_is_read_or_refused_in_one_line(
    damaged: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory, kind: str
) -> None:
    whole, path = damaged[kind], tmp_path_factory.mktemp("damaged") / "y"

    @settings(max_examples=80, deadline=None, derandomize=True)
    @given(place=st.integers(0, len(whole) - 1), put=st.binary(max_size=6))
    def damage(place: int, put: bytes) -> None:
        path.write_bytes(whole[:place] + put + whole[place + len(put) :] if put else whole[:place])
        assert len(complaint(path, kind).splitlines()) <= 1

    damage()


def complaint(path: Path, kind: str) -> str:
    """What is said against a file; anything but a refusal in words is a failure of the test."""
    try:
        to_table(read_file(path, kind, GIVEN), path)
    except ExchangeError as refusal:
        return str(refusal)
    return ""


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Whole files, to be damaged."""
    folder = tmp_path_factory.mktemp("whole")
    table = written(folder / "y.parquet", response(Y))
    content = {}
    for kind in ("csv", "mat", "touchstone"):
        export_table(table, folder / kind, kind)
        content[kind] = (folder / kind).read_bytes()
    return content


# The commands


def test_the_commands_take_a_table_out_and_in_again(tmp_path: Path) -> None:
    table = written(tmp_path / "y.parquet", response(Y))
    for name in ("y.csv", "y.mat", "y.s2p"):
        done = command("export", table, "-o", tmp_path / name)
        assert done.returncode == 0, done.stderr
        done = command("import", tmp_path / name, "-o", tmp_path / f"{name}.parquet")
        assert done.returncode == 0, done.stderr
        assert "read as admittance in pn, load direction, f1 = 49.97 Hz" in done.stdout
        assert command("validate", tmp_path / f"{name}.parquet").returncode == 0
    done = command("tune", tmp_path / "y.csv.parquet", "--grid", "0.012+0.25j", "--confirm")
    assert done.returncode == 2
    assert "recordings and imports cannot be confirmed" in done.stderr


WRONG_CALLS = {
    "suffix": (["export", "{table}", "-o", "{folder}/y.xyz"], "its suffix says no format"),
    "format": (["export", "{table}", "-o", "{folder}/y.csv", "--format", "xls"], "known are csv, mat, touchstone"),
    "exists": (["export", "{table}", "-o", "{table}", "--format", "csv"], "exists; --force replaces it"),
    "point": (["export", "{table}", "-o", "{folder}/y.mat", "--op", "p9"], "no operating point 'p9'"),
    "frame": (["export", "{table}", "-o", "{folder}/y.csv", "--frame", "abc"], "known are pn and dq"),
    "dq": (["export", "{table}", "-o", "{folder}/y.s2p", "--frame", "dq"], "no negative frequencies"),
    "z0": (["export", "{table}", "-o", "{folder}/y.s2p", "--z0", "-1"], "needed: a number above 0, in ohm"),
    "no file": (["import", "{folder}/none.csv", "-o", "{folder}/z.parquet"], "no such file"),
    "folder": (["import", "{folder}", "-o", "{folder}/z.parquet", "--format", "csv"], "is a folder"),
}


@pytest.mark.parametrize("case", WRONG_CALLS)
def test_a_wrong_call_leaves_nothing_behind(tmp_path: Path, case: str) -> None:
    arguments, words = WRONG_CALLS[case]
    table = written(tmp_path / "y.parquet", response(Y))
    done = command(*(argument.format(table=table, folder=tmp_path) for argument in arguments))
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["y.parquet"]
