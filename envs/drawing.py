"""Pictures without a graphics library: smooth-edged shapes painted on an array."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8

Color = tuple[int, int, int]
Point = tuple[float, float]
Distance = Callable[[Float[np.ndarray, "1 W"], Float[np.ndarray, "H 1"]], Float[np.ndarray, "H W"]]


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

        Args:
            width: of the image [pixel].
            height: of the image [pixel].
            view_width: what the image shows from left to right, in the unit of all lengths here.
            center: the point (x, z) in the middle of the image.
            background: red, green, blue in 0..255.
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
