"""``python -m seqsweep`` is the command line."""

from seqsweep.sweep.cli.main import console

console()
