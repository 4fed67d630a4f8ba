"""Kernels whose machine code is kept: numba's numbers without numba, and a way back whatever happens to the file."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from seqsweep.plant.kernels import branch, compiled, fmi, kept

KERNEL = """
import json, sys
import numpy as np
from seqsweep.plant.kernels.compiled import njit

@njit(forceinline=True)
def _weighted(x, p):
    return p[0] * x + p[1]

@njit(nogil=True, cache=True)
def fill(out, p, c, n, more, switched):
    for k in range(n):
        out[k] = _weighted(out[k], p) + c.real - c.imag * k
        if more is not None or not switched:
            out[k] = 0.0

if __name__ == "__main__":
    out = np.arange(6.0)
    fill(out, (2.0, 0.5), 1.0 + 0.25j, 5, None, True)
    print(json.dumps([out.tolist(), "numba" in sys.modules]))
"""
WANTED = [*(2.0 * k + 0.5 + 1.0 - 0.25 * k for k in range(5)), 5.0]


def called(folder: Path, text: str = KERNEL, **environment: str) -> tuple[list[float], bool]:
    """What the kernel fills in, and whether its process imported numba."""
    script = folder / "kernels_of_a_test.py"
    if not script.exists() or script.read_text("utf-8") != text:
        script.write_text(text, "utf-8")
    settings = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), **environment}
    done = subprocess.run([sys.executable, str(script)], env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    out, with_numba = json.loads(done.stdout)
    return out, with_numba


def files(folder: Path) -> list[Path]:
    return sorted((folder / "cache" / "seqsweep").glob("*.kernel"))


@pytest.fixture(scope="module")
def warm(tmp_path_factory):
    """A folder where the kernel was compiled once."""
    folder = tmp_path_factory.mktemp("warm")
    assert called(folder) == (WANTED, True)
    return folder


def test_the_second_process_calls_the_same_code_without_numba(warm):
    assert called(warm) == (WANTED, False)
    assert len(files(warm)) == 1


def test_of_processes_that_begin_together_one_compiles_and_the_others_wait(tmp_path):
    (tmp_path / "kernels_of_a_test.py").write_text(KERNEL, "utf-8")
    with ThreadPoolExecutor(3) as processes:
        outcomes = list(processes.map(called, 3 * [tmp_path]))
    assert sorted(outcomes) == [(WANTED, False), (WANTED, False), (WANTED, True)]
    assert [path.suffix for path in (tmp_path / "cache" / "seqsweep").iterdir()] == [".kernel"]


def test_a_lock_that_somebody_keeps_costs_time_alone(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(kept, "_PATIENCE_S", 0.1)
    with (tmp_path / "k.kernel.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with kept.alone(tmp_path / "k.kernel"):
            pass


@pytest.mark.parametrize(
    "damage",
    [lambda held: held[:-1], lambda held: held[:40] + b"x" + held[41:], lambda held: b"", lambda held: b"junk"],
)
def test_damage_to_a_file_is_seen(warm, tmp_path, damage):
    (path,) = files(warm)
    assert kept.read(path)
    (tmp_path / path.name).write_bytes(damage(path.read_bytes()))
    assert kept.read(tmp_path / path.name) is None


def test_a_damaged_file_is_made_anew(warm):
    (path,) = files(warm)
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    assert called(warm) == (WANTED, True)
    assert called(warm) == (WANTED, False)
    assert len(path.read_bytes()) == len(whole)


def test_another_processor_has_code_of_its_own(warm):
    before = set(files(warm))
    assert called(warm, NUMBA_CPU_NAME="haswell") == (WANTED, True)
    assert len(set(files(warm)) - before) == 1


def test_another_setting_has_code_of_its_own(monkeypatch):
    here = kept.machine.__wrapped__()
    monkeypatch.setenv("NUMBA_OPT", "1")
    assert kept.machine.__wrapped__() != here


def test_another_python_has_code_of_its_own(monkeypatch):
    here = kept.machine.__wrapped__()
    monkeypatch.setattr(sys, "version_info", (3, 99, 0))
    assert kept.machine.__wrapped__() != here


def test_an_edit_is_noticed(warm, tmp_path):
    shutil.copytree(warm, tmp_path, dirs_exist_ok=True)
    assert called(tmp_path) == (WANTED, False)
    edited = KERNEL.replace("p[0] * x + p[1]", "p[0] * x - p[1]")
    assert called(tmp_path, edited) == ([*(value - 1.0 for value in WANTED[:5]), 5.0], True)


def test_files_of_one_kernel_are_bounded(tmp_path):
    path = tmp_path / "k.f-0.kernel"
    for k in range(12):
        kept.write(path.with_name(f"k.f-{k}.kernel"), "f", b"code")
        os.utime(path.with_name(f"k.f-{k}.kernel"), (k, k))
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(f"k.f-{k}.kernel" for k in range(4, 12))


def test_a_folder_that_cannot_be_written_costs_time_alone(tmp_path):
    (tmp_path / "cache").write_text("a file where the folder should be")
    assert called(tmp_path) == (WANTED, True)


def test_what_returns_or_allocates_is_left_to_numba_and_right(tmp_path):
    returns = KERNEL.replace("    for k in range(n):", "    x = np.zeros(n)\n    for k in range(n):")
    assert called(tmp_path, returns) == (WANTED, True)
    assert called(tmp_path, returns) == (WANTED, True)
    assert all(kept.read(path) == ("", b"") for path in files(tmp_path))


def test_without_the_compiler_the_python_itself_runs(warm):
    assert called(warm, NUMBA_DISABLE_JIT="1") == (WANTED, False)


def test_arguments_numba_takes_and_we_do_not_are_its_own():
    @compiled.njit()
    def doubled(x):
        return x + x

    assert doubled(np.float32(1.5)) == 3.0
    assert doubled(np.int32(1)) == 2
    assert doubled(np.arange(6)[::2]).tolist() == [0, 4, 8]


def test_read_only_arrays_have_code_of_their_own():
    still = np.zeros(3)
    still.setflags(write=False)
    assert compiled._kind(still) != compiled._kind(np.zeros(3))
    assert compiled._kind(np.zeros(3, ">f8")) == "?" == compiled._kind(np.zeros((3, 3)).T[:2])


def test_many_threads_may_come_first():
    """Sixteen threads call a kernel that none has called before; each has its own memory and the same numbers."""
    kernel = compiled.Kernel(branch.advance_recording.py_func, {"nogil": True, "cache": True})

    def run(k: int) -> np.ndarray:
        v, i = np.empty(50, complex), np.empty(50, complex)
        source = np.array([400.0 + 0j]), np.array([np.exp(0.02j)])
        kernel(np.zeros(1, complex), *source, 0.1, 1e-3, 0.0, 0.0, 5e-5, v, i)
        return i

    with ThreadPoolExecutor(16) as pool:
        first, *others = pool.map(run, range(16))
    assert all(np.array_equal(other, first) for other in others)
    assert abs(first[-1]) > 0.0


def test_a_kernel_of_the_product_is_the_same_as_numbas_own():
    """Bit for bit, through every argument: the code differs by the stack's alignment alone."""
    from numba import njit

    rng = np.random.default_rng(1)
    tones, turns = rng.normal(size=(2, 3, 2)).view(complex)[..., 0]
    found = []
    for call in (branch.advance_blocks, njit(nogil=True)(branch.advance_blocks.py_func)):
        current, sums = np.array([1.0 + 2.0j]), np.empty((4, 4), complex)
        lines = np.array([1.0 + 0j, 0.6 - 0.8j])
        turn = np.exp(0.1j)
        call(
            current,
            tones.copy(),
            turns / abs(turns),
            0.1,
            1e-3,
            0.02,
            1e-4,
            5e-5,
            lines,
            lines.copy(),
            turn,
            turn,
            7,
            sums,
        )
        found.append((current.tobytes(), lines.tobytes(), sums.tobytes()))
    assert found[0] == found[1]


