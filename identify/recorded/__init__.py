"""Phasors and admittances from recordings, whose tones and fundamental have to be found first."""
