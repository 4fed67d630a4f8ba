"""What a wheel brings along: for the shell, manual page and completion scripts, made of the command line itself; and in
its metadata the bill of materials, what the program stands on (PEP 770; `supply/dependencies.py` makes it).

Everything else about the package stands in pyproject.toml. Where the command line cannot be imported (typer is missing
from the environment that builds), the wheel is made without manual page and completion scripts.
"""

from __future__ import annotations

import shutil
import sys
import tomllib
import types
from pathlib import Path

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel

TOP = Path(__file__).resolve().parent
MADE = Path("build") / "share"
BILL = TOP / "supply" / "seqsweep.cdx.json"

PLACES = {
    "share/man/man1": "seqsweep.1",
    "share/bash-completion/completions": "seqsweep",
    "share/zsh/site-functions": "_seqsweep",
    "share/fish/vendor_completions.d": "seqsweep.fish",
}
"""Where an environment keeps them, under its prefix."""


def texts() -> dict[str, str]:
    """Every file by its name; the folders of this clone stand for the package, as it is not installed yet."""
    package = types.ModuleType("seqsweep")
    package.__path__ = [str(TOP / "seqsweep"), str(TOP)]
    sys.modules["seqsweep"] = package
    from seqsweep.sweep.cli.shell import completion_script, manual_page

    version = tomllib.loads((TOP / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    scripts = {"seqsweep": "bash", "_seqsweep": "zsh", "seqsweep.fish": "fish"}
    return {"seqsweep.1": manual_page(version), **{name: completion_script(shell) for name, shell in scripts.items()}}


def data_files() -> list[tuple[str, list[str]]]:
    """The files, written, and where they go."""
    try:
        made = texts()
    except ImportError as missing:
        print(f"without manual page and completion scripts: {missing}", file=sys.stderr)
        return []
    (TOP / MADE).mkdir(parents=True, exist_ok=True)
    for name, text in made.items():
        (TOP / MADE / name).write_text(text, "utf-8")
    return [(place, [(MADE / name).as_posix()]) for place, name in PLACES.items()]


class WithBill(bdist_wheel):
    """Metadata of a wheel, or of an editable installation, with the bill of materials."""

    def egg2dist(self, egginfo_path: str, distinfo_path: str) -> None:
        """Make the ``.dist-info`` folder."""
        super().egg2dist(egginfo_path, distinfo_path)
        place = Path(distinfo_path) / "sboms"
        place.mkdir(exist_ok=True)
        shutil.copyfile(BILL, place / BILL.name)


setup(data_files=data_files(), cmdclass={"bdist_wheel": WithBill})
