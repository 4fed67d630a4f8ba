"""The impedance of the grid behind the PCC, measured from the device's side."""
