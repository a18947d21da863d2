"""The ablations: which settings each row has, the tables, and going on where they were."""

import json

import pytest
import torch

from conftest import TINY
from snake_training import ablations
from snake_training.ablations import BLIND, ROWS, Row, main, markdown, measure
from snake_training.config import TrainConfig, check
from snake_training.data import Procedural, write_corpus
from snake_training.export import write_weights
from snake_training.model import NetworkConfig, SnakeNetwork
from test_official import keypointnet

# Some rows are of one network detected with the same options: they stand in several tables and are measured once.
DISTINCT = {(row.run, row.options) for row in ROWS}


def test_every_row_can_be_trained_and_detected_and_rows_alike_share_a_run():
    runs = {}
    for row in ROWS:
        config = check(TrainConfig(**row.training))
        assert runs.setdefault(row.run, config) == config
    assert len(runs) == 12 and "all" in runs
    assert len(DISTINCT) == len(ROWS) - 3
    assert {row.table for row in ROWS} == {"losses", "local grids", "volume", "refinement"}


def test_a_row_is_trained_once_and_measured(tiny, tmp_path, monkeypatch):
    shapes = Procedural(2, 400)
    row = Row("losses", "none", {"weight_surface": 0.0}, BLIND | {"saliency_threshold": 0.0, "query_resolution": 8})
    found = measure(row, tmp_path, tiny(), shapes, 1, "torch", seeds=2)
    assert 0 <= found["repeatability"] <= 1 and found["deviation"] >= 0 and found["keypoints"] > 0
    monkeypatch.setattr(ablations, "train", lambda config: pytest.fail("trained again"))
    assert measure(row, tmp_path, tiny(), shapes, 1, "torch", seeds=2) == found


def test_tables_grow_row_by_row_and_a_second_call_goes_on(tmp_path, monkeypatch, capsys):
    write_corpus(tmp_path / "shapes", Procedural(2, 400), 400)
    measured = []
    monkeypatch.setattr(ablations, "TrainConfig", lambda **given: TrainConfig(**TINY | given))
    monkeypatch.setattr(ablations, "measure", lambda row, folder, config, *_: measured.append(config) or {
        "repeatability": 0.5, "deviation": 0.01, "keypoints": 64.0
    })  # fmt: skip
    words = ["-o", str(tmp_path / "out"), "--shapes", str(tmp_path / "shapes")]
    main([*words, "--tables", "losses"])
    assert len(measured) == 5
    main(words)
    assert len(measured) == len(DISTINCT)
    table = (tmp_path / "out" / "tables.md").read_text()
    assert "| no surface | 0.500 ±0.010 | 64 | 0.28 |" in table and "| J = 5 | 0.500 ±0.010 | 64 | 0.85 |" in table
    assert table == markdown(json.loads((tmp_path / "out" / "results.json").read_text()))
    for wrong in (["--tables", "colours"], ["--steps", "7"]):
        with pytest.raises(SystemExit):
            main([*words, *wrong])
    assert "other settings" in capsys.readouterr().err


def test_an_annotated_folder_gives_a_column_of_miou(tmp_path, monkeypatch, capsys, snake_cli):
    """Of each row by its own weights and options, as `snake-cli eval semantic` measures it."""
    data, _ = keypointnet(tmp_path / "annotated")
    write_corpus(tmp_path / "shapes", Procedural(2, 400), 400)

    def trained(row, folder, *_):
        torch.manual_seed(len(row.run))
        config = NetworkConfig(resolution=(8,) * 3, unet_levels=2, unet_base_channels=8)
        (folder / row.run).mkdir(exist_ok=True)
        network = SnakeNetwork(config)
        if row.training:  # salient nowhere, or everywhere
            torch.nn.init.constant_(network.decoder_keypoint.fc_out.bias, 50.0)
            torch.nn.init.constant_(network.decoder_occup.fc_out.bias, 50.0)
        write_weights(folder / row.run / "finished.safetensors", config, network.state_dict())
        return {"repeatability": 0.5, "deviation": 0.01, "keypoints": 64.0}

    monkeypatch.setattr(ablations, "measure", trained)
    names = ("all four", "no surface", "J = 0")
    monkeypatch.setattr(ablations, "ROWS", [row for row in ROWS if row.name in names])
    words = ["-o", str(tmp_path / "out"), "--shapes", str(tmp_path / "shapes"), "--annotated", str(data)]
    main([*words, "--tables", "losses", "refinement", "--cli", snake_cli.path])
    results = json.loads((tmp_path / "out/results.json").read_text())
    assert results["losses: all four"]["miou"] == 0 < results["losses: no surface"]["miou"] <= 1
    table = (tmp_path / "out/tables.md").read_text()
    shown = f"{results['losses: no surface']['miou']:.3f}"
    assert f"| no surface | 0.500 ±0.010 | 64 | 0.28 | {shown} ±" in table and "| 0.39 |\n" in table
    assert (
        "mIoU at 0.1 | paper (64³, KeypointNet) |" in table
        and "| all four | 0.500 ±0.010 | 64 | 0.85 | 0.000 ±" in table
    )
    for wrong, said in (
        (["--cli", "no-such-cli"], "needs snake-cli"),
        (["--annotated", str(tmp_path)], "eval semantic"),
    ):
        with pytest.raises(SystemExit):
            main([*words, "--cli", snake_cli.path, *wrong, "-o", str(tmp_path / wrong[0])])
        assert said in capsys.readouterr().err


def test_rows_can_start_from_weights_with_a_new_saliency_decoder(tmp_path, monkeypatch):
    write_corpus(tmp_path / "shapes", Procedural(2, 400), 400)
    given = []
    monkeypatch.setattr(ablations, "measure", lambda row, folder, config, *_: given.append(config) or {
        "repeatability": 0.5, "deviation": 0.01, "keypoints": 64.0
    })  # fmt: skip
    for words in ([], ["--init", "some.safetensors"]):
        main(["-o", str(tmp_path / f"out{len(words)}"), "--shapes", str(tmp_path / "shapes"), *words])
    starts = [(config.init, config.fresh_saliency) for config in given]
    assert starts == [("", False)] * len(DISTINCT) + [("some.safetensors", True)] * len(DISTINCT)
