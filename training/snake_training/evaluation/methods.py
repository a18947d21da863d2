"""The methods that an evaluation compares: our networks, classical detectors, and keypoints of other programs from files.

A word names a method: `snake` (the built-in model that suits the cloud), `compact`, `standard`, `scenes`, the path of a weight file,
`surface-variation`, `iss`, `harris3d`, `sift3d`, `fps` or `random`. Options follow a colon, `compact:rotations=4,prefer=corners`; those
that are not given are the file's own.
"""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .arrays import points_of
from .repeatability import suppress

NETWORKS = "snake", "compact", "standard", "scenes"
CLASSICAL = "surface-variation", "iss", "harris3d", "sift3d", "fps", "random"
# The wrapper behind the paper's tables has Harris without suppression and SIFT of the y coordinate.
PAPER_OPTIONS = {"harris3d": {"non_max": False}, "sift3d": {"field": "y"}}
OWN, ALL = "own", "all"  # suppression: the method's own, or none at all


@dataclass
class Method:
    """A detector with its options."""

    name: str
    options: dict = field(default_factory=dict)
    folder: Path = None  # of keypoints from files

    def find(self, points, file, seed, count, spacing):
        """The `count` best keypoints (K, 3) of a cloud (N, 3), best first, under a suppression: OWN, a radius, or ALL for candidates.

        `file` names the cloud to keypoints from files.
        """
        if self.options.get("protocol") == "paper":
            spacing = OWN  # a random subset is not suppressed
        if self.folder:
            ranked = read_keypoints(self.folder, file)[0]
        elif self.name in CLASSICAL:
            points = np.asarray(points)
            ranked = points[classical(self.name, points, count if spacing == OWN else None, seed, self.options)]
        else:
            return self.detect(points, count, spacing)
        return ranked if spacing == ALL else suppress(ranked, 0 if spacing == OWN else spacing, count)

    def detect(self, points, count, spacing):
        """Keypoints of our network, which suppresses by itself."""
        import snake_rs

        options = self.options | {"max_keypoints": count}
        if spacing == ALL:
            options |= {"nms_radius": None, "max_keypoints": None, "min_confidence": None}
        elif spacing != OWN:
            options["nms_radius"] = spacing or None
        word = self.name.partition(":")[0]
        return snake_rs.detect(points, None if word == "snake" else word, **options).points

    def settings(self):
        """All that its keypoints depend on, but the content of files of keypoints."""
        path = Path(self.name.partition(":")[0])
        digest = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        return {
            "method": self.name,
            "options": self.options,
            "weights": digest,
            "folder": self.folder and str(self.folder),
        }


def methods_of(words, external=(), paper=False, others=()):
    """Methods by their words, and those of `external`, words NAME=FOLDER with FOLDER/CLOUD.npz for each cloud.

    `paper`: classical detectors select a random subset, as in the paper's tables. `others` are further names with options.
    """
    methods = []
    for word in words:
        name, _, given = word.partition(":")
        if name in CLASSICAL:
            if given:
                raise ValueError(f"{word}: classical detectors have no options here")
            options = {"protocol": "paper"} | PAPER_OPTIONS.get(name, {}) if paper else {}
        elif name in (*NETWORKS, *others) or Path(name).is_file():
            options = dict(option_of(word, part) for part in given.split(",") if part)
        else:
            raise ValueError(f"{name}: neither a weight file nor one of {', '.join((*NETWORKS, *CLASSICAL, *others))}")
        methods.append(Method(word, options))
    for word in external:
        name, _, folder = word.partition("=")
        if not name or not folder or name.partition(":")[0] in NETWORKS + CLASSICAL:
            raise ValueError(f"--external {word}: expected NAME=FOLDER, of another name than a method of ours")
        methods.append(Method(name, folder=Path(folder)))
    names = [method.name for method in methods]
    if len(set(names)) < len(names) or not names:
        raise ValueError(f"{' '.join(names) or 'no method'}: each method once, and at least one")
    return methods


def option_of(word, text):
    """The name and value of an option in the word of a method; a value is JSON or else a text."""
    name, sign, value = text.partition("=")
    if not sign:
        raise ValueError(f"{word}: expected option=value, found {text}")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def classical(name, points, count, seed, options):
    """Indices (K,) of the keypoints of a classical detector, best first; without a count all candidates, but for the paper's subset."""
    from snake_rs import baselines

    if name == "fps":
        return baselines.farthest_points(points, count or len(points))[0]
    if name == "random":
        return baselines.random_points(points, count or len(points), seed)[0]
    detector = getattr(baselines, name.replace("-", "_"))
    return detector(points, count=count, seed=seed, **options)[0]


def read_keypoints(folder, file):
    """Ranked positions (K, 3) and descriptors (K, D), or None, of a cloud's file FOLDER/CLOUD.npz.

    It has `keypoints` (K, 3) in the cloud's frame and, unless they are ranked, `scores` (K,); `descriptors` are optional.
    """
    if file is None:
        raise ValueError("--external needs pairs of clouds: the views of an object are drawn at random")
    path = Path(folder) / f"{file}.npz"
    with np.load(path) as arrays:
        if "keypoints" not in arrays:
            raise ValueError(f"{path}: no array keypoints")
        positions = points_of(f"{path}: keypoints", arrays["keypoints"])
        scores, descriptors = (arrays.get(name) for name in ("scores", "descriptors"))
    for name, array, dimensions in (("scores", scores, 1), ("descriptors", descriptors, 2)):
        is_fit = array is None or (
            array.ndim == dimensions and len(array) == len(positions) and np.isfinite(array).all()
        )
        if not is_fit:
            raise ValueError(f"{path}: {name} {array.shape} for {len(positions)} keypoints, or not finite")
    order = slice(None) if scores is None else np.argsort(-scores, kind="stable")
    return positions[order], descriptors if descriptors is None else descriptors[order]
