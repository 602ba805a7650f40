"""Plants by name, so that files can say which equations a model knows without holding code.

Another package registers its own when it is imported, as `envs` does:

    from mcpilco.plant import known_plants
    known_plants.register("my-robot", lambda: plant_of("robot.xml"))
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mcpilco.plant.correction import corrected, correction_from
from mcpilco.plant.plant import Plant
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

_KNOWN: dict[str, Callable[[], Plant]] = {}


def register(name: str, make: Callable[[], Plant]) -> None:
    """Make a plant known.

    Args:
        name: that of the plant, which corrections name too.
        make: returns the nominal plant.
    """
    _KNOWN[name] = make


def plant_for(task: TaskSpec, described: Mapping[str, Any] | None) -> Plant:
    """The plant that a model is to know.

    Args:
        task: names states and inputs.
        described: what a file of `mcpilco.plant.correction` holds: the plant's name, and
        parameters and
            effects that it has beside the nominal ones. None: the one registered plant that has the
            task's states and inputs, as it is.

    Raises:
        InputError: there is no such plant, or the description does not fit it.
    """
    if described is not None:
        correction = correction_from(dict(described))
        if correction.plant not in _KNOWN:
            raise InputError(
                f"There is no plant {correction.plant!r}; there are {_names()}. Register yours "
                "with mcpilco.plant.known_plants.register."
            )
        return corrected(_KNOWN[correction.plant](), correction)
    wanted = set(task.state_names), set(task.input_names)
    fitting = [
        plant
        for plant in (make() for make in _KNOWN.values())
        if (set(plant.layout.states), set(plant.layout.inputs)) == wanted
    ]
    if len(fitting) != 1:
        raise InputError(
            f"Physics needs a plant with the states {', '.join(task.state_names)} and the inputs "
            f"{', '.join(task.input_names)}, {len(fitting)} of {_names()} have them; register one "
            "with mcpilco.plant.known_plants.register, or name one in model.plant."
        )
    return fitting[0]


def _names() -> str:
    return ", ".join(sorted(_KNOWN)) or "none"
