"""The computers of a simulated robot: processes, clocks, CPU and disks."""
