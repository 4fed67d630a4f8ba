"""The runner: same bytes however it runs, and whatever happened to an earlier run."""

from __future__ import annotations

import random
import socket
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from seqsweep.identify.table.read import read_table, validate_table
from seqsweep.plant.protocol import NotSettled
from seqsweep.plant.registry import make_plant
from seqsweep.plant.turbine.parameters import LINE_L_H, LINE_R_OHM
from seqsweep.plant.turbine.reference import ReferenceTurbine
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure import loadflow
from seqsweep.sweep.plan import Grid, _AtAnyCondition
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import campaign, host, shards, workers
from seqsweep.sweep.run.asked import Asked, Missing
from seqsweep.sweep.run.campaign import RunError, run

from ..support import oracle

TWO_POINTS = [
    {"id": "low", "active_power_mw": 0.3, "terminal_voltage_pu": 1.0},
    {"id": "high", "active_power_mw": 1.1, "terminal_voltage_pu": 0.95},
]


def planned(*, plant_id="dpmsg-v1", points=TWO_POINTS, n=24, **sections):
    content = {
        "campaign": {"name": "runner"},
        "plant": {"id": plant_id},
        "operating_point": points,
        "sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": n},
        **sections,
    }
    plant = make_plant(plant_id)
    return make_plan(Config.from_dict(content), plant), plant


def written(folder, plan, plant, *, jobs=1, backend="threading", name="y.parquet", **options):
    """The bytes of the table, measured in a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    run(plan, plant, folder / name, jobs=jobs, backend=backend, **options)
    assert [path.name for path in folder.iterdir()] == [name]  # no shard, no lock, nothing half-written
    return (folder / name).read_bytes()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    plan, plant = planned()
    return written(tmp_path_factory.mktemp("undisturbed"), plan, plant)


@pytest.mark.parametrize("backend", ["threading", "loky"])
def test_bundles_of_batches_give_the_same_bytes(tmp_path, monkeypatch, undisturbed, backend):
    monkeypatch.setattr(workers, "FEW", 1)
    monkeypatch.setattr(workers, "TOGETHER", 2)
    plan, plant = planned()
    assert [len(bundle) for bundle in workers._bundles(2, plant, list(plan.batches()))] == [4, 4]
    assert written(tmp_path, plan, plant, jobs=2, backend=backend) == undisturbed


def test_few_batches_of_a_quick_plant_are_shared_out_in_about_equal_parts(monkeypatch):
    plan, plant = planned()
    batches = list(plan.batches())
    shared = list(workers._bundles(2, plant, batches))
    assert sorted(batch.key for bundle in shared for batch in bundle) == sorted(batch.key for batch in batches)
    less, more = sorted(sum(map(workers._steps, bundle)) for bundle in shared)
    assert len(shared) == 2
    assert more - less <= max(map(workers._steps, batches))
    monkeypatch.setattr(workers, "MOST_STEPS", 1.0)  # as of a plant with tiny steps
    assert {len(bundle) for bundle in workers._bundles(2, plant, batches)} == {1}


@pytest.fixture
def counted(monkeypatch):
    """Keys of the batches that are measured in this process."""
    keys = []
    real = host.measure_together

    def counting(plant, batches):
        keys.extend(batch.key for batch in batches)
        return real(plant, batches)

    monkeypatch.setattr(host, "measure_together", counting)
    return keys


@pytest.fixture
def left_behind(tmp_path, monkeypatch):
    """A finished run whose shards were not removed: (plan, plant, output, folder of the shards)."""
    plan, plant = planned()
    output = tmp_path / "y.parquet"
    with monkeypatch.context() as patch:
        patch.setattr(shards, "remove", lambda folder: None)
        run(plan, plant, output, jobs=1, backend="threading")
    output.unlink()
    return plan, plant, output, shards.folder_of(output)


# Same campaign, same bytes


def test_the_table_is_whole_and_conforms(tmp_path, undisturbed):
    (tmp_path / "y.parquet").write_bytes(undisturbed)
    assert validate_table(tmp_path / "y.parquet") == []
    table = read_table(tmp_path / "y.parquet")
    plan, _ = planned()
    assert table.op_ids == ("low", "high")  # campaign order, not the alphabet's
    for response in table.responses:
        assert response.f_hz.tolist() == [point.f_hz for point in plan.points]
        assert set(response.status.tolist()) == {"ok"}
        power_w, voltage_v = response.meta["active_power_mw"] * 1e6, response.meta["terminal_voltage_pu"] * 690.0
        exact = oracle.admittance_pn(response.f_hz, power_w, voltage_v)
        error = np.linalg.norm(response.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))
        assert error.max() <= 1e-4  # the rows of one operating point are not the other's


@pytest.mark.parametrize(("backend", "jobs"), [("threading", 2), ("threading", 4), ("loky", 2), ("loky", 4)])
def test_jobs_and_backend_leave_no_trace_in_the_bytes(tmp_path, undisturbed, backend, jobs):
    plan, plant = planned()
    assert written(tmp_path / "another place", plan, plant, jobs=jobs, backend=backend, name="z.parquet") == undisturbed


def test_a_second_run_in_the_same_process_gives_the_same_bytes(tmp_path, undisturbed):
    assert written(tmp_path / "again", *planned()) == undisturbed


def test_a_local_dask_cluster_gives_the_same_bytes_beside_another(tmp_path, undisturbed):
    """Whose dashboard has the port that dask's own would have."""
    pytest.importorskip("distributed")
    with socket.socket() as other:
        with suppress(OSError):  # it is taken already: all the better
            other.bind(("", 8787))
            other.listen()
        assert written(tmp_path / "dask", *planned(), jobs=2, backend="dask") == undisturbed


