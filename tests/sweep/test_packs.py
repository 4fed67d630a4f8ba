"""Shards packed by the hundred: the same bytes, nothing measured twice, nothing damaged unnoticed."""

from __future__ import annotations

import random
from collections import Counter

import numpy as np
import pytest

from seqsweep.identify.table.format import content_hash
from seqsweep.plant.registry import make_plant
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.measure.measure import measure
from seqsweep.sweep.measure.rows import failed_batch
from seqsweep.sweep.planning import make_plan
from seqsweep.sweep.run import host, packs, shards, store
from seqsweep.sweep.run.campaign import run

N_POINTS = 11


@pytest.fixture(scope="module")
def asked():
    """A campaign of several operating points, two batches each, and its plant."""
    powers = np.linspace(0.2, 1.2, N_POINTS).round(3).tolist()
    plant = make_plant("dpmsg-v1")
    content = {
        "campaign": {"name": "packed"},
        "plant": {"id": "dpmsg-v1"},
        "operating_point": [{"active_power_mw": p, "terminal_voltage_pu": 1.0} for p in powers],
        "sweep": {"f_min_hz": 200.0, "f_max_hz": 900.0, "points": 20, "probes": 0},
    }
    return make_plan(Config.from_dict(content), plant), plant


@pytest.fixture(scope="module")
def undisturbed(asked, tmp_path_factory):
    """Bytes of the table where nothing is packed."""
    output = tmp_path_factory.mktemp("undisturbed") / "y.parquet"
    run(*asked, output, jobs=1)
    return output.read_bytes()


@pytest.fixture(autouse=True)
def soon_packed(monkeypatch):
    monkeypatch.setattr(store, "LOOSE", 4)


@pytest.fixture
def counted(monkeypatch):
    """How often every batch is measured."""
    found = Counter()

    def counting(plant, batches):
        found.update(batch.key for batch in batches)
        return [measure(plant, batch) for batch in batches]

    monkeypatch.setattr(host, "measure_together", counting)
    return found


def stopped(asked, output, after):
    """A run that is interrupted after so many reports; the folder of its shards."""
    reports = iter(range(after))

    def report(done, total, share):
        if next(reports, None) is None:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(*asked, output, jobs=1, report=report)
    return shards.folder_of(output)


def packed(folder, results):
    """Some results as shards, and these in the pack 0."""
    for key, result in results:
        shards.write(folder, key, result)
    return packs.write(folder, 0, [(key, shards.parts_of(folder, key)) for key, _ in results])


@pytest.mark.parametrize("jobs", [1, 2])
def test_packed_or_not_the_table_is_the_same(tmp_path, asked, undisturbed, counted, jobs):
    output = tmp_path / "y.parquet"
    run(*asked, output, jobs=jobs)
    assert output.read_bytes() == undisturbed
    assert [path.name for path in tmp_path.iterdir()] == ["y.parquet"]
    assert set(counted.values()) == {1}


@pytest.mark.parametrize("after", [4, 7, 13, 22])
def test_an_interrupted_run_goes_on_from_its_packs(tmp_path, asked, undisturbed, counted, after):
    output = tmp_path / "y.parquet"
    folder = stopped(asked, output, after)
    assert len(packs.numbers(folder)) == after // 4
    assert len(shards.keys(folder)) == after % 4  # bounded, however many were measured
    counted.clear()
    run(*asked, output, jobs=1)
    assert sum(counted.values()) == 2 * N_POINTS - after
    assert output.read_bytes() == undisturbed


def test_a_shard_that_is_packed_and_still_there_costs_nothing(tmp_path, asked, undisturbed, counted, monkeypatch):
    """As `kill -9` leaves it behind between the pack's renaming and the removal of what is in it."""
    output, real = tmp_path / "y.parquet", packs.write

    def last_deed(*arguments):
        real(*arguments)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(packs, "write", last_deed)
        with pytest.raises(KeyboardInterrupt):
            run(*asked, output, jobs=1)
    assert len(packs.numbers(shards.folder_of(output))) == 1
    assert len(shards.keys(shards.folder_of(output))) == 4
    counted.clear()
    run(*asked, output, jobs=1)
    assert sum(counted.values()) == 2 * N_POINTS - 4
    assert output.read_bytes() == undisturbed


