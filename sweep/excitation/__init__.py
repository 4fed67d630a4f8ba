"""What is injected: frequencies on the grid of windows, tones and broadband signals."""
