"""What is seen of a running robot: `poise top`, the dashboard, recordings, pictures."""
