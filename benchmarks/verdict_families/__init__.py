"""Families of devices with exact eigenvalues, tables drawn of them, and the score of the verdicts on those.

Nothing in here but `asking`, `sweeping` and `turbines` imports the product: the truth is computed by code of its own.
"""
