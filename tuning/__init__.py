"""From the table to decisions: verdict, margins, poles and the damping gain. No campaign is known here.

At the root stands what one verdict passes: `siso` (the paper's equivalents), `crossings`, `winding`, `poles`, `rows`
and `feeding` (the judges and what they look at), `unseen` (what may hide between rows), `probability` and `anchor` (how
sure, and what experiment proved), `objections` and `verdict`, `margins`, `intervals`, `gain` (k), `tune`, `result`,
`text` and `figures`; beside them `remedy`, `grid_check`, `metrics` with report and figure, and `region` (operating
points that follow from a grid, and the worst of a region).

`grids`     what a device may stand on: series R-L, elements, tables, regions, other devices
`network`   lines and loads between them
`farm`      many devices on a network
`bank`      one device on many grids
"""
