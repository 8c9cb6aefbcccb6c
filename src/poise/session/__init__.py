"""The application as a library: `poise.load`, `place`, `run`, `up`, `profile` ..."""
