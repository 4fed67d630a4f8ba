"""A controller as an FMU in the turbine's circuit: the same bytes as the library of the same source, in every version.

The library is held against the turbine and its own exact linearisation in `test_grey`; what is held against those
here besides is the path of the FMU through a whole sweep.
"""

from __future__ import annotations

import shutil
import time
from math import nan
from pathlib import Path

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table
from seqsweep.plant.check import check_plant
from seqsweep.plant.controllers.interface import ControllerFault
from seqsweep.plant.fmu.instance import FmuFault
from seqsweep.plant.greybox.turbine import GreyTurbine
from seqsweep.plant.protocol import Job, NotSettled, Source, Window
from seqsweep.plant.registry import PlantError, make_plant
from seqsweep.plant.states.forks import BoxDied, Forks
from seqsweep.plant.states.stores import Snapshots

from ..support import oracle
from ..support.commands import command, ended
from ..support.controllers import INPUTS, INPUTS_2, OUTPUTS, OUTPUTS_2, alone_us, build, build_fmu, needs_compiler
from ..sweep.test_accuracy import IN_PLACE, P_MW, U_V, relative, report, swept
from .test_grey import BAND, FEW, POINT, TONE, answers, linearised, time_of_example

pytestmark = needs_compiler

VERSIONS = [("STATE",), ("FMI3", "STATE")]


def plant(*switches, inputs=None, outputs=None, **parameters):
    """The FMU in the circuit; FMI 3.0 has arrays of three phases."""
    maps = (INPUTS, OUTPUTS) if "FMI3" in switches else (INPUTS_2, OUTPUTS_2)
    return GreyTurbine(f"fmu:{build_fmu(*switches)}", inputs or maps[0], outputs or maps[1], **parameters)


def library(*switches, **parameters):
    return GreyTurbine(f"cigre:{build(*switches)}", INPUTS, OUTPUTS, **parameters)


# ---------------------------------------------------------------------- against the turbine, and the library


@pytest.mark.parametrize("version", VERSIONS, ids=["FMI 2.0", "FMI 3.0"])
def test_controls_in_an_fmu_stepped_every_20_us_are_the_turbine(version):
    """The bar asked of a library or an FMU, 1e-3; what is left is the hold between samples."""
    f_hz, y = swept(plant(*version), FEW)
    error = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))
    report(f"20 us, {version[0]}", error, f_hz, 1e-3)
    assert error.max() <= 1e-3


@pytest.mark.parametrize(
    ("step_s", "delay"), [*(pytest.param(s, 0, marks=pytest.mark.evidence) for s in (20e-6, 50e-6)), (100e-6, 1)]
)
def test_a_sweep_is_the_exact_linearisation_of_the_sampled_model(step_s, delay):
    """Jacobians of the same sampled controls as a library, whose states can be moved; the bar is 1e-4."""
    settings, switch = {"Lead": 0.5 + delay}, f"SAMPLE_TIME_S={step_s}"
    device = plant("STATE", switch, sample_time_s=step_s, delay_samples=delay, settings=settings)
    f_hz, y = swept(device, FEW)
    twin = library(switch, delay_samples=delay, settings=settings)
    error = relative(y, linearised(twin, f_hz))
    report(f"FMU, {step_s:g} s, delay {delay}", error, f_hz, 1e-4)
    assert error.max() <= 1e-4


@pytest.mark.evidence
def test_sweeps_of_an_fmu_over_the_whole_band_are_the_turbine_and_the_sampled_model():
    for version in VERSIONS:
        for in_place in (False, True):
            f_hz, y = swept(plant(*version), BAND, source=IN_PLACE if in_place else None)
            error = relative(y, oracle.admittance_pn(f_hz, P_MW * 1e6, U_V))
            report(f"{version[0]}, {'behind the line' if in_place else 'ideal source'}", error, f_hz, 1e-3)
            assert error.max() <= 1e-3
            if not in_place:
                own = relative(y, linearised(library(), f_hz))
                print(f"; {own.max():.1e} from its own linearisation", end="")
                assert own.max() <= 1e-4


def test_every_version_and_every_way_to_branch_gives_the_bytes_of_the_library():
    """Records and phasors of jobs that branch, go on and come back."""
    expected = answers(library())
    for switches, snapshot in [
        (("STATE",), "auto"),
        (("FMI3", "STATE"), "auto"),
        (("STATE",), "fork"),
        (("STATE",), "copy"),
        (("FMI3",), "auto"),
    ]:
        found = answers(plant(*switches, snapshot=snapshot))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(expected, found, strict=True)), (switches, snapshot)


