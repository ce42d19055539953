"""What a log shows of work that takes its time."""

from __future__ import annotations

from motionmend import progress


class Hands:
    """Clock and timers that are moved by hand: a timer runs when the clock has passed it."""

    def __init__(self):
        self.now, self.timers = 0.0, []

    def monotonic(self) -> float:
        return self.now

    def Timer(self, seconds, call, arguments=()):
        hands = self

        class Timer:
            daemon, due = False, hands.now + seconds

            def start(self):
                hands.timers.append(self)

            def cancel(self):
                hands.timers[:] = [each for each in hands.timers if each is not self]

            def run(self):
                call(*arguments)

        return Timer()

    def passes(self, seconds: float) -> None:
        self.now += seconds
        for timer in [each for each in self.timers if each.due <= self.now]:
            timer.cancel()
            timer.run()


def test_a_log_has_few_lines_and_always_that_of_what_takes_long(monkeypatch, capsys):
    hands = Hands()
    monkeypatch.setattr(progress, "time", hands)
    monkeypatch.setattr(progress, "threading", hands)
    with progress.following("work") as stage:
        for number in range(100):
            stage(f"quick {number}")
            hands.passes(0.01)
        stage("long")
        hands.passes(30)
        stage("last")
        hands.passes(1)
    hands.passes(100)
    assert capsys.readouterr().err.splitlines() == ["work: long (31 s)"]
