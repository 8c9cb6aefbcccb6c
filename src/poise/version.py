"""Poise's version, also that of the package: reading it from there takes 25 ms."""

VERSION = "0.2.0"
