"""The emulated computers' network: its plan, its namespaces, its shaped links."""
