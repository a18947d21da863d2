"""A validation corpus in parts: `python -m snake_training.data.halves CORPUS/val -o HALVES` writes three corpus folders.

`choose` and `judge` hold every other object of the common kinds: settings and weights are chosen by the first, reported by the second.
`kinds` holds the objects of kinds that take part in no choice.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from .datasets import Corpus

HELD_BACK = "animal", "character", "bone"


def write_halves(source, folder):
    """Three corpus folders from one, by the order of its rows; returns the number of objects of each."""
    corpus = Corpus(source)
    kinds = [row for row, entry in enumerate(corpus.index) if entry.get("category") in HELD_BACK]
    common = [row for row, entry in enumerate(corpus.index) if entry.get("category") not in HELD_BACK]
    parts = {"choose": common[::2], "judge": common[1::2], "kinds": kinds}
    for name, rows in parts.items():
        part = Path(folder) / name
        part.mkdir(parents=True, exist_ok=True)
        np.save(part / "points.npy", corpus.points[rows])
        (part / "index.json").write_text(json.dumps([corpus.index[row] for row in rows]))
    return {name: len(rows) for name, rows in parts.items()}


def main(argv=None):
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m snake_training.data.halves",
        description="Write the halves of a corpus folder, and the held-back kinds.",
    )
    parser.add_argument("corpus", help="corpus folder")
    parser.add_argument("-o", "--output", required=True, help="folder of the three parts")
    arguments = parser.parse_args(argv)
    try:
        print(json.dumps(write_halves(arguments.corpus, arguments.output)))
    except (OSError, ValueError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
