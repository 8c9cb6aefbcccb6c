"""The application as a library: load, decide, run, profile, calibrate."""
