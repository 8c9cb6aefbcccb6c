"""Explanations: why a component is where it is, and why nothing can hold."""
