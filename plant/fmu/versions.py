"""What the versions of FMI that are driven do differently: names, types, the start. fmpy makes the calls."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

MESSAGES_KEPT = 10


class Type(NamedTuple):
    """A type of variables: how numpy spells its values, and what the functions that get and set it are called by."""

    numpy: str
    called: str


class Version(NamedTuple):
    """A version of the standard.

    Attributes
    ----------
    prefix : str
        Of its functions.
    types : mapping of str to Type
        Those that can be set and read in every step, by their names in the description.
    real : str
        The type of a physical quantity.
    enumeration : str
        How fmpy calls what sets an enumeration.
    state : str
        What it calls a snapshot, in the names of its functions.
    load : callable
        (folder, guid, identifier) to fmpy's slave.
    instantiate : callable
        (slave, messages): makes the instance, which logs into the messages.
    initialize : callable
        (slave): into initialization mode, at time zero.
    """

    prefix: str
    types: Mapping[str, Type]
    real: str
    enumeration: str
    state: str
    load: Callable[[str, str, str], Any]
    instantiate: Callable[[Any, list[str]], None]
    initialize: Callable[[Any], None]


def _load_2(folder: str, guid: str, identifier: str) -> Any:
    from fmpy.fmi2 import FMU2Slave

    return FMU2Slave(guid=guid, unzipDirectory=folder, modelIdentifier=identifier)


def _load_3(folder: str, guid: str, identifier: str) -> Any:
    from fmpy.fmi3 import FMU3Slave

    return FMU3Slave(guid=guid, unzipDirectory=folder, modelIdentifier=identifier)


def _instantiate_2(slave: Any, messages: list[str]) -> None:
    from fmpy import calloc, free
    from fmpy import fmi2 as interface

    callbacks = interface.fmi2CallbackFunctions()
    callbacks.logger = interface.fmi2CallbackLoggerTYPE(lambda *said: _hear(messages, said[-1]))
    callbacks.allocateMemory = interface.fmi2CallbackAllocateMemoryTYPE(calloc)
    callbacks.freeMemory = interface.fmi2CallbackFreeMemoryTYPE(free)
    with suppress(Exception):  # fills in what a message's % stand for, where it can be loaded
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(ctypes.byref(callbacks))
    slave.instantiate(callbacks=callbacks, loggingOn=False)


def _instantiate_3(slave: Any, messages: list[str]) -> None:
    slave.instantiate(logMessage=lambda *said: _hear(messages, said[-1]))


def _initialize_2(slave: Any) -> None:
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()


def _initialize_3(slave: Any) -> None:
    slave.enterInitializationMode(startTime=0.0)


def _hear(messages: list[str], message: bytes | None) -> None:
    """The last messages are kept."""
    messages.append((message or b"").decode(errors="replace").strip()[:200])
    del messages[:-MESSAGES_KEPT]


_TYPES_2 = {
    "Real": Type("f8", "Real"),
    "Integer": Type("i4", "Integer"),
    "Enumeration": Type("i4", "Integer"),
    "Boolean": Type("i4", "Boolean"),
}

_TYPES_3 = {
    "Float64": Type("f8", "Float64"),
    "Float32": Type("f4", "Float32"),
    "Int32": Type("i4", "Int32"),
    "UInt32": Type("u4", "UInt32"),
    "Int16": Type("i2", "Int16"),
    "UInt16": Type("u2", "UInt16"),
    "Int8": Type("i1", "Int8"),
    "UInt8": Type("u1", "UInt8"),
    "Boolean": Type("u1", "Boolean"),
}
"""Enumerations are 64 bits wide here, which no port of a controller is."""

VERSIONS = {
    2: Version("fmi2", _TYPES_2, "Real", "Integer", "FMUstate", _load_2, _instantiate_2, _initialize_2),
    3: Version("fmi3", _TYPES_3, "Float64", "Int64", "FMUState", _load_3, _instantiate_3, _initialize_3),
}
"""By the first number of the version."""
