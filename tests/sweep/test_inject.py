"""Perturbations as files: the waveforms are the plan's, every format says the same, the manifest tells the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import comtrade
import numpy as np
import pytest

from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.playback.comtrade import AnalogChannel, write_comtrade
from seqsweep.sweep.playback.inject import InjectError, Timing, chosen, inject, planned
from seqsweep.sweep.playback.manifest import Manifest, manifest_violations
from seqsweep.sweep.playback.waveform_files import phases

from ..support.commands import campaign, command

RATE_HZ = 5000.0
TIMING = Timing(RATE_HZ, quiet_s=0.2, settle_s=0.1, windows=1)
F_HZ = [20.0, 75.5, 100.0, 130.0]
EXTERNAL = {"id": "external", "parameters": {"f1_hz": 49.97, "rated_voltage_v": 33e3, "rated_power_va": 50e6}}


def config(plant: dict[str, Any] | None = None, **changes: Any) -> Config:
    return Config.from_dict(
        {
            "campaign": {"name": "play"},
            "plant": plant or {"id": "branch-v1"},
            "operating_point": [{"id": "p1", "active_power_mw": 0.1, "terminal_voltage_pu": 1.0}],
            "sweep": {"f_hz": F_HZ},
            "injection": {"amplitude_pu": 0.01},
            **changes,
        }
    )


def played(folder: Path, kind: Any, timing: Timing = TIMING, encoding: Any = "BINARY", **changes: Any) -> Manifest:
    plan, plant = planned(config(**changes), timing)
    return inject(plan, plant, chosen(plan, None), folder, kind, timing, encoding)


def columns(path: Path) -> np.ndarray:
    """Time and phases of a CSV."""
    return np.loadtxt(path, delimiter=",", skiprows=1)


def vector(abc: np.ndarray) -> np.ndarray:
    """Space vector of three phases, by its definition."""
    return 2.0 / 3.0 * abc @ np.exp(2j * np.pi * np.arange(3) / 3.0)


# Waveforms


def test_the_phases_of_a_forward_vector_follow_one_another() -> None:
    angle = np.linspace(0.0, 6.0, 7)
    abc = phases(3.0 * np.exp(1j * angle))
    third = 2.0 * np.pi / 3.0
    expected = 3.0 * np.cos(np.stack([angle, angle - third, angle + third], axis=1))
    np.testing.assert_allclose(abc, expected, atol=1e-14)


def test_every_experiment_holds_its_tone_at_its_frequency_and_nothing_else(tmp_path: Path) -> None:
    """Seen with a plain Fourier sum over the stretch that the manifest names."""
    manifest = played(tmp_path, "csv")
    data = columns(tmp_path / "shot_000.csv")
    x = vector(data[:, 1:])
    assert [shot.f_hz for one in manifest.experiments for shot in one.shots] == sorted(F_HZ * 2)
    for experiment in manifest.experiments:
        (shot,) = experiment.shots
        first = round((experiment.start_s + experiment.settle_s) * RATE_HZ)
        n = round(experiment.duration_s * RATE_HZ)
        t = data[first : first + n, 0]
        for f_hz in {shot.injected_hz, 2.0 * manifest.f1_hz - shot.injected_hz}:
            phasor = np.mean(x[first : first + n] * np.exp(-2j * np.pi * f_hz * t))
            expected = shot.amplitude * np.exp(1j * shot.phase_rad) if f_hz == shot.injected_hz else 0.0
            assert abs(phasor - expected) < 1e-8 * shot.amplitude  # ten digits in the file


def test_amplitudes_are_peaks_over_the_rated_peak(tmp_path: Path) -> None:
    manifest = played(tmp_path, "csv", plant=EXTERNAL)
    assert manifest.experiments[0].shots[0].amplitude == pytest.approx(0.01 * np.sqrt(2.0 / 3.0) * 33e3, rel=1e-12)
    weak = {"kind": "thevenin", "r_ohm": 0.1, "x_ohm": 1.0}
    manifest = played(
        tmp_path, "csv", plant=EXTERNAL, injection={"kind": "shunt_current", "amplitude_pu": 0.01}, source=weak
    )
    rated_peak_a = np.sqrt(2.0) * 50e6 / (np.sqrt(3.0) * 33e3)
    assert manifest.experiments[0].shots[0].amplitude == pytest.approx(0.01 * rated_peak_a, rel=1e-12)
    assert (tmp_path / "shot_000.csv").read_text().startswith("time [s],ia [A],ib [A],ic [A]\n")


def test_a_file_begins_in_silence_and_sums_to_zero(tmp_path: Path) -> None:
    played(tmp_path, "csv")
    data = columns(tmp_path / "shot_000.csv")
    np.testing.assert_array_equal(data[: round(0.2 * RATE_HZ), 1:], 0.0)
    np.testing.assert_allclose(data[:, 1:].sum(axis=1), 0.0, atol=1e-8)
    np.testing.assert_allclose(data[:, 0], np.arange(len(data)) / RATE_HZ, rtol=1e-9)


def test_windows_hold_whole_periods_of_everything(tmp_path: Path) -> None:
    """Of the tone and of f1, whatever f1 is: coherent windows need no taper."""
    manifest = played(tmp_path, "csv", plant=EXTERNAL, sweep={"f_min_hz": 5.0, "f_max_hz": 400.0, "points": 6})
    for experiment in manifest.experiments:
        for f_hz in (experiment.shots[0].injected_hz, manifest.f1_hz):
            cycles = f_hz * experiment.duration_s
            assert abs(cycles - round(cycles)) < 1e-9 * max(1.0, abs(cycles))


def test_a_broadband_signal_is_four_experiments_that_tell_every_row_apart(tmp_path: Path) -> None:
    """Along d and q, with both signs; heard with a plain Fourier sum, the 2x2 of excitations is far from singular."""
    injection = {"signal": "multisine", "amplitude_pu": 0.01}
    band = {"f_min_hz": 10.0, "f_max_hz": 300.0, "points": 8}
    manifest = played(tmp_path, "csv", injection=injection, sweep=band)
    data = columns(tmp_path / "shot_000.csv")
    x = vector(data[:, 1:])
    assert len(manifest.experiments) == 4
    assert np.abs(x).max() <= 0.01 * np.sqrt(2.0 / 3.0) * manifest.rated_voltage_v * 1.01  # amplitude_pu is its peak
    heard = []
    for experiment in manifest.experiments:
        first = round((experiment.start_s + experiment.settle_s) * RATE_HZ)
        part = slice(first, first + round(experiment.duration_s * RATE_HZ))
        heard.append(
            {
                shot.injected_hz: np.mean(x[part] * np.exp(-2j * np.pi * shot.injected_hz * data[part, 0]))
                for shot in experiment.shots
            }
        )
        for shot in experiment.shots:
            expected = shot.amplitude * np.exp(1j * shot.phase_rad)
            assert abs(heard[-1][shot.injected_hz] - expected) < 1e-6 * shot.amplitude
    for f_hz in {shot.f_hz for shot in manifest.experiments[0].shots}:
        pairs = [[one[f_hz], np.conj(one[100.0 - f_hz])] for one in (heard[0], heard[2])]
        assert np.linalg.cond(pairs) < 1.001
    assert manifest_violations(json.loads((tmp_path / "manifest.json").read_text())) == []


def test_an_adaptive_grid_cannot_be_played() -> None:
    band = {"f_min_hz": 10.0, "f_max_hz": 300.0, "points": 30, "spacing": "adaptive"}
    with pytest.raises(InjectError, match="asks on from what it has heard"):
        planned(config(sweep=band), TIMING)


def test_a_branch_that_is_fed_from_the_files_has_its_own_admittance(tmp_path: Path) -> None:
    """An R-L branch in the state space of scipy, the fundamental added, listened to where the manifest says."""
    from scipy.signal import lfilter

    r_ohm, l_h, rate_hz = 0.5, 2e-3, 20_000.0
    timing = Timing(rate_hz, quiet_s=0.1, settle_s=0.1, windows=1)
    manifest = played(tmp_path, "csv", timing, sweep={"f_hz": [20.0, 76.0, 130.0]})
    data = columns(tmp_path / "shot_000.csv")
    t, v = data[:, 0], 500.0 * np.exp(2j * np.pi * 50.0 * data[:, 0]) + vector(data[:, 1:])
    half = 0.5 / rate_hz
    gain = [half / (l_h + r_ohm * half)] * 2  # trapezoidal rule: 1e-4 at 130 Hz and 20 kHz
    i = lfilter(gain, [1.0, -(l_h - r_ohm * half) / (l_h + r_ohm * half)], v)
    for experiment in manifest.experiments:
        (shot,) = experiment.shots
        first = round((experiment.start_s + experiment.settle_s) * rate_hz)
        part = slice(first, first + round(experiment.duration_s * rate_hz))
        turn = np.exp(-2j * np.pi * shot.injected_hz * t[part])
        y = np.sum(i[part] * turn) / np.sum(v[part] * turn)
        expected = 1.0 / (r_ohm + 2j * np.pi * shot.injected_hz * l_h)
        assert abs(y - expected) < 1e-3 * abs(expected)


# Formats


COUNTS = {"ASCII": 99_998, "BINARY": 32_767, "BINARY32": 2**31 - 1, "FLOAT32": 2**23}
REVISION = {"ASCII": "1999", "BINARY": "1999", "BINARY32": "2013", "FLOAT32": "2013"}


@pytest.mark.parametrize("encoding", COUNTS)
def test_comtrade_is_read_by_a_reader_we_did_not_write(tmp_path: Path, encoding: str) -> None:
    played(tmp_path, "csv")
    expected = columns(tmp_path / "shot_000.csv")
    played(tmp_path, "comtrade", encoding=encoding)
    record = comtrade.load(str(tmp_path / "shot_000.cfg"))
    assert (record.ft, record.rev_year, record.frequency) == (encoding, REVISION[encoding], 50.0)
    assert record.cfg.sample_rates == [[RATE_HZ, len(expected)]]
    assert record.analog_channel_ids == ["va", "vb", "vc"]
    assert [channel.uu for channel in record.cfg.analog_channels] == ["V"] * 3
    np.testing.assert_allclose(record.time, expected[:, 0], atol=1e-9)
    step = np.abs(expected[:, 1:]).max() / COUNTS[encoding]
    # half a count, and the ten digits of the text it is held against
    np.testing.assert_allclose(np.array(record.analog).T, expected[:, 1:], atol=0.51 * step + 1e-9)


@pytest.mark.parametrize("encoding", ["ASCII", "BINARY", "FLOAT32"])
def test_a_combined_file_is_read_by_a_reader_we_did_not_write(tmp_path: Path, encoding: Any) -> None:
    samples = np.array([[0.0, 1.0], [3.0, -2.0], [-1.5, 0.25]])
    channels = [AnalogChannel("va", "A", "V"), AnalogChannel("ia", "A", "A")]
    write_comtrade(tmp_path / "x.cff", channels, samples, 1000.0, 50.0, encoding)
    record = comtrade.load(str(tmp_path / "x.cff"))
    np.testing.assert_allclose(np.array(record.analog).T, samples, atol=5e-5)  # 3 V in 32767 counts
    assert record.analog_channel_ids == ["va", "ia"]


def test_comtrade_refuses_what_it_cannot_hold(tmp_path: Path) -> None:
    channels = [AnalogChannel("va", "A", "V")]
    with pytest.raises(ValueError, match="no number for NaN"):
        write_comtrade(tmp_path / "x.cfg", channels, np.array([[np.nan]]), 1e3, 50.0)
    with pytest.raises(ValueError, match="for 1 channels"):
        write_comtrade(tmp_path / "x.cfg", channels, np.zeros((3, 2)), 1e3, 50.0)
    with pytest.raises(ValueError, match="time stamps"):
        write_comtrade(tmp_path / "x.cfg", channels, np.zeros((5000, 1)), 1.0, 50.0)
    assert list(tmp_path.iterdir()) == []


def test_pscad_gets_a_comment_then_time_and_kilovolts(tmp_path: Path) -> None:
    """Its File Read wants a first line that is a comment, time in s from zero, and carries kV on its wires."""
    played(tmp_path, "csv")
    expected = columns(tmp_path / "shot_000.csv")
    played(tmp_path, "pscad")
    lines = (tmp_path / "shot_000.txt").read_text().splitlines()
    assert lines[0].startswith("! time [s], va, vb, vc [kV]")
    data = np.array([line.split() for line in lines[1:]], dtype=float)
    assert data[0, 0] == 0.0
    np.testing.assert_allclose(data[:, 1:], 1e-3 * expected[:, 1:], atol=1e-12)


def test_simulink_gets_one_matrix_with_time_in_its_first_row(tmp_path: Path) -> None:
    from scipy.io import loadmat

    played(tmp_path, "csv")
    expected = columns(tmp_path / "shot_000.csv")
    played(tmp_path, "mat")
    content = {name: value for name, value in loadmat(tmp_path / "shot_000.mat").items() if name[0] != "_"}
    assert list(content) == ["perturbation"]  # From File takes the only variable of a file
    np.testing.assert_allclose(content["perturbation"].T, expected, atol=1e-8)


# Schedule and manifest


def test_long_campaigns_are_cut_into_files_that_keep_pairs_together(tmp_path: Path) -> None:
    manifest = played(tmp_path, "mat", TIMING._replace(longest_s=2.0))
    files: dict[str, list[float]] = {}
    for experiment in manifest.experiments:
        files.setdefault(experiment.file, []).append(experiment.shots[0].f_hz)
    assert len(files) > 1
    assert all(len(f) % 2 == 0 and f[0::2] == f[1::2] for f in files.values())
    assert sorted(files) == sorted(path.name for path in tmp_path.glob("*.mat"))
    assert len({e.file for e in played(tmp_path, "mat", TIMING._replace(longest_s=0.0)).experiments}) == len(F_HZ)


def test_the_manifest_conforms_and_takes_what_its_reader_adds(tmp_path: Path) -> None:
    manifest = played(tmp_path, "mat")
    data = json.loads((tmp_path / "manifest.json").read_text())
    assert data == json.loads(json.dumps(manifest.to_dict()))
    assert data["configuration"]["sweep"]["f_hz"] == F_HZ
    assert manifest_violations(data) == []
    data["experiments"][0]["recording"] = "answer.cfg"
    assert manifest_violations({**data, "direction": "generator"}) == []


def test_the_same_campaign_gives_the_same_bytes(tmp_path: Path) -> None:
    for kind in ("csv", "comtrade", "pscad", "mat"):
        contents = []
        for name in ("one", "two"):
            folder = tmp_path / f"{kind}-{name}"
            folder.mkdir()
            played(folder, kind)
            contents.append({path.name: path.read_bytes() for path in folder.iterdir()})
        assert contents[0] == contents[1]


def broken(data: dict[str, Any], *keys: Any, value: Any) -> dict[str, Any]:
    copy = json.loads(json.dumps(data))
    inner = copy
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return copy


BROKEN: dict[str, tuple[tuple[Any, ...], Any, str]] = {
    "format": (("format",), "x", "'seqsweep-manifest' was expected"),
    "unit": (("amplitude_unit",), "A", "amplitudes of a series_voltage in A; needed: V"),
    "path": (("experiments", 0, "file"), "../shot.csv", "does not match"),
    "mirror": (("experiments", 0, "shots", 0, "injected_hz"), 30.0, "neither 20 Hz nor its mirror 80 Hz"),
    "rate": (("sample_rate_hz",), 200.0, "not below half the sample rate, 100 Hz"),
    "order": (("experiments", 1, "start_s"), 0.0, "experiment 1 begins at 0 s, before the last one ends"),
    "duration": (("experiments", 0, "duration_s"), 0.0, "is less than or equal to the minimum"),
    "extra": (("colour",), "red", "'colour' was unexpected"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_manifest_is_refused_with_the_reason(tmp_path: Path, case: str) -> None:
    keys, value, words = BROKEN[case]
    played(tmp_path, "mat")
    data = broken(json.loads((tmp_path / "manifest.json").read_text()), *keys, value=value)
    assert any(words in violation for violation in manifest_violations(data))


# Refusals and the command


def test_a_device_that_is_elsewhere_needs_its_three_numbers() -> None:
    with pytest.raises(InjectError, match="takes the parameters f1_hz, rated_voltage_v, rated_power_va; given: f1_hz"):
        planned(config({"id": "external", "parameters": {"f1_hz": 50.0}}), TIMING)
    wrong = {**EXTERNAL["parameters"], "f1_hz": "50"}  # type: ignore[dict-item]
    with pytest.raises(InjectError, match="f1_hz is '50'; needed: a number above 0"):
        planned(config({"id": "external", "parameters": wrong}), TIMING)
    _, plant = planned(config(EXTERNAL), TIMING)
    with pytest.raises(InjectError, match="cannot be driven from here"):
        plant.run([], 1)


def test_a_rate_that_cannot_hold_the_tones_is_refused() -> None:
    with pytest.raises(InjectError, match="the highest is 130 Hz: ten samples per period are 1300 Hz"):
        planned(config(), TIMING._replace(rate_hz=250.0))
    with pytest.raises(InjectError, match=r"fewer than 4 samples per period of 49\.97 Hz"):
        planned(config(EXTERNAL), TIMING._replace(rate_hz=150.0))
    with pytest.raises(InjectError, match="--windows 0; needed"):
        planned(config(), TIMING._replace(windows=0))


def test_the_command_writes_files_and_says_how_many(tmp_path: Path) -> None:
    path = campaign(tmp_path, powers=(0.1, 0.2), n=3)
    out = tmp_path / "out"
    common = ("--format", "comtrade", "--rate", "5000", "--settle", "0.1")
    done = command("inject", path, "-o", out, *common)
    assert done.returncode == 2
    assert "choose with --op ID: p0, p1" in done.stderr
    assert not out.exists()
    done = command("inject", path, "-o", out, *common, "--op", "p1")
    assert done.returncode == 0, done.stderr
    assert "p1, 6 experiments in 1 file" in done.stdout
    assert sorted(file.name for file in out.iterdir()) == ["manifest.json", "shot_000.cfg", "shot_000.dat"]
    done = command("inject", path, "-o", out, *common, "--op", "p1")
    assert done.returncode == 2
    assert "exists; --force writes over it" in done.stderr
    elsewhere = [
        'plant.id="external"',
        "plant.parameters={f1_hz = 60.0, rated_voltage_v = 400.0, rated_power_va = 1e4}",
    ]
    settings = [each for setting in elsewhere for each in ("--set", setting)]
    done = command("inject", path, "-o", out, *common, "--op", "p0", "--force", *settings)
    assert done.returncode == 0, done.stderr
    assert json.loads((out / "manifest.json").read_text())["f1_hz"] == 60.0


def test_force_removes_the_files_of_the_earlier_run_and_no_others(tmp_path: Path) -> None:
    path, out = campaign(tmp_path, n=3), tmp_path / "out"
    common = ("--rate", "5000", "--settle", "0.1", "--longest", "0")
    assert command("inject", path, "-o", out, "--format", "comtrade", *common).returncode == 0
    earlier = json.loads((out / "manifest.json").read_text())
    names = ["../outside.csv", "../shot_000.csv", "notes.csv", "..", "shot_000.cfg/x.csv", 7, None]
    earlier["experiments"] += [{"file": name} for name in names] + [{}, "x"]
    (out / "manifest.json").write_text(json.dumps(earlier))
    kept = [tmp_path / "outside.csv", tmp_path / "shot_000.csv", out / "notes.csv", out / "shot_000.dat.bak"]
    for each in [*kept, out / "shot_777.cfg"]:
        each.write_text("mine")
    done = command("inject", path, "-o", out, "--format", "mat", *common, "--force")
    assert done.returncode == 0, done.stderr
    assert all(each.read_text() == "mine" for each in kept)
    written = {each["file"] for each in json.loads((out / "manifest.json").read_text())["experiments"]}
    assert {each.name for each in out.iterdir()} == {
        *written,
        "manifest.json",
        "notes.csv",
        "shot_000.dat.bak",
        "shot_777.cfg",
    }


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"format": "other", "experiments": [{"file": "shot_900.csv"}]}'])
def test_a_manifest_of_something_else_removes_nothing(tmp_path: Path, content: str) -> None:
    (tmp_path / "manifest.json").write_text(content)
    (tmp_path / "shot_900.csv").write_text("mine")
    played(tmp_path, "mat")
    assert (tmp_path / "shot_900.csv").read_text() == "mine"


def test_a_campaign_for_a_device_elsewhere_is_not_run(tmp_path: Path) -> None:
    path = campaign(tmp_path, plant="external")
    done = command("run", path, "-o", tmp_path / "y.parquet")
    assert done.returncode == 2
    assert "cannot be driven from here; seqsweep inject writes files" in done.stderr


WRONG_CALLS = {
    "format": (["--format", "wav"], "known are csv, comtrade, pscad, mat"),
    "encoding": (["--format", "comtrade", "--encoding", "GREY"], "known are ASCII, BINARY, BINARY32 and FLOAT32"),
    "rate": (["--format", "csv", "--rate", "nan"], "--rate nan; needed: a finite number"),
    "settle": (["--format", "csv", "--settle", "-1"], "--settle -1; needed: a finite number of at least 0"),
    "point": (["--format", "csv", "--op", "p9"], "no operating point 'p9' in the campaign; it has p0"),
}


@pytest.mark.parametrize("case", WRONG_CALLS)
def test_a_wrong_call_writes_nothing(tmp_path: Path, case: str) -> None:
    arguments, words = WRONG_CALLS[case]
    done = command("inject", campaign(tmp_path), "-o", tmp_path / "out", *arguments)
    assert done.returncode == 2
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
