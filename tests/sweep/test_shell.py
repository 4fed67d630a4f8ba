"""What a shell user meets beside the commands: versions, synonyms, other ways in, and `compare`'s exit status."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
import typer

from seqsweep.identify.table.read import read_table
from seqsweep.sweep.cli.commands import COMMANDS
from seqsweep.sweep.cli.main import app
from seqsweep.sweep.cli.telling import plain

from ..support.commands import SEQSWEEP, TOP, campaign, command, without_pictures


def test_the_module_is_the_command():
    done = subprocess.run([sys.executable, "-m", "seqsweep", "-h"], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0
    assert "compare" in done.stdout


def test_the_help_has_a_whole_sentence_for_every_command():
    told = " ".join(command("--help").stdout.split())
    assert "..." not in told.partition("Commands:")[2]
    assert "Print every shot, the simulated seconds and the expected wall time; no shot is fired." in told


def test_version_names_the_table_format_and_python():
    done = command("--version")
    assert "table format 1." in done.stdout
    assert f"Python {sys.version_info.major}.{sys.version_info.minor}" in done.stdout


@pytest.mark.parametrize(
    ("typed", "meant"), [("sweep", "run"), ("plot", "show"), ("tuen", "tune"), ("diff", "compare")]
)
def test_an_unknown_command_is_told_what_is_meant(typed, meant):
    done = command(typed, "x")
    assert done.returncode == 2
    told = done.stderr.lower()
    assert told.count("did you mean") == 1
    assert f"did you mean: seqsweep {meant}" in told or f"did you mean '{meant}'?" in told


def test_a_table_under_another_suffix_is_refused_with_the_way_out(tmp_path):
    done = command("run", campaign(tmp_path), "-o", tmp_path / "y.csv")
    assert done.returncode == 2
    assert "seqsweep export" in done.stderr


def test_compare_ends_with_0_or_6(tmp_path):
    for name, ohm in (("a", "1.0"), ("b", "1.0"), ("c", "1.05")):
        file = campaign(tmp_path, plant="branch-v1", plant_lines=f"parameters = {{ r_ohm = {ohm} }}", powers=(0.0,))
        assert command("run", file, "-o", tmp_path / f"{name}.parquet", "--jobs", 1).returncode == 0
    same = command("compare", tmp_path / "a.parquet", tmp_path / "b.parquet")
    assert same.returncode == 0, same.stderr
    assert "agree within their uncertainty: yes" in same.stdout
    other = command("compare", tmp_path / "a.parquet", tmp_path / "c.parquet")
    assert other.returncode == 6
    assert "agree within their uncertainty: no" in other.stdout


# What every command has in common ------------------------------------------------------------------------------------

NAMES = sorted(COMMANDS)


@pytest.mark.parametrize("name", NAMES)
def test_every_help_fits_80_columns_and_ends_with_examples_and_a_page_that_is_there(name):
    done = command(name, "--help")
    assert done.returncode == 0
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "--json" in done.stdout
    assert "--quiet" in done.stdout
    assert f"seqsweep {name}" in done.stdout[done.stdout.index("Examples:") :]
    page = re.search(r"More: (\S+)", done.stdout).group(1)
    assert (TOP / page).exists()


@pytest.mark.parametrize("name", NAMES)
def test_every_example_names_options_that_exist(name):
    known = {option for parameter in typer.main.get_command(app).commands[name].params for option in parameter.opts}
    used = {
        word for example in COMMANDS[name].examples for word in example.split() if word.startswith("-") and word != "-"
    }
    assert used - {"-l"} <= known  # -l is of man(1)
    assert all(example.split()[0] == name for example in COMMANDS[name].examples)


def test_a_synonym_means_one_command_and_is_none():
    words = [word for each in COMMANDS.values() for word in each.synonyms]
    assert len(words) == len(set(words))
    assert not set(words) & set(COMMANDS) - {"plant"}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    file = campaign(folder, plant="branch-v1", powers=(0.0, 0.1), n=24)
    assert command("run", file, "-o", folder / "y.parquet", "--jobs", 1).returncode == 0
    return folder


JSON = {
    "plan": ("plan", "campaign.toml"),
    "show": ("show", "y.parquet"),
    "show at": ("show", "y.parquet", "--at", "77"),
    "validate": ("validate", "y.parquet"),
    "tune": ("tune", "y.parquet", "--grid", "0.02+0.3j"),
    "compare": ("compare", "y.parquet", "y.parquet"),
    "metrics": ("metrics", "y.parquet"),
    "judge": ("judge", "y.parquet", "--grids", "grids", "--jobs", "1"),
    "check": ("check", "branch-v1"),
    "export": ("export", "y.parquet", "-o", "out.csv", "--force"),
    "report": ("report", "y.parquet", "-o", "r.html", "--force"),
    "run": ("run", "campaign.toml", "-o", "z.parquet", "--force", "--jobs", "1"),
    "completion": ("completion", "bash"),
}


@pytest.mark.parametrize("words", JSON.values(), ids=JSON)
def test_json_is_all_that_is_printed_and_quiet_says_nothing_else(swept, words):
    (swept / "grids").mkdir(exist_ok=True)
    (swept / "grids" / "g.toml").write_text(
        "voltage_kv = 0.69\n[[element]]\nkind = 'series'\nr_ohm = 0.1\nx_ohm = 0.2\n"
    )
    places = [swept / word if ("." in word and word[0].isalpha()) or word == "grids" else word for word in words]
    with without_pictures():
        done = command(*places, "--json", "--quiet")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert json.loads(done.stdout)


def test_json_of_tune_is_what_its_file_holds(swept, tmp_path):
    done = command("tune", swept / "y.parquet", "--grid", "0.02+0.3j", "-o", tmp_path / "t.json", "--json")
    assert json.loads(done.stdout) == json.loads((tmp_path / "t.json").read_text())


def test_a_failure_under_json_and_quiet_is_still_told_and_counted(swept):
    done = command("tune", swept / "nothing.parquet", "--grid", "1j", "--json", "--quiet")
    assert done.returncode == 2
    assert done.stdout == ""
    assert "nothing.parquet" in done.stderr


def test_a_long_command_closes_with_the_time_it_took(monkeypatch, swept):
    from seqsweep.sweep.cli import telling

    monkeypatch.setattr(telling, "LONG_S", 0.0)
    assert re.search(r"^took \d+\.\d s$", command("validate", swept / "y.parquet").stderr, re.MULTILINE)
    assert "took" not in command("validate", swept / "y.parquet", "-q").stderr
    assert telling.in_words(245.0) == "4 min 5 s"
    assert telling.in_words(7800.0) == "2 h 10 min"


def test_what_json_cannot_hold_becomes_null_or_text():
    values = {"a": np.array([1.0, np.nan]), "b": np.float64(2.0), "c": float("inf"), "d": TOP, "e": 1 + 2j, "f": (1,)}
    assert plain(values) == {"a": [1.0, None], "b": 2.0, "c": None, "d": str(TOP), "e": [1.0, 2.0], "f": [1]}


# show, compare, merge ------------------------------------------------------------------------------------------------


def test_show_at_prints_the_rows_value(swept):
    rows = read_table(swept / "y.parquet").responses[0]
    f = float(rows.f_hz[7])
    values = json.loads(command("show", swept / "y.parquet", "--op", "p0", "--at", f"{f!r}", "--json").stdout)
    assert values[0]["elements"]["Ypp"]["re"] == pytest.approx(rows.y[7, 0, 0].real, rel=1e-12)
    assert values[0]["between_hz"] is None
    text = command("show", swept / "y.parquet", "--op", "p0", "--at", "77", "--impedance", "--frame", "dq").stdout
    assert "Zdq" in text
    assert "in dq at |f - f1| = 27 Hz" in text
    assert max(map(len, text.splitlines())) <= 80


def test_show_summarises_one_operating_point(swept):
    text = command("show", swept / "y.parquet", "--op", "p1").stdout
    assert "p1" in text
    assert "p0 " not in text
    wrong = command("show", swept / "y.parquet", "--op", "p7")
    assert wrong.returncode == 2
    assert "p7" in wrong.stderr


@pytest.mark.parametrize("axes", ["log", "db", "linear"])
def test_show_draws_impedance_and_dq_on_every_kind_of_axes(swept, tmp_path, axes):
    words = ("--plot", tmp_path / "z.svg", "--impedance", "--frame", "dq", "--axes", axes)
    assert command("show", swept / "y.parquet", *words).returncode == 0
    text = (tmp_path / "z.svg").read_text("utf-8")
    assert "ohm" in text
    assert ("dB" in text) == (axes == "db")


SHOWN_WRONG = {
    "words": (("--at", "many"), "needed are numbers in Hz"),
    "outside": (("--at", "5000"), "nothing is extrapolated"),
    "frame": (("--frame", "abc"), "known are pn, dq"),
    "axes": (("--axes", "db"), "goes with --plot"),
    "impedance": (("--impedance",), "go with --at HZ or --plot"),
}


@pytest.mark.parametrize(("words", "said"), SHOWN_WRONG.values(), ids=SHOWN_WRONG)
def test_show_refuses_what_it_cannot_show(swept, words, said):
    done = command("show", swept / "y.parquet", *words)
    assert done.returncode == 2
    assert said in done.stderr


def test_compare_draws_the_difference(swept, tmp_path):
    done = command("compare", swept / "y.parquet", swept / "y.parquet", "--plot", tmp_path / "d.svg")
    assert done.returncode == 0, done.stderr
    assert "95 % region" in (tmp_path / "d.svg").read_text("utf-8")


def test_merge_joins_two_sweeps_of_one_device(swept, tmp_path):
    file = campaign(tmp_path, plant="branch-v1", powers=(0.2,), n=24)
    file.write_text(file.read_text("utf-8").replace('"p0"', '"p2"'), "utf-8")
    assert command("run", file, "-o", tmp_path / "b.parquet", "--jobs", 1).returncode == 0
    done = command("merge", swept / "y.parquet", tmp_path / "b.parquet", "-o", tmp_path / "m.parquet")
    assert done.returncode == 0, done.stderr
    assert read_table(tmp_path / "m.parquet").op_ids == ("p0", "p1", "p2")
    assert command("merge", swept / "y.parquet", swept / "y.parquet", "-o", tmp_path / "n.parquet").returncode == 2


# Completion and the manual page --------------------------------------------------------------------------------------


def completed(shell, line, folder):
    """What a shell offers at the end of a line."""
    script = command("completion", shell).stdout
    file = folder / f"seqsweep.{shell}"
    file.write_text(script, "utf-8")
    words = line.split(" ")
    if shell == "bash":
        listed = " ".join(f"'{word}'" for word in words)
        line = f"COMP_WORDS=({listed}); COMP_CWORD={len(words) - 1}; _seqsweep"
        arguments = ["bash", "-c", f'source {file}; {line}; printf "%s\\n" "${{COMPREPLY[@]}}"']
    else:
        arguments = ["fish", "-c", f"source {file}; complete -C '{line}'"]
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, timeout=600, check=True)
    return {offered.split("\t")[0] for offered in done.stdout.splitlines()}


@pytest.mark.parametrize("shell", ["bash", "fish"])
def test_a_shell_completes_commands_options_values_and_files(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here: its completion is not tried")
    for name in ("y.parquet", "t.json"):
        (tmp_path / name).touch()
    assert {"show", "surrogate"} <= completed(shell, "seqsweep s", tmp_path)
    assert "--impedance" in completed(shell, "seqsweep show --im", tmp_path)
    assert completed(shell, "seqsweep show --frame ", tmp_path) >= {"pn", "dq"}
    assert completed(shell, "seqsweep completion ", tmp_path) >= {"bash", "zsh", "fish"}
    assert "y.parquet" in completed(shell, "seqsweep show y", tmp_path)
    if shell == "bash":
        assert "t.json" not in completed(shell, "seqsweep show ", tmp_path)


SETUP_OF_ZSH = r"""
fpath=($PWD $fpath)
autoload -Uz compinit && compinit -u -d $PWD/.zcompdump
compadd() {
    if [[ ${@[1,(i)(-|--)]} == *-(O|A|D)\ * ]]; then builtin compadd "$@"; return $?; fi
    typeset -a offered
    builtin compadd -A offered "$@"
    print -rl -- $offered >> $PWD/offered
    builtin compadd "$@"
}
"""
"""Loads the completion as a user's .zshrc does, and writes down what is offered."""


