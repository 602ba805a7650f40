"""Pictures without a graphics library: smooth-edged shapes painted on an array.

Also the colours and sizes that all systems share, and how poles and torques are drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from mcpilco.show import Scene, Shape

Color = tuple[int, int, int]
Point = tuple[float, float]
Distance = Callable[[Float[np.ndarray, "1 W"], Float[np.ndarray, "H 1"]], Float[np.ndarray, "H W"]]

POLE_COLOR = (214, 120, 46)
FIXED_COLOR = (150, 156, 166)
TARGET_COLOR = (46, 158, 96)
INPUT_COLOR = (190, 60, 70)
BACKGROUND = (250, 250, 248)

POLE_RADIUS = 0.03
"""of a pole, in its lengths, so that a system of any size looks the same [-]"""
WIDTH, HEIGHT = 640, 352
"""size of a picture [pixel]"""


class Canvas:
    """An image of a part of the x-z plane; later shapes cover earlier ones.

    A shape is a box that contains it and its signed distance as a function of x and z: negative
    inside, positive outside. The distance, in pixels, says which share of a pixel the shape covers;
    this makes smooth edges.
    """

    def __init__(
        self, width: int, height: int, view_width: float, center: Point, background: Color
    ) -> None:
        """An empty image.

        It shows `view_width` from left to right, in the unit of all lengths here, around the point
        (x, z) of `center`; width and height are in pixels.
        """
        self._pixel = view_width / width
        self._x = center[0] + self._pixel * (np.arange(width) - 0.5 * (width - 1))
        self._z = center[1] + self._pixel * (0.5 * (height - 1) - np.arange(height))
        self._colors = np.full((height, width, 3), background, dtype=float)

    def line(self, start: Point, end: Point, radius: float, color: Color) -> None:
        """A thick line with round ends."""
        along = np.subtract(end, start)
        length2 = max(float(along @ along), 1e-12)

        def distance(x: np.ndarray, z: np.ndarray) -> np.ndarray:
            x, z = x - start[0], z - start[1]
            nearest = np.clip((x * along[0] + z * along[1]) / length2, 0.0, 1.0)
            return np.hypot(x - nearest * along[0], z - nearest * along[1]) - radius

        self._paint(
            np.minimum(start, end) - radius, np.maximum(start, end) + radius, distance, color
        )

    def arrow(self, start: Point, end: Point, radius: float, color: Color) -> None:
        """A thick line with a head, three line widths long or as long as the line, at its end."""
        along = np.subtract(end, start)
        back = -along * min(1.0, 6.0 * radius / max(float(np.hypot(*along)), 1e-12))
        side = 0.5 * np.array([-back[1], back[0]])
        for other in (start, end + back + side, end + back - side):
            self.line(tuple(other), end, radius, color)

    def disc(self, center: Point, radius: float, color: Color) -> None:
        """A filled circle."""
        self.line(center, center, radius, color)

    def ring(self, center: Point, radius: float, thickness: float, color: Color) -> None:
        """The line of a circle."""

        def distance(x: np.ndarray, z: np.ndarray) -> np.ndarray:
            from_line = np.hypot(x - center[0], z - center[1]) - radius
            return np.abs(from_line) - 0.5 * thickness

        reach = radius + thickness
        self._paint(np.subtract(center, reach), np.add(center, reach), distance, color)

    def box(self, center: Point, half: Point, corner: float, color: Color) -> None:
        """A filled rectangle of two half lengths, with corners rounded to the radius `corner`."""

        def distance(x: np.ndarray, z: np.ndarray) -> np.ndarray:
            x = np.abs(x - center[0]) - half[0] + corner
            z = np.abs(z - center[1]) - half[1] + corner
            outside = np.hypot(np.maximum(x, 0.0), np.maximum(z, 0.0))
            return outside + np.minimum(np.maximum(x, z), 0.0) - corner

        self._paint(np.subtract(center, half), np.add(center, half), distance, color)

    def image(self) -> UInt8[np.ndarray, "H W 3"]:
        """The picture: red, green, blue in 0..255."""
        return np.rint(self._colors).astype(np.uint8)

    def _paint(self, low: np.ndarray, high: np.ndarray, distance: Distance, color: Color) -> None:
        """Lays a shape over the pixels of the box from `low` to `high`."""
        low, high = low - self._pixel, high + self._pixel
        columns = np.flatnonzero((self._x >= low[0]) & (self._x <= high[0]))
        rows = np.flatnonzero((self._z >= low[1]) & (self._z <= high[1]))
        if not (len(columns) and len(rows)):
            return
        part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        pixels = distance(self._x[None, part[1]], self._z[part[0], None]) / self._pixel
        coverage = np.clip(0.5 - pixels, 0.0, 1.0)[..., None]
        self._colors[part] += coverage * (color - self._colors[part])


def blank(view_width: float, center: Point) -> Canvas:
    """An empty picture of the size and colour that all systems share."""
    return Canvas(WIDTH, HEIGHT, view_width, center, BACKGROUND)


def upright(count: int) -> Float[np.ndarray, "T 4"]:
    """Quaternions x, y, z, w of a body that is not turned, one for each of `count` states [-]."""
    return np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))


def hanging(angle: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 4"]:
    """Quaternions x, y, z, w that turn a body's -z axis from hanging to the angle of its pole [-].

    The angle [rad] is 0 hanging, and grows as the tip moves to positive x.
    """
    # by -angle about y
    half = -0.5 * angle
    zero = np.zeros_like(half)
    return np.stack([zero, np.sin(half), zero, np.cos(half)], axis=-1)


def twist(canvas: Canvas, hinge: Point, push: float, radius: float) -> None:
    """Draws a torque as an arc with an arrow: from below to positive x where it is positive.

    The push is relative to its limit, in [-1, 1]; 0 draws nothing.
    """
    if not push:
        return
    angles = np.linspace(0.0, 0.75 * np.pi * push, 13)
    x, z = hinge[0] + radius * np.sin(angles), hinge[1] - radius * np.cos(angles)
    *arc, (start, end) = pairwise(zip(x.tolist(), z.tolist(), strict=True))
    for piece in arc:
        canvas.line(*piece, 0.02, INPUT_COLOR)
    canvas.arrow(start, end, 0.02, INPUT_COLOR)


def hanging_end(length: float, angle: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b 3"]:
    """The end of a link of this length [m], 0 hanging [rad], relative to its joint [m]."""
    return length * np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)


def standing_scene(half: tuple[float, ...], reach: float, **moving: Any) -> Scene:
    """A scene in the x-z plane, about a box at the origin that does not move.

    The box is relative to the reach, which is how far above the origin the target is [m].
    """
    box = Shape("box", tuple(reach * side for side in half), FIXED_COLOR)
    return Scene(**moving, fixed=((box, (0.0, 0.0, 0.0)),), target=(0.0, 0.0, reach))


def side_view(scene: Scene, state: Float[np.ndarray, " X"]) -> UInt8[np.ndarray, "H W 3"]:
    """A scene in one state, as seen along y; the width shown is five times its reach at rest."""
    reach = float(np.linalg.norm(scene.marker(np.zeros_like(state)))) or 1.0
    middle = float(scene.marker(state)[0])
    middle -= min(max(middle, -2.0 * reach), 2.0 * reach)
    canvas = blank(5.0 * reach, (middle, 0.0))
    for shape, place in scene.fixed:
        _paint_shape(canvas, shape, np.array(place), Rotation.identity())
    for name, pose in scene.poses(state[None]).items():
        rotation = Rotation.from_quat(pose.quaternion[0])
        _paint_shape(canvas, scene.shapes[name], pose.translation[0], rotation)
    if scene.target is not None:
        x, _, z = scene.target
        canvas.ring((x, z), 0.08 * reach, 0.02 * reach, TARGET_COLOR)
    return canvas.image()


def _paint_shape(
    canvas: Canvas, shape: Shape, place: Float[np.ndarray, " 3"], rotation: Rotation
) -> None:
    """A shape from the side; a box as a thick line along its longer side."""
    if shape.kind == "sphere":
        radius, along = shape.size[0], np.zeros(3)
    elif shape.kind == "capsule":
        radius, along = shape.size[0], np.array([0.0, 0.0, shape.size[1]])
    else:
        wide, _, high = shape.size
        radius = min(wide, high)
        along = np.array([wide - radius, 0.0, high - radius])
    x, _, z = rotation.apply(along)
    start, end = (place[0] - x, place[2] - z), (place[0] + x, place[2] + z)
    canvas.line(start, end, radius, shape.color)
