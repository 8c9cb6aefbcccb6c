"""What a container gives its components: runners, wiring, counters."""
