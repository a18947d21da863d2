"""The corpus that the released models learnt from: its list, and a folder of it made from clones of the public repositories.

`corpus.tsv.gz`, beside this file, has a line for each object: split, repository, commit where known (it holds one of the
repository's listed files), path, name, category, group, family, licence, triangles, digest of the int16 points, and the spread of the
points along their principal axes. The points themselves are not in the repository. Made anew they are other points of the same
surfaces: the sampler's random numbers are not known, so no digest is the same. Triangles and spread say whether the surface is.
"""

import gzip
import hashlib
import json
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..augment import normalize
from ..progress import bar
from .assemblies import MeshError, triangles_of
from .datasets import Corpus
from .shapes import draw_on, superquadric, triangles

LIST = Path(__file__).with_name("corpus.tsv.gz")
POINTS = {"train": 4096, "val": 8192}
# Two samples of one surface differ by up to 0.028 (0.013 of nine in ten) with 4096 points each.
MAX_SPREAD_DIFFERENCE = 0.03
SUPERQUADRIC = re.compile(r"superquadric e1=(\S+) e2=(\S+) a=(\S+),(\S+),(\S+)")


@dataclass(frozen=True)
class Entry:
    """A line of the list."""

    split: str
    source: str
    commit: str
    path: str
    name: str
    category: str
    group: str
    family: str
    licence: str
    faces: str
    digest: str
    spread: str

    def row(self):
        """Its row in the index of a corpus folder."""
        names = "name", "source", "path", "category", "group", "licence", "family"
        return {name: getattr(self, name) for name in names} | {"faces": int(self.faces)}


def read_list(path=LIST):
    """The entries of a list."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        return [Entry(*line.rstrip("\n").split("\t")) for line in file]


def digest(points):
    """The first 16 hexadecimal digits of SHA-256 over int16 points (M, 3), little-endian."""
    return hashlib.sha256(np.ascontiguousarray(points, "<i2").tobytes()).hexdigest()[:16]


def spread(points):
    """The standard deviations (3,) of int16 points (M, 3) along their principal axes, largest first, in radii."""
    centered = points / 32767 - np.mean(points / 32767, axis=0)
    return np.sqrt(np.linalg.eigvalsh(centered.T @ centered / len(centered))[::-1].clip(0))


def surface(entry, clones):
    """The triangles (F, 3, 3) of an entry. Raises MeshError for what is not there or cannot be read."""
    if entry.source == "generated":
        e1, e2, *semiaxes = map(float, SUPERQUADRIC.fullmatch(entry.path).groups())
        return triangles(superquadric(2 * np.array(semiaxes), e1, e2, rows=121, columns=241))
    roots = [clones / entry.source, clones / entry.source.partition("/")[2]]
    root = next((root for root in roots if root.is_dir()), None)
    if root is None:
        raise MeshError(f"no clone of {entry.source}")
    if not (root / entry.path).is_file():
        raise MeshError(f"the clone of {entry.source} lacks the file")
    return triangles_of(root / entry.path, root)


def sample(corners, entry, number):
    """`number` points of a surface as int16 (number, 3), about their mean, the farthest at 32767; seeded by the entry."""
    chosen, weights = draw_on(corners, number, np.random.default_rng(int(entry.digest, 16)))
    cloud = (weights[:, :, None] * corners[chosen]).sum(axis=1)
    return (normalize(cloud)[0] * 2 * 32767).round().astype(np.int16)


def difference(entry, corners, points):
    """The difference of the surface from that of the list; empty without one."""
    off = np.abs(spread(points) - np.array(entry.spread.split(","), float)).max()
    said = [] if len(corners) == int(entry.faces) else [f"{len(corners)} triangles, listed {entry.faces}"]
    return ", ".join([*said, f"spread off by {off:.3f}"] if off > MAX_SPREAD_DIFFERENCE else said)


def build(entries, clones, output):
    """Writes the corpus folders of the splits below `output`, without what is missing, and `report.tsv`, a line for each entry.

    Gives the report: (entry, fault, difference) for each entry; the fault of what was made is empty.
    """
    report = []
    for split in dict.fromkeys(entry.split for entry in entries):
        rows, stored = [], []
        for entry in bar([entry for entry in entries if entry.split == split], unit="shape"):
            try:
                corners = surface(entry, clones)
                points = sample(corners, entry, POINTS[split])
            except ValueError as error:  # of a MeshError, or a surface without extent
                report.append((entry, str(error), ""))
                continue
            rows.append(entry.row())
            stored.append(points)
            report.append((entry, "", difference(entry, corners, points)))
        if rows:
            folder = output / split
            folder.mkdir(parents=True, exist_ok=True)
            np.save(folder / "points.npy", np.stack(stored))
            (folder / "index.json").write_text(json.dumps(rows))
    output.mkdir(parents=True, exist_ok=True)
    lines = (
        "\t".join([entry.split, entry.source, entry.path, fault or "made", other]).replace("\n", " ")
        for entry, fault, other in report
    )
    (output / "report.tsv").write_text("\n".join(lines) + "\n")
    return report


def summary(report):
    """The objects that were made and those that were not, as lines."""
    made = [other for _, fault, other in report if not fault]
    yield f"{len(made)} of {len(report)} objects, {sum(not other for other in made)} with the surface of the list"
    absent = Counter(fault for _, fault, _ in report if fault.startswith("no clone of"))
    yield from (f"{fault}: {count} objects" for fault, count in absent.most_common())
    for entry, fault, other in report:
        if (fault and fault not in absent) or other:
            yield f"{entry.source}: {entry.path}: {fault or f'another surface: {other}'}"


def check_points(entries, folders):
    """How many points of the list stand in corpus folders, and which do not, as lines."""
    there = {digest(points) for folder in folders for points in Corpus(folder).points}
    absent = [entry for entry in entries if entry.digest not in there]
    yield f"{len(entries) - len(absent)} of {len(entries)} listed objects have the same points here"
    yield from (f"other points, or none: {entry.split}: {entry.source}: {entry.path}" for entry in absent)


def clone_commands(entries):
    """A command for each repository, at its commit where it is known."""
    for source, commit in dict.fromkeys(
        (entry.source, entry.commit) for entry in entries if entry.source != "generated"
    ):
        at = f" && git -C CLONES/{source} checkout {commit}" if commit else ""
        yield f"git clone https://github.com/{source} CLONES/{source}{at}"


def make_corpus(output=None, clones=None, check=()):
    """Lines for a reader: of the points in folders to `check`, of the corpus that is made of clones, or the commands that clone.

    Raises ValueError without a folder for the corpus, or without the clones.
    """
    entries = read_list()
    if check:
        return check_points(entries, check)
    if clones is None:
        return clone_commands(entries)
    if output is None:
        raise ValueError("-o names the folder to write")
    if not clones.is_dir():
        raise ValueError(f"{clones}: no such folder")
    return summary(build(entries, clones, output))
