"""The page of the run: its tables and pictures, from the results that are there."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cases import TIERS
from confusion import write_confusion
from harness import code_that_made, fill
from verdicts import accuracy, by_name, in_family, in_joint, mended, misnamed, only_right, right

from mcpilco.sweep import markdown, rate, rate_cell

HERE = Path(__file__).parent
HEADER = ("tier", "cases", "right by name [%]", "right [%]", "right, or in a family [%]")
HEADER += ("wrong and sure [%]",)
HIDDEN = {
    "one": "one effect",
    "weak": "a weak one",
    "two": "two",
    "three": "three",
    "none": "none",
    "outside": "what no effect of the catalogue is",
    "sparse-one": "one, samples 0.1 s apart",
    "sparse-none": "none, samples 0.1 s apart",
    "further": "one of twelve later effects",
    "rough": "up to three, a cable, counts and gaps",
    "laboratory-one": "one, as a laboratory has it",
    "laboratory-none": "none, as a laboratory has it",
}
"""tiers in words"""
LONGEST_S = 180.0
"""CPU time that 95 % of the cases may take [s]"""


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {
        tier: [json.loads(p.read_text()) for p in sorted((out / "results" / tier).glob("*.json"))]
        for tier in TIERS
    }
    found = {tier: cases for tier, cases in found.items() if cases}
    parts = [asked(found), naming(found), by_number(found), numbers(found), places(found)]
    parts += [pictures(found, out), missed(found), origins(found)]
    parts = parts if found else ["Not measured yet."]
    fill(out / "README.md", parts, template=HERE / "README.md")
    if found and out == HERE:
        fill(HERE.parents[1] / "README.md", [by_tier(found), in_short(found)], name="hidden")


def by_tier(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """How often the verdict is right, strictly and in a family."""
    rows = [_shares(HIDDEN[tier], cases) for tier, cases in found.items()]
    return markdown(("hidden", *HEADER[1:]), rows)


def in_short(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Errors, the gap closed and the time, over all cases."""
    cases = [case for tier in found.values() for case in tier]
    errors, covered = accuracy([case for case in cases if right(case)])
    closed = [c["error"]["closed"]["value"] for c in cases if c["error"] and mended(c)]
    seconds = [case["cpu_s"] for case in cases]
    return (
        "Medians: where it is right the parameters are off by "
        f"{100 * np.median(errors):.2f} %, the held-out gap closes by "
        f"{100 * np.median(closed):.1f} %, and a case takes {np.median(seconds):.0f} s of one core "
        f"({max(seconds):.0f} s at most). {100 * np.mean(covered):.0f} % of the 95 % intervals "
        "hold the truth."
    )


