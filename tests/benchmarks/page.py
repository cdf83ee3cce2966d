"""How much of a browser's main thread the operator's page needs with many agents, on a computer as slow as is asked.

    python -m tests.benchmarks.page --agents 500 --things 50 --seconds 10 --slower 4

A picture each second and moves five times a second, as a ground station sends them, with every route shown and one
agent chosen. `--slower 4` lets Chromium's main thread run at a quarter of its speed, as on a slow laptop. The times of
a drawing are those of the map's own code; the share is that of all tasks of the page: JSON, tables, style, layout and
drawing.
"""

from __future__ import annotations

import argparse
import time

from playwright.sync_api import CDPSession, Page, expect

from groundstation.web.pipe import Message
from tests.web.pictures import View, moves, swarm
from tests.web.rig import CHROMIUM, NO_CHROMIUM, WIDE, Stage, Tab, chromium, served

MOVES_HZ = 5


def routes(shown: View) -> Message:
    """Return a route of four way points for every agent."""
    ways = {}
    for one in shown["agents"]:
        north_m, east_m = one["north_m"], one["east_m"]
        ways[str(one["id"])] = [[north_m + 1_500 * leg, east_m + 900 * leg * (-1) ** leg] for leg in range(5)]
    return {"type": "routes", "routes": ways}


def busy_s(session: CDPSession) -> float:
    """Return the seconds of processor time that the page's main thread has worked since it was opened."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(metric["value"] for metric in metrics if metric["name"] == "TaskDuration"))


def play(stage: Stage, shown: View, seconds: float) -> int:
    """Show moves and pictures for a time, and return the number of moves."""
    count = round(seconds * MOVES_HZ)
    begun = time.monotonic()
    for index in range(1, count + 1):
        t_s = shown["t_s"] + index / MOVES_HZ
        stage.show(moves(shown, t_s))
        if index % MOVES_HZ == 0:
            stage.show({**shown, "t_s": t_s}, routes(shown))
        time.sleep(max(0.0, begun + index / MOVES_HZ - time.monotonic()))
    return count


def measure(stage: Stage, shown: View, page: Page, options: argparse.Namespace) -> str:
    """Return the figures of one run as text."""
    session = page.context.new_cdp_session(page)
    session.send("Emulation.setCPUThrottlingRate", {"rate": options.slower})
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    play(stage, shown, 1.0)
    page.evaluate("() => { window.groundStationPage.map.frameMs.length = 0; }")
    before_s, begun = busy_s(session), time.monotonic()
    count = play(stage, shown, options.seconds)
    share = (busy_s(session) - before_s) / (time.monotonic() - begun)
    drawn = sorted(page.evaluate("() => window.groundStationPage.map.frameMs"))
    quantile = {q: drawn[min(len(drawn) - 1, int(q * len(drawn)))] for q in (0.5, 0.99)}
    return (
        f"{options.agents} agents, {options.things} targets and threats, main thread {options.slower:g} times slower: "
        f"{len(drawn)} drawings for {count} moves, {quantile[0.5]:.1f} ms in the median, "
        f"{quantile[0.99]:.1f} ms at 99 %; main thread busy {share:.0%}"
    )


def main() -> None:
    """Open the page and print how much it works."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--agents", type=int, default=500)
    parser.add_argument("--things", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--slower", type=float, default=1.0)
    options = parser.parse_args()
    if not CHROMIUM.exists():
        print(NO_CHROMIUM)
        return
    shown = swarm(options.agents, options.things)
    stage = Stage()
    stage.show(shown, routes(shown))
    with served(stage) as url, chromium() as browser:
        tab = Tab(browser, url, WIDE)
        expect(tab.page.locator("#mission")).to_have_text("swarm")
        tab.page.locator("#agents-table .pick").first.click()
        print(measure(stage, shown, tab.page, options))
        tab.close()


if __name__ == "__main__":
    main()
