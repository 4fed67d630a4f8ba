"""Sealed controllers, real-code libraries and FMUs, and how their signals are connected."""
