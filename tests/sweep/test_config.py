"""The campaign file: what is right comes back whole, what is wrong is named at its line, all of it at once."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from seqsweep.sweep.config import file as module
from seqsweep.sweep.config.sections import Config, ConfigError, load_config

ROOT = Path(__file__).parents[2]
TEMPLATE = ROOT / "sweep" / "config" / "template.toml"
EXAMPLE = ROOT / "examples" / "table1.toml"

GOOD = """\
[campaign]
name = "test"

[plant]
id = "dpmsg-v1"

[[operating_point]]
id = "p065"
active_power_mw = 0.65
terminal_voltage_pu = 1.0

[sweep]
f_min_hz = 1.0
f_max_hz = 1000.0
points = 100
"""
F_LIST = GOOD.replace("f_min_hz = 1.0\nf_max_hz = 1000.0\npoints = 100", "f_hz = [1, 2.5, 77.0]")
THEVENIN = GOOD + '[source]\nkind = "thevenin"\nr_ohm = 0.012\nx_ohm = 0.25\n'
GRID = THEVENIN.replace("r_ohm = 0.012\nx_ohm = 0.25\n", "").replace(
    "terminal_voltage_pu = 1.0", "grid = { r_ohm = 0.012, x_ohm = 0.25, scale = 1.4 }"
)

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def to_file(text: str) -> Path:
        path = tmp_path / "campaign.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return to_file


def problems(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    return [problem.replace(f"{path}:", "") for problem in caught.value.problems]


# What is right


def test_defaults_are_filled_in(write: Write) -> None:
    config = load_config(write(GOOD))
    assert (config.sweep.spacing, config.sweep.tolerance, config.sweep.max_simulated_s) == ("log", 1e-5, 60.0)
    assert config.injection.model_dump(exclude_none=True) == {
        "kind": "series_voltage",
        "signal": "tone",
        "amplitude_pu": 0.0005,
    }
    assert config.source.kind == "ideal"
    assert config.plant.isolate is None
    assert config.plant.timeout_s is None


@pytest.mark.parametrize("text", [GOOD, F_LIST, THEVENIN, GRID, GOOD + "[plant.parameters]\nk_pp = 0.1\nname = 'x'\n"])
def test_a_dictionary_rebuilds_the_campaign_through_json(write: Write, text: str) -> None:
    config = load_config(write(text))
    plain = json.loads(json.dumps(config.to_dict()))
    assert plain == config.to_dict()
    assert Config.from_dict(plain) == config
    assert Config.from_dict(plain).to_dict() == plain


def test_whole_numbers_and_their_floats_are_the_same_campaign(write: Write) -> None:
    one = load_config(write(GOOD)).to_dict()
    other = load_config(write(GOOD.replace("1.0", "1").replace("1000.0", "1000"))).to_dict()
    assert json.dumps(one) == json.dumps(other)


def test_template_and_example_are_one_campaign() -> None:
    assert load_config(TEMPLATE) == load_config(EXAMPLE)
    assert load_config(TEMPLATE).to_dict()["operating_point"][0]["active_power_mw"] == 0.65


def test_what_the_template_has_commented_out_is_accepted_too() -> None:
    text = TEMPLATE.read_text(encoding="utf-8")
    for key in ("isolate", "timeout_s", "tolerance", "max_simulated_s", "k_pp", "[plant.parameters]"):
        assert f"# {key}" in text
        text = text.replace(f"# {key}", key)
    import tomllib

    config = Config.from_dict(tomllib.loads(text))
    given = config.to_dict()
    assert given["plant"]["parameters"] == {"k_pp": 0.085}
    assert given["sweep"] == load_config(TEMPLATE).to_dict()["sweep"], "the comments show the defaults"


def test_operating_points_without_id_are_called_after_their_values(write: Write) -> None:
    config = load_config(write(GOOD.replace('id = "p065"\n', "")))
    assert config.operating_point[0].id == "p0.65-v1"
    grid = load_config(write(GRID.replace('id = "p065"\n', "")))
    assert grid.operating_point[0].id == "p0.65-r0.012-x0.25-e1-s1.4"


def test_overrides_change_add_and_the_last_one_wins(write: Write) -> None:
    config = load_config(
        write(GOOD),
        [
            "injection.amplitude_pu=0.01",
            "operating_point.0.active_power_mw=0.7",
            "operating_point.0.active_power_mw = 0.8",
            'plant.parameters.mode = "a=b"',
        ],
    )
    assert config.injection.amplitude_pu == 0.01
    assert config.operating_point[0].active_power_mw == 0.8
    assert config.plant.parameters == {"mode": "a=b"}


def test_a_byte_order_mark_and_windows_line_ends_are_harmless(tmp_path: Path) -> None:
    path = tmp_path / "campaign.toml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())
    assert load_config(path).campaign.name == "test"


def test_a_configuration_is_frozen(write: Write) -> None:
    config = load_config(write(GOOD))
    with pytest.raises(ValueError, match="frozen"):
        config.sweep.points = 3


# What is refused: file, line, key, what was given, what is needed, in which unit

REFUSALS: list[tuple[str, str, str, str]] = [
    # name, what is replaced, by what, what the message says
    ("empty name", 'name = "test"', 'name = ""', r'^2: campaign.name: given ""; needed: a name in quotes'),
    ("no name", 'name = "test"', "", r"^1: campaign.name: missing; needed: a name"),
    ("plant id", '"dpmsg-v1"', "3", r'^5: plant.id: given 3; needed: the id of a plant in quotes, such as "dpmsg-v1"'),
    ("isolate", "[[op", 'isolate = "yes"\n[[op', r'^7: plant.isolate: given "yes"; needed: true or false'),
    ("timeout", "[[op", "timeout_s = 0\n[[op", r"^7: plant.timeout_s: given 0; needed: a number above 0, in s$"),
    ("parameters", "[[op", "parameters = 1\n[[op", r"^7: plant.parameters: given 1; needed: a table"),
    ("nan parameter", "[[op", "parameters.k = nan\n[[op", r"^7: plant.parameters.k: given nan; needed: a finite num"),
    ("date", "[[op", "parameters.k = [1, 1979-05-27]\n[[op", r"^7: plant.parameters.k.1: given 1979-05-27; needed"),
    ("op id", '"p065"', '"p 65"', r"^8: operating_point.0.id: given \"p 65\"; needed: a name of letters, digits"),
    ("op id newline", '"p065"', r'"p\n"', r'^8: operating_point.0.id: given "p\\n"; needed'),
    (
        "power text",
        "= 0.65",
        '= "0.65"',
        r'^9: operating_point.0.active_power_mw: given "0.65"; needed: a number, in MW',
    ),
    ("power bool", "= 0.65", "= true", r"^9: operating_point.0.active_power_mw: given true; needed: a number, in MW"),
    ("power nan", "= 0.65", "= nan", r"^9: .*active_power_mw: given nan; needed: a number, in MW"),
    (
        "no power",
        "active_power_mw = 0.65",
        "",
        r"^7: operating_point.0.active_power_mw: missing; needed: a number, in MW",
    ),
    (
        "voltage",
        "voltage_pu = 1.0",
        "voltage_pu = -1",
        r"^10: .*terminal_voltage_pu: given -1; needed: a number above 0 and at most 5, in pu",
    ),
    (
        "no voltage",
        "terminal_voltage_pu = 1.0",
        "",
        r"^7: .*terminal_voltage_pu: missing; needed: .* in pu \(or a table grid\)",
    ),
    (
        "single brackets",
        "[[operating_point]]",
        "[operating_point]",
        r"^7: operating_point: .*single brackets; write \[\[",
    ),
    (
        "f negative",
        "f_min_hz = 1.0",
        "f_min_hz = -1.0",
        r"^13: sweep.f_min_hz: given -1.0; needed: a number above 0, in Hz",
    ),
    ("f infinite", "f_max_hz = 1000.0", "f_max_hz = inf", r"^14: sweep.f_max_hz: given inf; needed: .* in Hz"),
    (
        "f reversed",
        "f_max_hz = 1000.0",
        "f_max_hz = 0.5",
        r"^14: sweep.f_max_hz: given 0.5; needed: .*f_min_hz = 1, in Hz",
    ),
    ("f missing", "f_max_hz = 1000.0", "", r"^12: sweep.f_max_hz: missing; needed: .*, or a list f_hz"),
    ("points", "points = 100", "points = 100.0", r"^15: sweep.points: given 100.0; needed: a whole number from 2 to"),
    ("points bool", "points = 100", "points = true", r"^15: sweep.points: given true; needed: a whole number"),
    ("one point", "points = 100", "points = 1", r"^15: sweep.points: given 1; needed: a whole number from 2"),
    ("too many", "points = 100", "points = 100000000", r"^15: sweep.points: given 100000000; needed: .* to 1000000"),
    ("both", "points = 100", "points = 100\nf_hz = [3]", r"^15: sweep.points: given beside f_hz; needed: either"),
    (
        "spacing",
        "points = 100",
        'points = 100\nspacing = "lin"',
        r'^16: sweep.spacing: given "lin"; needed: "log", "linear"',
    ),
    (
        "tolerance",
        "points = 100",
        "points = 100\ntolerance = 1",
        r"^16: sweep.tolerance: given 1; needed: .*between 0 and 1",
    ),
    (
        "limit",
        "points = 100",
        "points = 9\nmax_simulated_s = 0",
        r"^16: sweep.max_simulated_s: given 0; needed: .*in s",
    ),
    ("section value", "[sweep]", "[swept]", r"^12: swept: unknown section; did you mean \[sweep\]\?"),
    ("huge", "= 0.65", "= 1" + "0" * 400, r"^9: .*active_power_mw: given 10+\.\.\.; needed: a number, in MW"),
]

ADDED: list[tuple[str, str, str, str]] = [
    # name, base, what is added, what the message says
    (
        "adaptive",
        GOOD,
        'spacing = "adaptive"\n[injection]\nsignal = "qrb"',
        r'sweep.spacing: given "adaptive" with a qrb; needed: signal = "tone"',
    ),
    (
        "noise",
        GOOD,
        '[injection]\nsignal = "noise"',
        r'^17: injection.signal: given "noise"; needed: "tone", "multisine", "prbs", "qrb" or "chirp"',
    ),
    (
        "period of a tone",
        GOOD,
        "[injection]\nperiod_s = 1.0",
        r"^17: injection.period_s: given, but a tone's window follows from its frequency",
    ),
    (
        "automatic",
        GOOD,
        '[injection]\namplitude_pu = "automatic"',
        r'injection.amplitude_pu: given "automatic"; needed: a number above 0 .* or "auto"',
    ),
    (
        "limit",
        GOOD,
        "[injection]\namplitude_max_pu = 0.01",
        r'injection.amplitude_max_pu: given, but it goes with amplitude_pu = "auto" alone',
    ),
    (
        "big",
        GOOD,
        "[injection]\namplitude_pu = 5",
        r"^17: injection.amplitude_pu: given 5; needed: .*at most 0.2, in pu",
    ),
    (
        "negative",
        GOOD,
        "[injection]\namplitude_pu = -0.1",
        r"injection.amplitude_pu: given -0.1; needed: a number above 0",
    ),
    (
        "kind",
        GOOD,
        '[injection]\nkind = "series"',
        r'injection.kind: given "series"; needed: "series_voltage" or "shunt_',
    ),
    (
        "shunt",
        GOOD,
        '[injection]\nkind = "shunt_current"',
        r"^17: injection.kind: \"shunt_current\" cannot .* ideal source",
    ),
    ("source kind", GOOD, '[source]\nkind = "weak"', r'source.kind: given "weak"; needed: "ideal" or "thevenin"'),
    (
        "no x",
        GOOD,
        '[source]\nkind = "thevenin"',
        r"^16: source.x_ohm: missing; needed: a number above 0 .*in ohm at f1",
    ),
    ("x zero", GOOD, '[source]\nkind = "thevenin"\nx_ohm = 0', r"^18: source.x_ohm: given 0; needed: a number above 0"),
    ("r negative", THEVENIN.replace("0.012", "-1"), "", r"^18: source.r_ohm: given -1; needed: .*at least 0, in ohm"),
    ("ideal x", GOOD, "[source]\nx_ohm = 0.25", r"^17: source.x_ohm: given, but an ideal source has no impedance"),
    (
        "grid and v",
        GRID.replace("grid =", "terminal_voltage_pu = 1\ngrid ="),
        "",
        r"^11: .*grid: given beside terminal_volt",
    ),
    ("grid and x", GRID, "x_ohm = 0.25", r"source.x_ohm: given beside the grid of every operating point"),
    (
        "grid x",
        GRID.replace("x_ohm = 0.25", "x_ohm = 0"),
        "",
        r"^10: .*grid.x_ohm: given 0; needed: a number above 0, in ohm",
    ),
    ("grid key", GRID.replace("scale", "scael"), "", r"^10: .*grid.scael: unknown key; did you mean scale\?"),
    ("empty list", F_LIST.replace("[1, 2.5, 77.0]", "[]"), "", r"^13: sweep.f_hz: given \[\]; needed: a list"),
    (
        "not a list",
        F_LIST.replace("[1, 2.5, 77.0]", "5"),
        "",
        r"^13: sweep.f_hz: given 5; needed: a list of increasing",
    ),
    ("zero", F_LIST.replace("[1,", "[0,"), "", r"^13: sweep.f_hz.0: given 0; needed: .*above 0, in Hz"),
    (
        "negative",
        F_LIST.replace("[1, 2.5,", "[1, -2.5,"),
        "",
        r"^13: sweep.f_hz.1: given -2.5; needed: .*above 0, in Hz",
    ),
    ("text", F_LIST.replace("[1,", '["1",'), "", r'^13: sweep.f_hz.0: given "1"; needed'),
    ("unsorted", F_LIST.replace("[1,", "[3,"), "", r"^13: sweep.f_hz.1: 2.5 Hz follows 3 Hz; needed: .*increase"),
    ("twice", F_LIST.replace("[1,", "[2.5,"), "", r"^13: sweep.f_hz.1: 2.5 Hz is there twice; needed"),
    ("misspelt", GOOD, "pionts = 3", r"^16: sweep.pionts: unknown key; did you mean points\?"),
    ("strange", GOOD, "colour = 3", r"^16: sweep.colour: unknown key; known: f_min_hz, f_max_hz"),
    ("misplaced", GOOD, "amplitude_pu = 3", r"^16: sweep.amplitude_pu: unknown key here; it belongs in \[injection\]"),
    ("strange section", GOOD, "[verify]\na = 1", r"^16: verify: unknown section; known: \[campaign\], \[plant\]"),
    (
        "plural",
        GOOD,
        "[[operating_points]]\na = 1",
        r"^16: operating_points: unknown section; did you mean \[operating_point\]",
    ),
]


@pytest.mark.parametrize(("old", "new", "said"), [r[1:] for r in REFUSALS], ids=[r[0] for r in REFUSALS])
def test_a_wrong_value_is_refused_at_its_line(write: Write, old: str, new: str, said: str) -> None:
    assert old in GOOD
    found = problems(write(GOOD.replace(old, new, 1)))
    assert any(re.search(said, problem) for problem in found), found


@pytest.mark.parametrize(("base", "added", "said"), [r[1:] for r in ADDED], ids=[r[0] for r in ADDED])
def test_a_wrong_addition_is_the_only_problem(write: Write, base: str, added: str, said: str) -> None:
    found = problems(write(base + added + "\n"))
    assert len(found) == 1, found
    assert re.search(said, found[0]), found


def test_two_operating_points_with_one_id_are_refused(write: Write) -> None:
    again = '[[operating_point]]\nid = "p065"\nactive_power_mw = 0.7\nterminal_voltage_pu = 1\n'
    assert problems(write(GOOD + again)) == [
        '17: operating_point.1.id: "p065" is also operating_point.0; every operating point needs its own id'
    ]


def test_equal_operating_points_without_id_are_refused_too(write: Write) -> None:
    point = "[[operating_point]]\nactive_power_mw = 0.7\nterminal_voltage_pu = 1\n"
    (found,) = problems(write(GOOD + 2 * point))
    assert re.search(r'operating_point.2.id: "p0.7-v1" is also operating_point.1', found)


def test_a_suggested_key_is_not_reported_missing_as_well(write: Write) -> None:
    for old, new in [("f_min_hz", "f_mn_hz"), ("terminal_voltage_pu", "terminl_voltage_pu"), ("name", "nmae")]:
        (found,) = problems(write(GOOD.replace(old, new)))
        assert f"did you mean {old}?" in found


def test_everything_wrong_is_said_at_once_in_the_order_of_the_file(write: Write) -> None:
    text = GOOD.replace("0.65", "true").replace("points = 100", "points = 0").replace("1000.0", "0.1") + (
        '[injection]\nkind = "shunt_current"\namplitude_pu = 5\n[plants]\n'
    )
    found = problems(write(text))
    assert [problem.split(": ")[:2] for problem in found] == [
        ["9", "operating_point.0.active_power_mw"],
        ["14", "sweep.f_max_hz"],
        ["15", "sweep.points"],
        ["17", "injection.kind"],
        ["18", "injection.amplitude_pu"],
        ["19", "plants"],
    ]


def test_a_hundred_problems_do_not_flood_the_terminal(write: Write) -> None:
    path = write(F_LIST.replace("[1, 2.5, 77.0]", str([-1.0] * 100)))
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert len(str(caught.value).splitlines()) == module.PROBLEMS_SHOWN + 1
    assert f"and {len(caught.value.problems) - module.PROBLEMS_SHOWN} more" in str(caught.value)


def test_an_empty_file_lacks_the_sections_it_needs(write: Write) -> None:
    found = problems(write(""))
    assert [re.search(r"(\w+): missing; needed: .*section", problem)[1] for problem in found] == [  # type: ignore[index]
        "campaign",
        "plant",
        "operating_point",
        "sweep",
    ]


def test_values_that_look_like_sections_do_not_move_the_lines(write: Write) -> None:
    tricky = 'text = """\n[sweep]\npoints = 3\n"""\nmatrix = [\n[1, 2],\n[3]\n]\n'
    path = write(GOOD.replace("[[op", f"[plant.parameters]\n{tricky}[[op").replace("= 0.65", "= nan"))
    assert problems(path)[0].startswith("18: operating_point.0.active_power_mw")


# Overrides that are refused

SETTINGS: list[tuple[str, str]] = [
    ("points", r"^--set points: write section.key=value"),
    (".points=3", r"^--set .points=3: write section.key=value"),
    (
        "plant.id=branch-v1",
        r"""^--set plant.id=branch-v1: 'branch-v1' is not a TOML value; text needs quotes: .*"branch-v1"'""",
    ),
    ("sweep.points=", r"^--set sweep.points=: '' is not a TOML value"),
    ("sweep.points=3\nx=4", r"is not a TOML value"),
    ("sweep.points=3.5", r"^--set sweep.points=3.5: sweep.points: given 3.5; needed: a whole number"),
    ("sweep.pionts=3", r"^--set sweep.pionts=3: sweep.pionts: unknown key; did you mean points\?"),
    ("sweep.points.x=3", r"^--set sweep.points.x=3: sweep.points is 100, not a section"),
    ("operating_point.1.id='a'", r"operating_point is a list of one entry, number 0"),
    ("operating_point.id='a'", r"an entry is named by its number: operating_point\.0\.id="),
    ("operating_point=[]", r"^--set operating_point=\[\]: operating_point: given \[\]; needed: at least one section"),
    ("source=3", r"^--set source=3: source: given 3; needed: a section \[source\]"),
]


