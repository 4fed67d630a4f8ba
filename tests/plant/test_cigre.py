"""The host of TB 958 libraries: what is read, what is checked and refused, and by which words."""

from __future__ import annotations

import shutil
import subprocess
from itertools import pairwise

import numpy as np
import pytest

from seqsweep.plant.controllers.cigre import Controller, private_copy
from seqsweep.plant.controllers.cigre_abi import CigreError, Library, describe
from seqsweep.plant.controllers.interface import ControllerFault, Stretch
from seqsweep.plant.controllers.signal_map import WiringError, wire
from seqsweep.plant.greybox.turbine import GreyTurbine
from seqsweep.plant.protocol import Job, OperatingPoint, Source
from seqsweep.plant.registry import PlantError, make_plant

from ..support.commands import command
from ..support.controllers import COMPILER, INPUTS, OUTPUTS, build, needs_compiler

pytestmark = needs_compiler


def controller(*switches, **settings):
    return Controller(Library(build(*switches)), settings)


# ---------------------------------------------------------------------- what a library says of itself


def test_a_description_names_ports_parameters_and_what_would_be_executed():
    lines = describe(build())
    assert lines[0] == "TurbineController 1.0: Grid-side controls of a wind turbine"
    assert "sample time: 2e-05 s" in lines
    assert "declared states: 0 integer, 0 float, 17 double" in lines
    assert "input v_abc[3] (real64, V): voltage at the terminals, phase to neutral" in lines
    assert "output limited (int32, no unit): 1 while a limit acts" in lines
    assert "parameter Kp = 0.25 (real64, ohm, 0 to 10): current, proportional" in lines
    assert lines[-3] == "executed for this: the library's initialisers, Model_GetInfo"
    assert lines[-2] == (
        "a run executes: Model_FirstCall, Model_CheckParameters, Model_Initialize, Model_Outputs, Model_Terminate"
    )


def test_the_command_asks_a_library_what_it_is_and_reads_a_file_without_loading_it():
    asked = command("check", f"cigre:{build()}")
    assert asked.returncode == 0
    assert asked.stdout.rstrip().splitlines() == describe(build())
    read = command("check", build())
    assert read.returncode == 0
    assert f"seqsweep check cigre:{build()}" in read.stdout


def test_a_library_that_dies_as_it_is_loaded_is_wrong_input(tmp_path):
    path = tmp_path / "fatal.so"
    (tmp_path / "fatal.c").write_text("#include <stdlib.h>\n__attribute__((constructor)) void f(void) { abort(); }\n")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-o", path, tmp_path / "fatal.c"], check=True)
    died = command("check", f"cigre:{path}")
    assert died.returncode == 2
    assert "cannot say what it is: signal 6" in died.stderr
    absent = command("check", f"cigre:{tmp_path / 'absent.so'}")
    assert absent.returncode == 2
    assert "cannot be read: No such file" in absent.stderr


def test_offsets_are_those_of_the_compiler(tmp_path):
    """The compiler's own offsetof against the host's layout, over all types, widths and orders that pad."""
    kinds = {
        "char": "u1",
        "int8_t": "i1",
        "int16_t": "i2",
        "int32_t": "i4",
        "uint32_t": "u4",
        "float": "f4",
        "double": "f8",
    }
    members = [*kinds, *reversed(kinds), "char", "double", "int16_t"]
    fields = "".join(f"{kind} m{k}[{1 + k % 3}];" for k, kind in enumerate(members))
    offsets = "".join(f'printf("%zu\\n", offsetof(S, m{k}));' for k in range(len(members)))
    source = tmp_path / "offsets.c"
    source.write_text(
        f"#include <stdio.h>\n#include <stddef.h>\n#include <stdint.h>\ntypedef struct {{{fields}}} S;\n"
        f'int main(void) {{ {offsets} printf("%zu\\n", sizeof(S)); }}\n'
    )
    subprocess.run([COMPILER, "-o", tmp_path / "offsets", source], check=True)
    printed = subprocess.run([tmp_path / "offsets"], check=True, capture_output=True, text=True).stdout.split()
    layout = np.dtype([(f"m{k}", kinds[kind], (1 + k % 3,)) for k, kind in enumerate(members)], align=True)
    assert [layout.fields[name][1] for name in layout.names] + [layout.itemsize] == [int(x) for x in printed]


