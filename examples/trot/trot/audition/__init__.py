"""Listens: who speaks, from where, and where to look next."""
