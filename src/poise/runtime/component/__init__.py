"""What users write against: components, ports, time limits."""
