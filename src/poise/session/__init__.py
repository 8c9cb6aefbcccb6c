"""The application as a library: `poise.load`, `place`, `run`, `up`, `profile` ...

Here the parts are wired together; `poise.cli` only parses arguments and prints.
"""
