"""What is driven: the promise of a plant, its conformance check, the registry and the built-in plants.

At the root: `protocol` (the promise), `promises` and `check` (is it kept?), `registry` (plants by name), `errors`,
`injection`, `operating_range`, `space_vectors`, `lanes` (plants that step many experiments at once), `rl_branch`.

`turbine`, `inverters`      plants of our own; `kernels` are their compiled loops (numpy and numba alone)
`damping`                   damping control, its estimator, and events in time
`boxes`, `fmu`, `foreign`   devices that nobody can look into: step functions, programs, FMUs, files read apart
`controllers`, `greybox`    a vendor's controller in the turbine's circuit
`states`                    how a state is kept: snapshots, replays, forks, steady states
`recordings`                readers of what was recorded

Nothing of ours is imported from above.
"""