def test_a_controller_whose_outputs_cannot_be_set_begins_cold_and_settles_to_the_same_state():
    """Without the first command the current starts with a blow; sweeps of both agree to their own tolerance of 1e-5."""
    told, cold = plant("STATE"), plant("STATE", "COLD")
    (told_y, cold_y) = (swept(device, {"f_hz": [20.0, 150.0]})[1] for device in (told, cold))
    assert np.max(np.abs(cold_y / told_y - 1.0)) <= 1e-5
    first = [
        device._core.run([Job(device._core._start(0.65e6, U_V, Source()), None)], 50)[0][1] for device in (told, cold)
    ]
    assert np.max(np.abs(first[1].i - first[0].i)) > 0.1 * np.max(np.abs(first[0].i))


def test_settings_of_whole_numbers_reach_the_fmu():
    """The delay is the controls' own, an Integer that is set before the start."""
    settings = {"Delay": 1, "Lead": 1.5}
    ours, theirs = plant("STATE", settings=settings), library(settings=settings)
    records = [device.run([Job(device.settle(POINT, Source()), TONE)], 400)[0][1] for device in (ours, theirs)]
    assert records[0].i.tobytes() == records[1].i.tobytes()


PYTHON_CONTROLLER = Path(__file__).parents[1] / "support" / "boxes" / "python_controller.py"


def exported(folder, exporter):
    """The same controls in Python as an FMU by somebody else's exporter: "pythonfmu" or "pythonfmu3"."""
    builder = pytest.importorskip(f"{exporter}.builder").FmuBuilder
    text = PYTHON_CONTROLLER.read_text("utf-8")
    if exporter == "pythonfmu3":
        for old, new in (("from pythonfmu ", "from pythonfmu3 "), ("Fmi2", "Fmi3"), ("Real", "Float64")):
            text = text.replace(old, new)
    script = folder / f"{exporter}_controller.py"
    script.write_text(text, "utf-8")
    return builder.build_FMU(str(script), dest=str(folder))


@pytest.mark.parametrize(("exporter", "validate"), [("pythonfmu", True), ("pythonfmu3", False)])
def test_an_fmu_from_an_exporter_of_somebody_elses_is_the_library_too(tmp_path, exporter, validate):
    """PythonFMU: no state to get, the interpreter within; another text of the same controls. PythonFMU3 leaves the
    independent variable out, which the standard wants."""
    units = {**{f"v_{p}": "V" for p in "abc"}, **{f"i_{p}": "A" for p in "abc"}, "v_dc": "V"}
    inputs = {name: {"signal": signal, "unit": units[name]} for name, signal in INPUTS_2.items() if name in units}
    outputs = {name: {"signal": signal, "unit": "V"} for name, signal in OUTPUTS_2.items()}
    path = exported(tmp_path, exporter)
    told = {"inputs": {**inputs, "v_dc_ref": 1200.0}, "outputs": outputs, "sample_time_s": 100e-6}
    if not validate:
        with pytest.raises(ValueError, match=r"independent variable .*; validate = false in"):
            GreyTurbine(f"fmu:{path}", **told)
    theirs = GreyTurbine(f"fmu:{path}", **told, validate=validate, settle_tolerance=1e-9)
    ours = library("SAMPLE_TIME_S=100e-6")
    (_, y), (_, expected) = (swept(device, {"f_hz": [150.0, 400.0]}) for device in (theirs, ours))
    error = np.max(np.abs(y / expected - 1.0))
    print(f"\n  {exporter}: {error:.1e} from the library", end="")
    assert error <= 1e-5  # the tolerance between the windows of a sweep
    assert isinstance(theirs._branched._branches, Forks)


# ---------------------------------------------------------------------- the promise of a plant


@pytest.mark.parametrize(
    "version", [pytest.param(VERSIONS[0], marks=pytest.mark.evidence), *VERSIONS[1:]], ids=["FMI 2.0", "FMI 3.0"]
)
def test_it_keeps_the_promise_of_a_plant_behind_a_grid(version):
    findings = check_plant(plant(*version), source=Source("thevenin", 0.012, 0.8e-3, angle_rad=0.3))
    assert not [finding for finding in findings if not finding.passed]
    assert len(findings) == 17


def test_a_state_that_the_fmu_only_claims_to_keep_is_found_out():
    """Its get and set of the state leave statics behind: two answers to one job differ, and forks take over."""
    honest, false = plant("STATE"), plant("STATE", "HIDDEN_STATES")
    for device in (honest, false):
        device.settle(POINT, Source())
    assert isinstance(honest._branched._branches, Snapshots)
    assert isinstance(false._branched._branches, Forks)
    expected = answers(honest)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(expected, answers(false), strict=True))


