"""The campaign: configuration, frequency grid, plan, runner, report and command line."""
