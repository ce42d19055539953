"""What a log shows of work that takes its time."""

from __future__ import annotations

import time

from motionmend import progress


def test_a_log_has_few_lines_and_always_that_of_what_takes_long(monkeypatch, capsys):
    monkeypatch.setattr(progress, "QUIET_SECONDS", 0.2)
    with progress.following("work") as stage:
        for number in range(100):
            stage(f"quick {number}")
        stage("long")
        time.sleep(0.6)
        stage("last")
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" (")[0] for line in lines if "long" in line] == ["work: long"]
    assert len(lines) <= 3