TURBINE = """
from seqsweep.plant.protocol import Job, OperatingPoint, Source
from seqsweep.plant.registry import make_plant
plant = make_plant("dpmsg-v1")
state = plant.settle(OperatingPoint(0.65e6, 690.0), Source())
plant.run([Job(state, None)], 20)
"""
SEALED_CONTROLLER = """
from seqsweep.plant.greybox.kernel_arguments import warm_up
warm_up()
"""
SEALED_DEVICE = """
from seqsweep.plant.fmu.instance import warm
warm()
"""


@pytest.mark.parametrize("work", [TURBINE, SEALED_CONTROLLER, SEALED_DEVICE], ids=["turbine", "controller", "FMU"])
def test_a_warm_process_does_without_numba(work):
    text = f'import sys\n{work}\nprint("numba" in sys.modules)'
    said = [subprocess.run([sys.executable, "-c", text], capture_output=True, text=True).stdout for _ in range(2)]
    assert said[1] == "False\n"


def test_the_key_knows_every_file_that_a_kernel_is_made_of(tmp_path):
    for name, text in (("a", "from .b import x\n"), ("b", "from .c import x\n"), ("c", "from .a import x\nx = 1\n")):
        (tmp_path / f"{name}.py").write_text(text)
    before = kept.text_of(tmp_path / "a.py")
    (tmp_path / "c.py").write_text("from .a import x\nx = 2\n")
    assert kept.text_of(tmp_path / "a.py") != before
    assert not kept.is_whole(tmp_path / "a.py")
    (tmp_path / "a.py").write_text("x = 1\n")
    assert kept.is_whole(tmp_path / "a.py")


