"""Connections between containers, and what they carry."""
