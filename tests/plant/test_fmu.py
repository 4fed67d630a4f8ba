"""FMUs of our own: as the device they hold, in every kind of snapshot; bad ones; and archives that lie in wait."""

from __future__ import annotations

import json
import os
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.check import check_plant
from seqsweep.plant.fmu import archive as fmu_archive
from seqsweep.plant.fmu.archive import ArchiveError, look_through, unpack
from seqsweep.plant.fmu.device import fmu_plant
from seqsweep.plant.fmu.instance import FmuFault
from seqsweep.plant.protocol import Injection, Job, OperatingPoint, Source, Tone

from ..support import step_plants
from ..support.commands import campaign, ended
from ..support.fmus import PARAMETERS, description, fmu
from ..support.sweeps import swept

POINT = OperatingPoint(0.4e6, 690.0)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A function from defines to the FMU that was built with them."""
    folder = tmp_path_factory.mktemp("fmus")

    def build(*defines):
        return fmu(folder, *defines, name=f"{'-'.join(defines) or 'plain'}.fmu")

    return build


def toml(**parameters):
    """[plant.parameters] of a campaign."""
    lines = [f"{key} = {written(value)}" for key, value in {**PARAMETERS, **parameters}.items()]
    return "\n".join(["[plant.parameters]", *lines])


def written(value):
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {written(inner)}' for key, inner in value.items())} }}"
    return json.dumps(value)


def failed(plant):
    return {finding.name for finding in check_plant(plant) if not finding.passed}


# The device


@pytest.mark.parametrize(
    ("defines", "snapshot"),
    [(["STATE"], "auto"), (["STATE"], "fork"), ([], "cold"), (["HIDDEN"], "auto"), (["FMI3", "STATE"], "auto")],
)
def test_an_fmu_keeps_the_promise_of_a_plant_however_it_is_branched(built, defines, snapshot):
    assert failed(fmu_plant(str(built(*defines)), **PARAMETERS, snapshot=snapshot)) == set()


def test_hidden_statics_are_no_matter_for_a_fork_and_found_out_without_it(built):
    """Two instances in one process share the statics: the check sees it."""
    assert failed(fmu_plant(str(built("HIDDEN")), **PARAMETERS, snapshot="cold")) & {"repeatable", "neighbours"}


ARRAYS = {"voltage": ["v_abc"], "current": ["i_abc"]}
TWO_PHASES = {"voltage": ["v_alpha", "v_beta"], "current": ["i_alpha", "i_beta"]}


@pytest.mark.parametrize(
    ("defines", "twin", "change"),
    [
        pytest.param(["STATE"], step_plants.branch, {}, marks=pytest.mark.evidence),
        ([], step_plants.branch, {}),
        (["STATE"], step_plants.branch, TWO_PHASES),
        (["FMI3", "STATE"], step_plants.branch, ARRAYS),
        pytest.param(["FMI3"], step_plants.branch, {}, marks=pytest.mark.evidence),
        (["FMI3", "CONVERTER", "STATE"], step_plants.converter, {"voltage": ["v_abc"]}),
        pytest.param(["CONVERTER", "STATE"], step_plants.converter, {}, marks=pytest.mark.evidence),
        (["CONVERTER"], step_plants.converter, {"current": TWO_PHASES["current"]}),
    ],
)
def test_an_fmu_gives_the_samples_of_its_twin_in_python(built, defines, twin, change):
    """Another text of the same device; rounding is all that differs, through a settled controller."""
    plants = [fmu_plant(str(built(*defines)), **{**PARAMETERS, **change}), twin()]
    tone = Injection("series_voltage", (Tone(-70.0, 5.0, 0.2),))
    records = [plant.run([Job(plant.settle(POINT, Source()), tone)], 900)[0][1] for plant in plants]
    assert records[0].t0_s == records[1].t0_s  # both took as long to settle
    assert np.max(np.abs(records[0].i - records[1].i)) <= 1e-8 * np.max(np.abs(records[1].i))


def test_units_and_direction_are_those_of_the_campaign(built):
    path = str(built("STATE"))
    plain = fmu_plant(path, **PARAMETERS)
    turned = fmu_plant(path, **PARAMETERS, current_direction="generator", voltage_unit_v=2.0, current_unit_a=10.0)
    i, other = (p.run([Job(p.settle(POINT, Source()), None)], 400)[0][1].i for p in (plain, turned))
    assert np.max(np.abs(other + 5.0 * i)) <= 1e-6 * np.max(np.abs(i))


@pytest.mark.parametrize("hold", ["start", "mean"])
def test_a_step_told_the_mean_of_its_voltage_makes_the_branch_the_continuous_one(built, hold):
    """R-L of 0.1 ohm and 1 mH at 50 us: with the value at the start, half a step of delay turns Re Y negative."""
    f_hz = np.array([100.0, 300.0, 1000.0])
    y = swept(fmu_plant(str(built("STATE")), **PARAMETERS, hold=hold), f_hz.tolist())[:, 0, 0]
    error = np.abs(y * (0.1 + 2j * np.pi * f_hz * 1e-3) - 1.0)
    print(
        f"\n  hold = {hold}: {', '.join(f'{e:.1e}' for e in error)} at 100, 300, 1000 Hz, Re Y {y.real.min():+.4f} S",
        end="",
    )
    assert (y.real.min() > 0.0) == (hold == "mean")
    assert (error.max() < 1e-3) == (hold == "mean")
    told = np.sinc(f_hz * 50e-6) * np.exp(1j * np.pi * f_hz * 50e-6)  # of a phasor, its mean over a step
    expected = step_plants.admittance(f_hz) * (told if hold == "mean" else 1.0)
    assert np.max(np.abs(y / expected - 1.0)) <= 1e-4


def test_the_sweep_of_an_fmu_is_that_of_its_twin(built):
    f_hz = [20.0, 130.0, 400.0]
    y = [
        swept(plant, f_hz)
        for plant in (
            step_plants.converter(),
            fmu_plant(str(built("CONVERTER", "STATE")), **PARAMETERS),
            fmu_plant(str(built("CONVERTER")), **PARAMETERS),
        )
    ]
    for found in y[1:]:
        assert np.max(np.abs(found - y[0])) <= 1e-6 * np.max(np.abs(y[0]))  # rounding under a small tone
    assert np.max(np.abs(y[0][:, 0, 1])) > 1e-3 * np.max(np.abs(y[0]))  # and it couples


@pytest.mark.parametrize(
    ("defines", "snapshot"),
    [(["STATE"], "state"), (["STATE"], "fork"), (["STATE"], "cold"), (["STATE", "FMI3"], "state")],
)
def test_a_fatal_answer_costs_an_instance_and_the_next_point_gets_another(built, defines, snapshot):
    start = {"start": {"fault": -1.0, "after_s": 0.1}, "snapshot": snapshot}
    plant = fmu_plant(str(built(*defines)), **PARAMETERS, **start)
    for _ in range(2):
        with pytest.raises(FmuFault, match=r"fmi[23]DoStep answered fatal at 0\.1"):
            plant.settle(OperatingPoint(9e6, 690.0), Source())
        assert plant.settle(OperatingPoint(0.0, 690.0), Source()).step > 2000


def test_an_operating_point_that_is_not_told_says_so(built):
    untold = {name: value for name, value in PARAMETERS.items() if name != "active_power"}
    assert fmu_plant(str(built("STATE")), **untold).power_meaning.startswith("not told to the FMU")


def test_the_table_remembers_which_file_it_was(built):
    plant = fmu_plant(str(built("STATE")), **PARAMETERS)
    contents = {"file_sha256": fmu_archive.sha256_of(built("STATE")), "model": "box 3", "held_late_s": 25e-6}
    assert plant.contents == contents


# Bad boxes

FAULTS = {  # in the order of the enum in box_fmu.c: (status, words)
    "errs": ("failed", "fmi2DoStep answered error at 1.5 s; it says: theta left the circle"),
    "prints": ("ok", ""),
    "sleeps": (),  # in a test of its own: no time limit is short for it and long for the others on any machine
    "leaks": ("ok", ""),
    "nans": ("diverged", "the response is not finite"),
    "aborts": ("failed", "died: SIGABRT, last words 'assertion failed: theta < 2 pi'"),
    "segfaults": ("failed", "died: SIGSEGV"),
    "discards": ("failed", "fmi2DoStep answered discard at 1.5 s"),
}


def going_wrong(folder, box, powers, timeout_s, f_hz):
    """A campaign of a box that misbehaves from 1.5 s on, as the powers say."""
    lines = f"timeout_s = {timeout_s}\n" + toml(start={"fault": -1.0, "after_s": 1.49999})
    path = campaign(folder, plant=f"fmu:{box}", plant_lines=lines, powers=powers)
    path.write_text(path.read_text().replace("f_min_hz = 20.0\nf_max_hz = 900.0\npoints = 8", f"f_hz = {f_hz}"))
    return path


@pytest.mark.parametrize(
    ("defines", "faults"),
    [
        pytest.param(["STATE"], [fault for fault, told in FAULTS.items() if told], marks=pytest.mark.evidence),
        ([], ["errs", "nans", "aborts"]),
        (["STATE", "FMI3"], ["errs", "prints", "discards"]),
    ],
    ids=["state", "fork", "FMI 3"],
)
def test_every_bad_box_costs_its_own_points_with_the_reason(tmp_path, built, defines, faults):
    """It goes wrong 1.5 s after its start, differently at each operating point: the window near f1 meets that."""
    powers = [0, *(1 + list(FAULTS).index(fault) for fault in faults)]
    path = going_wrong(tmp_path, built(*defines), powers, 300.0, [45.0, 300.0])
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", env=_environment(tmp_path))
    assert status == 1, said
    assert "Traceback" not in said
    well, *ill = read_table(tmp_path / "y.parquet").responses
    assert well.status.tolist() == ["ok", "ok"], well.reason
    assert np.max(np.abs(well.y[:, 0, 0] / step_plants.admittance(well.f_hz) - 1.0)) <= 1e-4
    for fault, response in zip(faults, ill, strict=True):
        status, words = FAULTS[fault]
        assert response.status.tolist() == [status, "ok"], (fault, response.reason)
        assert words.replace("fmi2", f"fmi{3 if 'FMI3' in defines else 2}") in response.reason[0]
    assert list((tmp_path / "temporary").iterdir()) == []  # what was unpacked went with the run


@pytest.mark.parametrize("defines", [pytest.param(["STATE"], marks=pytest.mark.evidence), []], ids=["state", "fork"])
def test_a_box_that_sleeps_is_ended_by_the_time_limit(tmp_path, built, defines):
    path = going_wrong(tmp_path, built(*defines), [1 + list(FAULTS).index("sleeps")], 0.5, [45.0])
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", env=_environment(tmp_path))
    assert status == 1, said
    (response,) = read_table(tmp_path / "y.parquet").responses
    assert response.status.tolist() == ["failed"]
    assert "4 shots took longer than 2 s of wall time" in response.reason[0]
    assert list((tmp_path / "temporary").iterdir()) == []


def _environment(tmp_path):
    (tmp_path / "temporary").mkdir()
    return {**os.environ, "TMPDIR": str(tmp_path / "temporary")}


# What the campaign says, against the FMU

WRONG = {
    "unknown": ({"voltage": ["v_a", "v_b", "vc"]}, r"voltage: .* has no variable 'vc' \(did you mean 'v_c'\?\)"),
    "output for input": (
        {"voltage": ["v_a", "v_b", "i_c"]},
        "voltage: variable 'i_c' .* is an output; needed: an input",
    ),
    "input for output": (
        {"current": ["v_a", "i_b", "i_c"]},
        "current: variable 'v_a' .* is an input; needed: an output",
    ),
    "four phases": ({"current": ["i_a", "i_b", "i_c", "i_alpha"]}, "current is .*; needed: the names of two variables"),
    "unknown start": ({"start": {"k_pl": 1.0}}, r"start: .* has no variable 'k_pl' \(did you mean 'k_pll'\?\)"),
    "start of an output": ({"start": {"i_a": 1.0}}, "start: variable 'i_a' .* cannot be set at the start"),
    "text for a number": ({"start": {"k_pll": "much"}}, "start: variable 'k_pll' is a Real; given 'much'"),
    "power": ({"active_power": "power"}, "active_power: .* has no variable 'power'"),
    "direction": ({"current_direction": "out"}, "current_direction is 'out'; needed: load, generator"),
    "step": ({"dt_s": 0.0}, "dt_s is 0.0; needed: a finite number above 0"),
    "step in words": ({"dt_s": "50us"}, "dt_s is '50us'; needed: a finite number above 0"),
    "unit": ({"current_unit_a": 0.0}, "current_unit_a is 0.0; needed: a finite number above 0"),
    "twice": ({"voltage": ["v_a", "v_a", "v_c"]}, "voltage is .*; needed: each variable once"),
    "hold": ({"hold": "middle"}, "hold is 'middle'; needed: start, mean"),
    "snapshot": ({"snapshot": "state"}, "cannot get and set its state"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_variable_is_refused_by_name_before_anything_runs(built, case):
    change, words = WRONG[case]
    with pytest.raises(ValueError, match=words):
        fmu_plant(str(built()), **{**PARAMETERS, **change})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (description(interface="ModelExchange"), "FMI 2.0, modelExchange; needed: FMI 2.0 or 3.0 for co-sim"),
        (description().replace('"2.0"', '"3.0"'), "its model description is refused"),
        (description(), r"it has binaries for no platform, this machine is linux64; .* process:COMMAND"),
        ("<fmi", "its model description is refused"),
        (description().replace('name="p_w"', 'name="v_a"'), "its model description is refused"),
    ],
)
def test_an_fmu_that_cannot_be_driven_says_why(tmp_path, text, words):
    pytest.importorskip("fmpy")
    with zipfile.ZipFile(tmp_path / "box.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", text)
    with pytest.raises(ValueError, match=words):
        fmu_plant(str(tmp_path / "box.fmu"), **PARAMETERS)


# Archives


def archive_with(path, name, content=b"", mode=stat.S_IFREG | 0o644):
    """An archive with one member."""
    info = zipfile.ZipInfo("placeholder")
    info.filename = info.orig_filename = name
    info.external_attr = mode << 16
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(info, content, zipfile.ZIP_DEFLATED)
    return path


@pytest.mark.parametrize(
    ("name", "mode", "words"),
    [
        ("../outside", stat.S_IFREG, "leads out of the folder"),
        ("resources/../../outside", stat.S_IFREG, "leads out of the folder"),
        ("/etc/outside", stat.S_IFREG, "leads out of the folder"),
        ("C:/outside", stat.S_IFREG, "leads out of the folder"),
        ("..\\outside", stat.S_IFREG, "leads out of the folder"),
        ("binaries/linux64/box.so", stat.S_IFLNK, "is a link"),
        ("resources/pipe", stat.S_IFIFO, "is a special file"),
    ],
)
def test_a_member_that_leads_elsewhere_is_refused_and_nothing_is_unpacked(tmp_path, name, mode, words):
    path = archive_with(tmp_path / "box.fmu", name, b"/etc/passwd", mode | 0o777)
    (tmp_path / "inside").mkdir()
    with pytest.raises(ArchiveError, match=words):
        unpack(path, tmp_path / "inside")
    assert sorted(file.name for file in tmp_path.rglob("*")) == ["box.fmu", "inside"]


def test_a_bomb_is_refused_before_it_goes_off(tmp_path, monkeypatch):
    path = archive_with(tmp_path / "bomb.fmu", "resources/zeros", bytes(32 << 20))
    with pytest.raises(ArchiveError, match=r"unpacks to \d+ times its size; it looks like a bomb"):
        look_through(path)
    monkeypatch.setattr(fmu_archive, "MOST_BYTES", 1 << 20)
    with pytest.raises(ArchiveError, match="unpacks to 33554432 bytes"):
        look_through(path)
    monkeypatch.setattr(fmu_archive, "MOST_MEMBERS", 0)
    with pytest.raises(ArchiveError, match="1 members"):
        look_through(path)


def test_a_member_that_is_there_twice_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "box.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "one")
        archive.writestr("ModelDescription.xml", "other")
    with pytest.raises(ArchiveError, match="is there twice"):
        look_through(tmp_path / "box.fmu")


def test_what_is_no_archive_is_refused(tmp_path):
    (tmp_path / "text.fmu").write_text("not a zip")
    with pytest.raises(ArchiveError, match="not an FMU"):
        look_through(tmp_path / "text.fmu")
    with pytest.raises(ArchiveError, match="no such file"):
        look_through(Path("nowhere.fmu"))


def test_a_damaged_archive_is_refused(tmp_path, built):
    whole = bytearray(built("STATE").read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    (tmp_path / "damaged.fmu").write_bytes(whole)
    with pytest.raises(ArchiveError, match="cannot be unpacked"):
        unpack(tmp_path / "damaged.fmu", tmp_path / "inside")
