"""Gives a robot its computers, starts it there, and leaves nothing behind."""