def test_zsh_completes_commands_options_values_and_files(tmp_path):
    """In a real zsh, which completes on a terminal only."""
    if shutil.which("zsh") is None:
        pytest.skip("no zsh here: its completion is not tried")
    pexpect = pytest.importorskip("pexpect", reason="no pexpect here: zsh's completion is not tried")
    (tmp_path / "_seqsweep").write_text(command("completion", "zsh").stdout, "utf-8")
    (tmp_path / "setup.zsh").write_text(SETUP_OF_ZSH)
    for name in ("y.parquet", "t.json", "c.toml"):
        (tmp_path / name).touch()
    offers = tmp_path / "offered"
    zsh = pexpect.spawn("zsh", ["-f", "-i"], cwd=str(tmp_path), encoding="utf-8", dimensions=(60, 200), timeout=600)
    zsh.sendline("source setup.zsh; print LOADED-$((1 + 1))")
    zsh.expect("LOADED-2")

    def offered(line):
        offers.write_text("")
        zsh.send(f"{line}\t\x15print DONE-$((1 + 1))\r")  # the tabulator, then the line is wiped out
        zsh.expect("DONE-2")
        return set(offers.read_text().split())

    assert offered("seqsweep s") == {"show", "surrogate"}
    assert offered("seqsweep show --im") == {"--impedance"}
    assert offered("seqsweep show --frame ") == {"pn", "dq"}
    assert offered("seqsweep completion ") == {"bash", "zsh", "fish"}
    assert offered("seqsweep show ") == {"y.parquet"}
    assert offered("seqsweep run ") == {"c.toml"}
    assert {"y.parquet", "t.json"} <= offered("seqsweep report ")
    zsh.close(force=True)


