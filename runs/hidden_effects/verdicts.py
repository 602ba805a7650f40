"""Whether what was found in a case is what was hidden in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from systems import SYSTEMS, Hidden

from mcpilco.plant import CATALOGUE

CONFIDENT = 0.9
"""probability above which a name is meant"""


def hidden(case: Mapping[str, Any]) -> set[frozenset[Hidden]]:
    """The effects to be named, each with those that no recording tells from it."""
    return {same(case, effect) for effect in case["truth"]}


def same(case: Mapping[str, Any], effect: Mapping[str, Any]) -> frozenset[Hidden]:
    """An effect, and those that do exactly the same to the recordings of a case."""
    pair = effect["name"], effect["target"]
    return SYSTEMS[case["plant"]].same(pair, case["velocities"])


def right(case: Mapping[str, Any]) -> bool:
    """Whether name and target of all effects, or the verdict none or unknown, are right.

    Where something small is hidden besides and not named, `partly` says so.
    """
    if any(effect["name"] == "outside" for effect in case["truth"]):
        return case["verdict"] == "unknown"
    wanted, told = hidden(case), [same(case, effect) for effect in asked(case)]
    return case["verdict"] in _fitting(case) and len(told) == len(wanted) and set(told) == wanted


def _fitting(case: Mapping[str, Any]) -> tuple[str, ...]:
    """The verdicts that suit what was hidden and found."""
    if not (case["found"] or case["truth"]):
        return ("none",)
    return ("named", "partly") if case.get("besides") else ("named",)


def asked(case: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The named effects, without those that are there besides and may be named."""
    besides = _besides(case)
    return [e for e in case["found"] if (e["name"], e.get("target")) not in besides]


def _besides(case: Mapping[str, Any]) -> set[Hidden]:
    """Names and targets of effects that are there besides, and not hidden too."""
    return {tuple(pair) for pair in case.get("besides", ())} - set().union(*hidden(case))


def only_right(case: Mapping[str, Any]) -> bool:
    """Whether no effect was named that is not there, or not in a family with one that is."""
    names = {name for effect in case["truth"] for name, _ in same(case, effect)}
    return all(names & set(e["family"]) or _is_beside(case, e) for e in asked(case))


def _is_beside(case: Mapping[str, Any], effect: Mapping[str, Any]) -> bool:
    """Whether an effect that was named has in its family what is there besides, in its joint."""
    besides = _besides(case)
    return any((name, effect.get("target")) in besides for name in effect["family"])


def by_name(case: Mapping[str, Any]) -> bool:
    """Whether the verdict is right and each effect has the very name under which it was hidden."""
    truth = {(e["name"], e["target"]) for e in case["truth"]}
    told = {(e["name"], e["target"]) for e in asked(case)}
    return right(case) and (case["verdict"] not in ("named", "partly") or truth == told)


def in_family(case: Mapping[str, Any]) -> bool:
    """Whether each hidden effect is in the family of one that was named, and no other was.

    But what has in its family what is there besides, as a cable's friction.
    """
    if right(case):
        return True
    told = asked(case)
    families = [set(effect["family"]) for effect in told]
    names = [{name for name, _ in effects} for effects in hidden(case)]
    fits = all(any(name & family for family in families) for name in names)
    others = len(told) - sum(_is_beside(case, effect) for effect in told)
    counted = others <= len(names) <= len(told) and len(told) > 0
    return case["verdict"] in _fitting(case) and counted and fits


def misnamed(case: Mapping[str, Any]) -> bool:
    """Whether a wrong effect was named, and confidently."""
    sure = [effect for effect in case["found"] if effect["probability"] > CONFIDENT]
    return case["verdict"] in ("named", "partly") and not only_right({**case, "found": sure})


def in_joint(case: Mapping[str, Any]) -> bool | None:
    """Whether the largest learned force is in a joint where one was hidden; None without one."""
    told = [part for part in case["where"] if "joint" in part]
    if not told:
        return None
    effect = case["truth"][0]
    return effect["kind"] == "coupling" or told[0]["joint"] == effect["target"]


def mended(case: Mapping[str, Any]) -> bool:
    """Whether something was added to the nominal plant: an effect, or a learned force."""
    return bool(case["found"]) or any("joint" in part for part in case["where"])


def accuracy(cases: Sequence[Mapping[str, Any]]) -> tuple[list[float], list[bool]]:
    """Errors of the parameters, and whether their intervals hold the truth.

    An error is relative to how far the parameter is from where it changes nothing.
    """
    errors, covered = [], []
    for case in cases:
        told = {(e["name"], e["target"]): e["parameters"] for e in case["found"]}
        for effect in case["truth"]:
            estimates = told.get((effect["name"], effect["target"]), {})
            for symbol, truth in effect.get("parameters", {}).items():
                if symbol in estimates:
                    estimate = estimates[symbol]
                    errors.append(
                        abs(estimate["value"] - truth) / size(effect["name"], symbol, truth)
                    )
                    covered.append(estimate["low"] <= truth <= estimate["high"])
    return errors, covered


def size(effect: str, symbol: str, value: float) -> float:
    """How far a parameter of an effect is from where it changes nothing."""
    neutral = next(known.neutral for known in CATALOGUE[effect].symbols if known.name == symbol)
    return max(abs(value - neutral) if math.isfinite(neutral) else abs(value), 1e-12)
