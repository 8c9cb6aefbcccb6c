"""Policies: conditions over what is measured, and what is done when they hold."""