def test_scripts_and_the_manual_page_are_not_folded(tmp_path):
    """They are for programs: a line that goes on below would be another line."""
    for words in (("completion", "zsh"), ("completion", "bash"), ("completion", "fish"), ("man",)):
        done = subprocess.run([SEQSWEEP, *words], capture_output=True, text=True, timeout=600, check=True)
        assert any(len(line) > 80 for line in done.stdout.splitlines()), words


def test_an_unknown_shell_is_refused():
    assert "known are bash, zsh, fish" in command("completion", "tcsh").stderr


def test_the_manual_page_has_every_command_option_and_status():
    page = command("man").stdout.replace("\\-", "-")
    for name, found in typer.main.get_command(app).commands.items():
        assert f'.SS "seqsweep {name}' in page
        options = [parameter for parameter in found.params if parameter.param_type_name == "option"]
        assert all(option in page for parameter in options for option in parameter.opts)
    assert all(f".B {status}\n" in page for status in range(7))


def test_the_manual_page_is_read_without_a_warning(tmp_path):
    if shutil.which("groff") is None:
        pytest.skip("no groff here: the manual page is not laid out")
    page = command("man").stdout
    done = subprocess.run(
        ["groff", "-man", "-Tascii", "-ww"], input=page, capture_output=True, text=True, timeout=600, check=True
    )
    assert "seqsweep show" in done.stdout
    assert [line for line in done.stderr.splitlines() if "cannot" not in line] == []


# init --notebook -----------------------------------------------------------------------------------------------------


def test_init_writes_a_notebook_that_is_one(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="the extra 'test' is not installed")
    done = command("init", "--notebook", "-o", tmp_path / "start.ipynb")
    assert done.returncode == 0, done.stderr
    nbformat.validate(nbformat.read(tmp_path / "start.ipynb", 4))
    assert command("init", "--notebook", "-o", tmp_path / "start.ipynb").returncode == 2


@pytest.mark.parametrize("words", ["--notebook -o a.toml", "-o a.ipynb", "--notebook --plant a.so"])
def test_init_refuses_a_notebook_by_another_name(words):
    assert command("init", *words.split()).returncode == 2
