"""The site: built without a warning, complete, self-contained, found by its own search, readable from 320 px on."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

pytest.importorskip("sphinx", reason="the extra 'docs' is not installed: the site is not built")

TOP = Path(__file__).parents[2]
DOCS = TOP / "docs"
SITE_CODE = str(DOCS / "site")
SPHINX = "import gc, sys; gc.disable(); from sphinx.cmd.build import main; sys.exit(main(sys.argv[1:]))"
"""What `python -m sphinx` does; looking for garbage among the nodes of all pages takes a sixth of its time."""
CHROMIUM = shutil.which("chromium")
browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium (apt-get install chromium): the site is not shown by a browser"
)


@pytest.fixture(scope="module")
def code() -> Iterator[None]:
    """The site's own modules can be imported."""
    sys.path.insert(0, SITE_CODE)
    yield
    sys.path.remove(SITE_CODE)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it, but for what is run: no example, no notebook, no command of a page."""
    folder = tmp_path_factory.mktemp("site")
    source = folder / "repository" / "docs"
    left_out = shutil.ignore_patterns("generated", "gallery", "notebooks", "__pycache__")
    shutil.copytree(DOCS, source, ignore=left_out)
    for name in ("examples", "data", "plant", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"):
        (source.parent / name).symlink_to(TOP / name)
    command = [sys.executable, "-W", "ignore", "-c", SPHINX, "-W", "--keep-going", "-q", "-b", "html"]
    quick = ["-D", "plot_gallery=0", "-D", "seqsweep_run=0"]
    done = subprocess.run(
        [*command, *quick, "-d", folder / "doctrees", source, folder / "html"],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


def pages(site: Path) -> list[str]:
    """Pages of the site as a reader sees them."""
    return [str(path.relative_to(site)) for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]


def test_nothing_is_fetched_every_link_leads_somewhere_every_picture_has_words(site, code):
    from held import problems_of

    assert list(problems_of(site)) == []


def test_what_is_not_kept_is_seen(tmp_path, code):
    from held import problems_of

    (tmp_path / "p.html").write_text(
        '<script src="https://cdn.example/x.js"></script><img src="p.html"><a href="q.html">x</a><a href="#y">y</a>'
    )
    assert [problem.partition(": ")[2] for problem in problems_of(tmp_path)] == [
        "<script> fetches https://cdn.example/x.js",
        "the picture p.html has no words (alt)",
        "the link q.html leads nowhere",
        "the link #y leads to a place that is not there",
    ]


NAVIGATION = re.compile(r'(?:<li class="toctree-l\d[^"]*">\s*<a class="[^"]*" |nav-internal" )href="(?!http)([^"]+)"')


def test_the_navigation_covers_every_page(site):
    """Every page of the repository is in the site, and is reached from the start by the navigation alone."""
    made = {"generated", "gallery", "notebooks", "site"}
    written = {path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")}
    expected = {str(name) for name in written if name.parts[0] not in made}
    reached, new = set(), {"index.html"}
    while new:
        page = new.pop()
        reached.add(page)
        for href in NAVIGATION.findall((site / page).read_text("utf-8")):
            target = (site / page).parent.joinpath(href.partition("#")[0] or Path(page).name).resolve()
            new |= {str(target.relative_to(site.resolve()))} - reached
    assert expected - reached == set()


def test_the_reference_has_every_command_and_option(site):
    from seqsweep.sweep.cli.main import app

    text = (site / "generated" / "commands.html").read_text("utf-8")
    plain = re.sub(r"<[^>]+>", "", text)
    for name, command in typer.main.get_command(app).commands.items():
        assert f"seqsweep {name}" in plain
        for parameter in command.params:
            options = parameter.opts if parameter.param_type_name == "option" else []
            assert [option for option in options if option not in plain] == [], name


def test_the_reference_has_every_key_of_a_campaign(site):
    """By the JSON schema that pydantic makes of the sections, which the page does not use."""
    from seqsweep.sweep.config.sections import Config

    schema = Config.model_json_schema()
    keys = {key for section in schema["$defs"].values() for key in section["properties"]} | set(schema["properties"])
    text = (site / "generated" / "campaign-keys.html").read_text("utf-8")
    plain = re.sub(r"<[^>]+>", "", text)
    assert {"grid", "voltage_pu", "settle_on"} <= keys
    assert [key for key in sorted(keys) if not re.search(rf"\b{key}\b", plain)] == []


def test_the_reference_has_every_column_and_every_name_in_python(site):
    import seqsweep
    from seqsweep.identify.table.format import COLUMNS

    columns = (site / "generated" / "columns.html").read_text("utf-8")
    assert [column.name for column in COLUMNS if f">{column.name}<" not in columns] == []
    api = (site / "generated" / "api.html").read_text("utf-8")
    names = [name for name in seqsweep.__all__ if not name.startswith("__")]
    assert [name for name in names if f'id="seqsweep.{seqsweep._HOME[name]}.{name}"' not in api] == []


def written_pages() -> list[Path]:
    """Pages that people write."""
    made = {DOCS / name for name in ("generated", "gallery", "notebooks", "site")}
    return [path for path in sorted(DOCS.rglob("*.md")) if not made & set(path.parents)]


NO_BOX = {"index", "how-to", "explanation", "reference", "appendix", "benchmarks", "exit-statuses", "notation"}
"""Lists of pages, and lists of words."""


@pytest.mark.parametrize("page", written_pages(), ids=lambda page: page.stem)
def test_a_page_begins_with_what_you_type_see_mean_and_do_next(page):
    if page.stem in NO_BOX:
        return
    head = page.read_text("utf-8").split("\n## ")[0]
    rows = re.findall(r"^\| (You type|You see|It means|Next) \| \S.* \|$", head, re.MULTILINE)
    assert rows == ["You type", "You see", "It means", "Next"]


def test_the_glossary_has_the_words_of_the_program():
    """Heads of the table of verdicts, statuses of rows, and what `check` tries."""
    import ast

    from seqsweep.identify.response import STATUSES

    text = (DOCS / "glossary.md").read_text("utf-8")
    verdicts = ast.parse((TOP / "tuning" / "text.py").read_text("utf-8"))
    heads = {
        key.value
        for function in ast.walk(verdicts)
        if isinstance(function, ast.FunctionDef)
        for mapping in ast.walk(function)
        if isinstance(mapping, ast.Dict)
        and any(isinstance(k, ast.Constant) and k.value == "verdict" for k in mapping.keys)
        for key in mapping.keys
        if isinstance(key, ast.Constant)
    }
    assert {"verdict", "m", "Z crit"} <= heads
    assert [word for word in sorted(heads | set(STATUSES)) if f"`{word}`" not in text] == []


# ---------------------------------------------------------------- what commands print


SHOWN = ["a: 1.5 s", "...", "last 2.0"]


@pytest.mark.parametrize(
    ("shown", "printed", "expected"),
    [
        (["old"], ["new", "lines"], ["new", "lines"]),
        (SHOWN, ["a: 2.5 s", "b", "c", "last 3.0"], ["a: 2.5 s", "...", "last 3.0"]),
        (SHOWN, ["a: 2.5 s", "b", "last 3.0", "and more"], ["a: 2.5 s", "...", "last 3.0", "and more"]),
        (["x 1", "y 2", "..."], ["x 1", "new", "y 2", "z"], ["x 1", "new", "y 2", "..."]),
        (SHOWN, ["a: 1.5 s", "b", "the last 3.0", "  goes on"], ["a: 1.5 s", "...", "the last 3.0", "  goes on"]),
        (["took 3.1 s"], ["took 4.9 s"], ["took 3.1 s"]),
        (["3 rows took 3.1 s"], ["4 rows took 3.1 s"], ["4 rows took 3.1 s"]),
    ],
)
def test_what_a_page_leaves_out_stays_left_out_and_what_is_shown_is_what_was_printed(code, shown, printed, expected):
    from executed import merged

    assert merged(shown, printed) == expected


def test_a_session_keeps_its_folder_and_its_status(code, tmp_path):
    from executed import run_session

    steps = [
        ("file", "words.txt", "one\n"),
        ("run", "hidden", "mkdir sub && cd sub"),
        ("run", "shown", "cat ../words.txt"),
        ("run", "shown", "seqsweep nonsense"),
        ("run", "shown", "echo $?"),
    ]
    first, second, third = run_session(steps, tmp_path)
    assert (first, third) == ("one\n", "2\n")
    assert "nonsense" in second


def test_progress_is_left_out_with_what_goes_on_below_it(code: None) -> None:
    from executed import PROGRESS

    beat = "p0: not yet at a shot, starting or settling for 10 s, the batch for 10 s; it\n  is given up in 470 s\n"
    shot = "p0: at shot 3 of 8, 12.5 Hz, for 5 s; it is given up in 460 s\n"
    shot += "p0: unperturbed for 0 s, the batch for 10 s; it is given up in 110 s\n  (plant.timeout_s ...)\n"
    said = f"7/100 points\n{beat}p0: 0.65 MW\n  band  1 Hz\n{shot}y.parquet: 100 ok\ntook 3 s"
    assert PROGRESS.sub("", said) == "p0: 0.65 MW\n  band  1 Hz\ny.parquet: 100 ok\n"


def test_a_line_that_fits_no_terminal_fails_the_page(code: None) -> None:
    from executed import too_wide

    wide = "a sentence that goes on and on, further than any terminal of eighty columns is wide, to its end"
    assert too_wide("seqsweep show y.parquet", f"short\n{wide}\n{'/path' * 30}\n") == [wide]
    assert too_wide("seqsweep show y.parquet --json", wide) == too_wide("cat grid.toml", wide) == []


def test_a_command_that_fails_ends_the_session(code, tmp_path):
    from executed import SessionFailed, run_session

    with pytest.raises(SessionFailed, match="exit status 3"):
        run_session([("run", "shown", "exit 3")], tmp_path)


@pytest.mark.evidence
def test_every_command_of_the_pages_prints_what_they_show():
    done = subprocess.run(
        [sys.executable, f"{SITE_CODE}/executed.py", "--check"], capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout + done.stderr


# ---------------------------------------------------------------- in a browser


def shown_by_chromium(url: str, folder: Path, *options: str) -> tuple[str, str, list[str]]:
    """The document after its scripts, what the console said (but for the theme's remarks), addresses asked for."""
    folder.mkdir(exist_ok=True)
    net = folder / "net.json"
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    quiet = ["--disable-component-update", "--disable-sync", "--no-first-run", "--enable-logging=stderr"]
    done = subprocess.run(
        [
            *command,
            *quiet,
            f"--user-data-dir={folder / 'profile'}",
            f"--log-net-log={net}",
            *options,
            "--dump-dom",
            url,
        ],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    said = "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line and '"[PST]: ' not in line)
    return done.stdout, said, asked_for(net)


def asked_for(net: Path) -> list[str]:
    """Addresses of pages that a log of the network says were fetched; what Chromium asks of itself is left out."""
    events = json.loads(net.read_text("utf-8"))["events"]
    urls = {event.get("params", {}).get("url", "") for event in events}
    own = re.compile(r"^(https?|wss?)://([\w.-]*\.)?(google|googleapis|gvt1|gstatic|chromium)\.\w+")
    return sorted(url for url in urls if url.startswith(("http:", "https:", "ws:")) and not own.match(url))


@browser
def test_the_search_finds_a_page_and_nothing_else_is_asked_for(site, tmp_path):
    address = f"file://{site}/search.html?q=damping+control"
    text, said, asked = shown_by_chromium(address, tmp_path, "--virtual-time-budget=20000")
    results = text[text.index('id="search-results"') :]
    assert len(re.findall(r"<li", results)) > 3
    assert "damping.html" in results
    assert said == ""
    assert asked == []


PROBE = """<!doctype html><html><body><pre id="found"></pre><script>
const pages = %s, found = {};
async function look(page, width) {
  const frame = document.createElement("iframe");
  frame.style.width = width + "px"; frame.style.height = "700px"; frame.src = page;
  document.body.append(frame);
  await new Promise(done => frame.addEventListener("load", done));
  await new Promise(done => setTimeout(done, 50));
  const shown = frame.contentDocument, root = shown.documentElement;
  const body = frame.contentWindow.getComputedStyle(shown.body);
  const answer = [root.scrollWidth, root.dataset.theme, body.color, body.backgroundColor];
  frame.remove();
  return answer;
}
(async () => {
  for (const page of pages) for (const width of [320, 1280]) found[page + " " + width] = await look(page, width);
  document.getElementById("found").textContent = JSON.stringify(found);
})();
</script></body></html>"""


def luminance(colour: str) -> float:
    """Relative luminance of a CSS colour after WCAG 2."""
    parts = [float(part) / 255.0 for part in re.findall(r"[\d.]+", colour)[:3]]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def misfits(site: Path, folder: Path, names: list[str], dark: bool) -> list[str]:
    """Pages that are wider than 320 or 1280 px, not in the style asked for, or too pale to read."""
    probe = site / f"probe-{dark}.html"
    probe.write_text(PROBE % json.dumps(names), "utf-8")
    options = ["--virtual-time-budget=400000", "--allow-file-access-from-files"]
    style = f"--blink-settings=preferredColorScheme={0 if dark else 1}"
    text, said, asked = shown_by_chromium(f"file://{probe}", folder, *options, style)
    probe.unlink()
    assert (said, asked) == ("", [])
    found = json.loads(re.findall(r'<pre id="found">(.*?)</pre>', text, re.DOTALL)[0])
    assert len(found) == 2 * len(names)
    return [f"{name}: {answer}" for name, answer in found.items() if not fits(name, answer, dark)]


def fits(name: str, answer: list, dark: bool) -> bool:
    width, theme, colour, ground = answer
    light, dim = sorted((luminance(colour), luminance(ground)), reverse=True)
    narrow = width <= int(name.rpartition(" ")[2])
    return narrow and theme == ("dark" if dark else "light") and (light + 0.05) / (dim + 0.05) > 7.0


@browser
def test_pages_fit_320_px_and_a_desktop_in_either_style(site, tmp_path):
    names = ["index.html", "tutorial.html", "generated/commands.html"]
    assert misfits(site, tmp_path / "light", names, dark=False) == []
    assert misfits(site, tmp_path / "dark", names, dark=True) == []


@browser
@pytest.mark.evidence
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_every_page_fits_320_px_and_a_desktop(site, tmp_path, dark):
    names = pages(site)
    assert misfits(site, tmp_path, names, dark) == []
    print(f"{len(names)} pages at 320 and 1280 px, {'dark' if dark else 'light'}: none is wider, none asks for more")
