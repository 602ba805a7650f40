"""The recordings of the hidden effects are those of the nominal plants where nothing is hidden."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
import pytest

from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.recordings import Recording

HERE = Path(__file__).parent.parent.parent / "runs" / "hidden_effects"
NAMES = ("truth", "systems", "felt", "cases", "verdicts", "confusion", "page", "peers", "freed")
NAMES += ("identified", "run")
"""of its modules, each after those that it imports"""


every_plant = pytest.mark.parametrize(
    "name",
    [
        "mcpilco/CartPoleSwingUp-v0",
        "mcpilco/Pendulum-v0",
        "mcpilco/DoublePendulum-v0",
        "rotary_pendulum.xml",
    ],
)


@pytest.fixture(scope="module")
def modules() -> Iterator[dict[str, ModuleType]]:
    """The modules of the run, under the names by which they import one another."""
    loaded = {}
    for name in NAMES:
        spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = loaded[name] = module
        spec.loader.exec_module(module)
    yield loaded
    for name in loaded:
        del sys.modules[name]


@pytest.mark.slow
@every_plant
def test_with_nothing_hidden_the_other_simulator_moves_as_the_nominal_plant(
    modules: dict[str, ModuleType], name: str
) -> None:
    cases, truth = modules["cases"], modules["truth"]
    system = cases.SYSTEMS[name]
    J, U = len(system.joints), len(system.inputs)
    plant = modules["run"].nominal(name)
    assert plant.layout.states == system.states
    assert plant.layout.inputs == system.inputs
    assert plant.layout.joints == system.joints
    rng = np.random.default_rng(0)
    start = rng.normal(0.0, 0.5, 2 * J)
    commands = np.stack([cases.excitation(rng, limit, 1)[:50] for limit in system.limit], axis=1)
    machine = cases.nominal(system)
    theirs = truth.simulate(
        system.kind,
        start,
        commands.copy(),
        np.zeros((U, 2 * J)),
        0.02,
        machine.body,
        machine.joint,
        machine.actuator,
        np.array(system.drives),
        cases.GRAVITY,
        2e-3,
    )
    ours = plant.simulate(start[None], commands[None, :-1], 0.02)[0]
    np.testing.assert_allclose(ours, theirs, atol=2e-5)


@pytest.mark.one_in(3)
@every_plant
@pytest.mark.parametrize("seed", [0, 1])
def test_an_effect_of_the_further_tier_moves_the_plant_as_its_formula_does(
    modules: dict[str, ModuleType], name: str, seed: int
) -> None:
    """Also its sign; friction turns over by another curve."""
    cases, truth = modules["cases"], modules["truth"]
    system, plant = cases.SYSTEMS[name], modules["run"].nominal(name)
    how = np.array(system.drives), cases.GRAVITY, 2e-3
    for effect in cases.FURTHER:
        if not cases.possible(effect, system):
            continue
        rng, machine = np.random.default_rng(seed), cases.nominal(system)
        told = cases.hide(effect, system, rng, 1.0, machine)
        instance = EffectInstance(CATALOGUE[effect], told["target"])
        values = [told["parameters"].get(s.name, 2e-3) for s in instance.effect.symbols]
        J, U = len(system.joints), len(system.inputs)
        resting = effect == "dahl_friction"  # where it was before is not known of a motion
        start = np.array([0.3, 0.0 if resting else 0.5] * J)
        commands = np.stack([cases.excitation(rng, u, 1)[:50] for u in system.limit], axis=1)
        held, none = commands.copy(), np.zeros((U, 2 * J))
        arrays = machine.body, machine.joint, machine.actuator, *how
        states = truth.simulate(system.kind, start, held, none, 0.02, *arrays)
        theirs = np.stack(
            [
                cases.seen(states, k, 0.02 * np.arange(50), machine.sensor.get(k, {}))
                for k in range(2 * J)
            ],
            axis=1,
        )
        ours = plant.having([(instance, values)]).simulate(start[None], commands[None, :-1], 0.02)
        nominal = plant.simulate(start[None], commands[None, :-1], 0.02)[0]
        gap, error = np.abs(theirs - nominal).max(), np.abs(theirs - ours[0])[8:].max()
        assert error < 0.03 * gap, effect


@every_plant
@pytest.mark.parametrize(
    "effect", ["actuator_delay", "actuator_lag", pytest.param("back_emf", marks=pytest.mark.slow)]
)
def test_times_of_a_motor_are_told_as_the_steps_make_them(
    modules: dict[str, ModuleType], name: str, effect: str
) -> None:
    """Half a step of the other simulator would be told as a delay."""
    cases, truth = modules["cases"], modules["truth"]
    system, plant = cases.SYSTEMS[name], modules["run"].nominal(name)
    rng, machine = np.random.default_rng(3), cases.nominal(system)
    told = cases.hide(effect, system, rng, 1.0, machine)
    instance = EffectInstance(CATALOGUE[effect], told["target"])
    start = np.zeros(2 * len(system.joints))
    commands = np.stack([cases.excitation(rng, u, 1)[:50] for u in system.limit], axis=1)
    none, drives = np.zeros((len(system.limit), len(start))), np.array(system.drives)
    arrays = machine.body, machine.joint, machine.actuator, drives, cases.GRAVITY, 2e-3
    theirs = truth.simulate(system.kind, start, commands.copy(), none, cases.DT, *arrays)

    time = "d" if effect == "actuator_delay" else "T"

    def ours(later: float = 0.0) -> np.ndarray:
        numbers = {**told["parameters"], time: told["parameters"][time] + later}
        moved = plant.having([(instance, [numbers[s.name] for s in instance.effect.symbols])])
        return moved.simulate(start[None], commands[None, :-1], cases.DT)[0]

    exact, half = ours(), ours(0.5 * truth.STEP)
    error, step = np.abs(theirs - exact).max(), np.abs(half - exact).max()
    assert error < 0.2 * step


def test_a_spring_is_told_with_that_of_the_cable(modules: dict[str, ModuleType]) -> None:
    cases = modules["cases"]
    system, rng = cases.SYSTEMS["mcpilco/Pendulum-v0"], np.random.default_rng(0)
    tied = cases.nominal(system)
    cases.bind(system, rng, tied)
    cable = tied.joint[0, cases.SPRING]
    told = cases.hide("spring", system, rng, 1.0, tied)
    assert told["parameters"]["k"] == tied.joint[0, cases.SPRING] > 2.0 * cable > 0.0


def test_no_two_hidden_effects_add_up_to_a_third(modules: dict[str, ModuleType]) -> None:
    cases = modules["cases"]
    system = cases.SYSTEMS["mcpilco/CartPoleSwingUp-v0"]

    def tellable(*pairs: tuple[str, str]) -> bool:
        return cases.tellable([{"name": n, "target": t} for n, t in pairs], system)

    assert not tellable(("coulomb_friction", "cart"), ("constant_force", "cart"))
    assert not tellable(("body_inertia", "pole"), ("armature", "pole"))
    assert not tellable(("actuator_delay", "actuator"), ("sensor_delay", "pole_angle"))
    assert tellable(("coulomb_friction", "cart"), ("constant_force", "pole"))
    assert tellable(("coulomb_friction", "cart"), ("armature", "cart"))


def test_a_limit_that_no_command_reaches_is_not_felt(modules: dict[str, ModuleType]) -> None:
    cases = modules["cases"]
    system = cases.SYSTEMS["mcpilco/Pendulum-v0"]
    bare, limited, stronger = (cases.nominal(system) for _ in range(3))
    limited.actuator[0, cases.ACTUATOR.index("actuator_saturation")] = 1.1
    stronger.actuator[0, cases.ACTUATOR.index("actuator_gain")] = 1.1
    assert not made(modules, "mcpilco/Pendulum-v0", limited, 1.0).felt(bare)
    assert made(modules, "mcpilco/Pendulum-v0", stronger, 1.0).felt(bare)
    assert made(modules, "mcpilco/Pendulum-v0", limited, 1.4).felt(bare)


def made(modules: dict[str, ModuleType], plant: str, machine: Any, most: float) -> Any:
    """Two seconds from rest under a command that rises to its most."""
    cases, system = modules["cases"], modules["cases"].SYSTEMS[plant]
    motions = [(np.zeros((100, 2 * len(system.joints))), np.linspace(-most, most, 100)[:, None])]
    std = np.array([cases.noise_of(system, j) for j in range(len(system.joints))])
    return cases.Made(system, machine, motions, std, (cases.DT, cases.GRAVITY, 1e-3))


def test_what_parameters_could_do_as_well_counts_by_how_far_they_would_be_off(
    modules: dict[str, ModuleType],
) -> None:
    """A friction that is 30 % larger is ten standard deviations of 3 % away, and felt more."""
    cases, plant = modules["cases"], "mcpilco/Pendulum-v0"
    bare, rubbing, turned = (cases.nominal(cases.SYSTEMS[plant]) for _ in range(3))
    rubbing.joint[0, cases.VISCOUS] *= 1.3
    machine = made(modules, plant, rubbing, 1.35)
    free, told, exact = (machine.apart(bare, std) for std in (0.3, 0.03, 3e-6))
    assert free < 1.01
    assert free < 0.3 * told < told < min(10.0, exact)
    assert exact == pytest.approx(machine.apart(bare), rel=1e-3)
    turned.sensor[0] = {"sensor_offset": 0.1}
    assert made(modules, plant, turned, 1.35).apart(bare, 0.03) > 100.0


@pytest.mark.parametrize(("state", "told"), [(0, False), (2, True)])
def test_what_another_start_would_do_as_well_is_not_felt(
    modules: dict[str, ModuleType], state: int, told: bool
) -> None:
    """Where a cart's position counts from changes nothing; where a pole's does, gravity tells."""
    cases = modules["cases"]
    system = cases.SYSTEMS["mcpilco/CartPoleSwingUp-v0"]
    bare, off = cases.nominal(system), cases.nominal(system)
    off.sensor[state] = {"sensor_offset": 0.1}
    assert made(modules, "mcpilco/CartPoleSwingUp-v0", off, 5.0).felt(bare) == told


def test_two_effects_of_one_sensor_both_act(modules: dict[str, ModuleType]) -> None:
    cases = modules["cases"]
    system = cases.SYSTEMS["mcpilco/Pendulum-v0"]
    states = np.stack([np.linspace(0.0, 1.0, 50), np.full(50, 1.0 / (49 * cases.DT))], axis=1)

    def angle(hidden: dict[str, float]) -> np.ndarray:
        rng = np.random.default_rng(0)
        torque = np.zeros((50, 1))
        return cases.measure(system, states, torque, {0: hidden}, False, rng, False)["angle"]

    delayed = angle({"sensor_delay": cases.DT})
    both = angle({"sensor_delay": cases.DT, "sensor_offset": 0.1})
    np.testing.assert_allclose(both, delayed + 0.1)
    assert (delayed[1:] < angle({})[1:]).all()


@every_plant
def test_effects_that_count_as_one_change_every_motion_alike(
    modules: dict[str, ModuleType], name: str
) -> None:
    system, plant = modules["cases"].SYSTEMS[name], modules["run"].nominal(name)
    commands = np.stack([np.repeat([0.0, u, -u, 0.5 * u], 12) for u in system.limit], axis=1)
    rest = np.zeros((1, 2 * len(system.joints)))

    def moved(effect: str, target: str) -> np.ndarray:
        """From where a machine rests."""
        value = size(effect, target)
        machine = plant.having([(EffectInstance(CATALOGUE[effect], target), (value,))])
        start = rest - value * np.eye(*rest.shape) * (effect == "gravity_tilt")
        return machine.simulate(start, commands[None], 0.02)[0, :, 0::2]

    def size(effect: str, target: str) -> float:
        if effect == "gravity_tilt":
            return -0.01
        if effect.endswith(("delay", "offset")):
            return 0.01
        place = system.bodies if target in system.bodies else system.joints
        mass, _, inertia, _ = system.body[place.index(target)]
        return 0.1 * (mass if effect == "body_mass" or not inertia else inertia)

    for alike in system.synonyms(velocities=False):
        first, *others = [moved(*effect) for effect in sorted(alike)]
        begun = np.zeros_like(rest)
        begun[0, 0::2] = first[0]
        still = plant.simulate(begun, commands[None], 0.02)[0, :, 0::2]
        assert np.abs(first - still).max() > 1e-3
        for other in others:
            np.testing.assert_allclose(other, first, atol=1e-5)


def case(hidden: list[str], verdict: str, named: list[str]) -> dict[str, Any]:
    truth = [{"name": name, "target": "cart"} for name in hidden]
    return {"truth": truth, "verdict": verdict, "found": [{"name": name} for name in named]}


def test_a_confusion_counts_each_hidden_effect_once(modules: dict[str, ModuleType]) -> None:
    cases = [
        case(["spring"], "named", ["spring"]),
        case(["spring", "armature"], "named", ["spring", "body_mass", "actuator_gain"]),
        case(["spring", "armature"], "named", ["spring"]),
        case([], "named", ["spring"]),
        case([], "none", []),
        case(["spring"], "unknown", ["armature"]),
        case(["backlash", "spring"], "partly", ["backlash"]),
    ]
    outside = case(["outside"], "unknown", ["spring"])
    outside["truth"][0]["kind"] = "detent"
    counts = modules["confusion"].confusions([*cases, outside])
    assert counts == {
        ("spring", "spring"): 3,
        ("armature", "body_mass"): 0.5,
        ("armature", "actuator_gain"): 0.5,
        ("armature", "none"): 1,
        ("none", "spring"): 1,
        ("none", "none"): 1,
        ("spring", "unknown"): 1,
        ("backlash", "backlash"): 1,
        ("spring", "none"): 1,
        ("detent", "unknown"): 1,
    }


@pytest.mark.parametrize(
    ("verdict", "named", "is_right"),
    [
        ("named", ["armature"], True),
        ("named", ["armature", "dahl_friction"], True),
        ("partly", ["armature"], True),
        ("unknown", [], False),
        ("named", ["armature", "coulomb_friction"], False),
    ],
)
def test_what_is_there_besides_may_be_named_and_partly_says_that_it_is_not(
    modules: dict[str, ModuleType], verdict: str, named: list[str], is_right: bool
) -> None:
    verdicts, told = modules["verdicts"], case(["armature"], verdict, named)
    told |= {"plant": "mcpilco/CartPoleSwingUp-v0", "velocities": True}
    told["besides"] = [["dahl_friction", "cart"]]
    for effect in told["found"]:
        effect |= {"target": "cart", "probability": 0.99, "family": [effect["name"]]}
    assert verdicts.right(told) == verdicts.in_family(told) == verdicts.by_name(told) == is_right
    assert verdicts.misnamed(told) == ("coulomb_friction" in named)


def test_of_what_was_missed_it_is_told_how_far_it_is_beyond_what_parameters_could_do(
    modules: dict[str, ModuleType],
) -> None:
    wrong = case(["spring", "armature"], "none", [])
    for effect in wrong["truth"]:
        effect["target"] = "cart"
    wrong |= {"seed": 7, "plant": "mcpilco/CartPoleSwingUp-v0", "velocities": True}
    missed = modules["page"].missed
    assert "hidden spring at cart, armature at cart; " in missed({"one": [wrong]})
    told = missed({"one": [{**wrong, "beyond": [6.6, 1234.0]}]})
    assert "hidden spring at cart (7 std), armature at cart (1234 std); " in told


@pytest.mark.parametrize(
    ("family", "in_family"), [(["coulomb_friction", "dahl_friction"], True), (["backlash"], False)]
)
def test_what_has_in_its_family_what_is_there_besides_is_no_wrong_name(
    modules: dict[str, ModuleType], family: list[str], in_family: bool
) -> None:
    """But not the right one; and what is hidden too is found by its own name alone."""
    verdicts = modules["verdicts"]
    told = case(["spring"], "named", ["spring", "coulomb_friction"])
    told |= {"plant": "mcpilco/CartPoleSwingUp-v0", "velocities": True}
    for effect in told["found"]:
        effect |= {"target": "cart", "probability": 0.99, "family": [effect["name"]]}
    told["found"][1]["family"] = ["coulomb_friction", *family]
    told["besides"] = [["dahl_friction", "cart"], ["spring", "cart"]]
    assert not verdicts.right(told)
    assert verdicts.in_family(told) == verdicts.only_right(told) == in_family
    assert verdicts.misnamed(told) != in_family
    assert not verdicts.in_family({**told, "found": told["found"][1:]})
    elsewhere = {**told, "besides": [["dahl_friction", "pole"]]}
    assert not verdicts.in_family(elsewhere)


def test_what_is_asked_of_rough_stands_beside_what_is_reached(
    modules: dict[str, ModuleType],
) -> None:
    def solved(seed: int, number: int, is_right: bool, cpu_s: float) -> dict[str, Any]:
        hidden = ["spring", "coulomb_friction", "quadratic_drag"][:number]
        told = case(hidden, "named" if hidden else "none", [*hidden, *["backlash"][is_right:]])
        for effect in told["truth"]:
            effect["parameters"] = {"k": 1.0} if effect["name"] == "spring" else {}
        for effect in told["found"]:
            parameters = {"k": {"value": 1.1, "low": 1.05, "high": 1.2}}
            effect |= {"target": "cart", "probability": 0.99, "family": [effect["name"]]}
            effect["parameters"] = parameters if effect["name"] == "spring" else {}
        told |= {"plant": "mcpilco/CartPoleSwingUp-v0", "velocities": True}
        told["events"] = [{"recording": "a", "start_s": 1.0, "end_s": 2.0}] * (number == 2)
        return {**told, "seed": seed, "cpu_s": cpu_s}

    asked = modules["page"].asked
    cases = [solved(1 + n, n % 4, is_right=n != 1, cpu_s=100.0 + 20.0 * n) for n in range(8)]
    table = asked({"rough": cases}).splitlines()
    rows = {name: reached for name, _, reached in (row.strip("| ").split(" | ") for row in table)}
    assert rows["single effects: right, or in a family"].endswith(": 1 of 2")
    assert rows["pairs"].endswith(": 2 of 2")
    assert rows["nothing hidden: no wrong name"].endswith(": 2 of 2")
    assert rows["wrong and sure"].endswith(": 1 of 8")
    assert rows["intervals that hold the truth, where it is right"].endswith(": 0 of 5")
    assert rows["no event is told; nothing pushes them"].endswith(": 6 of 8")
    assert rows["a case takes three CPU minutes or less"].endswith(": 5 of 8")
    assert rows["CPU time in the median"] == "170 s"
    assert asked({"rough": cases[:1]}) == asked({}) == ""


def test_the_joint_of_a_learned_force_is_right_where_the_hidden_one_acts(
    modules: dict[str, ModuleType],
) -> None:
    in_joint = modules["verdicts"].in_joint
    hidden = [{"name": "outside", "kind": "patch", "target": "elbow"}]
    channel = {"channel": "elbow_angle", "share": 1.0, "condition": "at all speeds and amplitudes"}
    assert in_joint({"truth": hidden, "where": [channel]}) is None
    assert in_joint({"truth": hidden, "where": [{**channel, "joint": "elbow"}, channel]})
    assert not in_joint({"truth": hidden, "where": [{**channel, "joint": "shoulder"}, channel]})


def test_the_peers_get_regressors_that_hold_the_missing_force(
    modules: dict[str, ModuleType],
) -> None:
    plant = modules["run"].nominal("mcpilco/Pendulum-v0")
    hidden = EffectInstance(CATALOGUE["spring"], "pendulum"), (0.2,)
    torque = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 20), 20)[:, None]
    start = np.array([[0.3, 0.0]])
    states = plant.having([hidden]).simulate(start, torque[None, :-1], 0.02)[0]
    layout = plant.layout
    time = 0.02 * np.arange(len(torque))
    recording = Recording("r", time, states, torque, layout.states, layout.inputs)
    terms, columns, missing = modules["peers"].regression(plant, [recording])
    spring = columns[:, terms.index(("spring", "pendulum"))]
    assert spring @ missing / (spring @ spring) == pytest.approx(0.2, rel=0.05)


sysid = importlib.util.find_spec("mujoco.sysid") and importlib.import_module("mujoco.sysid")
needs_toolbox = pytest.mark.skipif(not hasattr(sysid, "optimize"), reason="needs mujoco[sysid]")


def linear_fit(modules: dict[str, ModuleType], truth: list[float], columns: np.ndarray) -> Any:
    """A fit by least squares, with noise 1."""
    y = columns @ np.array(truth) + np.random.default_rng(1).standard_normal(len(columns))
    x = np.linalg.lstsq(columns, y, rcond=None)[0]
    freed = modules["freed"].Freed
    free = [freed(f"effect_{k}", "joint", "s", 0.0, 1.0, -9.0, 9.0) for k in range(len(truth))]
    return modules["identified"].Fit(free, x, columns @ x - y, columns, True)


@needs_toolbox
def test_a_parameter_that_is_there_is_sure_and_one_that_is_not_is_not(
    modules: dict[str, ModuleType],
) -> None:
    columns = np.random.default_rng(0).standard_normal((400, 3))
    fit = linear_fit(modules, [1.0, 0.0, 0.0], columns)
    assert modules["identified"].sure(fit) == [0]
    assert modules["identified"].kept(fit) == [0]


@needs_toolbox
def test_a_parameter_that_changes_the_residuals_little_is_not_named(
    modules: dict[str, ModuleType],
) -> None:
    columns = np.random.default_rng(0).standard_normal((40_000, 1))
    fit = linear_fit(modules, [0.03], columns)
    assert abs(fit.x[0]) > modules["identified"]._half_widths(fit.residuals, fit.J)[0]
    assert modules["identified"].sure(fit) == []
    assert modules["identified"].kept(fit) == []


@needs_toolbox
def test_of_two_parameters_that_do_the_same_none_is_sure_until_one_is_frozen(
    modules: dict[str, ModuleType],
) -> None:
    rng = np.random.default_rng(0)
    column = rng.standard_normal((400, 1))
    columns = np.concatenate([column, column + 1e-4 * rng.standard_normal((400, 1))], axis=1)
    fit = linear_fit(modules, [1.0, 0.0], columns)
    assert modules["identified"].sure(fit) == []
    assert len(modules["identified"].kept(fit)) == 1


@needs_toolbox
def test_freezing_a_parameter_gives_the_fit_of_the_others(modules: dict[str, ModuleType]) -> None:
    mixed = np.array([[1.0, 0.5, 0.2], [0.0, 1.0, 0.3], [0.0, 0.0, 1.0]])
    columns = np.random.default_rng(0).standard_normal((50, 3)) @ mixed
    fit = linear_fit(modules, [1.0, 2.0, 3.0], columns)
    y, others = columns @ fit.x - fit.residuals, columns[:, [0, 2]]
    z, left = modules["identified"]._linear(fit, [0, 2])
    np.testing.assert_allclose(z, np.linalg.lstsq(others, y, rcond=None)[0])
    np.testing.assert_allclose(left, others @ z - y)


@every_plant
def test_the_freed_model_with_nothing_changed_moves_as_the_nominal_plant(
    modules: dict[str, ModuleType], name: str
) -> None:
    plant, freed = modules["run"].nominal(name), modules["freed"]
    J = len(plant.layout.joints)
    start = np.random.default_rng(0).normal(0.0, 0.5, 2 * J)
    model = freed.spec_with(freed.nominal_model(plant), plant, []).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[0::2], start[1::2]
    moved = [start]
    for _ in range(50):
        mujoco.mj_step(model, data, 4)
        moved.append(np.stack([data.qpos, data.qvel], axis=1).ravel())
    still = np.zeros((1, 50, len(plant.layout.inputs)))
    ours = plant.simulate(start[None], still, 4 * freed.TIMESTEP)[0]
    np.testing.assert_allclose(moved, ours, atol=5e-5)


@pytest.mark.slow
@needs_toolbox
def test_mujocos_toolbox_names_a_dry_friction_when_what_is_unsure_is_frozen(
    modules: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    identified, plant = modules["identified"], modules["run"].nominal("mcpilco/Pendulum-v0")
    monkeypatch.setattr(identified, "WINDOWS", 4)
    hidden = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum"), (0.15, 2e-3)
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-1.5, 1.5, 20), 15)[:, None]
    states = plant.having([hidden]).simulate(np.array([[0.3, 0.0]]), torque[None, :-1], 0.02)[0]
    states = states + rng.standard_normal(states.shape) * [2e-3, 2e-2]
    layout = plant.layout
    time = 0.02 * np.arange(len(torque))
    recording = Recording("r", time, states, torque, layout.states, layout.inputs)
    named = identified.identified(plant, [recording])
    assert ("coulomb_friction", "pendulum") in named.terms[identified.FROZEN]