def test_a_state_from_another_process_is_reached_by_a_fork():
    """The way to it is known there, but not whether the FMU can be trusted with its states."""
    state = plant("STATE").settle(POINT, Source())
    first, other = plant("STATE"), plant("STATE")
    other.settle(POINT, Source())
    records = [device.run([Job(state, TONE)], 400)[0][1] for device in (first, other)]
    assert isinstance(first._branched._branches, Forks)
    assert records[0].i.tobytes() == records[1].i.tobytes()


def test_no_files_are_left_where_a_plant_was(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for snapshot in ("auto", "copy"):
        device = plant("STATE", snapshot=snapshot)
        device.settle(POINT, Source())
        assert list(tmp_path.iterdir())
        del device
        assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------------- what is refused, by name

WRONG_MAPS = {
    "unfed": ({"inputs": {k: v for k, v in INPUTS_2.items() if k != "v_dc"}}, "inputs: port 'v_dc' is not fed"),
    "unknown": ({"outputs": {**OUTPUTS_2, "u_d": "v_conv_a"}}, "outputs: there is no port 'u_d'"),
    "input for output": ({"outputs": {**OUTPUTS_2, "v_a": "v_conv_a"}}, "outputs: there is no port 'v_a'"),
    "unit": (
        {"inputs": {**INPUTS_2, "v_a": {"signal": "v_pcc_a", "unit": "kV"}}},
        "'v_a' is in V by the controller's own description, in kV by the signal map",
    ),
    "unwhole": ({"outputs": {"u_a": "v_conv_a"}}, "outputs: the ports give v_conv_a; needed are"),
    "unknown setting": ({"settings": {"Kppp": 1.0}}, r"settings: .* has no variable 'Kppp' \(did you mean 'Kpp'\?\)"),
    "setting of a result": ({"settings": {"angle": 1.0}}, "settings: variable 'angle' .* cannot be set at the start"),
    "kind of a setting": ({"settings": {"Delay": 0.5}}, "settings: variable 'Delay' is a Integer; given 0.5"),
    "sample time": ({"sample_time_s": 2.0}, r"sample_time_s is 2.0; needed: a number above 0 and up to 0.001, in s"),
    "sample time of no number": ({"sample_time_s": nan}, "sample_time_s is nan"),
    "no state": ({"snapshot": "states"}, 'snapshot = "states", but fmu:.* cannot get and set its state'),
}


@pytest.mark.parametrize("case", WRONG_MAPS)
def test_a_map_that_does_not_fit_is_refused_by_name_before_anything_runs(case):
    change, words = WRONG_MAPS[case]
    with pytest.raises(ValueError, match=words):
        plant(**change)


def test_another_kind_of_controller_is_refused_with_the_ones_there_are():
    with pytest.raises(PlantError, match=r"must read cigre:FILE .* or fmu:FILE"):
        make_plant("dpmsg-grey-v1", {"controller": "fmi:x.fmu", "inputs": {}, "outputs": {}})


def test_a_signal_map_for_a_whole_device_is_told_where_it_belongs():
    for name in ("inputs", "controller", "sample_time_s"):
        with pytest.raises(PlantError, match=r'id = "dpmsg-grey-v1", and controller = "fmu:x.fmu"'):
            make_plant("fmu:x.fmu", {name: {}})


def test_a_misspelt_parameter_is_told_the_nearest_one():
    with pytest.raises(ValueError, match=r"no parameter 'delay_sample' \(did you mean 'delay_samples'\?\)"):
        plant("STATE", delay_sample=1)


def test_an_fmu_given_as_a_library_is_told_what_it_is():
    with pytest.raises(ValueError, match=r'is an archive: if it is an FMU, give controller = "fmu:'):
        GreyTurbine(f"cigre:{build_fmu('STATE')}", INPUTS, OUTPUTS)


# ---------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("switches", "error", "words"),
    [
        (("FAULT_ERROR",), FmuFault, "fmi2DoStep answered error at 8.5 s; it says: DC overvoltage, converter blocked"),
        (("FAULT_ERROR", "FMI3"), FmuFault, "fmi3DoStep answered error at 8.5 s; it says: DC overvoltage"),
        (("FAULT_END", "FMI3"), FmuFault, "the FMU asks for the end of the simulation at 8.5 s"),
        (("FAULT_NAN",), ControllerFault, "output port 'u_b' is not a finite number at 8.5 s"),
        (("FAULT_ABORT",), BoxDied, "SIGABRT"),
    ],
)
def test_a_fault_costs_its_own_job_with_the_reason(switches, error, words):
    """The settled state, before it, goes on answering."""
    states = () if "FAULT_ABORT" in switches else ("STATE",)
    device = plant(*states, *switches, settings={"FaultTime": 8.5})
    state = device.settle(POINT, Source())
    with pytest.raises(error, match=words):
        device.run([Job(state, TONE)], 50_000)
    ((_, record),) = device.run([Job(state, TONE)], 500)
    assert np.all(np.isfinite(record.i))


