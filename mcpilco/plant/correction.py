"""Corrections of a plant, so that it moves as measured: JSON files, and plants by name."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from mcpilco.files import write_bytes
from mcpilco.plant.effects import CATALOGUE, Effect, Symbol
from mcpilco.plant.effects.learned import Axis, LearnedForce
from mcpilco.plant.effects.own import Own, own_effects
from mcpilco.plant.plant import EffectInstance, Plant
from mcpilco.plant.spread import Member, members_of
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

P = TypeVar("P", bound=Plant)
FORMAT = 1
"""of the file"""


@dataclass(frozen=True)
class Addition:
    """An effect to add to a plant.

    Raises:
        InputError: no effect of the catalogue, or values that are not those of its symbols.
    """

    name: str
    """of the effect, as in `coulomb_friction`"""
    target: str
    """a joint, body, actuator or state, as the effect's place has it"""
    parameters: Mapping[str, float]
    """by symbol, in its unit; what only smooths a formula may be left out"""
    own: Effect | None = None
    """a user's own effect of this name; None: that of the catalogue"""

    def __post_init__(self) -> None:
        if self.own is None and self.name not in CATALOGUE:
            raise InputError(f"there is no effect {self.name!r}; there are {', '.join(CATALOGUE)}.")
        symbols = {symbol.name: symbol for symbol in self.effect.symbols}
        for name, value in self.parameters.items():
            if name not in symbols:
                known = ", ".join(symbols)
                raise InputError(f"{self.name} has no parameter {name!r}; it has {known}.")
            _require_value(f"{name} of {self.name} ({self.target})", value, symbols[name])
        missing = [s.name for s in symbols.values() if s.reported and s.name not in self.parameters]
        if missing:
            raise InputError(
                f"{self.name} ({self.target}) needs a value of {', '.join(missing)}; add it to its "
                "parameters."
            )

    @property
    def effect(self) -> Effect:
        """The effect of this name."""
        return self.own or CATALOGUE[self.name]

    @property
    def values(self) -> tuple[float, ...]:
        """One for each symbol of the effect, in their order."""
        symbols = self.effect.symbols
        return tuple(float(self.parameters.get(s.name, s.neutral)) for s in symbols)


@dataclass(frozen=True)
class Correction:
    """Parameters and effects that a plant is corrected by."""

    plant: str
    """name of the plant that it is for"""
    parameters: Mapping[str, float]
    """physical parameters that are not nominal, by name"""
    effects: tuple[Addition, ...]
    """what the nominal plant lacks"""
    learned: tuple[LearnedForce, ...] = ()
    """forces that it lacks and no effect explains"""
    spread: tuple[Member, ...] = ()
    """the plants that are as possible as this one, see `mcpilco.plant.Spread`; none: not told"""
    mjcf: str = ""
    """the MJCF that the plant is, where it is no registered one"""


def correction_of(plant: Plant, nominal: Plant | None = None) -> Correction:
    """The correction that turns the nominal plant into `plant`: parameters and effects.

    Without a nominal plant it has all parameters, and so turns any into this one.
    """
    before = {} if nominal is None else nominal.values
    changed = {p.name: p.value for p in plant.parameters if p.value != before.get(p.name)}
    effects = (
        Addition(
            active.effect.name,
            active.target,
            dict(zip((s.name for s in active.effect.symbols), values, strict=True)),
            own=None if active.effect.name in CATALOGUE else active.effect,
        )
        for active, values in plant.added
    )
    return Correction(plant.name, changed, tuple(effects), plant.learned)


def corrected(plant: P, correction: Correction) -> P:
    """The plant with its correction.

    Raises:
        InputError: the correction is for another plant, or names what this one does not have.
    """
    if correction.plant != plant.name:
        raise InputError(
            f"The correction is for the plant {correction.plant!r}, got {plant.name!r}; if they "
            'are the same system, change "plant" in the correction.'
        )
    named = [(EffectInstance(e.effect, e.target), e.values) for e in correction.effects]
    changed = plant.where(**correction.parameters).having(named)
    return changed.with_learned(correction.learned)


