"""Talks with people: understanding, dialogue, mood, face, gestures, voice."""
