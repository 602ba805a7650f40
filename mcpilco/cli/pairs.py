"""Entries NAME=VALUE of an option."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from mcpilco.typing import InputError

EnvKeywords = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE...")]
"""keywords of an env, as `keywords` reads them"""


def pairs(option: str, entries: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Names and values.

    Raises:
        InputError: an entry is no NAME=VALUE.
    """
    for entry in entries:
        name, equals, value = entry.partition("=")
        if not (name and equals):
            raise InputError(f"{option} must be NAME=VALUE, got {entry!r}.")
        yield name, value


def separated(entries: Sequence[str]) -> list[str]:
    """The entries, of which some hold several, separated by commas."""
    return [part for entry in entries for part in entry.split(",") if part]


def number(what: str, text: str) -> float:
    """The number in a text.

    Raises:
        InputError: it is none.
    """
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{what} must be a number, got {text!r}.") from None


def named_numbers(option: str, entries: Sequence[str]) -> dict[str, float]:
    """Numbers by name, of entries that are also separated by commas.

    Raises:
        InputError: an entry is no NAME=VALUE, or its value no number.
    """
    found = pairs(option, separated(entries))
    return {name: number(f"{option} {name}", value) for name, value in found}


def keywords(option: str, entries: Sequence[str]) -> dict[str, Any]:
    """Keywords of an env: numbers, true, false, words, or what a JSON file holds.

    A run folder that keeps them needs no other file.

    Raises:
        InputError: an entry is no NAME=VALUE, or its file cannot be read.
    """
    return {name: _value(option, text) for name, text in pairs(option, entries)}


def _value(option: str, text: str) -> Any:
    path = Path(text)
    if path.suffix == ".json":
        try:
            text = path.read_text(encoding="utf-8")
            return json.loads(text)
        except OSError as error:
            raise InputError(f"{option}: cannot read {path}: {error.strerror or error}.") from None
        except (ValueError, RecursionError) as error:
            raise InputError(f"{option}: {path} is no JSON file: {error}.") from None
    try:
        return json.loads(text)
    except ValueError:
        return text
