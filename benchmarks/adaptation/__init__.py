"""What adaptation gains under load, and what it costs."""
