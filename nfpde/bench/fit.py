"""`nfpde bench fit`: the paper's two candidates on Hopper, exact OT to the robots before and after."""

from __future__ import annotations

import itertools
import json
import platform
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from nfpde.bench.code import built_solver, code_of
from nfpde.bench.estimation.cell import facts_of_device
from nfpde.bench.partial import Partial
from nfpde.benchmarks import collect, robot
from nfpde.estimation import NfpdeConfig, fit
from nfpde.evaluate import evaluate
from nfpde.sim import Device, found_device, make_simulator
from nfpde.storage import write_whole

CELLS = (("softmax", "flow"), ("cai", "flow"), ("trajectory", "population"), ("trajectory", "episodes"))
"""Method, and which of its answers is measured."""

SAMPLES = 2000
"""Samples of every distribution that is measured."""


def run(quick: bool, out: Path, device: Device = "cpu") -> None:
    """Fit, measure, print a table and write it to fit.md and fit.json.

    Where it was stopped, the same command goes on, as long as the code is the same.

    Args:
        quick: one seed and a tenth of the iterations.
        out: folder for the tables.
        device: where the fits are simulated; the table of another one than the CPU is `fit_<device>`.

    Raises:
        BadInput: no such device.
    """
    device = found_device(device)
    elsewhere = device != "cpu"
    config = NfpdeConfig(iterations=6) if quick else NfpdeConfig()
    facts = {
        "command": "nfpde bench fit" + (f" --device {device}" if elsewhere else "") + (" --quick" if quick else ""),
        "config": asdict(config),
        "samples": SAMPLES,
        "versions": {name: version(name) for name in ("nfpde", "mujoco", "torch", "zuko", "numpy")},
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "code": code_of("bench/fit.py", "benchmarks"),
        "solver": built_solver(),
        **facts_of_device(robot("hopper"), device),
    }
    out.mkdir(parents=True, exist_ok=True)
    record = out / ("fit" + (f"_{device}" if elsewhere else "") + ("_quick" if quick else "") + ".json")
    parts, rows = Partial(record.with_suffix(".part.json"), facts), []
    cells = itertools.product(CELLS, ("gaussian", "mixture"), range(1 if quick else 3))
    for (method, answer), target, seed in cells:
        key = {"target": target, "seed": seed, "method": method, "answer": answer}
        measure = partial(_cell, target, seed, method, answer, config, device)
        rows.append({**key, **parts.get(f"{method}, {answer}, {target}, seed {seed}", measure)})
        print(_line(rows[-1]), flush=True)
    write_whole(record, json.dumps({**facts, "rows": rows}, indent=1))
    table = _table(rows, facts)
    print(table)
    write_whole(record.with_suffix(".md"), table)
    parts.finish()


def _cell(target: Any, seed: int, method: Any, answer: str, config: NfpdeConfig, device: Device) -> dict[str, float]:
    hopper = robot("hopper")
    dataset, truth = collect(hopper, target, seed=seed)
    simulator = make_simulator(hopper.path, hopper.space, device=device)
    settings = None if method == "trajectory" else config
    result = fit(simulator, dataset, method=method, config=settings, seed=seed, quiet=True)
    estimate = result.episodes if answer == "episodes" and result.episodes is not None else result.distribution
    measured = evaluate(estimate, truth, initial=result.initial, samples=SAMPLES)
    episodes, fresh = measured.to_episodes, measured.to_population
    return {
        "transitions": result.info["transitions"],
        "before": episodes["initial"].physical,
        "after": episodes["estimate"].physical,
        "ratio": episodes["estimate"].physical / episodes["initial"].physical,
        "population": episodes["population"].physical,
        "before_box": episodes["initial"].box,
        "after_box": episodes["estimate"].box,
        "fresh_before": fresh["initial"].physical,
        "fresh_after": fresh["estimate"].physical,
        "million_steps": result.info["simulated_steps"] / 1e6,
        "seconds": result.info["seconds"],
    }


def _line(row: dict[str, Any]) -> str:
    return (
        f"| {row['target']} | {row['seed']} | {row['method']} | {row['answer']} | {row['transitions']} | "
        f"{row['before']:.3f} | "
        f"{row['after']:.3g} | {row['ratio']:.2g} | {row['population']:.3f} | {row['before_box']:.3f} | "
        f"{row['after_box']:.3g} | {row['fresh_before']:.3f} | {row['fresh_after']:.3f} | "
        f"{row['million_steps']:.1f} |"
    )


def _table(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    failed = [r for r in rows if r["method"] == "softmax" and r["ratio"] > 0.5]
    cai = {(r["target"], r["seed"]): r["after"] for r in rows if r["method"] == "cai"}
    compared = [r for r in rows if r["method"] == "softmax" and (r["target"], r["seed"]) in cai]
    lost = [r for r in compared if r["after"] >= cai[r["target"], r["seed"]]]
    head = (
        "| target | seed | method | answer | transitions | OT before | OT after | after / before | truth's own | "
        "before, boxes | after, boxes | before, fresh | after, fresh | million steps |"
    )
    nsoftmax = sum(r["method"] == "softmax" for r in rows)
    verdict = (
        f"Softmax at least halves the distance in {nsoftmax - len(failed)} of {nsoftmax} cells, and ends closer than "
        f"CAI in {len(compared) - len(lost)} of {len(compared)}."
    )
    rows = sorted(rows, key=lambda r: (r["target"], r["seed"]))
    return "\n".join(
        [
            "# NFPDE on Hopper",
            "",
            "Ten episodes of uniform random commands, one robot each; exact optimal transport (Euclidean) between "
            f"{SAMPLES} samples and the ten robots' true parameters, in physical units as in the paper and in widths "
            "of the bounds. `truth's own`: what fresh samples of the true population get. `fresh`: distance to fresh "
            "samples of the population instead of the ten robots. `trajectory` takes an episode for one robot and has "
            "two answers: the smoothed population, and the equal mixture of the ten robots' own posteriors.",
            "",
            head,
            "|" + "---|" * head.count(" | ") + "---|",
            *map(_line, rows),
            "",
            verdict,
            "",
            f"`{facts['command']}`, settings {facts['config']}; versions {facts['versions']}; {facts['machine']}"
            + (f"; {facts['device']}." if "device" in facts else "."),
            "",
        ]
    )
