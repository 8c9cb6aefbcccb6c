"""The kernel's control groups, versions 1 and 2: they limit and measure a computer."""
