"""What people see of a table: the summary and the Bode plot."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from seqsweep.identify.response import FrequencyResponse
from seqsweep.identify.table.format import TableError
from seqsweep.identify.table.write import write_table
from seqsweep.identify.views import bode as views
from seqsweep.identify.views.bode import MAX_OVERLAID, _without_streaks, bode, bode_figure
from seqsweep.identify.views.style import SUFFIXES
from seqsweep.sweep.report.summary import LISTED_UP_TO, MIN_WIDTH, summary

from ..support import oracle

F_HZ = np.geomspace(1.0, 990.0, 40)
SIGNATURES = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


def response(op_id: str, power_mw: float = 0.65, std: float = np.nan) -> FrequencyResponse:
    """The reference turbine, exact, with the given relative standard deviation; two rows are not ok."""
    y = oracle.admittance_pn(F_HZ, 1e6 * power_mw, 690.0)
    covariance = np.zeros((len(F_HZ), 8, 8))
    covariance[:, range(8), range(8)] = (std * np.abs(y).reshape(-1, 4).repeat(2, axis=1)) ** 2 / 2.0
    covariance[np.isnan(covariance[:, 0, 0])] = np.nan
    status, reason = np.full(len(F_HZ), "ok", dtype="U16"), np.full(len(F_HZ), "", dtype="U64")
    status[3], reason[3], y[3], covariance[3] = "not_settled", "windows differ by 3e-04 after 60 s", np.nan, np.nan
    status[30], reason[30] = "noisy", "standard deviation of 3 % [pp], ä"
    quality = {"residual": np.where(np.arange(40) == 7, 4.2e-6, 1e-7), "cond_v": np.where(np.arange(40) == 9, 8.5, 1.1)}
    return FrequencyResponse(F_HZ, y, 50.0, "pn", covariance, status, reason, quality, {"op_id": op_id})


def table(path: Path, responses: Sequence[FrequencyResponse]) -> Path:
    points = [
        {"op_id": r.meta["op_id"], "active_power_mw": 0.65, "terminal_voltage_pu": 1.0, "settle_residual": 1.3e-12}
        for r in responses
    ]
    meta = {
        "f1_hz": 50.0,
        "bases": {"rated_voltage_v": 690.0, "rated_power_va": 1.632e6},
        "power_meaning": "power of the lossless converters",
        "operating_points": points,
        "configuration": {
            "source": {"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25},
            "injection": {"kind": "series_voltage", "signal": "tone", "amplitude_pu": 0.001},
        },
        "plant": {"id": "dpmsg-v1"},
    }
    write_table(path, responses, meta)
    return path


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return table(tmp_path_factory.mktemp("one") / "one.parquet", [response("p065", std=0.02)])


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty operating points, of which the eighteenth is the worst."""
    shared = response("p00")
    responses = [
        FrequencyResponse(F_HZ, shared.y, 50.0, quality=shared.quality, meta={"op_id": f"p{k:02d}"}) for k in range(20)
    ]
    responses[17] = response("p17")
    return table(tmp_path_factory.mktemp("many") / "many.parquet", [finite(r) for r in responses])


def finite(given: FrequencyResponse) -> FrequencyResponse:
    """Rows that are ok need values."""
    y = np.where(given.ok[:, None, None] & np.isnan(given.y), 1.0, given.y)
    return FrequencyResponse(F_HZ, y, 50.0, "pn", None, given.status, given.reason, given.quality, given.meta)


# The summary


def test_a_summary_says_what_was_measured_and_how_well(one: Path) -> None:
    text = " ".join(summary(one).split())
    for said in (
        "table one.parquet",
        "format seqsweep-admittance 1.1.0, written by seqsweep",
        "plant dpmsg-v1, 690 V, 1.632 MVA",
        "f1 50 Hz",
        "power power of the lossless converters",
        "source thevenin, 0.012 + j 0.25 ohm",
        "injection series_voltage, tone, 0.001 pu",
        "rows 40 of 1 operating point: 38 ok, 1 not_settled, 1 noisy",
        "p065 0.65 MW, 1 pu",
        "band 1 to 990 Hz, 40 points",
        "status 38 ok, 1 not_settled, 1 noisy",
        f"residual worst 4.2e-06 at {F_HZ[7]:.5g} Hz",
        f"cond(V) worst 8.5 at {F_HZ[9]:.5g} Hz",
        "settled to 1.3e-12 over a period",
    ):
        assert said in text


def test_rows_that_are_not_ok_are_shown_with_their_reason_and_place(one: Path) -> None:
    text = " ".join(summary(one).split())
    assert f"1 not_settled windows differ by 3e-04 after 60 s (p065 at {F_HZ[3]:.5g} Hz)" in text
    assert f"(p065 at {F_HZ[30]:.5g} Hz)" in text


@pytest.mark.parametrize("width", [120, 80, 60, 45, MIN_WIDTH])
def test_no_line_is_wider_than_the_terminal(one: Path, many: Path, width: int) -> None:
    for path in (one, many):
        assert max(len(line) for line in summary(path, width).replace(r"\xe4", "a").splitlines()) <= width