def asked(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The rates that are asked of the tier `rough`, beside those that are reached."""
    all_cases = found.get("rough", ())
    by_effects = [[c for c in all_cases if len(c["truth"]) == n] for n in range(4)]
    if not all(by_effects):
        return ""
    _, covered = accuracy([case for case in all_cases if right(case)])
    seconds = [case["cpu_s"] for case in all_cases]
    short = [each <= LONGEST_S for each in seconds]
    shares = (
        ("single effects: right, or in a family", "90 %", map(in_family, by_effects[1])),
        ("pairs", "80 %", map(in_family, by_effects[2])),
        ("triples", "-", map(in_family, by_effects[3])),
        ("nothing hidden: no wrong name", "95 %", map(only_right, by_effects[0])),
        ("wrong and sure", "3 % at most", map(misnamed, all_cases)),
        ("intervals that hold the truth, where it is right", "90 to 98 %", covered),
        ("no event is told; nothing pushes them", "-", [not c["events"] for c in all_cases]),
        ("a case takes three CPU minutes or less", "95 %", short),
    )
    rows = [(what, wanted, _counted(list(flags))) for what, wanted, flags in shares]
    rows.append(("CPU time in the median", "30 s", f"{np.median(seconds):.0f} s"))
    seeds = [case["seed"] for case in all_cases]
    header = (f"rough, seeds {min(seeds)} to {max(seeds)}", "asked", "reached [%]")
    return markdown(header, rows)


def _counted(flags: Sequence[bool]) -> str:
    return f"{rate_cell(rate(flags))}: {sum(flags)} of {len(flags)}"


def naming(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """How often the verdict is right, beside the peers'."""
    rows = []
    for tier, cases in found.items():
        names = dict.fromkeys(name for case in cases for name in case.get("peers", ()))
        by_method = {tier: cases}
        by_method |= {
            f"{tier}: {name}": [as_told_by(name, case) for case in cases if "peers" in case]
            for name in names
        }
        rows += [_shares(method, told) for method, told in by_method.items()]
    return "\n\n".join(part for part in (markdown(HEADER, rows), fits(found)) if part)


def _shares(name: str, cases: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    rules = (by_name, right, in_family, misnamed)
    return name, str(len(cases)), *(rate_cell(rate(map(rule, cases))) for rule in rules)


def by_number(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Of the tier `rough`, how often the verdict is right by the number of hidden effects."""
    all_cases, rows = found.get("rough", ()), []
    for number in range(1 + TIERS["rough"].effects):
        cases = [case for case in all_cases if len(case["truth"]) == number]
        named = sum(case["verdict"] == "named" for case in cases)
        partly = sum(case["verdict"] == "partly" for case in cases)
        counts = f"{len(cases)} ({named}, {partly})"
        wrong_names = [not only_right(case) for case in cases]
        flags = [map(right, cases), map(in_family, cases), wrong_names, map(misnamed, cases)]
        if cases:
            rows.append((str(number), counts, *(rate_cell(rate(list(each))) for each in flags)))
    header = ("rough: hidden effects", "cases (`named`, `partly`)", "right [%]")
    header += ("right, or in a family [%]", "a wrong name [%]", "wrong and sure [%]")
    return markdown(header, rows) if rows else ""


def fits(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The sentences on the fits of mujoco.sysid: which failed, and what they cost."""
    told = [fit for cases in found.values() for case in cases if (fit := case.get("identified"))]
    if not told:
        return ""
    remarks = Counter(remark for fit in told for remark in fit["remarks"])
    counted = "; ".join(f"{remark}: {count}" for remark, count in remarks.most_common())
    seconds = [fit["cpu_s"] for fit in told]
    return (
        f"mujoco.sysid, {len(told)} cases: {np.median(seconds):.0f} CPU s in the median, "
        f"{max(seconds):.0f} in the worst. {counted or 'All fits converged'}."
    )


def as_told_by(peer: str, case: Mapping[str, Any]) -> dict[str, Any]:
    """The case with what another method names; that is sure, and has no families."""
    named = [
        {"name": name, "target": target, "family": [name], "probability": 1.0}
        for name, target in case["peers"][peer]
    ]
    return {**case, "found": named, "verdict": "named" if named else "none"}


def numbers(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Errors and intervals of the parameters, the gap closed, and the time it takes."""
    rows = []
    for tier, cases in {**found, **together(found)}.items():
        errors, covered = accuracy([case for case in cases if right(case)])
        closed = [c["error"]["closed"]["value"] for c in cases if c["error"] and mended(c)]
        seconds = [case["cpu_s"] for case in cases]
        rows.append(
            (
                tier,
                f"{100 * np.median(errors):.2f}" if errors else "-",
                f"{100 * np.mean(covered):.0f} (of {len(covered)})" if covered else "-",
                f"{100 * np.median(closed):.1f}, {100 * np.percentile(closed, 10):.1f}"
                if closed
                else "-",
                f"{np.median(seconds):.0f}, {max(seconds):.0f}",
            )
        )
    header = ("tier", "median error of parameters [%]", "95 % intervals that hold the truth [%]")
    header += ("gap closed: median, tenth percentile [%]", "CPU: median, worst [s]")
    return markdown(header, rows)


def together(
    found: Mapping[str, Sequence[Mapping[str, Any]]],
) -> dict[str, list[Mapping[str, Any]]]:
    """The cases of all tiers that hide effects of the catalogue in an exact plant, and of all."""
    exact = [tier for tier in found if TIERS[tier].effects and not TIERS[tier].laboratory]
    groups = {", ".join(exact): exact, "all": list(found)}
    return {
        name: [case for tier in tiers for case in found[tier]]
        for name, tiers in groups.items()
        if len(tiers) > 1
    }


def places(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Of effects that are not in the catalogue, how often the joint is told in which they act."""
    rows = []
    for kind in dict.fromkeys(
        e.get("kind", "") for c in found.get("outside", []) for e in c["truth"]
    ):
        cases = [case for case in found["outside"] if case["truth"][0].get("kind") == kind]
        unknown = [case for case in cases if case["verdict"] == "unknown"]
        told = [part for case in unknown if (part := in_joint(case)) is not None]
        closed = [case["error"]["closed"]["value"] for case in unknown if mended(case)]
        rows.append(
            (
                kind,
                str(len(cases)),
                str(len(unknown)),
                str(len(told)),
                rate_cell(rate(told)) if told else "-",
                f"{100 * np.median(closed):.1f}" if closed else "-",
            )
        )
    header = ("outside", "cases", "unknown", "force learned", "in the right joint [%]")
    table = markdown((*header, "gap closed: median [%]"), rows)
    return f"### What is not in the catalogue\n\n{table}" if rows else ""


def pictures(found: Mapping[str, Sequence[Mapping[str, Any]]], out: Path) -> str:
    """Draws what was named over what was hidden, a picture a tier."""
    paths = {
        tier: write_confusion(tier, cases, out / f"confusion-{tier}.png")
        for tier, cases in found.items()
    }
    lines = [f"![Hidden against named, {tier}]({path.name})" for tier, path in paths.items()]
    return "### What was hidden, and what was named\n\n" + "\n\n".join(lines)


def missed(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The cases that are not right."""
    lines = []
    for tier, cases in found.items():
        for case in cases:
            if not right(case):
                truth = ", ".join(_hidden(case)) or "none"
                told = ", ".join(f"{e['name']} at {e['target']}" for e in case["found"]) or "-"
                lines.append(
                    f"- {tier}, seed {case['seed']}, {case['plant']}: hidden {truth}; "
                    f"verdict {case['verdict']}, named {told}"
                )
    return "### Cases that are not right\n\n" + "\n".join(lines) if lines else ""


def _hidden(case: Mapping[str, Any]) -> list[str]:
    """The effects of a case, and how far beyond what parameters could do, where that is kept."""
    names = [f"{effect['name']} at {effect['target']}" for effect in case["truth"]]
    apart = [f" ({std:.0f} std)" for std in case.get("beyond", [])] or [""] * len(names)
    return [name + std for name, std in zip(names, apart, strict=True)]


def origins(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Which versions of the code solved the cases, where and how well; the latest come first."""
    solved: dict[tuple[str, ...], list[tuple[str, Mapping[str, Any]]]] = defaultdict(list)
    for tier, cases in found.items():
        for case in cases:
            where = (code_that_made(case), *map(str, case["machine"].values()))
            solved[where].append((tier, case))
    rows = {}
    for where, told in solved.items():
        cases = [case for _, case in told]
        seeds = [case["seed"] for case in cases]
        tiers = ", ".join(dict.fromkeys(tier for tier, _ in told))
        _, count, _, *shares = _shares("", cases)
        rows[max(seeds), where] = (*where, tiers, f"{min(seeds)}–{max(seeds)}", count, *shares)
    header = ("made by", "processor", "cores", "tiers", "seeds", "cases", *HEADER[3:])
    table = markdown(header, [rows[key] for key in sorted(rows, reverse=True)])
    return f"### Which code solved them\n\n{table}"
