"""Plants by name: what is found, what is refused and in which words, and what is imported."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from seqsweep.plant import registry
from seqsweep.plant.protocol import Plant
from seqsweep.plant.registry import PlantError, PlantSpec, fingerprint, make_plant, register, releases_gil
from seqsweep.plant.rl_branch import RLBranch
from seqsweep.plant.turbine.reference import ReferenceTurbine

from ..support.commands import call, campaign


def test_the_built_in_plants_are_found_and_answer_the_protocol():
    assert isinstance(make_plant("branch-v1", {}), RLBranch)
    assert isinstance(make_plant("dpmsg-v1", {"k_pp": 0.1}), ReferenceTurbine)
    ours = [plant_id for plant_id in registry.registered_ids() if registry.is_built_in(plant_id)]
    assert all(isinstance(make_plant(plant_id), Plant) for plant_id in ours)
    assert all(make_plant(plant_id).id == plant_id for plant_id in ours)


def test_importing_the_registry_imports_no_plant_and_no_numba():
    code = (
        "import sys, seqsweep.plant.registry as r; r.registered_ids();"
        "plants = {'seqsweep.plant.rl_branch', 'seqsweep.plant.turbine.reference'};"
        "assert not ({'numba', 'importlib.metadata'} | plants) & set(sys.modules)"
    )
    script = f"import sys; before = set(sys.modules); {code.replace('set(sys.modules)', '(set(sys.modules) - before)')}"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_an_unknown_id_is_refused_with_the_nearest_known_one():
    with pytest.raises(
        PlantError, match=r"unknown plant 'branch-v2' \(did you mean 'branch-v1'\?\); known are .*dpmsg"
    ):
        make_plant("branch-v2", {})
    with pytest.raises(PlantError, match="did you mean 'dpmsg-v1'"):
        make_plant("DPMSG", {})
    with pytest.raises(PlantError, match=r"unknown plant 'turbogenerator'; known are"):
        make_plant("turbogenerator", {})


def test_an_unknown_kind_is_refused():
    with pytest.raises(PlantError, match=r"unknown kind of plant 'pyton' \(did you mean 'python'\?\)"):
        make_plant("pyton:a:b", {})


@pytest.mark.parametrize(
    ("plant_id", "given", "meant"), [("branch-v1", "r_omh", "r_ohm"), ("dpmsg-v1", "k_ppp", "k_pp")]
)
def test_an_unknown_parameter_is_refused_with_the_nearest_known_one(plant_id, given, meant):
    with pytest.raises(PlantError, match=rf"{plant_id} has no parameter '{given}'.*did you mean '{meant}'"):
        make_plant(plant_id, {given: 1.0})


@pytest.mark.parametrize("value", ["much", None, -1.0, float("nan"), [1.0]])
def test_a_refused_value_names_the_plant(value):
    with pytest.raises(PlantError, match="branch-v1"):
        make_plant("branch-v1", {"r_ohm": value})


LOCAL_PLANT = """
from seqsweep.plant.rl_branch import RLBranch

TEXT = "no factory"

def factory(scale=1.0):
    return RLBranch(r_ohm=0.1 * scale)

def breaks():
    raise RuntimeError("no licence\\nfor this host")

def needs(scale, *, offset, more=0.0, **others):
    return RLBranch(r_ohm=0.1 * scale + offset)

def nothing():
    return object()
