"""Jumps of the admittance: limits and mode switches are found, smooth devices are left whole."""

from __future__ import annotations

import os

import numpy as np
import pytest

from seqsweep.identify.surrogate.design import WIDTH, first_points
from seqsweep.identify.surrogate.jumps import EVIDENCE, Border, Cut, _features, _splits, _thinned, find_border
from seqsweep.identify.surrogate.partitions import evidence_of
from seqsweep.identify.surrogate.region import Region, scale_of
from seqsweep.identify.surrogate.sparse_rational import Data
from seqsweep.identify.surrogate.store import surrogate_of, write_surrogate
from seqsweep.identify.surrogate.surrogate import AXES, SurrogateError, _data_of
from seqsweep.identify.table.read import read_table
from seqsweep.identify.table.write import write_table
from seqsweep.sweep.config.sections import Config
from seqsweep.sweep.region.adaptive import sweep_region
from seqsweep.sweep.region.figure import plot_map

from ..support.regions import BASES, PQV, PV, unseen
from ..support.switching import KINDS, drawn, limited, placed, swept, switched


@pytest.mark.evidence
@pytest.mark.parametrize(("kind", "most"), [("limit", 24), ("smooth", 13)])
def test_jumps_are_found_and_located(kind, most):
    assert not placed(kind, PV, 11, most).wrong


@pytest.mark.parametrize("kind", ["limit", "mode", "smooth"])
@pytest.mark.parametrize(("region", "n"), [(PV, 14), (PQV, 22)], ids=["PV", "PQV"])
def test_of_all_splits_the_device_s_own_has_the_most_evidence_and_a_smooth_device_has_none(kind, region, n):
    """Three random placements; several features may part the sweeps alike."""
    for seed in range(3):
        rule, _ = drawn(kind, region, np.random.default_rng(seed))
        points = np.vstack([first_points(region, seed), unseen(region, n, seed)])[:n]
        own = np.array([rule(point) == rule(points[0]) for point in points])
        splits, evidence = splits_of(points, region, [swept(point, rule) for point in points])
        if kind == "smooth":
            assert evidence.max() < 0.0
        elif min(own.sum(), n - own.sum()) >= 3:
            best = splits[int(evidence.argmax())]
            assert np.array_equal(best, own) or np.array_equal(best, ~own)
            assert evidence.max() > EVIDENCE


def splits_of(points, region, responses):
    """Splits with three sweeps or more on either side, and the evidence for each."""
    _, data, noise = _data_of(responses, scale_of(points, region).unit(points))
    few = _thinned(data, noise)
    splits = _splits(points, 3, _features(()))
    return splits, evidence_of(few.data, few.variance, splits)


