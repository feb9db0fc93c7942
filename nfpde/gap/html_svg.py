"""Small pieces of HTML and SVG: escaped text, numbers, colours, and an x-y panel."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

Array = NDArray[np.float64]


_LARGE = 9999.5
"""Percent from which on powers of ten are written."""


def text(value: object) -> str:
    """Anything as text that HTML cannot mistake for markup."""
    return html.escape(str(value), quote=True)


def number(value: float, digits: int = 4) -> str:
    """A number with so many significant digits; a dash for what is not one."""
    return f"{value:.{digits}g}" if math.isfinite(value) else "–"


def percent(value: float) -> str:
    """A share in percent with two digits that count, three just below the whole; a dash for what is not a number.

    What is far more than the whole is written as a power of ten.
    """
    size = abs(100 * value)
    if not math.isfinite(size):
        return "–"
    if size >= _LARGE:
        return f"{100 * value:.1e}%"
    if 0.985 < value < 1:
        return f"{100 * value:.1f}%"
    if size >= 9.95:
        return f"{100 * value:.0f}%"
    return f"{100 * value:.1f}%" if size >= 0.995 else f"{100 * value:.2g}%"


def shade(part: float) -> tuple[str, str]:
    """Colour for 0 to 1 and the ink to write on it: lightness falls steadily, so colour-blind readers see the order."""
    colour = to_hex(colormaps["YlOrBr"](0.05 + 0.75 * min(max(part, 0.0), 1.0)))
    # black and white stand out equally where (L + 0.05)^2 = 0.05 * 1.05
    return colour, "#ffffff" if luminance(colour) < 0.179 else "#000000"


def luminance(colour: str) -> float:
    """Relative luminance of "#rrggbb", 0 to 1, as defined for sRGB in WCAG 2.1."""
    channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@dataclass
class Panel:
    """An x-y picture in SVG that grows with its column.

    Args:
        x: range across.
        y: range upward; of logarithms where `log`.
        title: above the picture.
        x_label: below the axis.
        y_label: above the axis.
        log: whether y counts powers of ten.
        y_text: writes the numbers of the y axis.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    title: str
    x_label: str
    y_label: str = ""
    log: bool = False
    y_text: Callable[[float], str] = number
    marks: list[str] = field(default_factory=list)

    width, height = 380.0, 240.0
    left, right, top, bottom = 52.0, 18.0, 40.0, 38.0

    def across(self, x: float) -> float:
        """Pixel of a value of x."""
        low, high = self.x
        return self.left + (self.width - self.left - self.right) * (x - low) / (high - low)

    def upward(self, y: float) -> float:
        """Pixel of a value of y."""
        low, high = self.y
        if self.log:
            low, high, y = math.log10(low), math.log10(high), math.log10(min(max(y, low), high))
        return self.height - self.bottom - (self.height - self.top - self.bottom) * (y - low) / (high - low)

    def line(self, x: Array, y: Array, kind: str, dots: bool = False) -> None:
        """Draw a curve of the CSS class `kind`; it breaks where a value is not finite, and ends where it leaves."""
        low, high = (-math.inf, math.inf) if self.log else self.y
        parts, pen = [], (math.nan, math.nan)
        points = list(zip(x.tolist(), y.tolist(), strict=True))
        for (a, b), (c, d) in pairwise(points):
            piece = _inside(b, d, low, high) if all(map(math.isfinite, (a, b, c, d))) else None
            if piece is None:
                continue
            start, end = ((a + t * (c - a), b + t * (d - b)) for t in piece)
            parts += [] if start == pen else [f"M{self.across(start[0]):.1f} {self.upward(start[1]):.1f}"]
            parts.append(f"L{self.across(end[0]):.1f} {self.upward(end[1]):.1f}")
            pen = end
        for a, b in points if dots else []:
            if math.isfinite(a) and low <= b <= high:
                self.dot(a, b, kind)
        self.marks.append(f'<path class="line {kind}" d="{"".join(parts)}"/>')

    def dot(self, x: float, y: float, kind: str, radius: float = 2.6, note: str = "") -> None:
        """Draw a dot; `note` shows under the pointer."""
        inner = f"<title>{text(note)}</title>" if note else ""
        self.marks.append(
            f'<circle class="dot {kind}" cx="{self.across(x):.1f}" cy="{self.upward(y):.1f}" r="{radius}">{inner}'
            "</circle>"
        )

    def bar(self, x: float, low: float, high: float, kind: str) -> None:
        """Draw an error bar."""
        at = f"{self.across(x):.1f}"
        self.marks.append(f'<path class="bar {kind}" d="M{at} {self.upward(low):.1f}V{self.upward(high):.1f}"/>')

    def svg(self) -> str:
        """The picture."""
        ticks = LogLocator(numticks=6) if self.log else MaxNLocator(5)
        frame = []
        for y in ticks.tick_values(*self.y):
            if self.y[0] <= y <= self.y[1] * (1 + 1e-12):
                at = self.upward(y)
                frame.append(f'<path class="grid" d="M{self.left:.1f} {at:.1f}H{self.width - self.right:.1f}"/>')
                frame.append(f'<text x="{self.left - 6:.1f}" y="{at + 4:.1f}" class="end">{self.y_text(y)}</text>')
        floor = self.height - self.bottom
        for x in MaxNLocator(5).tick_values(*self.x):
            if self.x[0] <= x <= self.x[1]:
                at = self.across(x)
                frame.append(f'<path class="grid" d="M{at:.1f} {self.top:.1f}V{floor:.1f}"/>')
                frame.append(f'<text x="{at:.1f}" y="{floor + 15:.1f}" class="mid">{number(x)}</text>')
        middle = 0.5 * (self.left + self.width - self.right)
        return (
            f'<svg viewBox="0 0 {self.width:.0f} {self.height:.0f}" role="img" aria-label="{text(self.title)}">'
            f'{"".join(frame)}{"".join(self.marks)}<text x="4" y="14" class="title">{text(_short(self.title))}</text>'
            f'<text x="4" y="30">{text(self.y_label)}</text>'
            f'<text x="{middle:.1f}" y="{self.height - 6:.1f}" class="mid">{text(self.x_label)}</text></svg>'
        )


def _inside(start: float, end: float, low: float, high: float) -> tuple[float, float] | None:
    """The part of a way from one value to another that lies between two more, as shares of it; None: no part."""
    if start == end:
        return (0.0, 1.0) if low <= start <= high else None
    shares = sorted((bound - start) / (end - start) for bound in (low, high))
    first, last = max(shares[0], 0.0), min(shares[1], 1.0)
    return (first, last) if first < last else None


def _short(title: str, most: int = 50) -> str:
    return title if len(title) <= most else title[: most - 1] + "…"


def span(*values: Array, pad: float = 0.06) -> tuple[float, float]:
    """A range that holds all finite values, with some room."""
    flat = np.concatenate([np.ravel(v) for v in values]) if values else np.zeros(0)
    flat = flat[np.isfinite(flat)]
    if not len(flat):
        return 0.0, 1.0
    low, high = float(flat.min()), float(flat.max())
    room = pad * (high - low) or max(abs(high), 1.0) * 1e-3
    return low - room, high + room


def table(head: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """A table that scrolls sideways on a narrow screen; cells are HTML already, heads plain text."""
    top = "".join(f'<th scope="col">{text(h)}</th>' for h in head)
    body = "".join(f"<tr>{''.join(f'<td>{c}</td>' for c in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table class="{kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'
