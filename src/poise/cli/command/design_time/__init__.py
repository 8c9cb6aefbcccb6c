"""Commands about robots that need not run: checked, measured, placed and drawn."""
