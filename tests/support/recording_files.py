"""Writers of recordings, as other tools write them: small, obvious, and only for tests."""

from __future__ import annotations

import numpy as np

from .by_hand import phases

NAMES = ("Va", "Vb", "Vc", "Ia", "Ib", "Ic")


def six(stretch):
    """Three phases of v, three of i (n, 6) in V and A."""
    return np.column_stack([phases(stretch.v), phases(stretch.i)])


def comtrade(
    path, samples, *, form="BINARY", rate_hz=10_000.0, names=NAMES, units=None, f1_hz=50, revision=1999, **more
):
    """Write ``path``.cfg and .dat of samples (n, k); the cfg's path.

    ``more``: ``phases`` (per channel), ``ratio`` ((primary, secondary, "P" or "S") of all), ``cut`` (last bytes left
    out), ``rates`` ([(Hz, last sample)]), ``encoding``, ``stamps`` (us), ``status`` channels, ``cff`` (one file).
    """
    n, k = samples.shape
    units = units or ["V" if name[0].upper() == "V" else "A" for name in names]
    ratio = more.get("ratio", (1, 1, "P"))
    full = {"ASCII": 32766, "BINARY": 32767, "BINARY32": 2**31 - 1, "FLOAT32": 1}[form]
    scale = np.ones(k) if form == "FLOAT32" else np.nanmax(np.abs(samples), axis=0) / full
    scale = np.where(scale > 0.0, scale, 1.0)
    head = f"station,device,{revision}" if revision != 1991 else "station,device"
    status = more.get("status", 0)
    lines = [head, f"{k + status},{k}A,{status}D"]
    for c in range(k):
        phase = more.get("phases", [""] * k)[c]
        lines.append(
            f"{c + 1},{names[c]},{phase},,{units[c]},{scale[c]:.17g},0,0,{-full},{full}"
            + (f",{ratio[0]},{ratio[1]},{ratio[2]}" if revision != 1991 else "")
        )
    lines += [f"{c + 1},D{c + 1},,,0" for c in range(status)]
    rates = more.get("rates", [(rate_hz, n)])
    lines += [f"{f1_hz}", f"{len(rates)}", *(f"{rate:g},{last}" for rate, last in rates)]
    lines += [*["01/01/2026,00:00:00.000000"] * 2, form]
    lines += ["1"] if revision != 1991 else []
    lines += ["0,0", "0,0"] if revision == 2013 else []
    cfg = ("\r\n".join(lines) + "\r\n").encode(more.get("encoding", "utf-8"))
    dat = _dat(samples / scale, form, more.get("stamps", np.arange(n) * 1e6 / rate_hz), status)
    dat = dat[: len(dat) - more.get("cut", 0)]
    if more.get("cff"):
        path = path.with_suffix(".cff")
        kind = f"DAT {form}" + (f": {len(dat)}" if form != "ASCII" else "")
        path.write_bytes(b"--- file type: CFG ---\r\n" + cfg + f"--- file type: {kind} ---\r\n".encode() + dat)
        return path
    path.with_suffix(".dat").write_bytes(dat)
    path.with_suffix(".cfg").write_bytes(cfg)
    return path.with_suffix(".cfg")


def _dat(raw, form, stamps_us, status):
    n, k = raw.shape
    number, stamps = np.arange(1, n + 1), np.asarray(stamps_us).astype("u4")
    if form == "ASCII":
        rows = [
            ",".join(
                [
                    str(number[j]),
                    str(stamps[j]),
                    *(str(99999 if np.isnan(x) else round(x)) for x in raw[j]),
                    *["0"] * status,
                ]
            )
            for j in range(n)
        ]
        return ("\r\n".join(rows) + "\r\n").encode()
    kind = {"BINARY": "<i2", "BINARY32": "<i4", "FLOAT32": "<f4"}[form]
    words = -(-status // 16)
    rows = np.zeros(n, [("n", "<u4"), ("t", "<u4"), ("x", kind, (k,)), ("s", "<u2", (words,))])
    rows["n"], rows["t"] = number, stamps
    if form == "FLOAT32":
        rows["x"] = raw
    else:
        missing = np.iinfo(kind).min
        rows["x"] = np.where(np.isnan(raw), missing, np.rint(np.nan_to_num(raw)))
    return rows.tobytes()


def text(
    path,
    samples,
    *,
    dt_s=1e-4,
    t0_s=0.0,
    heads=None,
    delimiter=",",
    decimal=".",
    time="Time [s]",
    digits=17,
    preface=(),
):
    """Write a table of text with a column of time; its path."""
    heads = heads or [f"{name} [{'V' if name[0] == 'V' else 'A'}]" for name in NAMES]
    t = t0_s + dt_s * np.arange(len(samples))
    lines = [*preface, delimiter.join(([time] if time else []) + list(heads))]
    for j, row in enumerate(samples):
        cells = [f"{x:.{digits}g}" for x in ([t[j], *row] if time else row)]
        lines.append(delimiter.join(cell.replace(".", decimal) for cell in cells))
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def pscad(folder, case, samples, *, order=None, run="", dt_s=1e-4, names=NAMES, extra=0):
    """Write a PSCAD case of ``extra`` constant channels before ours; the .inf's path."""
    k = samples.shape[1] + extra
    x = np.column_stack([np.full((len(samples), extra), 7.0), samples])
    heads = [*(f"X{c}" for c in range(extra)), *names]
    units = ["", *[""] * extra][:extra] + ["kV" if name[0] == "V" else "kA" for name in names]
    lines = [
        f'PGB({c + 1}) Output Desc="{heads[c]}" Group="Main" Max=2.0 Min=-2.0 Units="{units[c]}"' for c in range(k)
    ]
    if order is not None:
        lines = [lines[c] for c in order]
    (folder / f"{case}.inf").write_text("\n".join(lines) + "\n")
    t = dt_s * np.arange(len(x))
    for number in range(-(-k // 10)):
        part = np.column_stack([t, x[:, 10 * number : 10 * number + 10] / 1e3])
        rows = ["".join(f"  {value: .13e}" for value in row) for row in part]
        (folder / f"{case}{run}_{number + 1:02d}.out").write_text("\n" + "\n".join(rows) + "\n")
    return folder / f"{case}.inf"