"""


@pytest.fixture
def local_plant(tmp_path, monkeypatch):
    """A module in the current directory that nobody else has."""
    (tmp_path / "seqsweep_local_plant.py").write_text(LOCAL_PLANT)
    (tmp_path / "seqsweep_local_broken.py").write_text("import nothing_of_that_name\n")
    (tmp_path / "seqsweep_local_exit.py").write_text("import sys; sys.exit(3)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield "python:seqsweep_local_plant"
    for name in ("plant", "broken", "exit"):
        sys.modules.pop(f"seqsweep_local_{name}", None)


def test_a_python_plant_is_found_in_the_current_directory(local_plant):
    assert make_plant(f"{local_plant}:factory", {"scale": 3.0}).r_ohm == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("python:seqsweep_local_plant:factor", "has no 'factor' .did you mean 'factory'"),
        ("python:seqsweep_local_plant:TEXT", "is a str, not a factory"),
        ("python:seqsweep_local_plant:nothing", "made a object, which is no plant: it lacks id, f1_hz"),
        ("python:seqsweep_local_plant:breaks", "cannot be made: no licence for this host"),
        ("python:seqsweep_local_broken:factory", "cannot be imported: No module named 'nothing_of_that_name'"),
        ("python:seqsweep_local_exit:factory", "cannot be imported: SystemExit: 3"),
        ("python:seqsweep_nowhere:factory", "seqsweep_nowhere cannot be imported"),
        ("python:seqsweep_local_plant", "must read python:package.module:factory"),
        ("python:", "must read python:package.module:factory"),
    ],
)
def test_a_python_plant_that_cannot_be_made_says_why(local_plant, target, words):
    with pytest.raises(PlantError, match=words):
        make_plant(target, {})


def test_missing_parameters_are_named_with_the_place_where_they_go(local_plant):
    with pytest.raises(PlantError, match=r"missing: scale, offset; they go under \[plant.parameters\] of a campaign"):
        make_plant(f"{local_plant}:needs")
    with pytest.raises(PlantError, match=r"a parameter that is missing: offset; it goes under"):
        make_plant(f"{local_plant}:needs", {"scale": 1.0})
    assert make_plant(f"{local_plant}:needs", {"scale": 1.0, "offset": 0.1}).r_ohm == pytest.approx(0.2)


def test_an_entry_point_is_read_only_for_an_unknown_id(monkeypatch):
    asked = []

    def entry_points(group):
        asked.append(group)
        return [EntryPoint("vendor-v1", "seqsweep.plant.rl_branch:RLBranch", group)]

    monkeypatch.setattr("importlib.metadata.entry_points", entry_points)
    make_plant("branch-v1", {})
    assert not asked
    assert make_plant("vendor-v1", {"r_ohm": 0.2}).r_ohm == 0.2
    assert asked == ["seqsweep.plants"]
    with pytest.raises(PlantError, match="did you mean 'vendor-v1'"):
        make_plant("vendor-v2", {})


def test_another_distribution_brings_a_plant_of_its_own(tmp_path):
    """Metadata as an installer leaves them, on the search path of the command: the runner and its children find it."""
    (tmp_path / "vendor_plants.py").write_text(
        "from seqsweep.plant.rl_branch import RLBranch\n\n\nclass Box(RLBranch):\n    id = 'vendor-box-v1'\n"
    )
    info = tmp_path / "vendor_plants-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: vendor-plants\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[seqsweep.plants]\nvendor-box-v1 = vendor_plants:Box\n")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = call("check", "vendor-box-v1", env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("pass  attributes        vendor-box-v1: f1 = 50 Hz")
    swept = call("run", campaign(tmp_path, plant="vendor-box-v1", n=3), "-o", tmp_path / "y.parquet", env=environment)
    assert (swept.returncode, "3 ok" in swept.stderr) == (0, True), swept.stderr
    missed = call("check", "vendor-box-v2", env=environment)
    assert missed.returncode == 2
    assert "did you mean 'vendor-box-v1'" in missed.stderr


def test_an_id_needs_a_version_and_keeps_its_meaning(monkeypatch):
    monkeypatch.setattr(registry, "_targets", dict(registry._targets))
    register("branch-v1", "seqsweep.plant.rl_branch:RLBranch")
    with pytest.raises(ValueError, match="changed physics get a new version"):
        register("branch-v1", "elsewhere:Other")
    with pytest.raises(ValueError, match="and a version"):
        register("branch", "elsewhere:Other")
    with pytest.raises(ValueError, match="module:attribute"):
        register("other-v1", "elsewhere")


def test_a_spec_survives_json_and_pickle_and_makes_the_same_plant():
    spec = PlantSpec("branch-v1", {"r_ohm": 0.2, "l_h": 0.1 + 0.2})
    assert PlantSpec.from_json(spec.to_json()) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec
    assert spec.make().l_h == 0.1 + 0.2
    assert PlantSpec("branch-v1", {"l_h": 0.1 + 0.2, "r_ohm": 0.2}).to_json() == spec.to_json()


def test_a_spec_keeps_its_own_parameters():
    parameters = {"r_ohm": 0.2}
    spec = PlantSpec("branch-v1", parameters)
    parameters["r_ohm"] = 0.3
    assert spec.parameters == {"r_ohm": 0.2}


@pytest.mark.parametrize("text", ["{", "[]", '{"id": "branch-v1"}', '{"id": 1, "parameters": {}}'])
def test_a_text_that_is_no_spec_is_refused(text):
    with pytest.raises(PlantError, match="plant spec"):
        PlantSpec.from_json(text)


def test_a_parameter_that_json_cannot_hold_is_refused():
    with pytest.raises(PlantError, match="parameters of branch-v1 must be"):
        PlantSpec("branch-v1", {"r_ohm": float("nan")})


def test_the_fingerprint_is_json_and_says_what_per_unit_and_power_mean():
    spec = PlantSpec("dpmsg-v1", {"dt_s": 1e-4})
    content = fingerprint(spec.make(), spec)
    assert json.loads(json.dumps(content)) == content
    assert content["id"] == "dpmsg-v1"
    assert content["parameters"] == {"dt_s": 1e-4}
    assert content["dt_s"] == 1e-4
    assert set(content) == {"id", "parameters", "dt_s", "f1_hz", "rating", "power_meaning"}


def test_a_plant_that_declares_nothing_holds_the_gil():
    assert releases_gil(make_plant("branch-v1"))
    assert not releases_gil(object())
