"""Makes data from nothing, from clones or from other data: `python -m snake_training.make KIND -o FOLDER`."""

from pathlib import Path

from .arguments import Help, add, option, parser_of
from .data.bodies import write_bodies
from .data.corpus import make_corpus
from .data.crops import write_crops
from .data.datasets import write_halves
from .data.landmarks import write_landmarks
from .data.sensors import write_drives, write_frames
from .data.views import write_bare

FOLDER = {"-o": dict(dest="folder", required=True, metavar="FOLDER", help="folder to write")}
SEED = {"--seed": option(1, "of the first; the others follow")}

# The function that makes each kind of data, a sentence, and the function's arguments.
KINDS = {
    "crops": (
        write_crops, "Crops of made rooms and streets as two sensors see them, to train a network of scenes.",
        FOLDER | {"--number": option(3000, "crops, 25 a file; files that are there stay")} | SEED,
    ),
    "frames": (
        write_frames, "Pairs of neighbouring depth frames of made rooms: clouds (N, 3) and pairs.json.",
        FOLDER | {"--pairs": option(30, "pairs")} | SEED,
    ),
    "bare": (
        write_bare, "Pairs of samples of bare made rooms, of many spacings and noises: clouds (N, 3) and pairs.json.",
        FOLDER | {"--pairs": option(30, "pairs")} | SEED,
    ),
    "drives": (
        write_drives, "Sweeps of a LiDAR along made streets: clouds (N, 3) and pairs.json, which lists neighbours.",
        FOLDER | {
            "--drives": option(10, "streets"), "--sweeps": option(3, "of each street"),
            "--step": option(6.0, "metres between sweeps"),
        } | SEED,
    ),
    "landmarks": (
        write_landmarks, "Shapes with known landmarks in KeypointNet's layout, for `snake_training.evaluation semantic`.",
        FOLDER | {"--number": option(200, "shapes"), "--points": option(4096, "points of each")} | SEED,
    ),
    "bodies": (
        write_bodies, "Bodies with known correspondences, for `snake_training.evaluation semantic`: annotated/, posed/ and bent/.",
        FOLDER | {
            "--number": option(200, "annotated shapes, and pairs of bodies"), "--points": option(2048, "points of each"),
            "--corpus": dict(nargs="+", default=(), help="corpus folders whose animals and characters are bent"),
            "--bends": option(4, "bent copies of each animal or character"),
        } | SEED,
    ),
    "halves": (
        write_halves, "A corpus folder in three: choose/, judge/ and kinds/, the categories that take part in no choice.",
        FOLDER | {"corpus": dict(help="corpus folder")},
    ),
    "corpus": (
        make_corpus, "The corpus of the released models, from clones of its repositories, CLONES/OWNER/NAME or CLONES/NAME.",
        {
            "clones": dict(nargs="?", type=Path, help="folder of the clones; without it, print the commands that clone"),
            "-o": dict(dest="output", type=Path, metavar="FOLDER", help="folder to write: train/, val/ and report.tsv"),
            "--check": dict(nargs="+", default=(), metavar="FOLDER", help="count the listed points in corpus folders"),
        },
    ),
}  # fmt: skip


def main(argv=None):
    """Command line."""
    parser = parser_of("make", __doc__, {})
    kinds = parser.add_subparsers(metavar="KIND", required=True)
    for name, (make, sentence, arguments) in KINDS.items():
        kind = add(kinds.add_parser(name, help=sentence, description=sentence, formatter_class=Help), arguments)
        kind.set_defaults(make=make, kind=kind)
    given = vars(parser.parse_args(argv))
    make, kind = given.pop("make"), given.pop("kind")
    try:
        for line in make(**given) or ():
            print(line)
    except (OSError, ValueError) as error:
        kind.error(str(error))


if __name__ == "__main__":
    main()