def test_a_file_gets_ascii_and_a_terminal_gets_colour(one: Path, many: Path) -> None:
    assert summary(one).isascii()
    assert summary(many).isascii()
    assert r"[pp], \xe4" in summary(one, 120)
    assert "\x1b[1m" in summary(one, plain=False)
    assert "ä" in summary(one, 120, plain=False)


def test_of_many_operating_points_the_worst_are_listed_first(many: Path) -> None:
    text = summary(many)
    assert "rows       800 of 20 operating points: 798 ok, 1 not_settled, 1 noisy" in text
    assert f"the worst {LISTED_UP_TO} of 20 operating points" in text
    lines = text.splitlines()
    listed = [line for line in lines[lines.index(next(x for x in lines if x.startswith("---"))) + 1 :] if line]
    assert listed[0].startswith("p17")


def test_reasons_that_differ_in_their_numbers_are_one_reason(tmp_path: Path) -> None:
    given = response("p065")
    status, reason = np.full(40, "failed"), np.array([f"diverged at {k / 7:.3g} s" for k in range(40)])
    failed = FrequencyResponse(F_HZ, np.full_like(given.y, np.nan), 50.0, status=status, reason=reason, meta=given.meta)
    text = " ".join(summary(table(tmp_path / "y.parquet", [failed])).split())
    assert "40 failed diverged at 0 s (p065 at 1, 1.1935, 1.4244 Hz, ...)" in text
    assert "residual worst unknown" in text


def test_a_name_cannot_write_on_the_terminal(tmp_path: Path) -> None:
    text = summary(table(tmp_path / "y.parquet", [response("p\x1b[2J[red]")]), plain=False)
    assert "\x1b[2J" not in text
    assert "p?[2J[red]" in text


def test_a_summary_needs_no_more_memory_for_more_operating_points(tmp_path: Path) -> None:
    shared = finite(response("p"))
    big = np.tile(shared.y, (500, 1, 1))
    f_hz = np.linspace(1.0, 1000.3, len(big))
    made = [FrequencyResponse(f_hz, big, 50.0, meta={"op_id": f"p{k}"}) for k in range(6)]
    path = table(tmp_path / "y.parquet", made)
    del made
    summary(path)
    tracemalloc.start()
    summary(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    whole = 6 * len(big) * (64 + 4) * 8
    assert peak < whole, "an operating point of this size has a covariance of 64 doubles a row; only some are held"


def test_what_is_not_a_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="no such file"):
        summary(tmp_path / "none.parquet")


# The plot


