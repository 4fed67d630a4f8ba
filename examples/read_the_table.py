"""Read a table without this package: pyarrow for the numbers and the metadata, pandas for a glance.

seqsweep run examples/table1.toml -o y.parquet
python examples/read_the_table.py y.parquet
"""

from __future__ import annotations

import json
import sys

import pyarrow.parquet as pq


def main(path: str) -> None:
    """Print what the table says about itself, its best-known element and the rows that are not ok."""
    table = pq.read_table(path)
    meta = json.loads(pq.read_metadata(path).metadata[b"seqsweep"])  # pandas would drop it
    print(f"{meta['format']} {meta['version']}, f1 = {meta['f1_hz']:g} Hz, {table.num_rows} rows")

    y_pp = table["y_pp_re"].to_numpy() + 1j * table["y_pp_im"].to_numpy()  # S, current into the device
    f_hz = table["f_hz"].to_numpy()
    print(f"|Ypp| is largest at {f_hz[abs(y_pp).argmax()]:g} Hz: {abs(y_pp).max():.4g} S")

    try:
        import pandas  # noqa: F401
    except ImportError:
        print("pandas is not installed: no table of the first rows")
        return
    frame = table.to_pandas()
    print(frame.loc[:, ["op_id", "f_hz", "f_mirror_hz", "y_pp_re", "y_pp_im", "status"]].head(3).to_string())
    print(frame.loc[frame.status != "ok", ["op_id", "f_hz", "status", "reason"]].to_string())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print(f"usage: python {sys.argv[0]} TABLE.parquet", file=sys.stderr)
        sys.exit(2)
    main(sys.argv[1])
