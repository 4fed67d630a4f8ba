"""A farm whose load flow is solved anew on every grid, against the explicit farm at each grid's own operating point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seqsweep.sweep.bank.following import FarmFollowing
from seqsweep.sweep.bank.judge import judge_bank
from seqsweep.tuning.bank.entries import BankEntry, bank_of
from seqsweep.tuning.farm.document import farm_of
from seqsweep.tuning.farm.entries import FarmError, NoLoadFlow
from seqsweep.tuning.farm.farm import judged, judged_with
from seqsweep.tuning.farm.on_grids import farm_on_grids
from seqsweep.tuning.farm.sources import with_source
from seqsweep.tuning.farm.units import Library, units_of

from ..support.farm_oracle import Star, closed_loop
from ..support.farms import document
from .test_farm_advice import region  # noqa: F401 (a fixture)

STAR = Star(0.0017 + 0.0175j, 400e-6, 0.004 + 0.085j)
POWERS_MW = (0.45, 0.6, 0.8)
SCALES = (0.5, 0.8, 1.0, 1.2, 1.35)


def devices(**others) -> list[dict]:
    return [
        {"name": f"wt{k}", "bus": f"t{k}", "table": "r", "active_power_mw": p, **others}
        for k, p in enumerate(POWERS_MW)
    ]


def following(region, **changed) -> FarmFollowing:  # noqa: F811
    content = {**document(STAR, 3), "device": devices(), **changed}
    return FarmFollowing(farm_on_grids(farm_of(content), Library(lambda name: region)))


@pytest.fixture(scope="module")
def farm(region) -> FarmFollowing:  # noqa: F811
    return following(region)


def grid(z_ohm: complex, **keys) -> BankEntry:
    element = {"kind": "series", "r_ohm": z_ohm.real, "x_ohm": z_ohm.imag}
    return BankEntry(f"{z_ohm:.4f}", document={"element": [element], **keys})


def judged_on(farm: FarmFollowing, entries: list[BankEntry]) -> dict:
    found = judge_bank(farm, farm.farm.bases, "", entries, output=None, jobs=1, elements=0)
    return {verdict.grid_id: verdict for verdict in found}


def critical(star: Star) -> complex:
    """The explicit farm's mode of the largest real part among those that oscillate in the band."""
    poles, _ = closed_loop(star, [1e6 * p for p in POWERS_MW])
    band = poles[(poles.imag > 20.0) & (poles.imag < 2000.0)]
    return complex(band[np.argmax(band.real)])


def test_every_grid_has_the_mode_of_the_explicit_farm_at_its_own_operating_point(farm):
    entries = [grid(scale * STAR.z_s) for scale in SCALES]
    found = judged_on(farm, entries)
    kinds = set()
    for scale, entry in zip(SCALES, entries, strict=True):
        verdict, true = found[entry.grid_id], critical(replace(STAR, z_s=scale * STAR.z_s))
        assert abs(complex(verdict.re_rad_s, verdict.im_rad_s) - true) < 3e-4
        assert verdict.verdict == ("unstable" if true.real > 0.0 else "stable")
        kinds.add(verdict.verdict)
    assert kinds == {"stable", "unstable"}


def test_terminals_are_where_the_explicit_load_flow_has_them_and_not_where_the_file_s_source_does(farm):
    for scale in (0.5, 1.35):
        _, v = closed_loop(replace(STAR, z_s=scale * STAR.z_s), [1e6 * p for p in POWERS_MW])
        np.testing.assert_allclose(farm.farm.flow(scale * STAR.z_s, 690.0).voltage_v, v, rtol=2e-6)
    held = farm.farm.flow(STAR.z_s, 690.0).voltage_v
    assert np.abs(np.abs(held) / np.abs(v) - 1.0).max() > 0.01


def test_a_grid_says_its_own_source_voltage(farm):
    """At 1.03 pu behind it the mode is the explicit farm's there, not that at 1 pu."""
    found = judged_on(farm, [grid(STAR.z_s, source_voltage_pu=1.03)])
    (verdict,) = found.values()
    at = complex(verdict.re_rad_s, verdict.im_rad_s)
    assert abs(at - critical(replace(STAR, source_v=1.03 * 690.0))) < 3e-4
    assert abs(at - critical(STAR)) > 0.1


