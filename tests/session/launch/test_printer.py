"""What is printed where nobody reads holds up nobody."""

import os

from poise.session.launch.printer import MOST_LINES, Printer

NUMBER = MOST_LINES + 1000
LINE = 100 * "x"
"""Of these a pipe of 64 KiB holds 650."""


def test_lines_that_nobody_reads_are_counted_and_dropped() -> None:
    reading, writing = os.pipe()
    printed = 0
    with os.fdopen(reading) as lines, Printer(writing) as printer:
        for _ in range(NUMBER):
            printer.print(LINE)  # must not wait
        for line in lines:
            if line.startswith("..."):
                break
            printed += 1
    os.close(writing)
    dropped = int(line.split()[1])
    assert dropped > 0
    assert printed + dropped == NUMBER
