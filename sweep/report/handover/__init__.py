"""The report that an engineer hands over: one HTML file that needs no network."""
