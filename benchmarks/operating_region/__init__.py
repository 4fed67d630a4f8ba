"""The bars of the surrogate over operating points: devices with a closed form, designs, a library's method beside."""
