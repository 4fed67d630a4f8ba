"""``inverter-grey-v1``: a sealed controller in the general circuit of an inverter. The users' page is docs/cigre.md."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import inf, isfinite
from typing import Any

from ..errors import SeqsweepError, nearest
from .inverter_circuit import InverterCircuit
from .inverter_stepping import SampledInverter
from .turbine import GreyTurbine

_MAY_BE_ZERO = ("r_f_ohm", "r_c_ohm", "r_g_ohm", "r_dc_ohm")


class GreyInverter(GreyTurbine):
    """A sealed controller in the circuit of `InverterCircuit`.

    Parameters
    ----------
    controller, inputs, outputs, settings
        As in `GreyTurbine`; ``v_f_...`` is the voltage of the capacitor branch, and an output may be the ``gate`` that
        blocks the bridge.
    believed_from_s : float
        Nothing counts as settled before this time (s): the start-up sequence of the controller.
    **parameters
        The others of `GreyTurbine`, and fields of `InverterCircuit` to replace.

    Raises
    ------
    SeqsweepError
        As `GreyTurbine`.
    """

    id = SampledInverter.id
    power_meaning = SampledInverter.power_meaning

    def __init__(
        self,
        controller: str,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, Any],
        settings: Mapping[str, Any] | None = None,
        *,
        believed_from_s: float = 0.0,
        damping_r_ohm: float = 0.0,
        damping_l_h: float = 0.0,
        **parameters: Any,
    ):
        if isinstance(believed_from_s, bool) or not 0.0 <= float(believed_from_s) < inf:
            raise SeqsweepError(f"believed_from_s is {believed_from_s!r}; {self.id} needs a time of at least 0, in s")
        self._core_class = partial(_believed, float(believed_from_s))  # type: ignore[assignment]
        super().__init__(
            controller,
            inputs,
            outputs,
            settings,
            damping_r_ohm=damping_r_ohm,
            damping_l_h=damping_l_h,
            **parameters,
        )

    @staticmethod
    def _circuit(parameters: Mapping[str, Any]) -> InverterCircuit:
        known = InverterCircuit._fields
        for name, value in parameters.items():
            if name not in known:
                raise SeqsweepError(
                    f"{SampledInverter.id} has no parameter {name!r}{nearest(name, known)}; for its circuit it has "
                    f"{', '.join(known)}"
                )
            number = isinstance(value, int | float) and not isinstance(value, bool)
            least_met = number and (value > 0.0 or (value == 0.0 and name in _MAY_BE_ZERO))
            if not least_met or not isfinite(value):
                least = "of at least" if name in _MAY_BE_ZERO else "above"
                raise SeqsweepError(f"{name} is {value!r}; {SampledInverter.id} needs a finite number {least} 0")
        return InverterCircuit(**{name: float(value) for name, value in parameters.items()})


def _believed(from_s: float, *arguments: Any, **named: Any) -> SampledInverter:
    """A stepped inverter that counts nothing as settled before ``from_s``."""
    stepped = SampledInverter(*arguments, **named)
    stepped.believed_from_s = from_s
    return stepped
