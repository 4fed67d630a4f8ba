"""What the program stands on: pinned with check sums, listed with licences, told in the wheel, held by an audit."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
LOCK = TOP / "constraints.lock"

pytest.importorskip("packaging", reason="the extra 'test' is not installed")


@pytest.fixture(scope="module", autouse=True)
def scripts() -> Iterator[None]:
    """The folder's own modules can be imported."""
    sys.path.insert(0, str(TOP / "supply"))
    yield
    sys.path.remove(str(TOP / "supply"))


def versions(path: Path) -> dict[str, str]:
    from audit import pins
    from packaging.utils import canonicalize_name

    return {str(canonicalize_name(name)): version for name, version in pins(path.read_text("utf-8")).items()}


def test_the_lock_has_the_versions_of_the_constraints_and_a_check_sum_of_each():
    """Differs after an edit of constraints.txt or pyproject.toml: `make lock`."""
    locked = versions(LOCK)
    assert locked.pop("setuptools")  # builds the project itself
    assert locked == versions(TOP / "constraints.txt")
    entries = LOCK.read_text("utf-8").replace("\\\n", " ").splitlines()
    assert [entry for entry in entries if "--hash=sha256:" not in entry] == []


def test_the_list_of_licences_and_the_bill_of_materials_are_those_of_what_is_installed():
    if sys.version_info[:2] != (3, 11) or sys.platform != "linux":
        pytest.skip("constraints.txt is for CPython 3.11 on Linux")
    from dependencies import files

    try:
        made = files()
    except PackageNotFoundError as missing:
        pytest.skip(f"not every extra is installed: {missing}")
    assert [path.name for path, text in made.items() if path.read_text("utf-8") != text] == []  # else: `make lock`


def test_everything_pinned_is_listed_and_nothing_the_program_needs_is_copyleft():
    rows = [line.split(" | ") for line in (TOP / "docs" / "dependencies.md").read_text("utf-8").splitlines()]
    listed = {row[0].removeprefix("| "): row[1:] for row in rows if len(row) == 4 and row[1][0].isdigit()}
    assert {name: row[0] for name, row in listed.items()} == versions(TOP / "constraints.txt")
    bill = json.loads((TOP / "supply" / "seqsweep.cdx.json").read_text("utf-8"))
    required = {part["name"] for part in bill["components"] if part["scope"] == "required"}
    assert {"numpy", "numba", "pyarrow", "typer"} <= required
    assert [name for name in required if "GPL" in listed[name][1] or "MPL" in listed[name][1]] == []


def test_the_bill_of_materials_leads_from_the_program_to_every_part():
    bill = json.loads((TOP / "supply" / "seqsweep.cdx.json").read_text("utf-8"))
    needs = {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]}
    reached, new = set(), [bill["metadata"]["component"]["bom-ref"]]
    while new:
        reached.add(new[0])
        new = [*new[1:], *(ref for ref in needs[new[0]] if ref not in reached and ref not in new)]
    assert reached == set(needs) == {part["bom-ref"] for part in [bill["metadata"]["component"], *bill["components"]]}


def test_a_wheel_has_the_bill_of_materials_in_its_metadata(tmp_path):
    pytest.importorskip("setuptools", reason="environments have it by themselves up to Python 3.11 alone")
    code = "import sys; from setuptools.build_meta import prepare_metadata_for_build_wheel as f; f(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, tmp_path], cwd=TOP, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    (bill,) = tmp_path.glob("seqsweep-*.dist-info/sboms/seqsweep.cdx.json")
    assert bill.read_bytes() == (TOP / "supply" / "seqsweep.cdx.json").read_bytes()


@pytest.fixture
def installed(tmp_path, monkeypatch) -> Path:
    """A distribution of one module, as an installer leaves it."""
    import hashlib
    from base64 import urlsafe_b64encode

    folder = tmp_path / "of_a_test-1.2.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.4\nName: of-a-test\nVersion: 1.2\n")
    module = tmp_path / "of_a_test.py"
    module.write_text("x = 1\n")
    digest = urlsafe_b64encode(hashlib.sha256(b"x = 1\n").digest()).decode().rstrip("=")
    (folder / "RECORD").write_text(f"of_a_test.py,sha256={digest},6\nof_a_test-1.2.dist-info/RECORD,,\n")
    monkeypatch.syspath_prepend(tmp_path)
    return module


def test_the_audit_finds_what_was_altered_lost_or_replaced(installed):
    from audit import problems_of

    import_module("importlib_metadata")  # once imported it answers for the standard library, and skips what is lost

    assert list(problems_of({"of-a-test": "1.2"})) == []
    assert list(problems_of({"of-a-test": "1.3"})) == ["of-a-test is 1.2, pinned is 1.3"]
    assert list(problems_of({"of-another-test": "2"})) == ["of-another-test 2 is not installed"]
    told = ["of-a-test 1.2: of_a_test.py was changed or removed since it was installed"]
    installed.write_text("x = 2\n")
    assert list(problems_of({"of-a-test": "1.2"})) == told
    installed.unlink()
    assert list(problems_of({"of-a-test": "1.2"})) == told


def test_a_pin_with_extras_or_a_marker_is_read(scripts):
    from audit import pins

    text = "a[b,c]==1.0 \\\n    --hash=sha256:00\nd_e.f==2.0rc1 ; python_version < '4'\n# g==3\n"
    assert pins(text) == {"a": "1.0", "d_e.f": "2.0rc1"}
