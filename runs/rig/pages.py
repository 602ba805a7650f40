"""README.md of this folder, between its marked lines, from all results that are there."""

import json
import sys
from pathlib import Path

HERE = Path(__file__).parent
BEGIN, END = "<!-- results: written by run.py -->", "<!-- end of results -->"


def kept(name):
    """The results of one kind, in order."""
    return [
        json.loads(path.read_text()) for path in sorted((HERE / "results").glob(f"{name}.json"))
    ]


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(map(str, line)) + " |" for line in lines] + [""]


def write():
    """Rewrite the tables."""
    lines = []
    for name, part in PARTS.items():
        found = kept(name)
        if found:
            lines += part(found)
    path = HERE / "README.md"
    if not path.exists():
        return
    text = path.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    path.write_text("\n".join([before + BEGIN, "", *lines, END + after]))


def crossings(found):
    def share(one, leg, place):
        return f"{100 * one[leg][place][0]:.0f}" if leg in one else "none tried"

    def solved(leg):
        return sum(leg in one and one[leg]["happened"][0] >= 0.9 for one in found)

    rows = [
        [
            one["seed"],
            ", ".join(f"{k} {v:g}" for k, v in one["hidden"].items()),
            ", ".join(one.get("named", [])) or one.get("verdict", "none"),
            share(one, "nominal", "happened"),
            share(one, "corrected", "promised"),
            share(one, "corrected", "happened"),
            one["minutes"],
            one["times"],
            f"{one['load'][0]}, {one['load'][1]}",
        ]
        for one in found
    ]
    good = {leg: solved(leg) for leg in ("corrected", "nominal")}
    said = (
        f"{len(found)} machines. Swung up in at least 9 of 10 attempts: "
        f"{good['corrected']} after the corrected simulation, {good['nominal']} after the nominal."
    )
    head = ["seed", "hidden (SI)", "named", "nominal [%]", "promised [%]", "corrected [%]"]
    return ["### Crossings", "", said, "", *table([*head, "minutes", "commands", "load"], rows)]


def timing(found):
    rows = [
        [
            one["rate"],
            one["steps"],
            f"{100 * one['missed'] / one['steps']:.3f}",
            f"{1e3 * one['latency_p50']:.2f}",
            f"{1e3 * one['latency_max']:.2f}",
            f"{1e3 * one['watchdog']:.0f}",
            one["stale"],
            one["watchdogs"],
            f"{one['load']:.1f}",
        ]
        for one in found
    ]
    head = ["rate [Hz]", "steps", "missed [%]", "latest step of an episode, median [ms]"]
    head += ["of all [ms]", "watchdog [ms]", "stale", "watchdogs", "load"]
    return ["### Timing", "", *table(head, rows)]


def faults(found):
    one = found[0]
    rows = [[name, *counts] for name, counts in one["kinds"].items()]
    head = ["fault", "tried", "told", "went on", "files lost"]
    return ["### Faults", "", f"Load {one['load']:.1f}.", "", *table(head, rows)]


def fuzz(found):
    one = found[0]
    rows = [[name, one["sent"].get(name, 0), one["refused"].get(name, 0)] for name in one["names"]]
    said = f"{one['total']} packets; they changed the inbox {one['changed']} times. "
    said += "The tag tells a changed byte only where the layout does not tell it first: "
    said += "such packets count as malformed. On the rig, "
    said += f"{one['rig']['in all']} of {one['rig']['sent']} were counted, and the session went on."
    return ["### Fuzzed packets", "", said, "", *table(["packets", "sent", "counted"], rows)]


PARTS = {
    "crossings/*": crossings,
    "timing-*": timing,
    "faults": faults,
    "fuzz": fuzz,
}

if __name__ == "__main__":
    write()
    sys.exit(0)
