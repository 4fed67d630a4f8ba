"""Rational models of a 2x2 admittance: vector fitting, order selection, covariance, interpolation."""
