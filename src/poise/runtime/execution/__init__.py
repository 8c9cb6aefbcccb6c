"""How a component's code is run: exclusion, mailbox, timers, counters."""