def test_a_grid_that_cannot_carry_the_farm_or_takes_a_device_out_of_its_region_says_so(farm):
    found = judged_on(farm, [grid(4.0 * STAR.z_s), grid(1e-4 + 1e-3j, source_voltage_pu=0.9)])
    reasons = [verdict.reason for verdict in found.values()]
    assert all(verdict.verdict == "undecided" for verdict in found.values())
    assert any("the load flow has no solution" in reason for reason in reasons)
    assert any(reason.startswith("wt0: ") for reason in reasons)


def test_a_farm_that_has_no_load_flow_on_its_own_source_is_counted_on_a_stronger_one(region):  # noqa: F811
    z = 4.0 * STAR.z_s
    farm = following(region, source=[{"bus": "pcc", "r_ohm": z.real, "x_ohm": z.imag}])
    with pytest.raises(NoLoadFlow):
        farm.farm.flow(z, 690.0)
    (verdict,) = judged_on(farm, [grid(STAR.z_s)]).values()
    assert abs(complex(verdict.re_rad_s, verdict.im_rad_s) - critical(STAR)) < 3e-4


def test_a_bank_s_regions_and_tables_are_grids_of_a_farm_as_well(farm, tmp_path):
    """A table of Z(f) of the same line gives the same mode."""
    f = np.geomspace(0.5, 2500.0, 120)
    z = STAR.z_s.real + 1j * STAR.z_s.imag * f / 50.0
    lines = ["f_hz,r_ohm,x_ohm", *(f"{a!r},{b.real!r},{b.imag!r}" for a, b in zip(f.tolist(), z.tolist(), strict=True))]
    (tmp_path / "line.csv").write_text("\n".join(lines))
    (table,) = judged_on(farm, list(bank_of(tmp_path))).values()
    (element,) = judged_on(farm, [grid(STAR.z_s)]).values()
    assert table.re_rad_s == pytest.approx(element.re_rad_s, abs=1e-5)


def test_a_device_of_one_operating_point_is_refused_with_the_way_out(region):  # noqa: F811
    fixed = [{"name": "wt0", "bus": "t0", "table": "r", "op": "many"}]
    with pytest.raises(FarmError, match=r"wt0 has one operating point of r; .* give active_power_mw"):
        following(region, device=fixed)


def test_a_network_with_a_loop_is_refused(region):  # noqa: F811
    loop = {"name": "loop", "from": "t0", "to": "t1", "r_ohm": 0.001, "x_ohm": 0.01}
    with pytest.raises(FarmError, match="the network has a loop"):
        following(region, series=[*document(STAR, 3)["series"], loop])


def test_a_farm_far_from_where_it_was_counted_is_left_undecided(farm):
    """The count of modes between devices is not carried over where a factor may have turned."""
    counted = farm.farm.counted
    turned = tuple(type(f)(-f.pp, f.pn, f.np, -f.nn) for f in counted.factors)
    far = FarmFollowing(replace(farm.farm, counted=replace(counted, factors=turned)))
    (verdict,) = judged_on(far, [grid(STAR.z_s)]).values()
    assert verdict.verdict == "undecided"
    assert "is far from that on its file's own source" in verdict.reason


def test_a_grid_side_damper_stays_as_it_is_set_on_the_file_s_own_source(region):  # noqa: F811
    """On another grid the mode is that of the whole farm there with the same damper, and not without it."""
    content = {**document(STAR, 3), "device": devices(), "damper": [{"name": "gsdc", "bus": "pcc"}]}
    library = Library(lambda name: region)
    own = judged(farm_of(content), library)
    weaker = with_source(own.entry, 1.2 * STAR.z_s)
    there = judged_with(weaker, units_of(weaker, library)[0], own.dampers).judgement
    (found,) = judged_on(FarmFollowing(farm_on_grids(own.entry, library)), [grid(1.2 * STAR.z_s)]).values()
    mode = complex(found.re_rad_s, found.im_rad_s)
    assert np.abs(there.in_band - mode).min() < 5e-3
    assert found.verdict == there.verdict
    assert abs(mode - critical(replace(STAR, z_s=1.2 * STAR.z_s))) > 1.0
