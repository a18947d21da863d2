"""Converts a body model of SMPL, SMPL+H or SMPL-X, a pickle as distributed, to the .npz that `snake-cli eval semantic` reads:

    python -m snake_training.body_model SMPL_NEUTRAL.pkl model.npz

Of a pickle's classes only NumPy's arrays are made, so it needs neither chumpy nor SciPy and runs nothing.
"""

import sys

import numpy as np

from .arguments import parser_of
from .data.official import body_arrays


def main(arguments=None):
    words = {
        "pickle": dict(help="the model as it was downloaded, such as SMPL_NEUTRAL.pkl"),
        "npz": dict(help="the file to write"),
    }
    given = parser_of("body_model", __doc__, words).parse_args(arguments)
    try:
        np.savez_compressed(given.npz, **body_arrays(given.pickle))
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