def write_correction(path: str | Path, correction: Correction) -> Path:
    """Writes a correction as JSON, whole or not at all; null stands for an infinite value.

    Raises:
        RunFolderError: the file cannot be written.
    """
    content = correction_json(correction)
    return write_bytes(Path(path), (json.dumps(content, indent=2) + "\n").encode())


def correction_json(correction: Correction) -> dict[str, Any]:
    """A correction as its file holds it; None stands for an infinite value."""
    content: dict[str, Any] = {
        "format": FORMAT,
        "plant": correction.plant,
        "parameters": dict(correction.parameters),
        "effects": [
            {
                "name": effect.name,
                "target": effect.target,
                "parameters": {
                    name: value if math.isfinite(value) else None
                    for name, value in effect.parameters.items()
                },
            }
            | ({"file": effect.own.file} if effect.own else {})
            for effect in correction.effects
        ],
    }
    if correction.learned:
        content["learned"] = [_grid(force) for force in correction.learned]
    if correction.spread:
        content["spread"] = [asdict(member) for member in correction.spread]
    if correction.mjcf:
        content["mjcf"] = correction.mjcf
    return content


def read_correction(path: str | Path, effects: Own | Iterable[Own] = ()) -> Correction:
    """The correction in a file.

    What a correction refers to is not executed unless it is given here: `effects` are Python files
    with a user's own effects, or these.

    Raises:
        InputError: the file is missing, is no JSON, or does not say what a correction must; or it
            has an effect that is neither in the catalogue nor given.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror or error}.") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON file: {error}.") from None
    try:
        return correction_from(content, effects)
    except InputError as error:
        raise InputError(f"{path} is no correction of a plant: {error}") from None


def correction_from(content: Any, effects: Own | Iterable[Own] = ()) -> Correction:
    """The correction that the JSON object of a file describes.

    Raises:
        InputError: a part is missing, unknown or of another kind.
    """
    content = {"learned": [], "spread": [], "mjcf": "", **_object(content, "it")}
    content.pop("about", None)  # what a command tells its user besides
    keys = ("format", "plant", "parameters", "effects", "learned", "spread", "mjcf")
    content = _object(content, "it", keys)
    if content["format"] != FORMAT or isinstance(content["format"], bool):
        raise InputError(f'"format" must be {FORMAT}, got {_short(content["format"])}.')
    plant, additions = content["plant"], content["effects"]
    if not isinstance(plant, str):
        raise InputError(f'"plant" must be the name of a plant, got {_short(plant)}.')
    _require_kinds(content, "", effects=list, learned=list, spread=list, mjcf=str)
    parameters = _object(content["parameters"], '"parameters"')
    for name, value in parameters.items():
        _require_value(f"parameter {name!r}", value, Symbol(name, "-"))
    learned = tuple(map(_learned, content["learned"]))
    own = {effect.name: effect for effect in own_effects(effects)}
    named = tuple(_addition(a, own) for a in additions)
    spread = members_of(content["spread"])
    return Correction(plant, parameters, named, learned, spread, content["mjcf"])


def _addition(content: Any, own: Mapping[str, Effect]) -> Addition:
    content = {"file": ""} | _object(content, "an effect")
    content = _object(content, "an effect", ("name", "target", "parameters", "file"))
    _require_kinds(content, " of an effect", name=str, target=str, file=str)
    values = _object(content["parameters"], f'"parameters" of {content["name"]}')
    infinite = {name: math.inf if value is None else value for name, value in values.items()}
    name, file = content["name"], content["file"]
    if file and name not in own:
        raise InputError(
            f"the effect {name!r} is a user's own, of the file {file!r}, which is not executed "
            f"because a correction names it. If you trust it, read the correction with "
            f"mcpilco.plant.read_correction(path, effects={file!r})."
        )
    return Addition(name, content["target"], infinite, own.get(name))


def _grid(force: LearnedForce) -> dict[str, Any]:
    """A learned force as a file holds it; eight digits of its weights are more than are known."""
    weights = [float(f"{weight:.8g}") for weight in force.weights]
    return {"joint": force.joint, "axes": list(map(vars, force.axes)), "weights": weights}


def _learned(content: Any) -> LearnedForce:
    content = _object(content, "a learned force", ("joint", "axes", "weights"))
    joint, axes, weights = content["joint"], content["axes"], content["weights"]
    _require_kinds(content, " of a learned force", joint=str, axes=list, weights=list)
    for weight in weights:
        _require_value(f"a weight of the learned force at {joint}", weight, Symbol("weight", "-"))
    return LearnedForce(joint, tuple(map(_axis, axes)), tuple(map(float, weights)))


def _axis(content: Any) -> Axis:
    content = {"closed": False} | _object(content, "an axis")
    content = _object(content, "an axis", ("of", "low", "high", "knots", "slow", "closed"))
    _require_kinds(content, " of an axis", of=str, knots=int, closed=bool)
    for name in ("low", "high", "slow"):
        _require_value(f"{name} of the axis {content['of']}", content[name], Symbol(name, "-"))
    return Axis(**content | {name: float(content[name]) for name in ("low", "high", "slow")})


def _object(content: Any, name: str, keys: tuple[str, ...] | None = None) -> dict[str, Any]:
    """The JSON object that some content must be, with these keys and no others."""
    if not isinstance(content, dict):
        raise InputError(f"{name} must be an object {{...}}, got {_short(content)}.")
    if keys is not None and set(content) != set(keys):
        expected = ", ".join(f'"{key}"' for key in keys)
        raise InputError(f"{name} must have {expected} and no more, got {_short(sorted(content))}.")
    return content


_KINDS = {str: "a word", list: "a list", int: "a count", bool: "true or false"}


def _require_kinds(content: Mapping[str, Any], owner: str, **kinds: type) -> None:
    """Raises InputError where an entry is not of its JSON type."""
    for key, kind in kinds.items():
        if type(content[key]) is not kind:
            raise InputError(f'"{key}"{owner} must be {_KINDS[kind]}, got {_short(content[key])}.')


def _require_value(name: str, value: Any, symbol: Symbol) -> None:
    """Raises InputError unless a value is a number that makes sense of its symbol."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    endless = math.isinf(symbol.neutral) and value == symbol.neutral
    if not number or not (endless or (abs(value) < 1e300 and symbol.low <= value <= symbol.high)):
        within = [f"at least {symbol.low:g}"] if symbol.low > -math.inf else []
        within += [f"at most {symbol.high:g}"] if symbol.high < math.inf else []
        expected = " ".join(["a finite number", " and ".join(within)]).strip()
        raise InputError(f"{name} must be {expected}, got {_short(value)}.")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


