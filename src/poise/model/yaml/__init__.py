"""Robot files as text: reading, including, validating and editing YAML."""