def test_after_a_fatal_answer_another_instance_takes_the_same_way():
    device = plant("STATE", "FAULT_FATAL", settings={"FaultTime": 8.5})
    state = device.settle(POINT, Source())
    ((_, before),) = device.run([Job(state, TONE)], 500)
    with pytest.raises(FmuFault, match=r"fmi2DoStep answered fatal at 8\.5 s"):
        device.run([Job(state, TONE)], 50_000)
    ((_, after),) = device.run([Job(state, TONE)], 500)
    assert before.i.tobytes() == after.i.tobytes()


def test_an_fmu_that_writes_more_than_it_declares_is_caught():
    """An array declared for two phases, of which the code writes three: the map takes two axes, so that it fits."""
    device = plant("FMI3", "STATE", "FAULT_WIDTH", outputs={"v_conv_abc": "v_conv_alphabeta"}, patience_s=1.0)
    with pytest.raises((ControllerFault, NotSettled), match="wrote out of bounds"):
        device.settle(POINT, Source())


def test_a_refusal_to_start_has_the_fmus_own_words():
    with pytest.raises(FmuFault, match=r"does not start: .*; it says: Ki without Kp has no limit"):
        plant("STATE", settings={"Kp": 0.0}).settle(POINT, Source())


# ---------------------------------------------------------------------- from the command line


def campaign(folder, *switches, f_hz=(20.0, 150.0)):
    """The example's, with the FMU of these switches."""
    path = folder / "campaign.toml"
    example = (Path(__file__).parents[2] / "examples" / "fmu_controller.toml").read_text("utf-8")
    head, _, _ = example.partition("[sweep]")
    head = head.replace("turbine_controller.fmu", str(build_fmu(*switches)))
    path.write_text(f"{head}[sweep]\nf_hz = {list(f_hz)}\n", "utf-8")
    return path


def test_the_example_gives_the_table_of_the_library(tmp_path):
    done = command("run", campaign(tmp_path, "STATE"), "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    (found,) = read_table(tmp_path / "y.parquet").responses
    _, y = swept(library(), {"f_hz": [20.0, 150.0]})
    assert np.max(np.abs(found.y / y - 1.0)) <= 1e-9


def test_a_crash_costs_its_own_points(tmp_path):
    """The windows near f1 last beyond 10 s, where it aborts; the others do not."""
    path = campaign(tmp_path, "STATE", "FAULT_ABORT", f_hz=(45.0, 150.0))
    path.write_text(path.read_text("utf-8").replace("Kpp = 0.085", "FaultTime = 10.0"), "utf-8")
    status, said = ended("run", path, "-o", tmp_path / "y.parquet", "--jobs", 1)
    assert status == 1, said
    assert "Traceback" not in said
    (found,) = read_table(tmp_path / "y.parquet").responses
    assert found.status.tolist() == ["failed", "ok"]
    assert "SIGABRT" in found.reason[0]


@pytest.mark.evidence
def test_a_hundred_points_with_an_fmu_take_less_than_twenty_seconds_on_two_cores(tmp_path):
    shutil.copy2(build_fmu("STATE"), tmp_path / "turbine_controller.fmu")
    wall, cpu = time_of_example("fmu_controller.toml", tmp_path)
    print(f"\n  100 points, the FMU's own states: {wall:.1f} s of wall time, {cpu:.1f} s of CPU time", end="")
    assert cpu / 2.0 < 20.0


@pytest.mark.evidence
def test_the_host_of_an_fmu_costs_at_most_150_ns_a_step():
    """CPU time of the loop, circuit and listening included, less that of the controls alone, called as a library:
    what the FMU itself spends in setting and getting its variables counts as the host's."""
    device = plant("STATE")  # with it its files would go
    core = device._core
    state, n_steps, whole = core.settle(POINT, Source()), 1_000_000, []
    for _ in range(5):
        begun = time.process_time()
        core.run_phasors([Job(state, TONE)], [Window(77.0, 100)], 1000, n_steps // 1000)
        whole.append((time.process_time() - begun) / n_steps * 1e6)
    twin = library()
    twin.settle(POINT, Source())
    controller = twin._core.controller
    alone = min(
        alone_us(controller.library.function("Model_Outputs"), int(controller.addresses[1]), n_steps) for _ in range(5)
    )
    print(f"\n  FMU: {min(whole):.3f} us a step, of which the controls' own code {alone:.3f} us", end="")
    assert min(whole) - alone <= 0.15
