"""The figures of the SNAKE paper (NeurIPS 2022), to stand beside ours; `published.csv` has a row a curve, and values and figures by spaces."""

from pathlib import Path

import pandas as pd

THRESHOLDS = tuple(hundredth / 100 for hundredth in range(11))
BEST = (2500, 1000, 500, 250, 100)


def published(data):
    """The rows of the long table, of methods "snake (paper)" and so on.

    data: object, room and annotated (beside UKPGAN, in the units of the files) for repeatability, keypointnet, smpl, 3dmatch.
    """
    table = pd.read_csv(Path(__file__).with_name("published.csv"))
    return [
        (row.metric, f"{row.method} (paper)", row.condition.format(float(value)), "paper", float(figure))
        for row in table[table["data"] == data].itertuples()
        for value, figure in zip(row.given.split(), row.figures.split(), strict=True)
    ]
