"""The needs of each table and figure of SNAKE (NeurIPS 2022): data, networks, evaluations, commands of snake-cli, and the paper's figures.

In words, {data} is the folder of data, {lists} that of the released code's lists, {run} that of the results.
"""

from dataclasses import dataclass

USIP = "ModelNet40, 3DMatch and Redwood of USIP, linked in the README of the authors' repository"
UKPGAN = "KeypointNet as UKPGAN has it, linked in the README of the authors' repository"
LISTS = "core/datasets/split of the authors' repository"
DRIVE = "the drive that the README of the authors' repository links"
D3FEAT = "D3Feat, run on the fragments: keypoints, scores and descriptors of all points"
# Folder of the clouds, lists of training and of validation (the bodies of SMPL have none), files and where they are from.
TRAINING = {
    "modelnet40": ("modelnet40/modelnet40-normal_numpy", "modelnet40_train.txt", "modelnet40_val.txt", USIP),
    "keypointnet": ("keypointnet_pcds", "keypointnet_train.txt", "keypointnet_val.txt", UKPGAN),
    "3dmatch": ("keypointnet_pcds", "keypointnet_train.txt", "keypointnet_val.txt", UKPGAN),
    "smpl": ("smpl_model", "", "", "the basic model of https://smpl.is.tue.mpg.de, renamed to model.pkl"),
    "redwood": ("3DMatch_npy", "match3d_train_new_40k.txt", "match3d_val.txt", USIP),
}
PAIRS = "{data}/modelnet40/modelnet40-test_rotated_numpy"
SHAPE = f"{PAIRS}/original/0.npy"
NEEDED = {
    "pairs": {
        f"{PAIRS}/original/*.npy": USIP, f"{PAIRS}/rotated/*.npy": USIP,
        f"{PAIRS}/transform.npy": f"{DRIVE}: the transforms of ModelNet40",
    },
    "annotations": {
        "{data}/keypointnet_pcds/annotations/*.json": UKPGAN, "{lists}/keypointnet_test_full.txt": LISTS,
    },
    "bodies": {
        "{data}/smpl_model/pose_test_100.npy": DRIVE, "{data}/smpl_model/beta_test_100.npy": DRIVE,
    },
    "rooms": {
        "{data}/redwood/numpy_gt_normal/*/*.npy": USIP,
        "{data}/redwood/numpy_gt_normal/redwood_pair.txt": f"{LISTS}, copied",
        "{data}/redwood/numpy_gt_normal/transform.npy": f"{DRIVE}: the transforms of Redwood",
    },
    "fragments": {
        "{data}/3DMatch_eval_downsample/*/cloud_bin_*.ply": "the test data of D3Feat.pytorch",
        "{data}/3DMatch_eval_downsample/**/gt.log": "the evaluation files of 3DMatch",
        "{data}/3DMatch_eval_downsample/**/gt.info": "the evaluation files of 3DMatch",
        "{data}/d3feat/*/cloud_bin_*.npz": D3FEAT,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Network:
    """A network of the paper: a preset, with further settings of an ablation."""

    preset: str
    variant: str = ""
    words: tuple = ()

    @property
    def name(self):
        """The folder of its runs."""
        return "-".join(filter(None, (self.preset, self.variant)))


@dataclass(frozen=True)
class Command:
    """A command of snake-cli with the weights of a network."""

    name: str
    network: Network
    words: str
    needs: str = "pairs"


@dataclass(frozen=True)
class Evaluation:
    """An evaluation of a network with `options` of its detection, of `seeds` models or of the first, beside other methods."""

    name: str
    network: Network
    kind: str  # of `snake_training.evaluation`
    data: str
    arguments: tuple = ()  # names and values
    options: str = ""
    others: tuple = ()
    needs: str = "pairs"
    seeds: bool = False


@dataclass(frozen=True)
class Cell:
    """Figures of the paper and where ours stand: a metric of the evaluation and what varies in its conditions, or one condition with the
    paper's figure. Those of all conditions are those that the evaluation shows."""

    command: Evaluation
    metric: str
    condition: str
    paper: float | None = None


@dataclass(frozen=True)
class Item:
    """A table or figure of the paper: its cells, and the commands that only leave files."""

    title: str
    cells: tuple = ()
    pictures: tuple = ()


def ablation(preset, variant, words):
    return Network(preset, variant, tuple(words.split()))


MODELNET, KEYPOINTNET, SMPL, REDWOOD, MATCH = map(Network, ("modelnet40", "keypointnet", "smpl", "redwood", "3dmatch"))
BASELINES = "iss", "harris3d", "sift3d", "random"
PAPER = (("protocol", "paper"), ("paper", True))
HALF = "normalization=half"
REPEATED = Evaluation(
    "modelnet40", MODELNET, "repeatability", PAIRS, (("nms_radius", 0.01), *PAPER), HALF, BASELINES, seeds=True
)  # fmt: skip
ROOMS = Evaluation(
    "redwood", REDWOOD, "repeatability", "{data}/redwood/numpy_gt_normal", (("nms_radius", 0.04), *PAPER), "", BASELINES, "rooms", True
)  # fmt: skip
SHAPES = "{data}/keypointnet_pcds"
LIST_630 = ("split", "{run}/keypointnet_test_630.txt")
CONSISTENT = Evaluation(
    "keypointnet", KEYPOINTNET, "semantic", SHAPES, (LIST_630, *PAPER), "", BASELINES, "annotations", True
)
BODIES = Evaluation("smpl", SMPL, "semantic", "{data}/smpl_model", PAPER, "", BASELINES, "bodies", True)
BESIDE_UKPGAN = Evaluation(
    "ukpgan", KEYPOINTNET, "repeatability", SHAPES,
    (("split", "{lists}/keypointnet_test_full.txt"), ("max_keypoints", 32), ("nms_radius", 0.03), ("downsample", (1, 4, 8)), ("paper", True)),
    needs="annotations",
)  # fmt: skip
REGISTERED = Evaluation(
    "3dmatch", MATCH, "registration", "{data}/3DMatch_eval_downsample",
    (("descriptors", "d3feat"), ("external", "d3feat={data}/d3feat"), ("max_keypoints", (2500, 1000, 500, 250, 100)), ("paper", True)),
    "preset=3dmatch,nms_radius=0.05", ("iss", "sift3d", "random"), "fragments",
)  # fmt: skip

# Table 4: the loss that is left out, its settings, our detection without it, repeatability and mIoU.
LOSSES = {
    "no-occupancy": ("--no-occupancy-decoder --weight-occupancy 0 --weight-surface 0", (0.92, 0.94, 0.95), (0.22, 0.25, 0.28)),
    "no-surface": ("--weight-surface 0", (0.28, 0.36, 0.42), (0.31, 0.35, 0.39)),
    "no-repeatability": ("--weight-repeatability 0", (0.22, 0.28, 0.34), (0.30, 0.35, 0.39)),
    "no-sparsity": ("--weight-sparsity 0", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "": ("", (0.85, 0.89, 0.90), (0.30, 0.37, 0.42)),
}  # fmt: skip
CLEAN = (("nms_radius", 0.01), ("downsample", 1), ("noise", 0))
EVERYWHERE = "occupancy_threshold=0,surface_threshold=0"
REPEATABILITY = "repeatability", "ε 0.04"


def clean(name, network, options="", more=()):
    """The repeatability of a network on the pairs of ModelNet40 as they are."""
    options = ",".join(filter(None, (HALF, options)))
    return Evaluation(f"ablations/{name}", network, "repeatability", PAIRS, (*CLEAN, *more), options)


def table_4():
    """Table 4 row by row: repeatability at three distances, mIoU at three thresholds."""
    for variant, (words, repeated, consistent) in LOSSES.items():
        options = EVERYWHERE if variant == "no-occupancy" else ""
        network = ablation("modelnet40", variant, words)
        command = clean(network.name, network, options)
        for distance, paper in zip((0.04, 0.05, 0.06), repeated):
            yield Cell(command, "repeatability", f"ε {distance}", paper)
        network = ablation("keypointnet", variant, words)
        command = Evaluation(
            f"ablations/{network.name}", network, "semantic", SHAPES, (LIST_630,), options, needs="annotations"
        )
        for threshold, paper in zip((0.08, 0.09, 0.1), consistent):
            yield Cell(command, "mIoU, as released", f"threshold {threshold}", paper)


def table_5(option, figures, words):
    """Table 5a or 5b: a network for each value of a setting; one value is the preset's own."""
    for value, paper in figures.items():
        is_own = (option, value) in (("grid-fraction", 6), ("resolution", 64))
        network = MODELNET if is_own else ablation("modelnet40", f"{option}-{value}", words.format(value, value // 8))
        yield Cell(clean(network.name, network), *REPEATABILITY, paper)


def over(option, name, figures, more=()):
    """The repeatability of the network of ModelNet40 over an option of its detection."""
    for value, paper in figures.items():
        yield Cell(clean(f"{name}-{value}", MODELNET, f"{option}={value}", more), *REPEATABILITY, paper)


def steps(points, figures):
    """Table 14: the repeatability of views of so many points after J steps."""
    return over("refine_steps", f"points-{points}-steps", figures, (("num_points", points),))


def timed():
    """Table 14: the time of a detection, printed."""
    for points in (2048, 4096):
        for number in (0, 5, 10):
            words = f"detect {SHAPE} --timing --set max_points={points} --set refine_steps={number} -o {{run}}/time.ply"
            yield Command(f"time-{points}-{number}", MODELNET, words)


def picture(name, words, network=MODELNET, needs="pairs"):
    """A command that draws."""
    return Command(name, network, f"{words} -o {{run}}/{name}", needs)


ANNOTATED = (
    "view {data}/keypointnet_pcds/02691156/1021a0914a7207aff927ed529ad90a11.pcd "
    "--annotations {data}/keypointnet_pcds/annotations/airplane.json"
)
VIEWS = f"view {SHAPE} {PAIRS}/rotated/0.npy"
ITEMS = {
    "tab1": Item("repeatability on KeypointNet beside UKPGAN", (Cell(BESIDE_UKPGAN, "repeatability", "ε"),)),
    "tab2": Item("the same of thinned and noisy clouds, ε 0.03", tuple(Cell(BESIDE_UKPGAN, "repeatability", f"ε 0.03, {kind}") for kind in ("1 in", "σ"))),
    "tab3": Item(
        "registration of 3DMatch: feature matching recall, inlier ratio, registration recall",
        tuple(Cell(REGISTERED, name, "best") for name in ("feature matching recall", "inlier ratio", "registration recall")),
    ),
    "tab4": Item("losses left out: repeatability on ModelNet40, mIoU on KeypointNet", tuple(table_4())),
    "tab5a": Item(
        "repeatability over U", tuple(table_5("grid-fraction", {4: 0.79, 6: 0.85, 8: 0.79, 10: 0.77}, "--grid-fraction {}"))
    ),
    "tab5b": Item(
        "repeatability over the resolution",
        tuple(table_5("resolution", {32: 0.62, 48: 0.79, 64: 0.85, 80: 0.78}, "--resolution {} --grid-size {}")),
    ),
    "tab6": Item("mIoU on KeypointNet (figure 5a)", (Cell(CONSISTENT, "mIoU, as released", "threshold"),)),
    "tab7": Item("mIoU on SMPL (figure 5e)", (Cell(BODIES, "mIoU, as released", "threshold"),)),
    "tab8": Item("repeatability on ModelNet40 (figure 5b)", (Cell(REPEATED, "repeatability", "ε"),)),
    "tab9": Item("the same of thinned clouds, ε 0.04 (figure 5c)", (Cell(REPEATED, "repeatability", "ε 0.04, 1 in"),)),
    "tab10": Item("the same of noisy clouds, ε 0.04 (figure 5d)", (Cell(REPEATED, "repeatability", "ε 0.04, σ"),)),
    "tab11": Item("repeatability on Redwood (figure 5f)", (Cell(ROOMS, "repeatability", "ε"),)),
    "tab12": Item("the same of thinned clouds, ε 0.2 m (figure 5g)", (Cell(ROOMS, "repeatability", "ε 0.2, 1 in"),)),
    "tab13": Item("the same of noisy clouds, ε 0.2 m (figure 5h)", (Cell(ROOMS, "repeatability", "ε 0.2, σ"),)),
    "tab14": Item(
        "repeatability over the steps J (figure 7c), and the time of a detection",
        (*steps(2048, {0: 0.795, 5: 0.835, 10: 0.851}), *steps(4096, {0: 0.811, 5: 0.850, 10: 0.864})),
        tuple(timed()),
    ),
    "sec4.4": Item(
        "repeatability over the step size λ",
        tuple(over("refine_step_size", "step-size", {0.1: 0.002, 0.01: 0.622, 0.001: 0.854, 0.0001: 0.826})),
    ),
    "fig3": Item("annotations of a shape beside its keypoints", pictures=(
        picture("annotations.html", ANNOTATED, KEYPOINTNET, "annotations"),
    )),
    "fig4": Item("saliency of the network", pictures=(
        picture("saliency.png", f"field {SHAPE} --quantity saliency --colormap reds --no-points"),
    )),
    "fig6": Item("keypoints of a cloud, of two views (also figure 1), thinned and with noise", pictures=(
        picture("keypoints.html", f"view {SHAPE}"), picture("views.html", VIEWS),
        picture("thinned.html", "view {run}/thinned.npy"), picture("noisy.html", "view {run}/noisy.npy"),
    )),
    "fig7": Item("saliency without the occupancy decoder (a) and over U (b)", pictures=tuple(
        picture(f"saliency-{network.name}.png", f"field {SHAPE} --quantity saliency --slice middle", network)
        for network in (ablation("modelnet40", "no-occupancy", LOSSES["no-occupancy"][0]), MODELNET, *(
            ablation("modelnet40", f"grid-fraction-{value}", f"--grid-fraction {value}") for value in (4, 8, 10)
        ))
    )),
    "appendix": Item("occupancy and surface", pictures=(
        picture("occupancy.png", f"field {SHAPE} --quantity occupancy --slice middle"),
        picture("surface.ply", f"reconstruct {SHAPE} --surface level --level 0.4 --outer"),
    )),
}  # fmt: skip