def test_a_kernel_over_stacks_is_the_kernel_over_each_of_their_entries():
    """Machine code in a loop of machine code, against one call after the other."""
    rng = np.random.default_rng(4)
    tones, rotations = rng.normal(size=(1, 3)) + 0.5j, np.exp(1j * rng.normal(size=3))
    current, v, i = np.full((5, 1), 2.0 + 1j), np.empty((5, 7), complex), np.empty((5, 7), complex)
    twin = [(np.full(1, 2.0 + 1j), np.empty(7, complex), np.empty(7, complex)) for _ in range(5)]
    constants = 0.1, 1e-3, 0.0, 0.0, 50e-6
    moving = tones[0].copy()
    compiled.each(branch.advance_recording, [current, moving, rotations, *constants, v, i], (0, 8, 9))
    moving = tones[0].copy()
    for of_current, of_v, of_i in twin:
        branch.advance_recording(of_current, moving, rotations, *constants, of_v, of_i)
    for found, expected in zip((current, v, i), zip(*twin, strict=True), strict=True):
        assert np.array_equal(found, expected)


DO_STEP = {2: "qddi", 3: "qddiqqqq"}
"""What the standard's step function takes: the instance, time (s), step (s), flags and addresses."""


def stepped(version: int) -> tuple[int, list[float], int, int]:
    """Steps of an FMU that fails behind 0.25 ms: rows done, times asked for, where it ended and how."""
    asked: list[float] = []
    kinds = [{"q": ctypes.c_int64, "d": ctypes.c_double, "i": ctypes.c_int32}[kind] for kind in DO_STEP[version]]

    @ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)
    def do_step(*given):
        asked.append(given[1])
        return 3 if given[1] > 2.5e-4 else 0

    block, done, none = np.zeros(fmi.N_CELLS, np.int64), np.zeros(1, np.int64), np.zeros(0)
    block[fmi.DO_STEP], times = ctypes.cast(do_step, ctypes.c_void_p).value or 0, block.view(np.float64)
    rows, time = np.zeros((5, 0)), times[fmi.TIME : fmi.TIME + 1]
    fmi.advance(fmi.step_of(version), block.ctypes.data, time, 1, 1e-4, none, none, rows, rows, done)
    return int(done[0]), asked, int(block[fmi.WHERE]), int(block[fmi.STATUS])


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_is_stepped_where_numba_is_inside_not_as_the_compiler_knows_it(version, monkeypatch):
    """Numba alone then makes the kernels and the step that is called by its address."""
    known = stepped(version)
    assert known == (2, [pytest.approx(k * 1e-4) for k in (1, 2, 3)], fmi.STEP, 3)

    def unknown(*_):
        raise AttributeError("numba has no such attribute")

    monkeypatch.setattr("seqsweep.plant.kernels.compiler.code_of", unknown)
    monkeypatch.setattr(compiled, "read", lambda path: None)
    monkeypatch.setattr(compiled, "write", lambda path, name, code: (name, code))
    name = f"_step_{version}"
    fresh = compiled.Kernel(getattr(fmi, name).py_func, {"nogil": True, "cache": True})
    monkeypatch.setattr(fmi, name, fresh)
    monkeypatch.setattr(fmi, "step_of", fmi.step_of.__wrapped__)
    assert compiled.callback(fresh, fmi.STATUS) == 0
    assert stepped(version) == known
