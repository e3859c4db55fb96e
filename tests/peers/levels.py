#!/usr/bin/env python3
"""What a sweep of random views says: how many are registered, refused, wrong, and whether a stated probability of the vertebral
level holds.

usage: levels.py CSV [CSV ...]

CSV  what `AVENTAIL_SWEEP=200 AVENTAIL_SWEEP_OUT=sweep.csv cargo test --release --test all sweep::` writes

The probability that the result lies right is 1 / (1 + none + sum over other places of other * exp(-slope * x)); x is the share
of the result's evidence that a place lacks (src/bones/fit/probable.rs holds none, other and slope as learnt from all views). To
hold it against the truth, the law is learnt from the odd half of the seeds (least logarithmic loss) and tried on the even half,
and the other way round. A result is right where no vertebra in view lies nearer to the place of another one than to its own.
"""
import csv
import math
import sys
from collections import defaultdict

# What asks for a look at where the bones are.
OF_PLACE = {"bones-lost", "fraction-scaled", "level-unsure", "side-unsure", "weak-start"}
BINS = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 1.01]
# From a vertebra to the next, about.
LEVEL_MM = 16.0
# No view with one place alone was wrong; as many views cannot show that none ever is.
LEAST_NONE = 0.006


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
        cost = float(places[0][0]) if places else 0.0
        # The share that each other place lacks, and the probability that the program stated, where the file has it.
        self.lacks, kept = [], [0.0]
        for there, _, _, _, apart, *_ in places[1:]:
            # Two fits that ended as far from the result and with as much evidence ended at one place.
            if float(apart) > LEVEL_MM / 2 and all(abs(float(apart) - k) > 1.0 for k in kept):
                kept.append(float(apart))
                self.lacks.append(1.0 - float(there) / cost)
        self.stated = float(places[0][5]) if places and len(places[0]) > 5 else None


def probability(case, law):
    none, other, slope = law
    return 1.0 / (1.0 + none + sum(other * math.exp(min(500.0, -slope * x)) for x in case.lacks))


def loss(cases, law):
    total = 0.0
    for case in cases:
        p = min(max(probability(case, law), 1e-6), 1.0 - 1e-6)
        total -= math.log(p if case.right else 1.0 - p)
    return total / max(1, len(cases))


def fitted(cases):
    """None, other and slope of the least loss, by ever finer grids; `other` is 1 at most: no place weighs more than the result."""
    best, width = (0.01, 0.5, 8.0), [3.0, 3.0, 1.5]
    for _ in range(12):
        steps = [[b * math.exp(w * n / 3) for n in range(-3, 4)] for b, w in zip(best, width)]
        all_laws = ((max(n, LEAST_NONE), min(o, 1.0), s) for n in steps[0] for o in steps[1] for s in steps[2])
        best = min(all_laws, key=lambda law: loss(cases, law))
        width = [0.6 * w for w in width]
    return best


def share(part, whole):
    return f"{part}/{whole}" + (f" ({100.0 * part / whole:.0f} %)" if whole else "")


def reliability(said):
    """A table of probabilities stated and what was right."""
    print("| stated | views | mean stated | right |\n|---|---|---|---|")
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
    alone = [c for c in cases if not c.lacks]
    weighed = [c for c in cases if c.lacks]
    print(f"no other place fitted: right {share(sum(c.right for c in alone), len(alone))}")
    print(f"other places fitted: right {share(sum(c.right for c in weighed), len(weighed))}\n")
    said = []
    for odd in (1, 0):
        learnt = [c for c in cases if c.seed % 2 == odd]
        held = [c for c in cases if c.seed % 2 != odd]
        law = fitted(learnt)
        print(f"none {law[0]:.4f}, other {law[1]:.3f}, slope {law[2]:.2f} from {len(learnt)} {'odd' if odd else 'even'} seeds; "
              f"loss {loss(learnt, law):.3f} there, {loss(held, law):.3f} on the {len(held)} others")
        said += [(probability(c, law), c.right) for c in held]
    print("each half by the law of the other:")
    reliability(said)
    law = fitted(cases)
    print(f"all: none {law[0]:.4f}, other {law[1]:.3f}, slope {law[2]:.2f}; loss {loss(cases, law):.3f}")
    reliability([(probability(c, law), c.right) for c in cases])
    stated = [(c.stated, c.right) for c in cases if c.stated is not None]
    if stated:
        print("as the program stated:")
        reliability(stated)


if __name__ == "__main__":
    main()