def test_terminals_lie_where_the_library_has_them():
    device = controller()
    assert [(t.name, t.width, t.type, t.first) for t in device.input_terminals] == [
        ("v_abc", 3, "f8", 0),
        ("i_abc", 3, "f8", 3),
        ("v_dc", 1, "f8", 6),
        ("v_dc_ref", 1, "f8", 7),
    ]
    assert [(t.name, t.type, t.first) for t in device.output_terminals][1:] == [
        ("limited", "i4", 6),
        ("angle", "f8", 4),
    ]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "cannot be read: No such file"),
        (b"MZ\x90\x00", "is a library for Windows"),
        (b"\x7fELF rubbish", "cannot be loaded"),
    ],
    ids=["absent", "windows", "broken"],
)
def test_what_is_no_library_is_refused(tmp_path, content, words):
    path = tmp_path / "box.so"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CigreError, match=words):
        Library(path)


def test_a_library_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "other.so"
    (tmp_path / "other.c").write_text("int answer(void) { return 42; }\n")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-o", path, tmp_path / "other.c"], check=True)
    with pytest.raises(CigreError, match="is no TB 958 library: it exports no Model_GetInfo"):
        Library(path)


# ---------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"Kdc": 1.0}, r"has no parameter 'Kdc' \(did you mean 'Kdcp'\?\); it has Kpp, Kpi"),
        ({"Kp": 11.0}, "Kp is 11; the library takes 0 to 10, in ohm"),
        ({"Kp": "much"}, "Kp is 'much'; the library takes a number, in ohm"),
        ({"Kp": float("nan")}, "Kp is nan; the library takes a number"),
        ({"Kp": True}, "Kp is True; the library takes a number"),
        ({"Delay": 0.5}, r"Delay is 0.5; the library takes a whole number \(int32\)"),
        ({"Delay": 2}, "Delay is 2; the library takes 0 to 1"),
    ],
    ids=str,
)
def test_a_setting_that_cannot_be_is_refused(settings, words):
    with pytest.raises(CigreError, match=words):
        controller(**settings)


def test_what_the_librarys_own_check_refuses_is_told_in_its_words():
    with pytest.raises(ControllerFault, match="Model_CheckParameters refuses at 0 s: Ki without Kp has no limit"):
        controller(Kp=0.0).start()


def test_a_message_is_kept_and_no_error():
    device = controller(Delay=1)
    device.start()
    assert device.messages == ["Delay is on, but Lead does not make up for it"]


# ---------------------------------------------------------------------- memory


def test_memory_is_put_back():
    device = controller()
    device.start()
    before = device.memory()
    device._states[2].cells[:] = 7
    device.inputs.cells[:] = 9
    assert device.memory() != before
    device.restore(before)
    assert device.memory() == before


@pytest.mark.parametrize(("switch", "where"), [("FAULT_STATES", "double states"), ("FAULT_WIDTH", "outputs")])
def test_a_declaration_that_does_not_fit_the_code_is_seen(switch, where):
    """The library declares three doubles less than it writes, or an output of one for three."""
    device = controller(switch)
    with pytest.raises(ControllerFault, match=f"wrote out of bounds, .* of its {where}"):  # noqa: PT012
        device.start()
        device.library.function("Model_Outputs")(int(device.addresses[1]))
        device.check()


def test_what_lies_beyond_a_stretch_is_not_a_number():
    beyond = Stretch("inputs", 24)
    assert beyond.address % 64 == 0
    assert np.isnan(beyond._all[beyond._first + 24 :][:8].view(np.float64)[0])


