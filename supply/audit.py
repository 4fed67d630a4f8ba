"""Holds what is installed against constraints.lock, without a network: ``make audit``.

Every pinned distribution has to be there in its version, and every file that an installer wrote for it has to have the
check sum with which it was written (the RECORD of its metadata). What was altered, lost or replaced since is told, one
line each, and the exit status is 1.
"""

from __future__ import annotations

import hashlib
import re
import sys
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, PackagePath, distribution
from pathlib import Path

LOCK = Path(__file__).resolve().parent.parent / "constraints.lock"
PIN = re.compile(r"^([\w.-]+)(?:\[[\w,-]+\])?==([^\s;\\]+)", re.MULTILINE)


def pins(text: str) -> dict[str, str]:
    """Versions by name."""
    return dict(PIN.findall(text))


def problems_of(pinned: dict[str, str]) -> Iterator[str]:
    """What is not as it was pinned and installed."""
    for name, version in pinned.items():
        try:
            found = distribution(name)
        except PackageNotFoundError:
            yield f"{name} {version} is not installed"
            continue
        if found.version != version:
            yield f"{name} is {found.version}, pinned is {version}"
        yield from altered(found)


def altered(found: Distribution) -> Iterator[str]:
    """Files of a distribution that are not what its installer wrote."""
    for file in found.files or ():
        if file.hash is not None and not is_whole(file):
            yield f"{found.metadata['Name']} {found.version}: {file} was changed or removed since it was installed"


def is_whole(file: PackagePath) -> bool:
    """Whether a file is there and has its check sum."""
    path = Path(str(file.locate()))
    if file.hash is None or not path.is_file():
        return False
    digest = hashlib.new(file.hash.mode, path.read_bytes()).digest()
    return urlsafe_b64encode(digest).decode().rstrip("=") == file.hash.value


def main() -> int:
    """Tell every problem; the exit status."""
    pinned = pins(LOCK.read_text("utf-8"))
    problems = list(problems_of(pinned))
    print("\n".join(problems) or f"{len(pinned)} distributions are as pinned, every file as it was installed")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
