#!/usr/bin/env python3
"""What a sweep of random views says: how many are registered, refused, wrong, and whether a stated probability of the vertebral
level holds.

usage: levels.py CSV [CSV ...]

CSV  what `AVENTAIL_SWEEP=200 AVENTAIL_SWEEP_OUT=sweep.csv cargo test --release --test all sweep::` writes

The probability that the result has the right level is 1 / (1 + sum over other levels of exp(-(offset + slope * x))); x is the
share of the evidence that the best place at that level lacks (`share`), or the difference of costs (`cost`). Offset and slope
follow from the odd half of the seeds (least logarithmic loss), the tables from the even half; then the other way round. A result
is right where no vertebra in view lies nearer to the place of another one than to its own.
"""
import csv
import math
import sys
from collections import defaultdict

# What asks for a look at where the bones are.
OF_PLACE = {"bones-lost", "fraction-scaled", "level-unsure", "side-unsure", "weak-start"}
BINS = [0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.01]


def doubted(row):
    return bool(OF_PLACE & set(row["findings"].split("|")))


class Case:
    """A registered view with its level."""

    def __init__(self, row):
        self.seed, self.kind = int(row["seed"]), row["kind"].split(":")[0]
        self.findings = row["findings"].split("|")
        self.doubted = doubted(row)
        self.right = int(row["levels_wrong"]) == 0
        self.shift = int(row["level"])
        places = [p.split(":") for p in row["places"].split(";") if p]
        self.cost = float(places[0][0]) if places else 0.0
        # The best place at each other level.
        self.rivals = {}
        for cost, found, level, right, apart in places[1:]:
            if level not in ("", "0"):
                self.rivals[level] = min(float(cost), self.rivals.get(level, math.inf))

    def gaps(self, measure):
        """How far each other level is behind."""
        of = {"cost": lambda c: c - self.cost, "share": lambda c: 1.0 - c / self.cost}[measure]
        return [of(c) for c in self.rivals.values()]


def probability(gaps, offset, slope):
    return 1.0 / (1.0 + sum(math.exp(min(500.0, -(offset + slope * g))) for g in gaps))


def loss(cases, measure, offset, slope):
    total = 0.0
    for case in cases:
        p = min(max(probability(case.gaps(measure), offset, slope), 1e-6), 1.0 - 1e-6)
        total -= math.log(p if case.right else 1.0 - p)
    return total / max(1, len(cases))


def fitted(cases, measure):
    """Offset and slope of the least loss, by ever finer grids."""
    scale = {"cost": 0.01, "share": 10.0}[measure]
    best, width = (0.0, scale), [4.0, 1.5]
    for _ in range(9):
        offsets = [best[0] + width[0] * n / 5 for n in range(-5, 6)]
        slopes = [best[1] * math.exp(width[1] * n / 5) for n in range(-5, 6)]
        best = min(((o, s) for o in offsets for s in slopes), key=lambda b: loss(cases, measure, *b))
        width = [0.55 * w for w in width]
    return best


def share(part, whole):
    return f"{part}/{whole}" + (f" ({100.0 * part / whole:.0f} %)" if whole else "")


def reliability(cases, measure, law):
    print("| stated | views | mean stated | right |\n|---|---|---|---|")
    said = [(probability(case.gaps(measure), *law), case.right) for case in cases]
    for low, high in zip(BINS, BINS[1:]):
        some = [s for s in said if low <= s[0] < high]
        if some:
            mean = 100.0 * sum(p for p, _ in some) / len(some)
            print(f"| {100 * low:.0f} to {min(100, 100 * high):.0f} % | {len(some)} | {mean:.1f} % "
                  f"| {share(sum(r for _, r in some), len(some))} |")
    sure = [r for p, r in said if p >= 0.9]
    print(f"stated 90 % or more: right {share(sum(sure), len(sure))}\n")


def main():
    rows = [row for name in sys.argv[1:] for row in csv.DictReader(open(name))]
    large = [r for r in rows if int(r["large"]) >= 2]
    kinds = defaultdict(list)
    for row in large:
        kinds[row["kind"].split(":")[0] + (":axis" if row["kind"].endswith("axis") else "")].append(row)
    print(f"{len(rows)} views, {len(large)} with two bones of 5 ml\n")
    print("| views | number | registered | of them asking for a look | all bones within bounds | level wrong | untold | refused |")
    print("|---|---|---|---|---|---|---|---|")
    for kind, some in [*sorted(kinds.items()), ("all", large)]:
        done = [r for r in some if r["outcome"] == "registered"]
        wrong = [r for r in done if int(r["levels_wrong"]) > 0]
        cells = [len(some), len(done), sum(map(doubted, done)), sum(r["beyond"] == "0" for r in done),
                 len(wrong), sum(not doubted(r) for r in wrong), len(some) - len(done)]
        print(f"| {kind} | " + " | ".join(str(c) for c in cells) + " |")
    refusals = defaultdict(int)
    for row in large:
        refusals[row["outcome"]] += 1
    print("\noutcomes:", ", ".join(f"{k} {n}" for k, n in sorted(refusals.items(), key=lambda i: -i[1])))
    seconds = sorted(float(r["seconds"]) for r in rows)
    print(f"seconds on one thread: median {seconds[len(seconds) // 2]:.1f}, most {seconds[-1]:.1f}\n")

    cases = [Case(r) for r in large if r["outcome"] == "registered" and r["level"] != ""]
    for code in ("level-unsure", "weak-start", "bones-lost"):
        some = [c for c in cases if code in c.findings]
        print(f"{code}: {len(some)} views, right {share(sum(c.right for c in some), len(some))}")
    quiet = [c for c in cases if not c.doubted]
    print(f"nothing asks for a look: right {share(sum(c.right for c in quiet), len(quiet))}")
    alone = [c for c in cases if not c.rivals]
    weighed = [c for c in cases if c.rivals]
    print(f"no other level weighed: right {share(sum(c.right for c in alone), len(alone))}")
    print(f"other levels weighed: right {share(sum(c.right for c in weighed), len(weighed))}\n")
    for measure in ("share", "cost"):
        for odd in (1, 0):
            learnt = [c for c in weighed if c.seed % 2 == odd]
            held = [c for c in weighed if c.seed % 2 != odd]
            law = fitted(learnt, measure)
            losses = loss(learnt, measure, *law), loss(held, measure, *law)
            print(f"{measure}: offset {law[0]:.2f}, slope {law[1]:.4g} from {len(learnt)} {'odd' if odd else 'even'} seeds; "
                  f"loss {losses[0]:.3f} there, {losses[1]:.3f} on the {len(held)} others")
            reliability(held, measure, law)


if __name__ == "__main__":
    main()