def test_a_copy_has_statics_of_its_own_and_leaves_no_file(tmp_path):
    path = shutil.copy2(build("HIDDEN_STATES"), tmp_path / "box.so")
    first, second = Library(path), private_copy(path)
    addresses = [Controller(library).addresses[0] for library in (first, Library(path), second)]
    assert addresses[0] == addresses[1] != addresses[2]
    assert [file.name for file in tmp_path.iterdir()] == ["box.so"]
    assert not second.path.exists()


def test_a_library_without_optional_exports_runs():
    """Nothing but Model_GetInfo and Model_Outputs: it starts itself in its first call, and gives the same bytes."""
    assert Library(build("BARE")).exports() == ("Model_Outputs",)
    devices = [GreyTurbine(f"cigre:{build(*switches)}", INPUTS, OUTPUTS) for switches in ((), ("BARE",))]
    point = OperatingPoint(0.65e6, 690.0)
    records = [device.run([Job(device.settle(point, Source()), None)], 500)[0][1] for device in devices]
    assert records[0].i.tobytes() == records[1].i.tobytes()


# ---------------------------------------------------------------------- the signal map


def mapped(inputs, outputs, *switches):
    device = controller(*switches)
    return wire(device.input_terminals, device.output_terminals, {**INPUTS, **inputs}, {**OUTPUTS, **outputs})


@pytest.mark.parametrize(
    ("inputs", "outputs", "words"),
    [
        ({"v_ab": "v_pcc_abc"}, {}, r"inputs: there is no port 'v_ab' \(did you mean 'v_abc'\?\)"),
        ({"v_abc": "v_pc_abc"}, {}, r"port 'v_abc' has the signal 'v_pc_abc', .* \(did you mean 'v_pcc_abc'\?\)"),
        ({"v_abc": "v_pcc_a"}, {}, "port 'v_abc' is 3 wide, but 'v_pcc_a' is 1 numbers"),
        ({"v_abc": {"signal": "v_pcc_abc", "unit": "kA"}}, {}, "'v_abc' has unit 'kA', but its signal is in V"),
        ({"v_abc": {"signal": "v_pcc_abc", "unit": "kV"}}, {}, "'v_abc' is in V by the controller's own description"),
        ({"v_abc": {"signal": "v_pcc_abc", "unit": "pu", "override_unit": True}}, {}, "'v_abc' is in pu: say what one"),
        ({"v_abc": {"signal": "v_pcc_abc", "base": 563.0}}, {}, "has a base, but its unit is 'V'; a base needs unit"),
        ({"v_abc": {"signal": "v_pcc_abc", "sign": 2}}, {}, "'v_abc' has sign = 2; it is 1 or -1"),
        ({"v_abc": {"signal": ["v_pcc_a", "v_pcc_b", "i_l_c"]}}, {}, "port 'v_abc' mixes signals in A and V"),
        ({"v_abc": {"unit": "V"}}, {}, "port 'v_abc' needs either a signal or a value"),
        ({"v_abc": {"sigal": "v_pcc_abc"}}, {}, r"port 'v_abc' has 'sigal' \(did you mean 'signal'\?\)"),
        ({"v_dc_ref": {"value": "much"}}, {}, "port 'v_dc_ref' has value = 'much'; it needs a number"),
        ({"v_dc": []}, {}, "port 'v_dc' has \\[\\]; it needs a table"),
        ({}, {"v_conv_abc": {"value": 1.0}}, "port 'v_conv_abc' has a value; an output port gives a signal"),
        ({}, {"v_conv_abc": ["v_conv_a"]}, "it needs a table"),
        ({}, {"v_conv_abc": {"signal": ["v_conv_a", "v_conv_b", "v_conv_b"]}}, "each once"),
        ({}, {"v_conv_abc": {"signal": ["v_conv_a", "v_conv_b", "m_conv_c"], "unit": "V"}}, "mixes signals in 1 and V"),
        ({}, {"angle": "v_conv_a"}, "port 'angle' needs a unit|each once"),
    ],
    ids=str,
)
def test_a_map_that_does_not_fit_is_refused_and_names_the_port(inputs, outputs, words):
    with pytest.raises(WiringError, match=words):
        mapped(inputs, outputs)


