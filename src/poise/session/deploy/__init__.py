"""Robots' code on its way to their computers."""
