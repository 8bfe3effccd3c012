"""Whether merges are right as often as they say: stated probabilities beside what came out, in simulated buildings.

    python benchmarks/merge_trust.py [--trials N] [--seed S] [--kinds office,corridor,..] [--log FILE].. [--fit]
        [--page FILE]

Pairs are those of `merge_trials.py`, of its kinds; `--log` keeps every trial, and the same command goes on after those
that are there, so that several may fill files of their own, with other seeds; `corrected_logs.py --pairs` fills one
with pieces of real logs. `--fit` prints the weights fitted to them, for `mapping/merge_ambiguity.py`, and what those
say that are fitted without the building, or the tenth of the simulated pairs, that they are asked of; the table tells
how the weights that stand there do: give it other trials than those they were fitted to. `--trials 0` tells of those in
the logs alone.
"""

import argparse
import json
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from merge_trials import KINDS, judged, trial
from scipy.optimize import minimize

from mapweave.mapping.merge_ambiguity import SIGNS, Grounds

BEGIN, END = "<!-- merge trust: begin -->", "<!-- merge trust: end -->"
BANDS = (0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)  # of the stated probability
UNTOLD = 0.003  # of pairs come out otherwise and nothing tells, as in a building that is the same turned round
STIFF = 0.5  # variance of each weight before any trial is 1 over this, in features of unit variance
Z = 1.96  # standard deviations of an interval of 95 %


def kept(seed: int, kinds: tuple[str, ...]) -> dict[str, Any]:
    """A trial, as the log keeps it: whether the best transform is right, what the decision is, and its grounds."""
    kind, share, pair, merge, _ = trial(seed, kinds)
    right = judged(pair, merge.best) == "right"
    grounds = (merge.grounds or Grounds())._asdict()
    return {"seed": seed, "kind": kind, "share": share, "right": right, "merged": merge.merged, "grounds": grounds}


def fitted(trials: Sequence[dict[str, Any]]) -> np.ndarray:
    """Weights of greatest posterior density, with a wide normal prior on all but the first.

    What speaks for a place never counts against it, nor the other way round: few pairs would tell that by chance.
    """
    X = np.array([Grounds(**t["grounds"]).features() for t in trials])
    y = np.array([2.0 * t["right"] - 1.0 for t in trials])
    sd = np.where(X.std(axis=0) > 1e-9, X.std(axis=0), 1.0)
    stiff = np.where(np.arange(X.shape[1]) > 0, STIFF, 0.0)

    def cost(w: np.ndarray) -> tuple[float, np.ndarray]:
        right = 1.0 / (1.0 + np.exp(-np.clip(y * (X / sd @ w), -500.0, 500.0)))
        told = UNTOLD + (1.0 - 2.0 * UNTOLD) * right
        slope = -(1.0 - 2.0 * UNTOLD) * right * (1.0 - right) / told * y
        return float(-np.log(told).sum() + 0.5 * stiff @ w**2), (X / sd).T @ slope + stiff * w

    bounds = [(None, None), *((0.0, None) if sign > 0 else (None, 0.0) for sign in SIGNS[1:])]
    made = minimize(cost, np.zeros(X.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 5000})
    return np.asarray(made.x) / sd


def interval(right: int, n: int) -> tuple[float, float]:
    """Of a share, 95 %, by Wilson."""
    p, z2 = right / n, Z * Z / n
    middle, half = p + 0.5 * z2, Z * np.sqrt(p * (1 - p) / n + 0.25 * z2 / n)
    return (middle - half) / (1 + z2), (middle + half) / (1 + z2)


def name_of(trial: dict[str, Any]) -> str:
    return str(trial.get("pair", trial.get("seed")))


def without_own(trials: Sequence[dict[str, Any]]) -> np.ndarray:
    """Of each trial what weights say that were fitted to those of other buildings."""
    fold = np.array([name_of(t).split()[0] if "pair" in t else f"{t['seed'] % 10}" for t in trials])
    out = np.zeros(len(trials))
    for name in np.unique(fold):
        weights = fitted([t for t, f in zip(trials, fold, strict=True) if f != name])
        for k in np.flatnonzero(fold == name):
            out[k] = Grounds(**trials[k]["grounds"]).probability(tuple(weights))
    return out


def band_rows(trials: Sequence[dict[str, Any]], what: str, stated: np.ndarray | None = None) -> list[str]:
    """A row for each band of stated probability that has trials; of what the weights say that stand in the program."""
    if stated is None:
        stated = np.array([Grounds(**t["grounds"]).probability() for t in trials])
    right = np.array([t["right"] for t in trials], dtype=bool)
    rows = []
    for low, high in pairwise(BANDS):
        inside = (stated >= low) & ((stated < high) | (high == BANDS[-1]))
        if n := int(inside.sum()):
            k = int(right[inside].sum())
            of = " to ".join(f"{p:.3f}" for p in interval(k, n))
            said = f"{stated[inside].mean():.3f} | {k / n:.3f} | {of}"
            rows.append(f"| {what} | {low:.2f} to {high:.2f} | {n} | {said} |")
    return rows


def table(trials: Sequence[dict[str, Any]], command: str) -> str:
    merged, refused = [t for t in trials if t["merged"]], [t for t in trials if not t["merged"]]
    lines = ["| decision | said | pairs | said, mean | right | 95 % |", "|---|---|---|---|---|---|"]
    lines += band_rows(merged, "merged") + band_rows(refused, "refused")
    wrong = sum(not t["right"] for t in merged)
    told = f"{len(trials)} pairs, {len(merged)} merged, {wrong} of them wrongly, by `{command}`."
    return "\n".join([*lines, "", told])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--log", type=Path, action="append", default=[])
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--page", type=Path)
    asked = parser.parse_args()
    kinds = tuple(asked.kinds.split(","))
    done: dict[str, dict[str, Any]] = {}
    for path in asked.log:
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        done |= {name_of(t): t for t in map(json.loads, lines)}
    for seed in range(asked.seed, asked.seed + asked.trials):
        if str(seed) not in done:
            done[str(seed)] = kept(seed, kinds)
            for path in asked.log[:1]:
                with path.open("a", encoding="utf-8") as log:
                    log.write(json.dumps(done[str(seed)]) + "\n")
    trials = [done[name] for name in sorted(done)]
    if asked.fit:
        print(f"WEIGHTS = ({', '.join(f'{w:.3f}' for w in fitted(trials))})")
        print("\n".join(band_rows(trials, "each without its own", without_own(trials))))
    told = table(trials, f"benchmarks/merge_trust.py --trials {asked.trials} --seed {asked.seed}")
    print(told)
    if asked.page is not None:
        page = asked.page.read_text(encoding="utf-8")
        marked = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
        asked.page.write_text(marked.sub(lambda _: f"{BEGIN}\n{told}\n{END}", page), encoding="utf-8")


if __name__ == "__main__":
    main()
