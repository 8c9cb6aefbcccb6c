"""What all tests share."""

from hypothesis import settings

# an example that takes long on a busy machine is no fault
settings.register_profile("poise", deadline=None)
settings.load_profile("poise")
