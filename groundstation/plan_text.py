"""A plan of the broadcast as tables for the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Column, Table

from groundstation.plan import BURSTS, Plan

_TABLE_COLUMNS = 200


def plan_text(found: Plan) -> str:
    """Return a plan as tables, with a line for each item that does not fit."""
    console = Console(soft_wrap=True, highlight=False, markup=False, width=_TABLE_COLUMNS)
    with console.capture() as capture:
        console.print(
            f"{found.mission} over {found.radio}, share {found.share:g}: {found.budget_bytes_per_s:.0f} B/s, "
            f"{found.authentication}; longest frame {found.largest_frame_bytes} bytes on the air\n"
        )
        items = Table("item", *(Column(title, justify="right") for title in ("frames", "every (s)", "copies", "B/s")))
        for item in found.items:
            every = "-" if item.interval_s is None else f"{item.interval_s:.2f}"
            items.add_row(item.name, str(item.frames), every, f"{item.copies:.1f}", f"{item.bytes_per_s:.0f}")
        items.add_row("together", "", "", "", f"{found.bytes_per_s:.0f}")
        console.print(items)
        console.print(f"used: {found.utilisation:.1%} of the budget\n")
        losses = Table("frames lost", Column("99.9 % of agents current after (s)", justify="right"))
        for loss, after_s in found.current_after_s.items():
            losses.add_row(loss, "longer than planned for" if after_s is None else f"{after_s:.1f}")
        console.print(losses)
        console.print(
            f"bursts: {BURSTS.bad_loss:.0%} lost for {BURSTS.bad_s:g} s after {BURSTS.good_s:g} s with "
            f"{BURSTS.good_loss:.0%} lost, on average\n"
        )
        outage = found.outage
        limit = "no limit" if outage.limit_s is None else f"{outage.limit_s:.0f} s"
        console.print(f"outage without an entry: {limit}: {outage.why}")
        for line in found.left_out:
            console.print(f"does not fit: {line}")
    return capture.get().rstrip("\n")
