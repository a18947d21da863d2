"""The page that shows a cloud with its keypoints."""

from __future__ import annotations

import html as text
import os
import sys
import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from ._core import page

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from typing_extensions import Unpack

    from ._core import _Model, _Options, _Points

HEIGHT = 600


class View:
    """A page with a cloud, its keypoints, its surface and its saliency. It is one file and needs no server; `html` is all
    of it."""

    __module__ = "snake_rs"
    html: str

    def __init__(self, html: str) -> None:
        self.html = html

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the page to a file (.html)."""
        Path(path).write_text(self.html, encoding="utf-8")

    def open(self) -> Path:
        """Opens the page in the browser, from a temporary file that stays, and returns the path of that file."""
        with tempfile.NamedTemporaryFile(
            "w", suffix=".html", prefix="snake_rs-", delete=False, encoding="utf-8"
        ) as file:
            file.write(self.html)
        webbrowser.open(Path(file.name).as_uri())
        return Path(file.name)

    def _repr_html_(self) -> str:
        page = text.escape(self.html, quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="{HEIGHT}" style="border: 0"></iframe>'

    def __repr__(self) -> str:
        return f"View({len(self.html) / 1e6:.1f} MB of HTML; open() shows it, save(path) keeps it)"


def view(
    points: _Points,
    second: _Points | None = None,
    model: _Model | None = None,
    *,
    name: str | None = None,
    epsilon: float | str | None = None,
    t_first_second: ArrayLike | None = None,
    **options: Unpack[_Options],
) -> View:
    """Shows a cloud with its keypoints, its surface and its saliency: a notebook embeds the page, and elsewhere it opens in
    the browser. It is the page of `snake-cli view`.

    `points`, `model` and `options` are those of `detect`. `name` is the title on the page; None: the path of a file, or
    "cloud". With a `second` cloud of the same object or scene the page shows both, and which keypoints repeat: those of
    which one of the other cloud is nearer than `epsilon` (a number of cloud units, or text such as "3r"; None: 0.04 of the
    first cloud's radius). `t_first_second` (4, 4) maps a point of the second cloud to the first; None: `register` finds it.
    A model may stand in the place of `second`.

    Raises ValueError as `detect` does, and where two clouds cannot be registered.
    """
    shown = View(page(points, second, model, name, epsilon, t_first_second, **options))
    if not _in_notebook():
        shown.open()
    return shown


def _in_notebook() -> bool:
    """Whether the caller is a notebook, which shows the value of a cell."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython else None
    return hasattr(shell, "kernel")
