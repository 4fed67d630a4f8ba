"""Sequence admittance of grid converters, whether they are stable on a grid, and the gain that makes them so."""
