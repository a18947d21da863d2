"""Where training shapes come from: the int16 corpus, folders of clouds, or procedural shapes. None needs labels."""

from .datasets import CloudError, Corpus, Folder, Mixture, ShapeError, open_all, open_shapes, write_corpus
from .shapes import Procedural

__all__ = [
    "CloudError",
    "Corpus",
    "Folder",
    "Mixture",
    "Procedural",
    "ShapeError",
    "open_all",
    "open_shapes",
    "write_corpus",
]
