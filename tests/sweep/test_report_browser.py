"""The report in a real browser: no console error, no request, text and pictures there, cursor, widths, print.

A page that is added to the report for the test moves the pointer and measures; it writes what it saw into its title.
"""

from __future__ import annotations

import json
import re
import subprocess

import pytest

from seqsweep.sweep.report.handover.pdf import PdfError, browser

from ..support.commands import campaign, command

try:
    CHROMIUM = browser()
except PdfError:
    CHROMIUM = ""

pytestmark = pytest.mark.skipif(
    not CHROMIUM, reason="no Chromium (apt-get install chromium): no browser shows the report"
)

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--enable-logging=stderr", "--allow-file-access-from-files",
)  # fmt: skip

PROBE = """
<script>
const seen = {};
document.querySelectorAll("figure").forEach((figure) => {
  const data = JSON.parse(figure.querySelector("script").textContent);
  const canvas = figure.querySelector(".canvas"), box = canvas.getBoundingClientRect(), panel = data.panels[0];
  const at = data.kind === "points" ? data.points[0] : [(panel.left + panel.right) / 2, (panel.top + panel.bottom) / 2];
  const place = { clientX: box.left + at[0] * box.width, clientY: box.top + at[1] * box.height };
  canvas.dispatchEvent(new PointerEvent("pointermove", { ...place, bubbles: true }));
  const width = canvas.querySelector("svg").getBoundingClientRect().width;
  seen[figure.id] = [width, figure.querySelector("output").textContent];
});
const dark = matchMedia("(prefers-color-scheme: dark)").matches;
const colours = [...document.querySelectorAll("p, td, th, caption, a, summary, figcaption, strong")].map((e) =>
  [getComputedStyle(e).color, e.tagName]);
const paper = getComputedStyle(document.body).backgroundColor;
const head = getComputedStyle(document.querySelector("thead th")).backgroundColor;
const fetched = performance.getEntriesByType("resource").map((entry) => entry.name);
document.title = JSON.stringify({ seen, dark, colours, paper, head, fetched });
</script></body>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shown")
    file = campaign(folder, plant="branch-v1", powers=(0.0, 0.1), n=24)
    assert command("run", file, "-o", folder / "y.parquet", "--jobs", 1).returncode == 0
    tuned = ("tune", folder / "y.parquet", "--grid", "0.02+0.3j", "--scale", "1.0,2.0", "-o", folder / "t.json")
    assert command(*tuned).returncode == 0
    judged = ("judge", folder / "y.parquet", "--grids", _bank(folder), "-o", folder / "j.parquet", "--jobs", 1)
    assert command(*judged).returncode == 0
    results = folder / "t.json", folder / "j.parquet"
    done = command("report", folder / "y.parquet", *results, "-o", folder / "r.html", "--pdf")
    assert done.returncode == 0, done.stderr
    return folder


def _bank(folder):
    bank = folder / "bank"
    bank.mkdir()
    for k in range(3):
        text = f"[[element]]\nkind = 'series'\nr_ohm = 0.02\nx_ohm = {0.2 + 0.1 * k}\n"
        (bank / f"g{k}.toml").write_text("voltage_kv = 0.69\n" + text)
    return bank


def shown(page, tmp_path, *flags):
    """The page's DOM and what the browser said on the way."""
    command = [CHROMIUM, *FLAGS, *flags, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=True, stdin=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def by_day(folder, tmp_path_factory):
    """What the probe saw without any flag."""
    return measured(folder, tmp_path_factory.mktemp("day"))


def measured(folder, tmp_path, *flags):
    """What the probe saw; the policy is lifted for the probe's own script alone."""
    text = (folder / "r.html").read_text("utf-8")
    text = re.sub(r"script-src '[^']*'", "script-src 'unsafe-inline'", text).replace("</body>", PROBE)
    page = tmp_path / "probed.html"
    page.write_text(text, "utf-8")
    title = re.search(r"<title>(.*?)</title>", shown(page, tmp_path, *flags).stdout, re.DOTALL).group(1)
    return json.loads(title.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))


@pytest.fixture(scope="module")
def as_it_is(folder, tmp_path_factory):
    """What the browser says of the page, and its own log of the network."""
    own = tmp_path_factory.mktemp("as it is")
    return shown(folder / "r.html", own, f"--log-net-log={own / 'net.json'}"), (own / "net.json").read_text("utf-8")


def test_the_page_as_it_is_has_no_console_message_and_its_script_runs(as_it_is):
    done, _ = as_it_is
    assert "What operators ask of a scan" in done.stdout
    assert "Point into the picture" in done.stdout
    assert "CONSOLE" not in done.stderr


def test_nothing_is_requested(as_it_is, by_day):
    """By the browser's own log of the network: the page's file, and nothing by http."""
    _, log = as_it_is
    hosts = set(re.findall(r'"url":"https?://([^/"]+)', log))
    of_the_browser = (".google.com", ".googleapis.com", ".gvt1.com")  # its own search for updates
    assert not [host for host in hosts if not host.endswith(of_the_browser)]
    assert by_day["fetched"] == []


def test_every_picture_is_there_and_gives_its_values_under_the_pointer(by_day):
    seen = by_day["seen"]
    assert set(seen) == {"loop", "locus", "poles", "bankmap", "bode"}
    assert all(width > 300.0 for width, _ in seen.values())
    assert "f = " in seen["bode"][1]
    assert "|Ypp| (S)" in seen["bode"][1]
    assert "damping" in seen["poles"][1]
    assert "dB" in seen["locus"][1]
    assert "grid g" in seen["bankmap"][1]


def test_the_page_fits_the_window_at_every_width(folder, tmp_path):
    """A window is never narrower than 500 px here, so that a frame of 320 px stands for a telephone."""
    widths = 320, 500, 1280
    frame = tmp_path / "frame.html"
    (tmp_path / "inner.html").write_text(
        (folder / "r.html").read_text("utf-8").replace("script-src '", "script-src 'unsafe-inline' '"), "utf-8"
    )
    frame.write_text(
        "".join(f'<iframe src="inner.html" style="width:{width}px;height:800px;border:0"></iframe>' for width in widths)
        + "<script>onload = () => { document.title = [...document.querySelectorAll('iframe')].map("
        "(frame) => frame.contentDocument.documentElement.scrollWidth); };</script>"
    )
    done = shown(frame, tmp_path, "--window-size=1400,900", "--virtual-time-budget=3000")
    needed = [int(number) for number in re.search(r"<title>([\d,]+)</title>", done.stdout).group(1).split(",")]
    assert len(needed) == len(widths)
    assert all(one <= width for one, width in zip(needed, widths, strict=True)), needed


def _contrast(a, b):
    """Contrast ratio of two colours (WCAG 2.1, 1.4.3)."""

    def luminance(text):
        parts = [float(x) / 255.0 for x in re.findall(r"[\d.]+", text)[:3]]
        linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_text_has_contrast_by_day_and_by_night(folder, tmp_path, by_day, dark):
    found = measured(folder, tmp_path, "--blink-settings=preferredColorScheme=0") if dark else by_day
    assert found["dark"] is dark
    weak = [(colour, tag) for colour, tag in found["colours"] if _contrast(colour, found["paper"]) < 4.5]
    assert not weak
    assert _contrast(found["head"], next(c for c, tag in found["colours"] if tag == "TH")) >= 4.5


def test_the_command_prints_beside_the_page_without_a_date(folder):
    paper = (folder / "r.pdf").read_bytes()
    assert paper.startswith(b"%PDF")
    assert b"/CreationDate (D:00000000" in paper
    assert not re.search(rb"\(D:20\d\d", paper)