@pytest.mark.evidence
@pytest.mark.parametrize(("kind", "most"), KINDS.items())
def test_jumps_are_found_in_fifty_random_placements(kind, most):
    first, n = int(np.random.default_rng().integers(1 << 30)), int(os.environ.get("SEQSWEEP_TRIALS", "50"))
    print(f"\n  seed {first}")
    wrong = []
    for seed in range(first, first + n):
        found = placed(kind, (PV, PQV)[seed % 2], seed, most)
        print(f"  {kind} {seed}: {found.at} in {found.found}, {found.sweeps} sweeps", flush=True)
        wrong += [f"{seed}: {found.wrong}"] if found.wrong else []
    print(f"\n  {kind}: {n - len(wrong)} of {n} right")
    assert not wrong


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Thirty listed operating points of a device with a current limit, as an import would have them."""
    path = tmp_path_factory.mktemp("jump") / "y.parquet"
    points = np.vstack([first_points(PV, 3), unseen(PV, 24, 4)])
    responses = [swept(point, limited(0.8)) for point in points]
    listed = [{"op_id": r.meta["op_id"], **{a: r.meta[a] for a in AXES}} for r in responses]
    meta = {"f1_hz": 50.0, "bases": BASES, "power_meaning": "machine", "operating_points": listed, "configuration": {}}
    write_table(path, responses, {**meta, "plant": {"id": "limited"}})
    return read_table(path)


@pytest.fixture(scope="module")
def split(table):
    return surrogate_of(table)


def test_a_table_is_split_and_nothing_is_said_in_the_gap(table, split, tmp_path):
    surrogate = split
    cut = surrogate.border.cuts[0]
    assert cut.feature == "current"
    assert cut.low <= 0.8 <= cut.high
    at = unseen(PV, 200, 9)
    at = at[surrogate.holds(at)]
    truth = np.array([swept(point, limited(0.8)).y for point in at])
    found = np.array([surrogate.response(point).y for point in at])
    off = np.linalg.norm(found - truth, axis=(2, 3)) / np.linalg.norm(truth, axis=(2, 3))
    assert off.max() < 1e-2
    middle = surrogate.border.question(surrogate.points, PV.samples(512), 1.0)
    with pytest.raises(SurrogateError, match=r"the device changes between current .* nothing is interpolated"):
        surrogate.evaluate(middle)
    write_surrogate(tmp_path / "s.parquet", surrogate, table)
    assert surrogate_of(read_table(tmp_path / "s.parquet")).border == surrogate.border


def test_the_gap_is_on_the_map(split, tmp_path):
    plot_map(tmp_path / "map.svg", split, None)
    assert (tmp_path / "map.svg").stat().st_size > 10_000


def test_features_that_disagree_leave_a_gap():
    border = Border((Cut("active power", 0.5, 0.6), Cut("current", 0.5, 0.6)))
    points = np.array([[0.3, 0.0, 1.0], [0.9, 0.0, 1.0], [0.62, 0.0, 1.1], [0.55, 0.0, 1.0]])
    assert border.side(points).tolist() == [0, 1, -1, -1]


def test_a_device_that_switches_at_a_value_of_a_parameter_is_parted_by_it():
    """A synthetic device over P, V and one parameter: another one above 0.3, which no power or voltage tells."""
    random = np.random.default_rng(2)
    box = Region(np.array([0.2, 0.0, 0.9, 0.0]), np.array([1.3, 0.0, 1.1, 1.0]), ("gain",))
    points = np.vstack([first_points(box, 1), box.low + random.random((18, 4)) * (box.high - box.low)])
    x = scale_of(points, box).unit(points)
    slopes = random.normal(size=(2, 6, 4, 3))
    side = (points[:, 3] > 0.3).astype(int)
    y = np.array([1.0 + 0.3 * slopes[s] @ each for s, each in zip(side, x, strict=True)]).transpose(1, 0, 2)
    data = Data(x, y.astype(complex), 1.0 / np.linalg.norm(y, axis=2))
    border = find_border(points, data, scale_of(points, box).unit(box.samples(32)), None, ("gain",)).border
    assert border.cuts[0].feature == "gain"
    assert border.cuts[0].low <= 0.3 <= border.cuts[0].high
    assert str(border).startswith("gain 0.")
    assert np.array_equal(border.side(points), side)


REGION = {
    "active_power_mw": [0.5, 0.9],
    "terminal_voltage_pu": [0.9, 1.1],
    "tolerance": 0.01,
    "most": 40,
}


def test_a_campaign_locates_the_border_and_certifies_both_sides(tmp_path):
    rule = switched(0, 0.71)
    plain = {
        "campaign": {"name": "jump"},
        "plant": {"id": "dpmsg-v1"},
        "sweep": {"f_hz": [10.0, 20.0], "operating_points": REGION},
    }

    def sweep(config, path):
        points = [[p.active_power_mw, 0.0, p.terminal_voltage_pu] for p in config.operating_point]
        responses = [swept(np.array(point), rule) for point in points]
        listed = [{"op_id": r.meta["op_id"], **{a: r.meta[a] for a in AXES}} for r in responses]
        meta = {"f1_hz": 50.0, "bases": BASES, "power_meaning": "machine", "operating_points": listed}
        write_table(path, responses, {**meta, "configuration": config.to_dict(), "plant": {"id": "dpmsg-v1"}})

    said: list[str] = []
    outcome = sweep_region(Config.from_dict(plain), tmp_path / "y.parquet", sweep, said.append)
    assert outcome.certified
    assert outcome.progress.width <= WIDTH
    assert "the device changes between active power" in said[-1]
