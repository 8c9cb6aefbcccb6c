"""How far decisions at run time are from those of an oracle that knows the future.

    python -m benchmarks.regret [--json] [--seeds 17] [--load 0.6-0.8 0.4-0.6]
    python -m benchmarks.regret --kinds lost flapping

Six or seven components run on three computers for five minutes, while demands and other
programs change, by seed. A cost is the CPU work that is not done [core-seconds]: what
components need and other programs do not leave, all of it on a lost computer; and for
each move 0.3, and what the component needs for 50 ms. In a ratio to the cost of the
oracle, both count as the cost of one move at least.

`oracle` has the least cost that is possible. `poise` is the real loop, with simulated
measurements. The others know the present exactly: `never` only restarts what a lost
computer ran; `greedy` counts with the next second; `horizon` counts with 30 s; `total`
seeks a placement that keeps all limits, and goes there when that gains within 30 s.
"""

from __future__ import annotations

import argparse

import msgspec

from benchmarks.regret.summary import ARMS, Band, band
from benchmarks.regret.traces import KINDS


def main() -> None:
    """Compare, and print it."""
    parser = argparse.ArgumentParser(
        "python -m benchmarks.regret",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print all figures as JSON")
    parser.add_argument("--seeds", type=int, default=17, help="traces of each load")
    parser.add_argument(
        "--load",
        nargs="+",
        type=_loads,
        default=[(0.6, 0.8), (0.4, 0.6)],
        metavar="LOW-HIGH",
        help="the mean load of a trace, as a share of all capacity",
    )
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    asked = parser.parse_args()
    found = []
    for loads in asked.load:
        found.append(band(loads, asked.seeds, asked.kinds))
        if not asked.json:
            print_table(found[-1])
    if asked.json:
        print(msgspec.json.format(msgspec.json.encode(found)).decode())


def _loads(text: str) -> tuple[float, float]:
    low, high = map(float, text.split("-"))
    if not 0 < low <= high < 1:
        raise ValueError(text)
    return low, high


def print_table(found: Band) -> None:
    """Print the figures of one load."""
    low, high = found.loads
    title = f"load {low:.0%} to {high:.0%}, {len(found.traces)} traces"
    print(f"{title:30} {'cost / oracle, per trace':>28}")
    heads = ("arm", "cost", "mean", "median", "worst", "moves", "worse than never")
    print("{:8} {:>12} {:>10} {:>8} {:>8} {:>8} {:>18}".format(*heads))
    for name in ARMS:
        arm = found.arms[name]
        print(
            f"{name:8} {arm.cost:12.2f} {arm.mean_ratio:10.2f} {arm.median_ratio:8.2f} "
            f"{arm.worst_ratio:8.2f} {arm.moves:8.1f} {arm.harmful:18}"
        )
    acts, needless, simple, one_step = (
        sum(getattr(each, name) for each in found.traces)
        for name in ("acts", "needless", "simple", "one_step")
    )
    print(
        f"poise acted {acts} times, {needless} of them when nothing was short; one "
        f"move sufficed {simple} times, and it took one step {one_step} times"
    )
    for target in found.targets:
        limit = f"at most {target.most:.4g}"
        if target.most == float("inf"):
            limit = f"at least {target.least:.4g}"
        met = "met" if target.is_met else "not met"
        print(f"  {met:8} {target.what}: {target.value:.3g}, asked {limit}")
    print(flush=True)


if __name__ == "__main__":
    main()
