"""Many devices on one network: load flow, modes, verdict, and who takes part in which mode.

`document` reads a farm file, `loadflow` finds every terminal's voltage and angle, `system` joins devices and network,
`judge` decides, `participation` says who causes a mode, `farm` calls them in this order.
"""