@pytest.mark.parametrize(("override", "said"), SETTINGS)
def test_a_wrong_override_is_named(write: Write, override: str, said: str) -> None:
    (found,) = problems(write(GOOD), override)
    assert re.search(said, found)


def test_several_wrong_overrides_are_named_at_once(write: Write) -> None:
    assert len(problems(write(GOOD), "a", "b", "sweep.points=5")) == 2


# Files that are no campaign


def unreadable(path: Path) -> str:
    (found,) = problems(path)
    return found


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    assert "no such file; `seqsweep init" in unreadable(tmp_path / "none.toml")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    assert "is a folder; name a campaign file in it" in unreadable(tmp_path)


def test_a_path_through_a_file_is_refused(write: Write) -> None:
    assert "cannot be read: Not a directory" in unreadable(write(GOOD) / "campaign.toml")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"a = 1\nb = \n", r"2: not TOML: Invalid value$"),
        (b"a = 1\nb = [\n", r"3: not TOML: "),
        (b"a = 1\na = 2\n", r"2: not TOML: "),
        (b"a = 1\nb = '\xe9'\n", r"2: not UTF-8 \(byte 0xe9\): save the file as UTF-8"),
        (b"PAR1\x15\x04\x00\xff", r"1: not UTF-8"),
        (b"a = " + 20000 * b"[", r"nested too deeply"),
    ],
)
def test_a_file_that_is_not_toml_is_refused_with_its_line(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "campaign.toml"
    path.write_bytes(content)
    assert re.search(said, unreadable(path))


def test_a_dictionary_is_refused_without_file_and_line() -> None:
    data: dict[str, Any] = load_config(EXAMPLE).to_dict()
    data["sweep"] = {**data["sweep"], "points": -1}
    with pytest.raises(ConfigError, match=r"^sweep.points: given -1; needed: a whole number"):
        Config.from_dict(data)
