"""Progress without a terminal is lines."""

import time

from snake_training import progress


def test_without_a_terminal_progress_is_lines_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr(progress, "INTERVAL", 0.05)
    for _ in progress.bar(range(20), unit="step"):
        time.sleep(0.01)
    text = capsys.readouterr().err
    lines = text.splitlines()
    assert "\r" not in text and 3 <= len(lines) <= 8
    assert lines[0].startswith("0%") and "20/20" in lines[-1] and all("step" in line for line in lines)
