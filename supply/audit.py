"""Holds what is installed against constraints.lock, without a network: ``make audit``.

Every pinned distribution has to be there in its version, and every file that an installer wrote for it has to have the
check sum with which it was written (the RECORD of its metadata). What was altered, lost or replaced since is told, one
line each, and the exit status is 1.
"""

from __future__ import annotations

import csv
import hashlib
import re
import sys
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
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
    """Files of a distribution that are not what its installer wrote: its RECORD lists them with their check sums."""
    for name, check_sum, *_ in csv.reader((found.read_text("RECORD") or "").splitlines()):
        if check_sum and not is_whole(Path(str(found.locate_file(name))), check_sum):
            yield f"{found.metadata['Name']} {found.version}: {name} was changed or removed since it was installed"


def is_whole(path: Path, check_sum: str) -> bool:
    """Whether a file is there and has its check sum, as "sha256=" and the digest in URL-safe base64."""
    if not path.is_file():
        return False
    kind, _, value = check_sum.partition("=")
    digest = hashlib.new(kind, path.read_bytes()).digest()
    return urlsafe_b64encode(digest).decode().rstrip("=") == value


def main() -> int:
    """Tell every problem; the exit status."""
    pinned = pins(LOCK.read_text("utf-8"))
    problems = list(problems_of(pinned))
    print("\n".join(problems) or f"{len(pinned)} distributions are as pinned, every file as it was installed")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