@pytest.fixture(scope="module")
def drawn(one: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the picture of one operating point in every format."""
    folder = tmp_path_factory.mktemp("drawn")
    assert [bode(one, folder / f"bode{suffix}") for suffix in SUFFIXES] == 3 * [("p065",)]
    return folder


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_suffix_decides_the_format(drawn: Path, suffix: str) -> None:
    assert (drawn / f"bode{suffix}").read_bytes().startswith(SIGNATURES[suffix])
    assert sorted(file.name for file in drawn.iterdir()) == sorted(f"bode{each}" for each in SUFFIXES)


@pytest.mark.parametrize("name", ["bode.jpg", "bode", "bode.png.txt"])
def test_another_suffix_is_refused_and_nothing_is_written(one: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"needed: \.png, \.svg, \.pdf"):
        bode(one, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_an_unknown_operating_point_is_refused_and_nothing_is_written(one: Path, tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"no operating point 'p66' in what is to be drawn; it has p065"):
        bode(one, tmp_path / "bode.png", "p66")
    assert not list(tmp_path.iterdir())


def test_another_frame_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    dq = FrequencyResponse(F_HZ, np.ones((40, 2, 2)), 50.0, "dq", meta={"op_id": "p"})
    with pytest.raises(ValueError, match="pn frame"):
        bode(dq, tmp_path / "bode.png")
    assert not list(tmp_path.iterdir())


def test_the_same_table_gives_the_same_svg(one: Path, drawn: Path, tmp_path: Path) -> None:
    bode(one, tmp_path / "again.svg")
    assert (tmp_path / "again.svg").read_bytes() == (drawn / "bode.svg").read_bytes()


def test_a_plot_names_device_frequencies_and_mirror(drawn: Path) -> None:
    text = (drawn / "bode.svg").read_text(encoding="utf-8")
    for said in ("dpmsg-v1, p065: 0.65 MW, 1 pu", "f (Hz)", "mirror", "Magnitude (S)", "Phase (deg)", "not ok"):
        assert said in text
    assert "95 % interval" in text


def test_few_operating_points_are_overlaid_and_of_many_the_chosen_one_is_drawn(
    many: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The figures themselves: that they are written in every format is seen above."""
    figures: list[Figure] = []
    monkeypatch.setattr(views, "write_figure", lambda path, make: figures.append(make()))
    few = [response(f"p{k}", 0.2 * (k + 1)) for k in range(MAX_OVERLAID)]
    assert bode(few, "few.svg") == tuple(f"p{k}" for k in range(MAX_OVERLAID))
    assert bode(many, "many.svg") == ("p00",)
    assert bode(many, "many.svg", "p17") == ("p17",)
    overlaid, first, chosen = figures
    assert len(overlaid.axes[0].get_lines()) >= MAX_OVERLAID * len(first.axes[0].get_lines()) // 2
    assert "p00" in first.get_suptitle()
    assert "p17" in chosen.get_suptitle()


def test_rows_without_a_value_leave_a_mark_and_a_gap_but_no_line() -> None:
    figure = bode_figure([response("p065")])
    lines = figure.axes[0].get_lines()
    curve, crosses = lines[0], next(line for line in lines if line.get_marker() == "x")
    ticks = next(line for line in lines if line.get_marker() == "|")
    assert np.isnan(np.asarray(curve.get_ydata(), dtype=float)[[3, 30]]).all()
    np.testing.assert_array_equal(crosses.get_xdata(), F_HZ[[30]])
    np.testing.assert_array_equal(ticks.get_xdata(), F_HZ[[3]])


def test_a_table_without_any_value_can_still_be_drawn(tmp_path: Path) -> None:
    y = np.full((40, 2, 2), complex(np.nan, np.nan))
    status, reason = np.full(40, "diverged"), np.full(40, "lost")
    nothing = FrequencyResponse(F_HZ, y, 50.0, status=status, reason=reason, meta={"op_id": "cost$x$"})
    assert bode(nothing, tmp_path / "nothing.png") == ("cost$x$",)
    assert bode(FrequencyResponse([3.0], np.ones((1, 2, 2)), 50.0, meta={"op_id": "one"}), tmp_path / "one.png") == (
        "one",
    )
    for name in ("nothing.png", "one.png"):
        height, width, _ = imread(tmp_path / name).shape
        assert width == pytest.approx(7.16 * 200, abs=2)
        assert height == pytest.approx(7.0 * 200, abs=2)
    magnitude = bode_figure([nothing]).axes[0]
    ticks = next(line for line in magnitude.get_lines() if line.get_marker() == "|")
    np.testing.assert_array_equal(ticks.get_xdata(), F_HZ)  # every row leaves its mark


def test_a_phase_that_wraps_runs_to_the_edge_and_comes_in_on_the_other_side() -> None:
    f, angle = _without_streaks(np.array([1.0, 10.0, 100.0]), np.array([170.0, -170.0, -160.0]))
    np.testing.assert_allclose(angle, [170.0, 180.0, np.nan, -180.0, -170.0, -160.0])
    np.testing.assert_allclose(f, [1.0, 10**0.5, 10**0.5, 10**0.5, 10.0, 100.0])
    f, angle = _without_streaks(np.array([1.0, 10.0]), np.array([-175.0, 165.0]))
    np.testing.assert_allclose(angle, [-175.0, -180.0, np.nan, 180.0, 165.0])
    np.testing.assert_allclose(f[1], 10**0.25)


def test_an_adaptive_table_is_drawn_by_its_interpolation_with_the_rows_as_dots():
    """Ten rows of a narrow peak between them: the line must reach it, the dots must be the rows, f1 stays a gap."""
    f_hz = np.array([1.0, 5.0, 12.0, 20.0, 35.0, 46.0, 54.0, 75.0, 95.0, 140.0, 300.0, 700.0])
    certificate = {"certified": True, "except_within_hz_of_f1": 0.5}

    def y_of(f):
        s = 2j * np.pi * (f - 50.0)
        y = 1.0 / (1.0 + 0.01 * s) + 40.0 * s / (s**2 + 20.0 * s + (2 * np.pi * 23.0) ** 2)
        return y[:, None, None] * np.array([[1.0, 0.1], [0.1, 1.0]])

    meta = {"op_id": "a", "interpolation": certificate}
    response = FrequencyResponse(f_hz, y_of(f_hz), 50.0, covariance=np.tile(1e-18 * np.eye(8), (12, 1, 1)), meta=meta)
    axes = bode_figure([response]).axes[0]
    line, dots = axes.get_lines()[:2]
    f, size = (np.asarray(x, dtype=float) for x in (line.get_xdata(), line.get_ydata()))
    finite = np.isfinite(size)
    np.testing.assert_allclose(size[finite], np.abs(y_of(f[finite])[:, 0, 0]), rtol=1e-3)
    assert np.max(size[finite]) > 1.2 * np.max(np.abs(y_of(f_hz)[:, 0, 0]))  # the peak stands between the rows
    assert np.all(np.abs(f[~finite] - 50.0) < 0.5)
    np.testing.assert_array_equal(dots.get_xdata(), f_hz)


def test_the_mirror_axis_holds_no_rounding():
    f1_hz = 50.00000000000039
    response = FrequencyResponse(np.array([1.0, 10.0, 100.0, 900.0]), np.ones((4, 2, 2)), f1_hz, meta={"op_id": "a"})
    figure = bode_figure([response])
    texts = [text.get_text() for child in figure.axes[0].child_axes for text in child.get_xticklabels()]
    assert "0" in texts
    assert not any("e" in text for text in texts)
