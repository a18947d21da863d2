"""Figures as one long table, its pivot to Markdown, and its curves.

A row has the columns of `COLUMNS`: metric, method, condition ("ε 0.04, 1 in 8"), unit (the pair, class or scene that it is a figure of) and
value. The figure of a data set is the mean over its units.
"""

import json
import os
import re
from pathlib import Path

import pandas as pd

COLUMNS = ["metric", "method", "condition", "unit", "value"]
CURVES = (
    "repeatability",
    "mIoU, strict",
    "mIoU, as released",
    "feature matching recall",
    "registration recall",
)  # metrics with panels


def table_of(rows):
    """The table of rows in the order of `COLUMNS`."""
    return pd.DataFrame(rows, columns=COLUMNS)


def pivot(table, columns=None):
    """The means over the units: a row a method, in the table's order, and a column a condition.

    columns: title -> (metric, condition), to choose columns of several metrics; all conditions of a table of one metric otherwise.
    """
    means = table.groupby(["metric", "condition", "method"], sort=False)["value"].mean()
    if columns is None:
        columns = {condition: (metric, condition) for metric, condition, _ in means.index}
        kinds = [kind_of(condition)[0] for condition in columns]
        columns = {name: columns[name] for name in sorted(columns, key=lambda name: kinds.index(kind_of(name)[0]))}
    methods = pd.unique(table["method"])
    rows = [[means.get((*column, method), float("nan")) for column in columns.values()] for method in methods]
    return pd.DataFrame(rows, index=methods, columns=list(columns)).dropna(how="all")


def kind_of(condition):
    """What varies in a condition, and its value: ("ε 0.04, 1 in", 8.0), ("ε", 0.04); the value may be None."""
    parts = re.fullmatch(r"(.*?) ?([\d.]+)", condition)
    return (parts[1], float(parts[2])) if parts else (condition, None)


def markdown(frame, digits=3):
    """A frame of numbers, a row a method, as a table in Markdown."""
    cells = [["method", *frame.columns], ["---"] * (len(frame.columns) + 1)]
    for method, row in zip(frame.index, frame.to_numpy()):
        cells.append([method, *("-" if pd.isna(value) else f"{value:.{digits}f}" for value in row)])
    head, rule, *lines = cells
    rows = [f"| {' | '.join(map(str, line))} |" for line in (head, *lines)]
    return "\n".join([rows[0], f"|{'|'.join(rule)}|", *rows[1:]]) + "\n"


def report(table):
    """The pivots of all metrics, each under its name."""
    metrics = pd.unique(table["metric"])
    return "\n".join(f"{metric}:\n\n{markdown(pivot(table[table['metric'] == metric]))}" for metric in metrics)


def curves(table, path):
    """Draws the means over every condition that has several values, a panel a metric and a kind of condition, as SVG.

    Without such a condition nothing is drawn. Figures of the paper are dashed.
    """
    panels = {}
    for metric in pd.unique(table["metric"]):
        frame = pivot(table[table["metric"] == metric])
        for condition in frame.columns:
            kind, value = kind_of(condition)
            if value is not None and metric in CURVES:
                panels.setdefault((metric, kind), []).append((value, frame[condition]))
    panels = {names: sorted(points, key=lambda point: point[0]) for names, points in panels.items() if len(points) > 1}
    if not panels:
        return
    import matplotlib  # takes a second, and tables do without it

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "snake"  # the same figures are the same file
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(panels), figsize=(4 * len(panels), 3.8), squeeze=False, layout="constrained")
    colors = {}
    for axis, ((metric, kind), points) in zip(axes[0], panels.items()):
        for method in points[0][1].index:
            values = [(x, row.get(method)) for x, row in points if not pd.isna(row.get(method))]
            color = colors.setdefault(method.removesuffix(" (paper)"), f"C{len(colors) % 10}")
            axis.plot(*zip(*values), "--" if method.endswith("(paper)") else "-", color=color, marker=".", label=method)
        axis.set(xlabel=kind, ylabel=metric, ylim=(0, 1))
        if kind.endswith("1 in"):
            axis.set_xscale("log", base=2)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="x-small")
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def kept(path, settings, compute):
    """The table of a CSV file; `compute` makes it where the file is not there. Without a path it is only computed.

    The first line has the settings; a file of other ones is a ValueError.
    """
    if path is None:
        return table_of(compute())
    path, head = Path(path), f"# {json.dumps(settings, sort_keys=True, default=str)}\n"
    if path.exists():
        with path.open() as file:
            if file.readline() != head:
                raise ValueError(f"{path} was written with other settings; delete it, or give another --output")
            return pd.read_csv(file, dtype={"unit": str, "condition": str, "method": str})
    table, temporary = table_of(compute()), path.with_name(f"{path.name}.{os.getpid()}")
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary.open("w") as file:
        file.write(head)
        table.to_csv(file, index=False)
    temporary.replace(path)
    return table
