"""What a machine that is there for its GPU does beside training: it tries what is faster there, and chooses between networks."""

import copy
import json

import numpy as np
import pytest
import torch

from snake_training import choice, tuning
from snake_training.data import Procedural
from snake_training.evaluate import select
from snake_training.tuning import TRIALS, Tuner


def test_a_tuner_keeps_what_makes_steps_faster_and_a_run_that_goes_on_has_it(network, tmp_path, monkeypatch):
    on = set()
    trials = {
        name: lambda _unet, is_on, name=name: on.add(name) if is_on else on.discard(name)
        for name in ("faster", "slower", "breaks")
    }
    monkeypatch.setattr(tuning, "TRIALS", trials)
    monkeypatch.setattr(
        network.encoder.unet3d, "forward", lambda x: (_ for _ in ()).throw(RuntimeError) if "breaks" in on else x
    )
    tuner, now = Tuner(network, 1, True, tmp_path, seconds=5.0, steps=3), 0.0
    for _ in range(60):
        now += 1.0 - 0.5 * ("faster" in on) + 0.3 * ("slower" in on)
        tuner.step(now)
    expected = {"kept": ["faster"], "seconds": 1.0, "faster": 0.5, "slower": 0.8}
    assert on == {"faster"} and json.loads((tmp_path / "tuned.json").read_text()) == expected
    on.clear()
    again = Tuner(network, 1, True, tmp_path)
    again.step(1.0)
    assert on == {"faster"} and not again.times


@pytest.mark.parametrize("name", [name for name in TRIALS if name != "compiled"])
def test_what_is_tried_changes_the_network_little_and_goes_off_again(network, name):
    unet = network.encoder.unet3d
    volume = torch.randn(1, 8, 8, 8, 8, generator=torch.Generator().manual_seed(0))
    before, weights = unet(volume), copy.deepcopy(unet.state_dict())
    TRIALS[name](unet, True)
    with torch.autocast("cpu", torch.bfloat16, enabled=name == "narrow_norms"):
        seen = unet(volume).float()
    assert (seen - before).abs().max() < 0.05 * before.abs().max()
    TRIALS[name](unet, False)
    assert torch.equal(unet(volume), before)
    assert all(torch.equal(tensor, weights[name]) for name, tensor in unet.state_dict().items())


def test_the_number_of_keypoints_brings_networks_to_one_coverage():
    line = torch.arange(100.0)[:, None] * torch.tensor([0.01, 0.0, 0.0])
    reached = choice.coverage_by_number([(line, line[[0, 99, 50]])])
    assert len(reached) == 64 and reached[:3].tolist() == pytest.approx([0.495, 0.245, 0.1225], abs=1e-3)
    assert (reached[2:] == reached[2]).all()
    assert choice.coverage_by_number([(line, line[:0]), (line, line[:64])])[63] == pytest.approx(
        0.5 + 0.5 * 0.0666, abs=1e-4
    )


def test_the_network_that_finds_the_same_places_again_is_judged_better(network, monkeypatch):
    """A detector of the points that lie farthest out, which turn with the cloud, and one of those along an axis, which do not."""

    def detector(score):
        def found(_network, points, options):
            points = torch.from_numpy(np.asarray(points, np.float32))
            return select(points, score(points), options)

        monkeypatch.setattr(choice, "detect", found)
        return choice.judge(network, Procedural(), 3, 0.3)

    same, other = detector(lambda points: points.norm(dim=1)), detector(lambda points: points[:, 0] + 2)
    assert same["coverage"] <= 0.3 and other["coverage"] <= 0.3
    assert same["score"] > other["score"] + 0.05 and same["clean"] > same["thinned"]
    assert set(same) == {"keypoints", "coverage", "clean", "thinned", "noise", "score"}
