"""Converts a body model of SMPL, SMPL+H or SMPL-X, a pickle as distributed, to the .npz that `snake-cli eval semantic` reads:

    python -m snake_training.body_model SMPL_NEUTRAL.pkl model.npz

Of a pickle's classes only NumPy's arrays are made, so it needs neither chumpy nor SciPy and runs nothing.
"""

import argparse
import sys

import numpy as np

from snake_training.data.official import body_arrays


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pickle", help="the model as it was downloaded, such as SMPL_NEUTRAL.pkl")
    parser.add_argument("npz", help="the file to write")
    given = parser.parse_args(arguments)
    try:
        np.savez_compressed(given.npz, **body_arrays(given.pickle))
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
