"""How a recording opens in Rerun: the scene on the left, the curves on the right."""

from __future__ import annotations

from collections.abc import Mapping

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
_FROM_ABOVE = np.array([0.35, 0.8, -0.6])
"""likewise, from higher up, to see what is horizontal"""
_NEAR = 0.55
"""from the camera to an arm that reaches all around, in diagonals of the box around its path [-]"""
_DISTANCE = 1.0
"""from the camera to what it looks at, in diagonals of the box around that [-]"""
_WIDE = 2.0
"""width over height of a scene above which several stand one above the other [-]"""
_ROW = 3.0
"""width over height of the view of one of three such scenes [-]"""
_MARGIN = 1.4
"""distance of the camera from a scene whose view it fills, in heights of this view [-]"""
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

    The camera must see the points of `extent` [m]; without it there is no scene. In a film several
    trials follow one another: it shows what each one cost. Live, it follows what is to come, and
    shows the policy search.
    """
    states = zip(task.state_names, task.state_units, strict=True)
    inputs = zip(task.input_names, task.input_units, strict=True)
    titles = {entity(STATES, name): f"{name} [{unit}]" for name, unit in states}
    titles |= {entity(INPUTS, name): f"{name} [{unit}]" for name, unit in inputs}
    views: list[rrb.View] = [_curve(*entry) for entry in (titles | {COST: "cost [-]"}).items()]
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
    return _blueprint(body, live)


def _blueprint(body: rrb.Container, live: bool = False) -> rrb.Blueprint:
    """A layout and the panels around it; it plays, or follows what is to come."""
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


def build_side_by_side(
    titles: Mapping[str, str], worlds: Mapping[str, str], extent: Float[np.ndarray, "N 3"]
) -> rrb.Blueprint:
    """The layout: scenes beside one another over the notes and the curves.

    Names of scenes and titles of curves are by entity; the cameras see the points of `extent` [m].
    """
    width, _, height = np.ptp(extent, axis=0)
    wide = width > _WIDE * height
    aspect = _ROW if wide else 1.0
    distance = _MARGIN * max(height, width / aspect, _SMALLEST_DIAGONAL)
    scenes = [_scene_view(extent, path, name, distance) for path, name in worlds.items()]
    plots = rrb.Grid(*(_curve(*entry) for entry in titles.items()), grid_columns=2, name="curves")
    about = rrb.TextDocumentView(origin=ABOUT, name="about")
    if wide:
        right = rrb.Vertical(plots, about, row_shares=[3, 1])
        return _blueprint(rrb.Horizontal(rrb.Vertical(*scenes, name="scenes"), right))
    below = rrb.Horizontal(about, plots, column_shares=[1, 3])
    return _blueprint(rrb.Vertical(rrb.Horizontal(*scenes, name="scenes"), below))


def build_watch(titles: Mapping[str, str], extent: Float[np.ndarray, "N 3"]) -> rrb.Blueprint:
    """The layout: one scene over the notes, and two columns of curves beside them.

    Titles of curves are by entity; the camera sees the points of `extent` [m].
    """
    about = rrb.TextDocumentView(origin=ABOUT, name="about")
    size = float(np.linalg.norm(np.ptp(extent, axis=0)))
    scene = _scene_view(extent, distance=_NEAR * size, look=_FROM_ABOVE)
    left = rrb.Vertical(scene, about, row_shares=[3, 1], name="system")
    plots = rrb.Grid(*(_curve(*entry) for entry in titles.items()), grid_columns=2, name="curves")
    return _blueprint(rrb.Horizontal(left, plots, column_shares=[1, 1]))


def _curve(path: str, title: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path,
        name=title,
        axis_x=rrb.archetypes.TimeAxis(link="LinkToGlobal"),
        plot_legend=rrb.PlotLegend(visible=False),
        background=rrb.archetypes.PlotBackground(color=_NIGHT),
    )


def _scene_view(
    extent: Float[np.ndarray, "N 3"],
    origin: str = WORLD,
    name: str = "scene",
    distance: float | None = None,
    look: Float[np.ndarray, " 3"] = _LOOK,
) -> rrb.Spatial3DView:
    low, high = extent.min(axis=0), extent.max(axis=0)
    centre = (low + high) / 2
    if distance is None:
        distance = _DISTANCE * max(float(np.linalg.norm(high - low)), _SMALLEST_DIAGONAL)
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        background=_NIGHT,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=centre - distance * look / np.linalg.norm(look),
            look_target=centre,
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
