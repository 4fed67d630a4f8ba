"""The former name of `identify.exchange.objects`, kept for one release."""

from .exchange.objects import to_control, to_network, to_xarray

__all__ = ["to_control", "to_network", "to_xarray"]
