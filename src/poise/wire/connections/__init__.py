"""Connections between containers: opening, sending, receiving, shared memory."""
