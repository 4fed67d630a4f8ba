"""From records to a frequency response: phasors, the 2x2 solve, quality and the table."""
