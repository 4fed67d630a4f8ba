"""Touchstone: scattering parameters of one operating point, in the pn frame, through scikit-rf.

Y is written as S-parameters because every reader understands them; the reference impedance stands
in the option line and the facts in comments. Admittance blocks of other writers are refused: readers
disagree on how they are scaled.
"""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..files import atomic_file
from .convert import Outgoing, the_one
from .facts import (
    ExchangeError,
    Facts,
    Found,
    Sheet,
    agreed,
    check_file,
    extra,
    facts_of,
    points_of,
)
from .objects import to_network


def write_touchstone(path: str | Path, out: Outgoing, z0_ohm: float | None = None) -> None:
    """Write one response as Touchstone 1, S-parameters as real and imaginary part, Hz.

    Parameters
    ----------
    path : path
        Replaced as a whole; by custom it ends in ``.s2p``.
    out : Outgoing
        One response; rows that are not "ok" are left out, the format knows no status.
    z0_ohm : float or None
        Reference impedance (ohm); None: U^2/S of the table's rating.

    Raises
    ------
    ExchangeError
        As `to_network`.
    """
    response, facts = the_one(out, "Touchstone"), out.facts
    z0_ohm = z0_ohm or facts["rated_voltage_v"] ** 2 / facts["rated_power_va"]
    network = to_network(response, z0_ohm)
    comments = {"written_by": "seqsweep", **facts, "operating_points": [out.point(str(response.meta["op_id"]))]}
    network.comments = "\n".join(f"{key}: {json.dumps(value)}" for key, value in comments.items())  # in ASCII
    text = network.write_touchstone(return_string=True, form="ri", r_ref=z0_ohm, skrf_comment=False)
    with atomic_file(path) as file:
        file.write(text.encode("ascii"))


def read_touchstone(path: str | Path, given: Facts) -> Found:
    """Read a two-port of S-parameters.

    Raises
    ------
    ExchangeError
        If it is no Touchstone file, has another number of ports or other parameters, or a fact is missing.
    """
    text = check_file(path).read_bytes().decode("latin-1")
    comments = [line.lstrip()[1:].strip() for line in text.splitlines() if line.lstrip().startswith("!")]
    _check_parameters(path, text)
    _check_order(path, text)
    f_hz, y = _admittance(path, text)
    said = facts_of(comments)
    said.update(quantity="admittance", unit="S", frequency_unit="Hz")
    point = next(iter(points_of(said)), {})
    return Found((Sheet(f_hz, y, point),), agreed(said, given, path))


def _check_parameters(path: str | Path, text: str) -> None:
    option = re.search(r"^\s*#(.*)$", text, re.MULTILINE)
    if option is None:
        raise ExchangeError(f"{path}: not Touchstone: it has no option line such as '# Hz S RI R 50'")
    found = {word.upper() for word in option[1].split()} & {"Y", "Z", "G", "H"}
    if found:
        raise ExchangeError(
            f"{path} holds {found.pop()}-parameters, whose scaling writers disagree on: save S-parameters"
        )


def _check_order(path: str | Path, text: str) -> None:
    """Refuse frequencies that do not ascend: readers take the first that falls for the beginning of noise data."""
    rows = list(_rows(text))
    if any(len(row) not in (5, 9) for row in rows):
        return  # a number of ports that is refused anyway, or numbers that are no two-port: scikit-rf says so
    last = -np.inf
    for number, row in enumerate(rows):
        if len(row) == 5:
            if any(len(other) == 9 for other in rows[number:]):
                raise ExchangeError(f"{path}: row {number + 1} has 5 numbers, a two-port has 9")
            return
        if not row[0] > last:
            raise ExchangeError(
                f"{path}: {row[0]:g} follows {last:g} (row {number + 1}); needed: ascending frequencies: sort the "
                "rows, or cut the file where another sweep begins"
            )
        last = row[0]


def _rows(text: str) -> Iterator[list[float]]:
    """Numbers of each line of data."""
    for line in text.splitlines():
        words = line.partition("!")[0].split()
        if words and words[0][0] not in "#[":
            try:
                yield [float(word) for word in words]
            except ValueError:
                yield []


def _admittance(path: str | Path, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (n,) in Hz and Y (n, 2, 2) in S, not finite where S has none."""
    skrf = extra("skrf", "scikit-rf")
    stream = io.StringIO(text)  # a file of its own it would leave open where its parser fails
    name = Path(path).name.lower()
    stream.name = name if re.search(r"\.s\d+p$", name) else f"{name}.s2p"  # the suffix tells it the ports
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            network = skrf.Network(stream)
            if network.nports != 2:
                raise ExchangeError(f"{path} has {network.nports} ports; needed: 2")
            return np.asarray(network.f), np.asarray(network.y)
    except ExchangeError:
        raise
    except Exception as error:  # it raises whatever its parser met
        raise ExchangeError(f"{path}: scikit-rf cannot read it: {str(error)[:200]}") from None