def test_a_port_that_is_not_fed_is_named():
    device = controller()
    told = {name: entry for name, entry in INPUTS.items() if name != "v_dc_ref"}
    with pytest.raises(WiringError, match="inputs: port 'v_dc_ref' is not fed"):
        wire(device.input_terminals, device.output_terminals, told, OUTPUTS)


def test_no_output_at_all_is_refused():
    device = controller()
    with pytest.raises(WiringError, match="outputs: the ports give nothing; needed are all of v_conv_abc"):
        wire(device.input_terminals, device.output_terminals, INPUTS, {})


def test_components_are_those_of_a_space_vector():
    """Phases, axes and line-to-line voltages of one vector, against cosines 120 degrees apart."""
    device = controller()
    names = ["v_pcc_a", "v_pcc_b", "v_pcc_c"], ["v_pcc_ab", "v_pcc_bc", "v_pcc_ca"], ["v_pcc_alpha", "v_pcc_beta"]
    size, angle = 563.0, 0.7
    abc = [size * np.cos(angle - 2.0 * np.pi * k / 3.0) for k in range(3)]
    expected = abc, [a - b for a, b in pairwise([*abc, abc[0]])], [size * np.cos(angle), size * np.sin(angle)]
    vector = size * np.cos(angle), size * np.sin(angle)
    for signals, values in zip(names, expected, strict=True):
        padded = [*signals, *signals][:3]
        told = {**INPUTS, "v_abc": {"signal": padded, "unit": "kV", "sign": -1, "override_unit": True}}
        parts = wire(device.input_terminals, device.output_terminals, told, OUTPUTS).inputs[:3]
        found = [part.gain[0] * vector[0] + part.gain[1] * vector[1] for part in parts]
        assert found == pytest.approx([-1e-3 * value for value in [*values, *values][:3]], rel=1e-12)


# ---------------------------------------------------------------------- as a plant


def test_the_registry_makes_it_and_the_file_is_in_its_fingerprint():
    first = make_plant(f"cigre:{build()}", {"inputs": INPUTS, "outputs": OUTPUTS})
    other = make_plant(f"cigre:{build('SINGLE')}", {"inputs": INPUTS, "outputs": OUTPUTS})
    assert isinstance(first, GreyTurbine)
    assert first.contents["controller"]["name"] == "TurbineController"
    assert first.contents["controller"]["sha256"] != other.contents["controller"]["sha256"]


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "inputs is missing: a signal map says"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "delay_samples": 2}, "delay_samples is 2; dpmsg-grey-v1 takes 0 or 1"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "l_c": 1.0}, "has no parameter 'l_c' .*; it has controller, inputs"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "l_c_h": 0.0}, "l_c_h is 0.0; dpmsg-grey-v1 needs a finite number"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "sample_time_s": 5e-5}, "is sampled every 2e-05 s: leave it away"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "snapshot": "none"}, "snapshot is 'none'; dpmsg-grey-v1 has 'auto'"),
        ({"inputs": INPUTS, "outputs": OUTPUTS, "settings": 3}, "settings is 3; dpmsg-grey-v1 needs a table"),
    ],
    ids=str,
)
def test_parameters_that_cannot_be_are_refused(parameters, words):
    with pytest.raises(PlantError, match=words):
        make_plant(f"cigre:{build()}", parameters)


def test_a_model_for_rms_programs_is_refused():
    with pytest.raises(PlantError, match="is a model for RMS programs"):
        make_plant(f"cigre:{build('RMS')}", {"inputs": INPUTS, "outputs": OUTPUTS})


def test_a_library_that_names_no_sample_time_needs_one():
    parameters = {"inputs": INPUTS, "outputs": OUTPUTS}
    with pytest.raises(PlantError, match="names no sample time: give sample_time_s, in s"):
        make_plant(f"cigre:{build('UNTIMED')}", parameters)
    assert make_plant(f"cigre:{build('UNTIMED')}", {**parameters, "sample_time_s": 5e-5}).dt_s == 5e-5
