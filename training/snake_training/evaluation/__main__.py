"""Command line: `python -m snake_training.evaluation repeatability|semantic|registration DATA`; `--help` lists the layouts of DATA."""

import sys
from pathlib import Path

from ..arguments import Help, add, argparse
from .datasets import open_scenes, open_semantic, open_views
from .methods import __doc__ as METHODS_TEXT
from .published import BEST, THRESHOLDS
from .run import BODY_RADIUS, METHODS, repeatability, semantic
from .scenes import registration
from .tables import curves, report

SHARED = {
    "data": dict(help="folder of the data set"),
    "--methods": dict(nargs="+", default=METHODS, help="see below"),
    "--external": dict(nargs="+", default=(), metavar="NAME=FOLDER", help="keypoints of other programs, FOLDER/CLOUD.npz: keypoints "
                       "(K, 3) in the cloud's frame, scores (K,) unless they are ranked, and descriptors (K, D) for registration"),
    "--limit": dict(type=int, help="evaluate only so many pairs or shapes, evenly spaced; all by default"),
    "--seed": dict(type=int, default=0, help="of all random choices"),
    "-o": dict(dest="output", metavar="FOLDER", help="tables (.csv, .md) and curves (.svg); a method whose file is there is not run again"),
    "--paper": dict(action="store_true", help="show the paper's figures too"),
}  # fmt: skip
KEYPOINTS = {
    "--split": dict(default="", help="evaluate only the shapes of this list, a CLASS-SHAPE a line (KeypointNet)"),
    "--protocol": dict(default="ranked", choices=("ranked", "paper"), help="paper: classical detectors select a random subset, as in its tables"),
    "--max-keypoints": dict(type=int, default=64, help="of each cloud, the best"),
    "--coverage": dict(type=float, help="suppress each method's keypoints until their mean distance from the points is this"),
}  # fmt: skip
COMMANDS = {
    "repeatability": (repeatability, open_views, KEYPOINTS | {
        "--epsilon": dict(type=float, nargs="+", help="distances of repeated keypoints; those of the paper by default"),
        "--table-epsilon": dict(type=float, help="the one of thinned and noisy views"),
        "--downsample": dict(type=int, nargs="+", default=(1, 2, 4, 8, 16), help="one point in so many is kept"),
        "--downsample-one": dict(type=int, nargs="+", default=(), help="the same of one of the two alone"),
        "--noise": dict(type=float, nargs="+", help="standard deviations of noise; those of the paper by default"),
        "--num-points": dict(type=int, help="of each view; 5000 of objects, 2048 of KeypointNet, 10240 of rooms by default"),
        "--nms-radius": dict(type=float, help="of suppression; each method's own by default"),
    }),
    "semantic": (semantic, open_semantic, KEYPOINTS | {
        "--threshold": dict(type=float, nargs="+", default=THRESHOLDS, help="distances of a match"),
        "--nms-radius": dict(type=float, default=BODY_RADIUS, help="of suppression"),
    }),
    "registration": (registration, open_scenes, {
        "--descriptors": dict(nargs="+", default=("fpfh",), help="fpfh, or names of --external"),
        "--max-keypoints": dict(type=int, nargs="+", default=BEST, help="numbers of keypoints, the best"),
        "--nms-radius": dict(type=float, help="of suppression, in metres; 0.03 of our networks by default"),
    }),
}  # fmt: skip


def parser():
    """The parser of all commands."""
    top = argparse.ArgumentParser(prog="python -m snake_training.evaluation", description=__doc__, formatter_class=Help)
    commands = top.add_subparsers(dest="command", required=True)
    for name, (evaluate, layouts, arguments) in COMMANDS.items():
        about = f"{evaluate.__doc__}\n\n{layouts.__doc__}\n\n{METHODS_TEXT}"
        some = commands.add_parser(
            name, description=about, help=evaluate.__doc__.partition("\n")[0], formatter_class=Help
        )
        add(some, SHARED | arguments)
    return top


def evaluate(words):
    """The table of a command line."""
    given = vars(parser().parse_args(words))
    command, output = given.pop("command"), given["output"]
    table = COMMANDS[command][0](**given)
    if output:
        path = Path(output) / command
        table.to_csv(f"{path}.csv", index=False)
        path.with_suffix(".md").write_text(report(table))
        curves(table, f"{path}.svg")
    return table


def main(words=None):
    """Prints the tables of a command line."""
    try:
        print(report(evaluate(sys.argv[1:] if words is None else words)))
    except (OSError, ValueError, TypeError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
