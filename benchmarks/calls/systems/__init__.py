"""The systems that are compared, one a file.

Each has ``serve(folder, ready)``, which answers what comes until its process ends and
calls ``ready`` as soon as it does, and ``connect(folder)``, a context manager that
gives a `benchmarks.calls.timing.Trips`. Payloads go there and back.
"""
