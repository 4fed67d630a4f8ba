"""The product's runner on a plant of the families: campaign in memory, table on disk, read back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from seqsweep.identify.response import FrequencyResponse


def swept(plant: Any, content: Mapping[str, Any], output: Path) -> FrequencyResponse:
    """Run a campaign of one operating point and read its table; a table that is there already is read."""
    from seqsweep.identify.table.read import read_table
    from seqsweep.sweep.config.sections import Config
    from seqsweep.sweep.planning import make_plan
    from seqsweep.sweep.run.campaign import run

    if not output.exists():
        plan = make_plan(Config.from_dict(dict(content)), plant)
        run(plan, plant, output, jobs=1, backend="threading", discard=True)
    return read_table(output).responses[0]
