"""Recognises the people of the household by the camera in the head."""
