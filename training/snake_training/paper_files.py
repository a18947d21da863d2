"""The files that the tables of the paper read: every missing one is named before anything runs."""

from pathlib import Path

import numpy as np

from .data.official import find, names_of_split, roots_of
from .paper_tables import D3FEAT, LISTS, NEEDED, PAIRS, TRAINING, UKPGAN, USIP


def missing(commands, networks, folders):
    """Lines that name files that commands and the training of their networks need and that `folders` lack, each with where it
    comes from: first whole folders and lists, then single files of them."""
    wanted = {}
    for network in networks:
        folder, split, validation, source = TRAINING[network.preset]
        wanted[f"{{data}}/{folder}/" + ("**/*.*" if split else "model.pkl")] = source
        wanted |= {f"{{lists}}/{name}": LISTS for name in (split, validation) if name}
    for command in commands:
        wanted |= NEEDED[command.needs]
    lines = [
        f"{path.format(**folders)}: from {source}" for path, source in wanted.items() if not is_there(path, folders)
    ]
    return lines or [*absent_shapes(commands, networks, folders), *absent_files(commands, folders)]


def is_there(path, folders):
    """Whether any file has a path, with wildcards."""
    root, _, pattern = path.partition("/")
    return any(Path(root.format(**folders)).glob(pattern))


def absent_shapes(commands, networks, folders):
    """Lines for lists with shapes that have no file."""
    lists = {
        (folder, name): source
        for folder, *names, source in map(TRAINING.get, [n.preset for n in networks])
        for name in names
    }
    if any(command.needs == "annotations" for command in commands):
        lists[TRAINING["keypointnet"][0], "keypointnet_test_full.txt"] = UKPGAN
    for (folder, name), source in lists.items():
        if name:
            split, folder = f"{folders['lists']}/{name}", f"{folders['data']}/{folder}"
            roots, names = roots_of(folder), names_of_split(split)
            yield from summary(
                f"{split}: shapes", [shape for shape in names if not find(roots, shape)], len(names), source
            )


def absent_files(commands, folders):
    """Lines for the files that lists of pairs and fragments name."""
    needs = {command.needs for command in commands}
    data = Path(folders["data"])
    if "pairs" in needs:
        folder = Path(PAIRS.format(**folders))
        number = len(np.load(folder / "transform.npy", mmap_mode="r"))
        files = [folder / part / f"{row}.npy" for part in ("original", "rotated") for row in range(number)]
        yield from absent(files, f"{folder}/transform.npy: clouds", USIP)
    if "rooms" in needs:
        folder = data / "redwood/numpy_gt_normal"
        rows = [
            line.split()
            for line in (folder / "redwood_pair.txt").read_text(encoding="utf-8-sig").splitlines()
            if line.strip()
        ]
        files = dict.fromkeys(folder / scene / f"{number}.npy" for scene, *pair in rows for number in pair)
        yield from absent(list(files), f"{folder}/redwood_pair.txt: clouds", USIP)
    if "fragments" in needs:
        clouds = sorted((data / "3DMatch_eval_downsample").glob("*/cloud_bin_*.ply"))
        files = [data / "d3feat" / cloud.parent.name / f"{cloud.stem}.npz" for cloud in clouds]
        yield from absent(files, f"{data}/3DMatch_eval_downsample: descriptors", D3FEAT)


def absent(files, what, source):
    """A line for those of the files that are not there."""
    return summary(what, [str(file) for file in files if not file.is_file()], len(files), source)


def summary(what, names, number, source):
    """One line for the `names` that are missing of a `number`, or none."""
    return [f"{what}: {len(names)} of {number} are missing, such as {names[0]}: from {source}"] if names else []
