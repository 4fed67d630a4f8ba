"""The campaign: configuration, plan, runner, confirmation and command line.

At the root: `plan` (every shot, as data), `planning` (from the configuration to it) and `confirm` (k, swept again).

`config`       a campaign's file: sections, checks, every problem at its line
`excitation`   which frequencies, which signal
`measure`      one batch: the unperturbed device, tones or a signal, the solve, its judgement
`run`          the runner: workers, host (here or in a child process), what is kept, the table
`region`       operating points placed where a surrogate is least sure
`verify`, `grid_probe`, `bank`     proof in time, the grid behind the PCC, many grids
`playback`, `recorded`             perturbations out as files, recordings in
`report`       summary of a table; `cli` is the command line

Called, this folder is `seqsweep.sweep(...)`: the function of the face shares its name.
"""