def test_the_hash_of_a_batch_knows_everything_that_moves_a_number():
    plan, _ = planned()
    keys = {batch.key for batch in plan.batches()}
    assert len(keys) == len(list(plan.batches()))
    same, _ = planned(campaign={"name": "another name"})
    assert {batch.key for batch in same.batches()} == keys
    for change in (
        {"injection": {"amplitude_pu": 0.002}},
        {"sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 24, "tolerance": 1e-6}},
        {"sweep": {"f_min_hz": 20.0, "f_max_hz": 900.0, "points": 24, "max_simulated_s": 1.0}},
        {"source": {"kind": "thevenin", "r_ohm": 0.012, "x_ohm": 0.25}},
        {"points": [{**TWO_POINTS[0], "active_power_mw": 0.31}, {**TWO_POINTS[1], "terminal_voltage_pu": 0.96}]},
        {"plant": {"id": "dpmsg-v1", "isolate": True}},
        {"plant": {"id": "dpmsg-v1", "isolate": True, "timeout_s": 1.0}},
    ):
        other, _ = planned(**change)
        assert not keys & {batch.key for batch in other.batches()}, change
    finer, _ = make_plan(Config.from_dict(plan.configuration), ReferenceTurbine(dt_s=25e-6)), None
    assert not keys & {batch.key for batch in finer.batches()}


# After an earlier run


def test_only_what_is_missing_is_measured_again(left_behind, undisturbed, counted):
    plan, plant, output, folder = left_behind
    keys = [batch.key for batch in plan.batches()]
    gone = keys[::2]
    for key in gone:
        (folder / key).unlink()
    seen = []
    run(plan, plant, output, jobs=1, backend="threading", report=lambda done, total, share: seen.append((done, total)))
    assert counted == gone
    assert output.read_bytes() == undisturbed
    assert not folder.exists()
    assert seen[0][0] > 0  # the progress begins with what was there
    assert seen[-1] == (48, 48)
    assert seen == sorted(seen)


def test_a_shard_with_a_flipped_bit_is_measured_again(left_behind, undisturbed, counted):
    plan, plant, output, folder = left_behind
    hurt = next(iter(plan.batches())).key
    text = bytearray((folder / hurt).read_bytes())
    where = text.rindex(b"\t") + 40  # a digit of a number: still base 64, still plausible
    text[where] = ord("B") if text[where] != ord("B") else ord("C")
    (folder / hurt).write_bytes(text)
    run(plan, plant, output, jobs=1, backend="threading")
    assert counted == [hurt]
    assert output.read_bytes() == undisturbed


def test_no_flipped_bit_and_no_cut_goes_unnoticed(left_behind):
    plan, _, _, folder = left_behind
    key = next(iter(plan.batches())).key
    whole = (folder / key).read_bytes()
    assert shards.read(folder, key) is not None
    dice = random.Random(5)
    for _ in range(300):
        hurt = bytearray(whole)
        hurt[dice.randrange(len(whole) - 1)] ^= 1 << dice.randrange(8)
        (folder / key).write_bytes(hurt)
        assert shards.read(folder, key) is None
    for length in (0, 1, 64, 65, len(whole) // 2, len(whole) - 2):
        (folder / key).write_bytes(whole[:length])
        assert shards.read(folder, key) is None


def test_a_shard_under_another_name_is_not_that_other(left_behind):
    plan, _, _, folder = left_behind
    first, second = [batch.key for batch in plan.batches()][:2]
    (folder / first).write_bytes((folder / second).read_bytes())
    assert shards.read(folder, first) is None


def test_shards_of_another_configuration_are_not_used(left_behind, counted, tmp_path):
    _, _, output, folder = left_behind
    plan, plant = planned(injection={"amplitude_pu": 0.0004})
    with pytest.raises(RunError, match=r"of another campaign.*--force to discard"):
        run(plan, plant, output, jobs=1, backend="threading")
    assert not counted
    run(plan, plant, output, jobs=1, backend="threading", discard=True)
    assert counted == [batch.key for batch in plan.batches()]
    assert output.read_bytes() == written(tmp_path / "fresh", plan, plant)
    assert not folder.exists()  # the strangers are gone too: the table is whole without them


def test_an_interrupted_run_goes_on_where_it_was(tmp_path, undisturbed, counted):
    plan, plant = planned()
    output = tmp_path / "y.parquet"

    def stop_after_three(done, total, share):
        if len(list(shards.folder_of(output).glob("?" * 64))) == 3:
            raise KeyboardInterrupt

    said = []
    with pytest.raises(KeyboardInterrupt):
        run(plan, plant, output, jobs=1, backend="threading", report=stop_after_three, say=said.append)
    assert said == []  # nothing was there to go on with
    assert not output.exists()
    kept = len(list(shards.folder_of(output).glob("?" * 64)))
    assert kept >= 3
    points = sum(
        len(batch.points) for batch in plan.batches() if shards.read(shards.folder_of(output), batch.key) is not None
    )
    counted.clear()
    run(plan, plant, output, jobs=2, backend="threading", say=said.append)
    assert said == [f"going on: {points}/48 points are measured already, {48 - points} left"]
    assert len(counted) == len(list(plan.batches())) - kept
    assert output.read_bytes() == undisturbed


def test_a_run_that_only_lacks_its_table_says_that_nothing_is_left_to_measure(left_behind, counted):
    plan, plant, output, _ = left_behind
    said = []
    for batch in plan.batches():
        shards.write(shards.folder_of(output), batch.key, host.measure(plant, batch))
    counted.clear()
    run(plan, plant, output, jobs=1, backend="threading", say=said.append)
    total = sum(len(batch.points) for batch in plan.batches())
    assert (said, counted) == ([f"going on: {total}/{total} points are measured already, 0 left"], [])


def test_batches_that_are_kept_are_not_made_again(monkeypatch):
    plan, _ = planned()
    asked, keys = Asked((plan,)), [batch.key for batch in plan.batches()]
    missing = Missing(asked, [k % 2 == 1 for k in range(len(keys))])
    made = []
    of_any = _AtAnyCondition.batch
    monkeypatch.setattr(_AtAnyCondition, "batch", lambda *given: made.append(given) or of_any(*given))
    assert [batch.key for batch in missing] == keys[1::2]
    assert len(made) == len(missing) == len(keys) // 2


def test_a_plan_of_one_operating_point_keeps_none_of_its_batches():
    """With an amplitude for each operating point there are as many plans: their shots would be most of the memory."""
    plan, _ = planned(points=TWO_POINTS[:1])
    before = set(vars(plan))
    keys = [batch.key for batch in plan.batches()]
    assert set(vars(plan)) == before
    assert [batch.key for batch in plan.batches_at(plan.conditions[0])] == keys


def test_that_many_batches_are_looked_for_is_said_before(left_behind, monkeypatch):
    plan, plant, output, _ = left_behind
    monkeypatch.setattr(campaign, "MANY", 1)
    said = []
    run(plan, plant, output, jobs=1, backend="threading", say=said.append)
    assert said[0] == "looking for what is measured already of 48 points"
    assert said[1].startswith("going on: ")
    said.clear()
    run(plan, plant, output.with_name("fresh.parquet"), jobs=1, backend="threading", say=said.append)
    assert said == []  # nothing to look for


def test_a_stranger_among_the_shards_stays(left_behind):
    plan, plant, output, folder = left_behind
    (folder / "notes.txt").write_text("mine")
    run(plan, plant, output, jobs=1, backend="threading")
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_a_disk_that_fills_up_ends_the_run_and_keeps_what_is_whole(tmp_path, undisturbed, monkeypatch):
    plan, plant = planned()
    output = tmp_path / "y.parquet"
    real, writes = shards.os.replace, []

    def full_after_two(source, target):
        writes.append(target)
        if len(writes) > 2:
            raise OSError(28, "No space left on device")
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(shards.os, "replace", full_after_two)
        with pytest.raises(OSError, match="No space left"):
            run(plan, plant, output, jobs=1, backend="threading")
    left = sorted(path.name for path in shards.folder_of(output).iterdir())
    assert len(left) == 3  # two shards and the lock; no temporary file
    run(plan, plant, output, jobs=1, backend="threading")
    assert output.read_bytes() == undisturbed


# One output, one run


def test_a_second_run_on_the_same_output_says_so(tmp_path):
    plan, plant = planned(n=4)
    output = tmp_path / "y.parquet"
    with (
        shards.locked(shards.folder_of(output)),
        pytest.raises(shards.OutputInUse, match="another run is writing this output"),
    ):
        run(plan, plant, output, jobs=1)
    run(plan, plant, output, jobs=1)  # the lock is gone with its holder
    assert output.exists()


def test_a_lock_that_was_removed_under_its_waiter_does_not_count(tmp_path, monkeypatch):
    """Between opening and locking the other run may finish and remove the folder: two files, two 'holders'."""
    import fcntl

    folder = tmp_path / "y.parquet.parts"
    real, opened = fcntl.flock, []

    def late(file, how):
        if not opened:
            opened.append(file)
            shards.remove(folder)
        real(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with shards.locked(folder):
        assert (folder / "lock").exists()
        with pytest.raises(shards.OutputInUse), shards.locked(folder):
            pass


# The grid of an operating point


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.2, 1.4])
@pytest.mark.parametrize("power_w", [0.2e6, 0.65e6])
def test_the_load_flow_on_the_black_box_is_the_closed_form(scale, power_w):
    """At 1.4 Z and 0.65 MW the loop is unstable; the voltage that belongs to it is found all the same."""
    r_ohm, l_h = scale * LINE_R_OHM, scale * LINE_L_H
    exact = oracle.terminal_voltage(power_w, r_ohm, l_h, 690.0)
    found = loadflow.terminal_voltage(ReferenceTurbine(), power_w, Grid(r_ohm, l_h, 690.0))
    print(f"\n  {power_w / 1e6} MW on {scale} Z: {found:.6f} V, closed form {exact:.6f} V", end="")
    assert found == pytest.approx(exact, rel=1e-9)


def test_a_grid_that_cannot_carry_the_power_has_no_operating_point():
    with pytest.raises(NotSettled, match=r"no operating point with 1\.3 MW"):
        loadflow.terminal_voltage(ReferenceTurbine(), 1.3e6, Grid(2 * LINE_R_OHM, 2 * LINE_L_H, 690.0))


def test_grids_of_operating_points_become_the_voltages_of_the_table(tmp_path):
    """1.0 Z is swept in place; 1.4 Z cannot be, and says so in its rows, beside the others."""
    grid = {"r_ohm": 0.012, "x_ohm": 0.25}
    points = [
        {"id": "firm", "active_power_mw": 0.65, "grid": grid},
        {"id": "weak", "active_power_mw": 0.65, "grid": {**grid, "scale": 1.4}},
        {"id": "none", "active_power_mw": 1.3, "grid": {**grid, "scale": 2.0}},
    ]
    sweep = {"f_hz": [10.0, 130.0, 400.0]}
    plan, plant = planned(points=points, sweep=sweep, source={"kind": "thevenin"})
    outcome = run(plan, plant, tmp_path / "y.parquet", jobs=1)
    assert outcome.statuses == {"ok": 3, "diverged": 3, "not_settled": 3}
    firm, weak, none = read_table(tmp_path / "y.parquet").responses
    v_pcc = firm.meta["terminal_voltage_pu"] * 690.0
    assert v_pcc == pytest.approx(687.02, abs=0.005)  # the page's
    exact = oracle.admittance_pn(firm.f_hz, 0.65e6, v_pcc)
    assert np.max(np.linalg.norm(firm.y - exact, axis=(1, 2)) / np.linalg.norm(exact, axis=(1, 2))) <= 1e-4
    assert "unstable: +9.57 rad/s" in weak.reason[0]
    assert weak.meta["terminal_voltage_pu"] is None
    assert "no equilibrium: 1.3e+06 W cannot be carried by 690 V" in none.reason[0]
    assert np.all(np.isnan(weak.y))
    assert validate_table(tmp_path / "y.parquet") == []


def test_a_plan_is_printed_without_a_shot(counted):
    plan, _ = planned()
    assert len(list(plan.shots())) == plan.n_shots == 2 * 2 * (24 + 2)  # two of the 24 rows are probed
    assert counted == []
    assert replace(plan, configuration={}).n_shots == plan.n_shots