_KNOWN: dict[str, Callable[[], Plant]] = {}


def register_plant(name: str, make: Callable[[], Plant]) -> None:
    """Makes a plant known by name, so that files can name it without holding code.

    Another package does so when it is imported, as `envs` does.
    """
    _KNOWN[name] = make


def plant_for(
    task: TaskSpec,
    described: Mapping[str, Any] | None,
    parse: Callable[[str, str], Plant] | None = None,
) -> Plant:
    """The plant that a model is to know.

    `described` is what a file of a correction holds: the plant's name, or its MJCF, and parameters
    and effects that it has beside the nominal ones. None: the one registered plant that has the
    task's states and inputs, as it is. `parse` makes the plant of an MJCF and its name.

    Raises:
        InputError: there is no such plant, or the description does not fit it.
    """
    if described is not None:
        correction = correction_from(dict(described))
        if correction.mjcf and parse is not None:
            return corrected(parse(correction.mjcf, correction.plant), correction)
        if correction.plant not in _KNOWN:
            raise InputError(
                f"There is no plant {correction.plant!r}; there are {_names()}. Register yours "
                "with mcpilco.plant.register_plant."
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
            "with mcpilco.plant.register_plant, or name one in model.plant."
        )
    return fitting[0]


def _names() -> str:
    return ", ".join(sorted(_KNOWN)) or "none"
