"""The manager's part in moves, transitions and replacements."""