@pytest.mark.parametrize("cut", [0, 1000, -1])
def test_of_a_pack_that_was_cut_everything_is_measured_again(tmp_path, asked, undisturbed, counted, cut):
    output = tmp_path / "y.parquet"
    folder = stopped(asked, output, 13)
    hurt = packs.path_of(folder, 1)
    hurt.write_bytes(hurt.read_bytes()[:cut])
    counted.clear()
    run(*asked, output, jobs=1)
    assert sum(counted.values()) == 2 * N_POINTS - 13 + 4
    assert output.read_bytes() == undisturbed


def test_a_damaged_shard_in_a_pack_is_measured_again_alone(tmp_path, asked, undisturbed, counted):
    output = tmp_path / "y.parquet"
    folder = stopped(asked, output, 13)
    hurt = packs.path_of(folder, 1)
    content = bytearray(hurt.read_bytes())
    content[300] ^= 1
    hurt.write_bytes(content)
    counted.clear()
    run(*asked, output, jobs=1)
    assert sum(counted.values()) == 2 * N_POINTS - 13 + 1
    assert output.read_bytes() == undisturbed


def test_of_a_shard_in_several_packs_the_last_is_read_however_often_places_are_joined(tmp_path):
    """Its first place may be damaged, and more packs may have come since it was measured again."""
    first, again, further = (np.array([(key, 0, 1, 1, n)], packs.PLACE) for n, key in enumerate((b"b", b"b", b"a")))
    joined = store._sorted([store._sorted([first, again]), further])
    assert joined[["key", "pack"]].tolist() == [(b"a", 2), (b"b", 1)]


def test_no_flipped_bit_in_a_pack_goes_unnoticed(tmp_path, asked):
    plan, plant = asked
    results = [(batch.key, measure(plant, batch)) for batch in plan.batches_at(plan.conditions[0])]
    places = packed(tmp_path, results)
    path, dice = packs.path_of(tmp_path, 0), random.Random(7)
    whole = path.read_bytes()
    sound = [packs.read(tmp_path, place) for place in packs.places(tmp_path, 0)]
    assert repr(sound) == repr([result for _, result in results])  # NaN is not NaN's equal
    for _ in range(300):
        hurt, at = bytearray(whole), dice.randrange(len(whole))
        hurt[at] ^= 1 << dice.randrange(8)
        path.write_bytes(hurt)
        read = [packs.read(tmp_path, place) for place in packs.places(tmp_path, 0)]
        beyond = at >= int(places["at"][-1] + places["size"][-1])
        assert read == [] if beyond else read.count(None) == 1


def test_a_batch_without_numbers_is_packed_word_for_word(tmp_path, asked):
    plan, _ = asked
    batch = next(plan.batches())
    failed = failed_batch(batch, "failed", 'the box said: "näh"\t\n and went')
    (place,) = packed(tmp_path, [(batch.key, failed)])
    assert repr(packs.read(tmp_path, place)) == repr(failed)


def test_the_work_of_another_campaign_is_known_by_its_packs(tmp_path, asked):
    output = tmp_path / "y.parquet"
    folder = stopped(asked, output, 9)
    plan, _ = asked
    assert len(packs.numbers(folder)) == 2
    assert store.Folder(folder).keys() == {batch.key for batch, _ in zip(plan.batches(), range(9), strict=False)}


def test_keys_are_hashes_of_all_that_a_batch_knows(asked):
    plan, _ = asked
    for batch in plan.batches():
        assert batch.key == content_hash({**batch.facts(), **plan._facts()})
        assert batch.key == plan.batch(batch.condition, batch.points).key
