"""What a reader of a figure meets: the texts as they were laid out, and the lines and marks that tell things apart."""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from fvslam_graph.evaluation.plots.style import STYLE

TOUCHING = 0.5  # points by which boxes may overlap: letters leave more room than that within their boxes
# Machado, Oliveira, Fernandes, "A physiologically-based model for simulation of color vision deficiency", 2009.
DEUTERANOPIA = np.array(
    [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
)
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # of linear sRGB
LUMINANCE = XYZ[1]
VIEWS = ("colour", "deuteranopia", "grey")
PAPER = 90  # lightness; darker pixels are ink
CLEARLY = 10  # distance of colours in CIELAB that anybody sees; 2.3 is just noticeable


@dataclass
class Drawn:
    """The texts of one figure, with their boxes in points."""

    figure: Figure
    texts: dict[int, tuple[str, np.ndarray]] = field(default_factory=dict)

    def clipped(self) -> list[str]:
        """Texts that stick out of the figure."""
        size = 72 * self.figure.get_size_inches()
        return [
            text for text, box in self.texts.values() if (box[0] < -TOUCHING).any() or (box[1] > size + TOUCHING).any()
        ]

    def overlapping(self) -> list[tuple[str, str]]:
        """Pairs of texts that lie upon each other."""
        return [
            (a, b)
            for (a, first), (b, second) in combinations(self.texts.values(), 2)
            if (np.minimum(first[1], second[1]) - np.maximum(first[0], second[0]) > TOUCHING).all()
        ]

    def handles(self) -> dict[str, np.ndarray]:
        """The handles of the legend by their names, as pixels (H, W, 3) of 0 to 1, all of the same size."""
        self.figure.set_dpi(150)
        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        image = np.asarray(canvas.buffer_rgba())[:, :, :3] / 255
        (legend,) = self.figure.legends
        boxes = [handle.get_window_extent(canvas.get_renderer()) for handle in legend.legend_handles]
        middles = [(int((box.x0 + box.x1) / 2), int(len(image) - (box.y0 + box.y1) / 2)) for box in boxes]
        wide, high = int(max(box.width for box in boxes)) // 2 + 4, 9  # markers are higher than lines
        names = [text.get_text() for text in legend.get_texts()]
        crops = [image[y - high : y + high, x - wide : x + wide] for x, y in middles]
        return dict(zip(names, crops, strict=True))

    def differences(self) -> dict[tuple[str, str, str], float]:
        """How different two names look in each of VIEWS: the share of their ink that is clearly another colour."""
        found, handles = {}, self.handles()
        for how in VIEWS:
            seen = {name: seen_by(pixels, how) for name, pixels in handles.items()}
            for (a, first), (b, second) in combinations(seen.items(), 2):
                ink = np.minimum(first[..., 0], second[..., 0]) < PAPER
                found[a, b, how] = float((np.linalg.norm(first - second, axis=-1) > CLEARLY).sum() / ink.sum())
        return found


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Drawn]:
    """All figures that are drawn from here on, as they were the last time."""
    found: list[Drawn] = []
    draw_figure, draw_text = Figure.draw, Text.draw

    def of(figure: Figure) -> Drawn:
        known = [entry for entry in found if entry.figure is figure]
        if not known:
            known = [Drawn(figure)]
            found.extend(known)
        return known[0]

    def begun(self, renderer):
        of(self).texts.clear()
        draw_figure(self, renderer)

    def recorded(self, renderer, *args, **kwargs):
        if self.get_visible() and self.get_text().strip():
            figure = self.get_figure(root=True)
            of(figure).texts[id(self)] = (
                self.get_text(),
                self.get_window_extent(renderer).get_points() * 72 / figure.dpi,
            )
        draw_text(self, renderer, *args, **kwargs)

    monkeypatch.setitem(STYLE, "savefig.dpi", 72)  # quicker; texts are measured in points
    monkeypatch.setattr(Figure, "draw", begun)
    monkeypatch.setattr(Text, "draw", recorded)
    return found


def seen_by(rgb: np.ndarray, how: str) -> np.ndarray:
    """Colours (..., 3) of 0 to 1 as CIELAB coordinates, as they are seen in colour, with deuteranopia or in grey."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    if how == "deuteranopia":
        linear = np.clip(linear @ DEUTERANOPIA.T, 0, 1)
    elif how == "grey":
        linear = np.repeat((linear @ LUMINANCE)[..., None], 3, axis=-1)
    ratio = linear @ XYZ.T / XYZ.sum(axis=1)
    x, y, z = np.moveaxis(np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)
