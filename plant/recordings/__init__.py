"""Readers of recordings: files of waveforms in, named channels out. One small file per format."""
