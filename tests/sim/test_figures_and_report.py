"""The pictures and the report: whole, repeatable, self-contained, and safe to show anybody's mission name."""

from __future__ import annotations

import base64
import re
import time
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Polygon

from sim.figures import clearance_png, draw_flight, plot_paths
from sim.flown import FlownMission
from sim.report import Pictures, write_report
from sim.score import Score, score
from sim.trajectory import Trajectory, TrajectoryBuilder

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
PLOT_LIMIT_S = 2.0
"""Of CPU time, for 10 agents and 5000 samples."""
HOSTILE_NAME = "<script>alert('x')</script> & \"quoted\" $\\frac{"
VOID_TAGS = frozenset({"meta", "img", "br", "link", "input"})


def mission_of(agents: int, targets: int, threats: int, name: str = "two by two", losses: Sequence[int] = ()) -> Any:  # noqa: ANN401
    return SimpleNamespace(
        name=name,
        origin=SimpleNamespace(alt_m=500.0),
        layers=1,
        layer_spacing_m=0.0,
        agents=tuple(
            SimpleNamespace(id=index + 1, height_m=30.0, only_target=None, speed_m_s=60.0, n_max=1.0)
            for index in range(agents)
        ),
        targets=tuple(SimpleNamespace(id=index + 1) for index in range(targets)),
        threats=tuple(
            SimpleNamespace(
                id=index + 1,
                detection_radius_m=300.0,
                attack_radius_m=150.0,
                motion="random",
                floor_m=None,
                ceiling_m=None,
            )
            for index in range(threats)
        ),
        losses=tuple(SimpleNamespace(agent=agent, t_s=20.0) for agent in losses),
        queue=False,
        fence=None,
        exclusions=(),
        arrival_radius_m=50.0,
        separation_m=20.0,
        broadcast_period_s=5.0,
        assignment_period_s=25.0,
        guidance_step_s=0.5,
        max_time_s=2_000.0,
        case="I",
        link=SimpleNamespace(loss=0.25, burst=None, delay_s=0.1, jitter_s=0.0, duplicate=0.0, reorder=0.0),
        wind=SimpleNamespace(from_deg=270.0, speed_m_s=0.0, gust_m_s=0.0),
    )


def flown(agents: int, targets: int, threats: int, steps: int = 60, scale: float = 1.0) -> Trajectory:
    """Return agents flying north side by side to targets, threats drifting east beyond them."""
    builder = TrajectoryBuilder(range(1, agents + 1), range(1, targets + 1), range(1, threats + 1))
    for step in range(steps):
        part = step / max(steps - 1, 1)
        rows = (
            [(2_000 * part * scale, 400 * index * scale, 0.0, 20.0) for index in range(agents)],
            [(2_000 * scale, 400 * index * scale, 0.0, 0.0) for index in range(targets)],
            [(1_000 * scale, (2_000 + 900 * index + 300 * part) * scale, 90.0, 5.0) for index in range(threats)],
        )
        builder.append(0.5 * step, *rows)
    return builder.build()


def run_of(
    agents: int,
    targets: int,
    threats: int,
    name: str = "two by two",
    losses: Sequence[int] = (),
    **how: Any,  # noqa: ANN401
) -> tuple[Trajectory, Any, Score]:
    trajectory = flown(agents, targets, threats, **how)
    mission = mission_of(agents, targets, threats, name, losses)
    return trajectory, mission, score(trajectory, mission)


def flown_of(trajectory: Trajectory, mission: Any, found: Score) -> FlownMission:  # noqa: ANN401
    return FlownMission(mission, trajectory, found, seed=1, law="seed")


def report_of(
    folder: Path, name: str = "two by two", result: dict[str, Any] | None = None, losses: Sequence[int] = ()
) -> str:
    trajectory, mission, found = run_of(3, 2, 1, name, losses)
    whole = {"seed": 7, "law": "seed", **found.to_dict(), **(result or {})}
    player = {"agents": [{"id": 1, "words": [[0.0, name]]}]}
    pictures = Pictures(PNG_SIGNATURE + b"paths", PNG_SIGNATURE + b"clearance", player)
    command = f"sim fly '{name}' --seed 7 --law seed"
    write_report(folder / "report.html", flown_of(trajectory, mission, found), whole, pictures, command)
    return (folder / "report.html").read_text(encoding="utf-8")


