"""What is said of stalls and floods: once, with its number, and when it is over."""

from __future__ import annotations

from companion.onboard.loop_watch import CALM_S, REPEAT_S, STALLS_APART_S, Counts, FloodWatch, StallWatch


class Link:
    """What came on a link, as a test says."""

    def __init__(self) -> None:
        self.counts = Counts()
        self.watch = FloodWatch("broadcast link", lambda: self.counts)
        self.said: list[str] = []

    def pass_second(self, now_s: float, offered: int = 0, dropped: int = 0, overran: int = 0) -> None:
        before = self.counts
        self.counts = Counts(before.offered + offered, before.dropped + dropped, before.overran + overran)
        self.said += self.watch.news(now_s)


def test_a_link_on_which_nothing_is_dropped_is_no_news() -> None:
    link = Link()
    for second in range(200):
        link.pass_second(float(second), offered=1_000)
    assert link.said == []


def test_a_flood_is_told_with_its_numbers_once_a_minute_and_when_it_has_ended() -> None:
    link = Link()
    link.pass_second(0.0)
    for second in range(1, 100):
        link.pass_second(float(second), offered=18_000, dropped=16_400, overran=2_000)
    for second in range(100, 120):
        link.pass_second(float(second), offered=30)
    begun = "warning: broadcast link flooded: 18400 of 20000 datagrams/s dropped unread, 2000 of them by the kernel"
    ended = f"broadcast link no longer flooded: {99 * 18_400} datagrams dropped in 99 s"
    assert link.said == [begun, begun, ended]


def test_a_burst_too_great_for_the_buffer_is_told_when_it_is_over() -> None:
    link = Link()
    link.pass_second(0.0)
    link.pass_second(1.0, offered=300, overran=40)
    for second in range(2, 10):
        link.pass_second(float(second), offered=30)
    assert link.said == ["broadcast link no longer flooded: 40 datagrams dropped in 1 s"]


def test_a_flood_that_comes_back_soon_is_the_same_one() -> None:
    link = Link()
    link.pass_second(0.0)
    for second in range(1, 30):
        link.pass_second(float(second), offered=1_000, dropped=900 * (second % (CALM_S - 1) == 0))
    assert len(link.said) == 1
    assert REPEAT_S > 30.0


def test_stalls_are_told_with_the_worst_of_them_and_not_too_often() -> None:
    watch = StallWatch()
    watch.note_slot(0.0, 0.0, 0.0)
    watch.note_slot(0.1, 3.3, 0.0)
    assert watch.news(3.3) == ["warning: this computer stood still for 3.2 s"]
    for slot, late_s in enumerate((0.5, 0.9, 0.3)):
        watch.note_slot(4.0 + slot, 4.0 + slot + late_s, 0.0)
    assert watch.news(7.0) == []
    assert watch.news(3.3 + STALLS_APART_S) == [
        "warning: this computer stood still for 0.9 s, the worst of late; 4 stalls in all"
    ]
    assert watch.news(100.0) == []
