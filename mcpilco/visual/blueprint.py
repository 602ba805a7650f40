"""How a recording opens in Rerun: the scene on the left, the curves on the right."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from mcpilco.task import TaskSpec

TIMELINE = "sim_time"
"""seconds since the start of the rollout; `step` counts the same instants"""

WORLD, STATES, INPUTS, COST, ABOUT = "world", "states", "inputs", "cost", "about"
LEARNING, SEARCH = "learning", "search"
"""top-level entities of a recording"""

_NIGHT = (18, 20, 26)
"""background in every theme of the viewer: white lines stand out, opaque dim ones recede"""
_LOOK = np.array([0.0, 1.0, -0.15])
"""the camera looks along +y, slightly from above, so that x runs to the right and z upwards"""
_DISTANCE = 1.0
"""from the camera to what it looks at, in diagonals of the box around that [-]"""
_SMALLEST_DIAGONAL = 0.3
"""where nothing moves [m]"""


def entity(*parts: str) -> str:
    """The entity path of these parts, with characters that Rerun reserves escaped."""
    return rr.new_entity_path(list(parts)).lstrip("/")


def build_blueprint(
    task: TaskSpec,
    extent: Float[np.ndarray, "N 3"] | None,
    *,
    film: bool = False,
    live: bool = False,
) -> rrb.Blueprint:
    """The layout: the scene over the notes, and a plot for each state, each input and the cost.

    Args:
        task: names and units of states and inputs.
        extent: points that the camera must see [m]; None where there is no scene to show.
        film: several trials follow one another; show what each one cost.
        live: more is to come; follow it, and show the policy search.
    """
    views: list[rrb.View] = [*_plots(task)]
    if film:
        views.append(_curve(LEARNING, "cost of an episode [-]"))
    if live:
        views.append(rrb.BarChartView(origin=SEARCH, name="policy search: predicted cost [-]"))
    plots = rrb.Grid(*views, grid_columns=2, name="curves")
    about = rrb.TextDocumentView(origin=ABOUT, name="about")
    if extent is None:
        body = rrb.Horizontal(about, plots, column_shares=[1, 3])
    else:
        left = rrb.Vertical(_scene_view(extent), about, row_shares=[4, 1], name="system")
        body = rrb.Horizontal(left, plots, column_shares=[1, 1])
    return rrb.Blueprint(
        body,
        rrb.TimePanel(
            timeline=TIMELINE,
            state="collapsed",
            play_state="following" if live else "playing",
            loop_mode="off" if live else "all",
        ),
        rrb.SelectionPanel(state="hidden"),
        auto_layout=False,
        auto_views=False,
    )


def _plots(task: TaskSpec) -> list[rrb.TimeSeriesView]:
    states = zip(task.state_names, task.state_units, strict=True)
    inputs = zip(task.input_names, task.input_units, strict=True)
    titles = {entity(STATES, name): f"{name} [{unit}]" for name, unit in states}
    titles |= {entity(INPUTS, name): f"{name} [{unit}]" for name, unit in inputs}
    titles |= {COST: "cost [-]"}
    return [_curve(path, title) for path, title in titles.items()]


def _curve(path: str, title: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path,
        name=title,
        axis_x=rrb.archetypes.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=_NIGHT),
    )


def _scene_view(extent: Float[np.ndarray, "N 3"]) -> rrb.Spatial3DView:
    low, high = extent.min(axis=0), extent.max(axis=0)
    centre = (low + high) / 2
    distance = _DISTANCE * max(float(np.linalg.norm(high - low)), _SMALLEST_DIAGONAL)
    return rrb.Spatial3DView(
        origin=WORLD,
        name="scene",
        background=_NIGHT,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=centre - distance * _LOOK / np.linalg.norm(_LOOK),
            look_target=centre,
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
