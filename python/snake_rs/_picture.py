"""The picture that a notebook shows of keypoints."""

from __future__ import annotations

import html as text
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ._core import Keypoints

WIDTH, HEIGHT, MARGIN = 240, 160, 10
# From low to high saliency.
LOW, HIGH = np.array([68, 1, 84]), np.array([253, 200, 37])


def html(keypoints: Keypoints) -> str:
    """The keypoints along their two longest axes, as an SVG in HTML."""
    points = np.asarray(keypoints, dtype=np.float64)
    summary = f"<p>{text.escape(repr(keypoints))}</p>"
    if len(points) == 0:
        return summary
    extent = np.ptp(points, axis=0)
    axes = np.sort(np.argsort(-extent, kind="stable")[:2])
    flat = points[:, axes] - points[:, axes].min(axis=0)
    scale = min((WIDTH - 2 * MARGIN) / max(extent[axes[0]], 1e-30), (HEIGHT - 2 * MARGIN) / max(extent[axes[1]], 1e-30))
    # The best are drawn last, on top.
    circles = [
        f'<circle cx="{MARGIN + x * scale:.1f}" cy="{HEIGHT - MARGIN - y * scale:.1f}" r="3" fill="rgb({r},{g},{b})"/>'
        for (x, y), (r, g, b) in zip(flat[::-1], _colours(keypoints.saliency[::-1]), strict=True)
    ]
    names = "".join("xyz"[axis] for axis in axes)
    title = f"<title>{len(points)} keypoints, {names}</title>"
    frame = f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" role="img">'
    return f"{frame}{title}{''.join(circles)}</svg>{summary}"


def _colours(saliency: NDArray[np.float32]) -> NDArray[np.int64]:
    colours: NDArray[np.float64] = LOW + (HIGH - LOW) * saliency.clip(0.0, 1.0)[:, None]
    return np.rint(colours).astype(np.int64)
