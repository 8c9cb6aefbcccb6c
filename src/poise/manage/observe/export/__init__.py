"""The metrics of a running robot, for Prometheus and OpenTelemetry."""