class Page(HTMLParser):
    """Collects what a page consists of, and checks that every tag is closed in turn."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.words: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, key, value or "") for key, value in attrs]
        if tag not in VOID_TAGS:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_the_picture_of_the_paths_is_written_and_returned(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(2, 2, 2, losses=[2])
    png = plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
    assert png.startswith(PNG_SIGNATURE)
    assert (tmp_path / "paths.png").read_bytes() == png


def test_fence_and_exclusions_are_drawn_to_their_places_and_named(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(1, 1, 1)
    mission.fence = ((-9_000.0, -8_000.0), (9_000.0, -8_000.0), (9_000.0, 7_000.0), (-9_000.0, 7_000.0))
    mission.exclusions = (((100.0, 200.0), (300.0, 200.0), (300.0, 600.0)),)
    axes = Figure().subplots()
    legend, unit = draw_flight(axes, flown_of(trajectory, mission, found))
    drawn = [patch.get_xy().tolist() for patch in axes.patches if isinstance(patch, Polygon)]
    assert unit == "km"
    assert [corners[0] for corners in drawn] == [[-8.0, -9.0], [0.2, 0.1]]
    assert [entry.get_label() for entry in legend][:2] == ["fence", "exclusion (hatched)"]
    assert axes.get_xlim()[0] < -8.0
    assert axes.get_ylim()[1] > 9.0


@pytest.mark.slow
def test_the_same_run_gives_the_same_picture_byte_for_byte(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(2, 2, 2)
    first, second = (
        plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run") for _ in range(2)
    )
    assert first == second
    assert clearance_png(found, mission) == clearance_png(found, mission)


@pytest.mark.slow
def test_the_pictures_carry_no_date_and_no_program_name(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(2, 2, 2)
    png = plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
    for chunk in (b"tEXt", b"tIME", b"iTXt", b"zTXt"):
        assert chunk not in png
        assert chunk not in clearance_png(found, mission)


@pytest.mark.slow
def test_a_circle_is_drawn_in_blue_and_one_in_red_only_where_there_is_a_threat(tmp_path: Path) -> None:
    def coloured(threats: int) -> tuple[int, int]:
        trajectory, mission, found = run_of(1, 1, threats)
        plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
        red, green, blue = np.moveaxis(imread(tmp_path / "paths.png")[..., :3], -1, 0)
        return int(((blue > red + 0.5) & (blue > green + 0.3)).sum()), int((red > np.maximum(green, blue) + 0.6).sum())

    assert coloured(0) == (0, 0)
    assert min(coloured(1)) > 200


def test_the_picture_keeps_circles_round(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(1, 1, 1)
    plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
    red, green, blue = np.moveaxis(imread(tmp_path / "paths.png")[:, :850, :3], -1, 0)
    rows, columns = np.nonzero((blue > red + 0.6) & (blue > green + 0.4))
    # The threat moved 300 m east, so its two thin and solid circles span one and a half diameters.
    assert np.ptp(columns) == pytest.approx(1.5 * np.ptp(rows), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("agents", "targets", "threats"), [(1, 1, 0), (1, 0, 1), (25, 3, 2)])
@pytest.mark.parametrize("steps", [1, 2, 60])
def test_any_make_up_of_a_mission_can_be_drawn(
    tmp_path: Path, agents: int, targets: int, threats: int, steps: int
) -> None:
    trajectory, mission, found = run_of(agents, targets, threats, steps=steps)
    plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
    assert clearance_png(found, mission).startswith(PNG_SIGNATURE)


def test_an_agent_lost_from_the_start_can_be_drawn(tmp_path: Path) -> None:
    trajectory, mission, _ = run_of(2, 1, 1)
    mission.losses = (SimpleNamespace(agent=1, t_s=0.0),)
    found = score(trajectory, mission)
    assert plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")


def test_a_title_that_looks_like_mathematics_is_drawn_as_it_is(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(1, 1, 0)
    assert plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "$\\frac{$")


@pytest.mark.slow
def test_ten_agents_and_five_thousand_samples_are_drawn_in_time(tmp_path: Path) -> None:
    trajectory, mission, found = run_of(10, 5, 4, steps=5_000)
    begin_s = time.process_time()
    plot_paths(flown_of(trajectory, mission, found), tmp_path / "paths.png", "a run")
    assert time.process_time() - begin_s < PLOT_LIMIT_S


def test_the_report_is_well_formed_and_accessible(tmp_path: Path) -> None:
    page = Page(report_of(tmp_path))
    assert ("html", "lang", "en") in page.attributes
    assert page.tags.count("h1") == 1
    assert page.tags.count("img") == sum(
        1 for tag, key, value in page.attributes if tag == "img" and key == "alt" and value
    )
    assert page.tags.count("table") == page.tags.count("caption") == 5
    assert page.tags.count("th") == sum(1 for tag, key, _ in page.attributes if tag == "th" and key == "scope")
    assert any(key == "name" and value == "viewport" for _, key, value in page.attributes)


def test_the_report_loads_nothing_and_runs_only_its_own_player(tmp_path: Path) -> None:
    text = report_of(tmp_path)
    page = Page(text)
    assert not {"link", "iframe", "object"} & set(page.tags)
    assert page.tags.count("script") == 2
    assert [value for tag, key, value in page.attributes if tag == "script"] == ["application/json", "flight"]
    policy = [value for tag, key, value in page.attributes if (tag, key) == ("meta", "content")]
    assert any(value.startswith("default-src 'none'; img-src data:;") for value in policy)
    assert not any(key.startswith("on") or key == "href" for _, key, _ in page.attributes)
    sources = [value for _, key, value in page.attributes if key == "src"]
    assert len(sources) == 2
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "url(" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_the_report_holds_the_pictures_it_was_given(tmp_path: Path) -> None:
    sources = [value for _, key, value in Page(report_of(tmp_path)).attributes if key == "src"]
    assert [base64.b64decode(source.partition(",")[2]) for source in sources] == [
        PNG_SIGNATURE + b"paths",
        PNG_SIGNATURE + b"clearance",
    ]


def test_a_hostile_mission_name_is_shown_and_not_run(tmp_path: Path) -> None:
    text = report_of(tmp_path, name=HOSTILE_NAME)
    page = Page(text)
    assert page.tags.count("script") == 2
    assert HOSTILE_NAME in page.words
    assert any(HOSTILE_NAME in words and words.startswith("sim fly") for words in page.words)


@pytest.mark.parametrize("result", [{"law": "<b>"}, {"seed": "<b>"}, {"arrived": "<b>"}, {"<b>": 1}])
def test_every_value_of_the_result_is_escaped(tmp_path: Path, result: dict[str, Any]) -> None:
    text = report_of(tmp_path, result=result)
    assert "<b>" not in text
    assert "&lt;b&gt;" in text


def test_the_report_tells_what_became_of_each_agent_and_why(tmp_path: Path) -> None:
    entry = {
        "id": 2,
        "outcome": "blocked",
        "reason": "no way to the target <b>",
        "certificate_at_start": "for ever",
        "certificate_lost": {"t_s": 12.5, "certificate": "none", "why": "new threat"},
        "broken": [{"assumption": "new threat", "count": 3, "first_t_s": 12.5}],
        "least_clearance_detection": {"m": 7.25, "threat": 4, "t_s": 30.0},
        "least_clearance_attack": None,
        "least_separation": {"m": 80.0, "agent": 1, "t_s": 31.0},
        "entries_detection": 1,
        "entries_attack": 0,
    }
    text = report_of(tmp_path, result={"agents": [entry]})
    words = " ".join(Page(text).words)
    assert "<b>" not in text
    for said in (
        "blocked",
        "no way to the target <b>",
        "for ever",
        "none from 12.5 s on: new threat",
        "new threat: 3 times from 12.5 s on",
        "7.2 m at 30.0 s (threat 4)",
        "80.0 m at 31.0 s (agent 1)",
        "1 / 0",
    ):
        assert said in words


def test_the_report_says_what_was_flown_and_that_it_is_kinematic(tmp_path: Path) -> None:
    words = " ".join(Page(report_of(tmp_path)).words)
    assert "Seed 7, law seed. Kinematic simulator." in words
    assert "25 % of frames lost" in words
    assert "Nothing here was flown outside the simulator" in words
    assert "sim fly 'two by two' --seed 7 --law seed" in words


def test_the_report_sums_the_run_up_in_words(tmp_path: Path) -> None:
    words = " ".join(Page(report_of(tmp_path, losses=[3])).words)
    assert "All targets were reached; 2 of 3 agents arrived. No agent was ever inside a detection radius." in words
    assert "Agents kept their separation throughout; the nearest two were 400.0 m apart." in words
    assert "1 agent was lost on the way" in words


def test_the_report_lists_every_figure_of_the_result_with_its_meaning(tmp_path: Path) -> None:
    result = {"decision_us": {"median": 80.0, "max": 1_234.5}, "frames_lost": 4_321, "something_new": 55}
    text = report_of(tmp_path, result=result)
    assert "median 80.00\nmax 1,234.50" in text
    assert "4,321" in text
    assert re.search(r"something_new</th><td[^>]*>55<", text)
    assert "guard interventions" not in text


def test_the_report_lists_every_agent_and_target_with_time_and_lengths(tmp_path: Path) -> None:
    text = report_of(tmp_path)
    rows = [re.sub("<[^>]*>", "|", row) for row in re.findall("<tr>(.*?)</tr>", text)]
    cells = [[cell for cell in row.split("|") if cell] for row in rows]
    assert ["1", "target 1", "28.8", "2.00", "1.95", "1.95", "1.000", "0"] in cells
    assert ["3", "–", "–", "2.00", "2.00", "2.00", "1.000", "0"] in cells
    assert ["2", "28.8", "2"] in cells


def test_a_lost_agent_is_told_with_the_time_of_its_loss(tmp_path: Path) -> None:
    text = report_of(tmp_path, losses=[3])
    assert "lost at 20.0 s" in text
