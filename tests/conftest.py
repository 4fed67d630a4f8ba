"""The order of the files, and what `make evidence` finds: every evidence test's words go to docs/evidence.md."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from .support.evidence_page import read, trial_of, written

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # two workers, two cores
for _name in ("COLUMNS", "LINES"):  # readline, which pytest imports, gives them to children behind Python's back
    os.environ.pop(_name, None)
    os.unsetenv(_name)

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # begun by a shell's "&": commands would not hear Ctrl-C either
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("same", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("same")  # the same examples every time, however busy the machine: no test fails by chance

HERE = Path(__file__).parent
PAGE = HERE.parent / "docs" / "evidence.md"
_NO_BYTE_CODE = sys.dont_write_bytecode
_said: dict[str, str] = {}

LONG = (
    "plant/test_farm_in_time.py", "sweep/test_grey_verify.py", "sweep/test_elements.py", "docs/test_notebooks.py",
    "plant/test_fmu.py", "plant/test_grey_fmu.py", "plant/test_grey.py", "docs/test_site.py", "sweep/test_cli.py",
    "plant/test_step.py", "sweep/test_farm_verify.py", "identify/test_jumps.py", "sweep/test_columns.py",
    "tuning/grids/test_in_time.py", "tuning/test_farm_advice.py", "sweep/test_farm_command.py", "docs/test_paper.py",
    "docs/test_examples.py", "tuning/test_verdict_families.py", "sweep/test_report_browser.py", "sweep/test_show.py",
    "sweep/test_inverter_damping.py", "sweep/test_kill.py", "tuning/test_verdict_cases.py", "plant/test_compiled.py",
    "plant/test_sandbox.py", "identify/test_confidence.py", "sweep/test_dask.py", "sweep/test_identify.py",
    "sweep/test_child.py", "identify/test_adaptive.py", "plant/test_process.py", "sweep/test_region.py",
    "plant/test_turbine_reactive.py", "plant/test_inverters.py", "face/test_trust.py", "sweep/test_shell.py",
    "tuning/test_stability.py", "sweep/test_report.py", "plant/test_events.py", "identify/test_grid_impedance.py",
    "sweep/test_damaged_files.py", "sweep/test_worst.py", "sweep/bank/test_judge_command.py",
    "identify/test_exchange.py", "identify/test_hear.py", "tuning/grids/test_elements.py", "plant/test_emt.py",
    "plant/test_grey_inverter.py", "sweep/test_progress.py", "plant/test_grey_faults.py", "plant/test_damping.py",
    "identify/test_region_bars.py", "identify/test_recorded_kinds.py", "plant/test_recordings_wild.py",
    "identify/test_surrogate.py", "identify/test_fit.py",
)  # fmt: skip
"""Files that take longest. They begin first, so that no worker is left alone with one at the end; files that need the
same kernels stand apart, so that the second finds them compiled."""


def pytest_configure(config: pytest.Config) -> None:
    """Every worker begins to collect at another folder, and finds byte code of the others' when it comes to theirs.

    What pytest makes of a file of tests takes longer than all that the file imports. Byte code is kept while tests are
    collected, also where PYTHONDONTWRITEBYTECODE is set; what tests import of their own later is as ever.
    """
    workers = getattr(config, "workerinput", None)
    if workers is not None and [Path(name).resolve() for name in config.args] == [HERE]:
        sys.dont_write_bytecode = False
        folders = [str(path) for path in sorted(HERE.iterdir()) if path.is_dir() and path.name[0] not in "._"]
        first = len(folders) * int(workers["workerid"].removeprefix("gw")) // workers["workercount"]
        config.args = folders[first:] + folders[:first]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole files, the longest first; pytest-xdist takes them so with ``--no-loadscope-reorder``."""
    places = {HERE / name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: (places.get(item.path, len(LONG)), item.path))


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: the collector of garbage looks at them no more, and at others less often."""
    sys.dont_write_bytecode = _NO_BYTE_CODE
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)  # compiling and drawing make many objects: a tenth of their time


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call" and "evidence" in report.keywords and report.passed:
        _said[report.nodeid] = report.capstdout.strip()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Only a green run of evidence speaks for the pages."""
    if session.config.option.markexpr != "evidence" or exitstatus != 0 or hasattr(session.config, "workerinput"):
        return
    fresh = {trial.name: trial for name, text in _said.items() if text for trial in [trial_of(name, text)]}
    whole = session.config.args_source is pytest.Config.ArgsSource.TESTPATHS and not session.config.option.keyword
    kept = {} if whole else read(PAGE.read_text("utf-8"))
    PAGE.write_text(written(kept | fresh), "utf-8")
