"""Compiled kernels: raw arrays and numbers in, arrays out; SI units; no files, no logging."""
