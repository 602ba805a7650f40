"""Write the tables of effects and of plants in docs/plants.md, from what the code has.

python docs/write_tables.py
"""

from __future__ import annotations

import re
from pathlib import Path

from envs.plants import PLANTS
from mcpilco.plant import CATALOGUE

PAGE = Path(__file__).parent / "plants.md"
EFFECTS = "| effect | acts at | what it does | symbols |\n|---|---|---|---|\n"
PLANTS_HEAD = "| id | states | inputs | parameters |\n|---|---|---|---|\n"


def effect_rows() -> list[str]:
    """A row for each effect of the catalogue, with the units at a hinge."""
    rows = []
    for effect in CATALOGUE.values():
        formula = (effect.__doc__ or "").splitlines()[0].rstrip(".").replace("|", "\\|")
        units = [s.unit.format(f="N m", q="rad", x="rad or rad/s") for s in effect.symbols]
        symbols = [f"{s.name} [{unit}]" for s, unit in zip(effect.symbols, units, strict=True)]
        rows.append(f"| `{effect.name}` | {effect.place} | {formula} | {', '.join(symbols)} |")
    return rows


def plant_rows() -> list[str]:
    """A row for each plant of this project: states, inputs and parameters."""
    rows = []
    for name, make in PLANTS.items():
        if not name.startswith("mcpilco/"):
            continue  # a user's
        plant = make()
        parameters = [parameter.name for parameter in plant.parameters]
        columns = (plant.layout.states, plant.layout.inputs, parameters)
        cells = [", ".join(f"`{name}`" for name in column) for column in columns]
        rows.append(f"| `{name}` | {' | '.join(cells)} |")
    return rows


def written(page: str) -> str:
    """The page with both tables as they are now."""
    for head, rows in ((EFFECTS, effect_rows()), (PLANTS_HEAD, plant_rows())):
        before, _, after = page.partition(head)
        rest = re.sub(r"\A(?:\|.*\n)*", "", after)
        page = before + head + "\n".join(rows) + "\n" + rest
    return page


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
