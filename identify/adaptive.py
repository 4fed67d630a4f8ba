"""The former name of `identify.fit.adaptive`, kept for one release."""

from .fit.adaptive import interpolate

__all__ = ["interpolate"]
