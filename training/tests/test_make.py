"""The command that makes data."""

import inspect
import json

import numpy as np
import pytest

from snake_training.data import Corpus
from snake_training.make import KINDS, main


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_has_the_arguments_and_defaults_of_its_function(kind):
    make, _, arguments = KINDS[kind]
    given = {words.get("dest", name.removeprefix("--")): words.get("default") for name, words in arguments.items()}
    parameters = inspect.signature(make).parameters.values()
    empty = inspect.Parameter.empty
    assert given == {one.name: None if one.default is empty else one.default for one in parameters}


def test_halves_of_a_corpus_are_disjoint_and_keep_categories_back(tmp_path, capsys):
    categories = ["chair", "animal", "chair", "bone", "lamp", "lamp", "chair"]
    points = np.arange(len(categories) * 12, dtype=np.int16).reshape(-1, 4, 3)
    np.save(tmp_path / "points.npy", points)
    rows = [{"name": str(row), "category": category} for row, category in enumerate(categories)]
    (tmp_path / "index.json").write_text(json.dumps(rows))
    main(["halves", str(tmp_path), "-o", str(tmp_path / "parts")])
    assert json.loads(capsys.readouterr().out) == {"choose": 3, "judge": 2, "kinds": 2}
    parts = {name: Corpus(tmp_path / "parts" / name) for name in ("choose", "judge", "kinds")}
    names = {name: [int(row["name"]) for row in part.index] for name, part in parts.items()}
    assert names == {"choose": [0, 4, 6], "judge": [2, 5], "kinds": [1, 3]}
    assert all(np.array_equal(parts[name].points, points[rows]) for name, rows in names.items())


def test_a_fault_is_said_under_the_kinds_usage(tmp_path, capsys):
    for words in (["halves", str(tmp_path / "none"), "-o", "x"], ["frames", "-o", "x", "--pairs", "0"], ["none"]):
        with pytest.raises(SystemExit):
            main(words)
        assert words[0] in capsys.readouterr().err
