"""From records to a frequency response: phasors, the 2x2 solve, quality and the table.

At the root stands what one frequency passes: `fourier` (a phasor), `settling` (is it at rest?), `admittance` (two
experiments give a 2x2), `uncertainty`, `response` (the type), `frames` (pn and dq); beside them `operating_state` (what
is known of the point), `transient_modes`, `grid_impedance`, `exclusion`, `files` and `read_only`.

`table`       the Parquet format: read, written, held against its rules
`fit`         rational models of a response, and what an adaptive grid asks next
`surrogate`   Y at any operating point
`recorded`    tones and broadband signals in recordings
`exchange`    files and objects of other tools
`views`       how a response shows itself: words, HTML, pandas, figures

Of `seqsweep.plant` only the promise, the errors and space vectors are known here.
"""
