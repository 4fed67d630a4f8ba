"""``process:COMMAND``: a device behind a pipe, be it another simulator, a library under wine, or a laboratory.

The frames are those of `peer`; a program in ten lines of Python or fifty of C is in ``examples/``.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from ..protocol import OperatingRange, Rating
from ..states.steady_state import Clock, Patience
from ..states.store import StateStore
from ..states.stores import Replays, Snapshots
from .box import DrivenPlant, Identity
from .program_frames import PeerBox


def process_plant(
    command: str,
    *,
    answer_s: float = 30.0,
    settle_tolerance: float = 1e-8,
    patience_s: float = 30.0,
    hold: str = "start",
    **parameters: Any,
) -> DrivenPlant:
    """The device that ``command`` is, or speaks for.

    Parameters
    ----------
    command : str
        What stands behind ``process:``; words and quotes as in a shell, but no shell reads it.
    answer_s : float
        Wall time (s) that an answer may take.
    settle_tolerance, patience_s : float
        Change from one period to the next, over the peak, at which it counts as settled; simulated time (s) until then.
    hold : "start" or "mean"
        What is told of the voltage in a step; see `periodic.HOLDS`.
    **parameters
        Handed to the program as they are.

    Raises
    ------
    SeqsweepError
        If the command cannot be started.
    PeerError
        If what answers does not speak this protocol.
    """
    box = PeerBox(command, answer_s, parameters)
    card = box.card
    box.peer.close()
    build = partial(PeerBox, command, answer_s, parameters)
    branches: StateStore = Snapshots(build) if card["snapshot"] else Replays(build)
    low, high = (limit * card["voltage_v"] for limit in card["terminal_voltage_pu"])
    power = card["active_power_w"]
    identity = Identity(
        f"process:{command}",
        Clock(float(card["f1_hz"]), float(card["dt_s"])),
        Rating(float(card["voltage_v"]), float(card["power_va"])),
        OperatingRange((float(power[0]), float(power[1])), (low, high)),
        card["power_meaning"],
    )
    return DrivenPlant(identity, branches, Patience(settle_tolerance, patience_s), {"program": card["name"]}, hold)
