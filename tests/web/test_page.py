"""The page in Chromium, on pictures that the test shows: what it draws and says, what it asks, and who may."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, ViewportSize, expect

from companion.geo.local_frame import LocalFrame
from companion.mission.model import parse_mission
from companion.protocol.codec import Kind
from groundstation import view
from groundstation.ground_station import GroundStation
from groundstation.origins import Observation
from groundstation.web.feed import Refused
from groundstation.web.pipe import Message, Who
from groundstation.web.site import Site
from groundstation.web.tokens import add_token
from tests.web.pictures import BEGAN_S, agent, moves, picture, swarm, threat, valley
from tests.web.rig import NARROW, WIDE, Stage, Tab, served

pytestmark = pytest.mark.slow
TILE = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
"""Picture of one pixel."""
THEMES = ("light", "dark", "contrast")
HALF_SEEN = """
name: half-seen
case: II
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 20}
  - {id: 2, north_m: 0, east_m: 4000, heading_deg: 0, speed_m_s: 20}
targets: [{id: 1, north_m: 9000, east_m: 0}, {id: 2, north_m: 9000, east_m: 4000}]
broadcast_period_s: 1
"""
HOSTILE = '<img src=x onerror="document.title=1"><script>alert(1)</script>\u202e"};'
_ANNA = {"name": "anna", "role": "operator"}
_CONTRAST = (Path(__file__).parent / "contrast.js").read_text(encoding="utf-8")


def _event(number: int, command: Message) -> Message:
    """Return the event of an order to one agent, as a ground station would."""
    names = {"take-out": "taken-out", "direct": "directed"}
    rest = {key: value for key, value in command.items() if key != "do"}
    return {"event": names.get(command["do"], command["do"]), "number": number, "unix_s": 1.79e9, "who": _ANNA, **rest}


def _answer(command: Message) -> Message:
    if command["do"] == "retire":
        raise Refused("threat 1 is not known; allowed: 2, 3")
    return _event(7, command)


class _Scene:
    """A stage with the server that shows it, and one page of the browser, which each test opens anew."""

    def __init__(self, browser: Browser, stage: Stage, url: str) -> None:
        self.stage = stage
        self._url = url
        self._tab = Tab(browser, "about:blank")

    @contextmanager
    def opened(self, shown: Message, size: ViewportSize = WIDE, token: str | None = None) -> Iterator[Page]:
        """Open the page on a picture; it must ask nobody else for anything and complain of nothing.

        `token`: what is given where the page asks for one.
        """
        tab = self._tab
        self.stage.asked.clear()
        self.stage.show(shown)
        tab.context.clear_cookies()
        tab.open(self._url, size)
        if token is not None:
            tab.page.fill("[name=token]", token)
            tab.page.click("dialog [type=submit]")
        expect(tab.page.locator("#mission")).to_have_text(shown["mission"])
        yield tab.page
        assert tab.hosts() == {"127.0.0.1"}
        assert tab.complaints == []


@pytest.fixture(scope="module")
def scene(browser: Browser) -> Iterator[_Scene]:
    stage = Stage(_answer)
    with served(stage) as url:
        yield _Scene(browser, stage, url)


@pytest.fixture(scope="module")
def guarded(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[_Scene, dict[str, str]]]:
    """Return a scene that asks for a token, and a token for each role."""
    path = tmp_path_factory.mktemp("tokens") / "tokens.json"
    tokens = {role: add_token(path, Who(f"anna {role}", role)) for role in ("observer", "operator")}
    stage = Stage(_answer)
    with served(stage, Site(tokens=path)) as url:
        yield _Scene(browser, stage, url), tokens


def _drawn_at(page: Page, north_m: float, east_m: float) -> tuple[float, float]:
    """Return where on the screen the map draws a place."""
    x, y = page.evaluate(
        """([north, east]) => {
          const map = window.groundStationPage.map;
          map.drawNow();
          const [x, y] = map.state.plane.toSquare(north, east);
          const corner = map.leaflet.getPixelBounds().min;
          const scale = 256 * 2 ** map.leaflet.getZoom();
          const box = map.element.getBoundingClientRect();
          return [x * scale - corner.x + box.left, y * scale - corner.y + box.top];
        }""",
        [north_m, east_m],
    )
    return x, y


def test_the_projection_is_that_of_the_mission(scene: _Scene) -> None:
    places = [(0.0, 0.0), (12.5, -3.0), (4_000.0, 9_000.0), (-180_000.0, 60_000.0), (90_000.0, -170_000.0)]
    origins = [(47.0, 8.0), (-33.9, 151.2), (0.0, 179.999), (69.6, -18.9)]
    with scene.opened(picture()) as page:
        for origin in origins:
            frame = LocalFrame(*origin)
            found = page.evaluate(
                """async ([origin, places]) => {
                  const { Plane } = await import("/page/geo.js");
                  const plane = new Plane(...origin);
                  return places.map(([n, e]) => [plane.toGlobal(n, e), plane.toLocal(...plane.toGlobal(n, e))]);
                }""",
                [origin, places],
            )
            for (north_m, east_m), ((lat_deg, lon_deg), back) in zip(places, found, strict=True):
                expected = frame.to_global(north_m, east_m)
                assert lat_deg == pytest.approx(expected[0], abs=1e-9)
                assert (lon_deg - expected[1] + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-9)
                assert back == pytest.approx([north_m, east_m], abs=1e-3)


def _half_seen() -> Message:
    """Return the picture of a ground station that has heard the telemetry of agent 1, and nothing of agent 2."""
    station = GroundStation(parse_mission(HALF_SEEN, "half-seen"), BEGAN_S, sensed=False)
    for second in range(31):
        now_s = BEGAN_S + float(second)
        place = complex(20.0 * second, 0.0)
        station.observe(Observation(Kind.AGENT, 1, place, complex(20.0), now_s, 10.0, "vehicle 1"))
        station.tick(now_s)
    return view.picture(station, BEGAN_S + 30.0, view.Surroundings())


def test_an_agent_with_telemetry_and_a_ghost_stand_side_by_side_and_look_different(scene: _Scene) -> None:
    shown = _half_seen()
    with scene.opened(shown) as page:
        rows = page.locator("#agents-table tbody tr")
        expect(rows.nth(0)).to_contain_text("telemetry")
        expect(rows.nth(1)).to_contain_text("reckoned")
        assert [rows.nth(row).locator(".col-by").get_attribute("data-sign") for row in (0, 1)] == ["telemetry", "ghost"]
        seen, ghost = _inked(page, [(one["north_m"], one["east_m"]) for one in shown["agents"]])
        assert seen > 1.5 * ghost
        rows.nth(1).locator("button").click()
        expect(page.locator("#details-facts")).to_contain_text("May be off by")


def _inked(page: Page, places: list[tuple[float, float]]) -> list[int]:
    """Return how many pixels around each of these places on the map are neither empty nor white."""
    counts: list[int] = page.evaluate(
        """(places) => {
          const map = window.groundStationPage.map;
          map.drawNow();
          const { width, data } = map.canvas.getContext("2d").getImageData(0, 0, map.canvas.width, map.canvas.height);
          const corner = map.leaflet.getPixelBounds().min;
          const scale = 256 * 2 ** map.leaflet.getZoom();
          return places.map(([north, east]) => {
            const at = map.state.plane.toSquare(north, east);
            const [x, y] = [at[0] * scale - corner.x, at[1] * scale - corner.y].map(Math.round);
            let inked = 0;
            for (let row = y - 8; row < y + 8; row += 1) {
              for (let column = x - 8; column < x + 8; column += 1) {
                const byte = 4 * (row * width + column);
                inked += data[byte + 3] > 200 && data[byte] < 160;
              }
            }
            return inked;
          });
        }""",
        places,
    )
    return counts


def test_names_are_shown_as_the_text_that_they_are(scene: _Scene) -> None:
    shown = picture(mission=HOSTILE, threats=[threat(1, 400, 400, name=HOSTILE)], warnings=[HOSTILE])
    scene.stage.show({"type": "event", "event": _event(1, {"do": "directed", "directive": HOSTILE, "agent": 1})})
    with scene.opened(shown) as page:
        page.click("#tab-threats")
        page.locator("#threats-table tbody button").click()
        for place in ("#mission", "#threats-table .col-name >> nth=1", "#details-title", "#warnings li"):
            assert "<img src=x" in (page.locator(place).text_content() or "")
        assert page.locator("img[src=x], main script").count() == 0


def test_a_stream_that_falls_silent_is_said_at_once_and_greys_the_page(scene: _Scene) -> None:
    shown = picture()
    with scene.opened(shown) as page:
        before = page.locator("#map").bounding_box()
        expect(page.locator("#stale")).to_contain_text("No word from the ground station for 2")
        expect(page.locator("#stale")).to_be_in_viewport()
        assert page.locator("#map").bounding_box() == before
        assert "grayscale" in page.locator("#map").evaluate("(map) => getComputedStyle(map).filter")
        page.click("#hold-all")
        expect(page.locator("dialog")).to_contain_text("What you see is")
        page.keyboard.press("Escape")
        scene.stage.show(moves(shown, shown["t_s"] + 1.0))
        expect(page.locator("#stale")).to_be_hidden()
        expect(page.locator("#connection")).to_have_text("connected")


def test_a_stream_that_breaks_off_is_opened_again_and_shows_what_is_now(scene: _Scene) -> None:
    with scene.opened(picture()) as page:
        page.evaluate("() => window.groundStationPage.stream.socket.close()")
        scene.stage.show(picture(mission="another valley"))
        expect(page.locator("#mission")).to_have_text("another valley")
        expect(page.locator("#connection")).to_have_text("connected")


def test_an_action_is_done_with_the_keyboard_alone(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.keyboard.press("Tab")
        expect(page.locator(".skips a:focus")).to_have_text("To the agents")
        page.keyboard.press("Enter")
        for _ in range(20):
            page.keyboard.press("Tab")
            if page.locator("#agents-table .pick:focus").count():
                break
        page.keyboard.press("Enter")
        expect(page.locator("#details-title")).to_have_text("Agent 1")
        page.locator("#details").focus()
        while page.locator("[data-act=take-out]:focus").count() == 0:
            page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator("dialog button:focus")).to_have_text("Take agent 1 out")
        page.keyboard.press("Enter")
        expect(page.locator("#toast")).to_contain_text("Agent 1 taken out")
        assert scene.stage.asked == [{"do": "take-out", "agent": 1}]
        expect(page.locator(":focus")).to_have_attribute("data-act", "take-out")


def test_a_threat_is_added_where_the_map_was_clicked(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.click("#add-threat")
        page.mouse.click(*_drawn_at(page, 3_000.0, 6_000.0))
        page.fill("[name=attack_radius_m]", "250")
        page.fill("[name=detection_radius_m]", "400")
        page.click("dialog [type=submit]")
        expect(page.locator("#toast")).to_contain_text("threat added")
        (asked,) = scene.stage.asked
        assert asked["do"] == "add-threat"
        assert (asked["attack_radius_m"], asked["detection_radius_m"]) == (250.0, 400.0)
        assert (asked["north_m"], asked["east_m"]) == (pytest.approx(3_000, abs=30), pytest.approx(6_000, abs=30))


def test_a_target_is_added_by_latitude_and_longitude(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.click("#tab-targets")
        page.click("#form-target")
        page.check("[name=unit][value=degrees]")
        page.fill("[name=lat_deg]", "47.05")
        page.fill("[name=lon_deg]", "8.01")
        page.fill("[name=name]", "Dam")
        page.click("dialog [type=submit]")
        expect(page.locator("#toast")).to_contain_text("target added")
        assert scene.stage.asked == [
            {"do": "add-target", "lat_deg": 47.05, "lon_deg": 8.01, "name": "Dam", "speed_bound_m_s": 0.0}
        ]


def test_a_chosen_threat_is_dragged_to_another_place(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.mouse.click(*_drawn_at(page, 4_700, 3_300))
        expect(page.locator("#details-title")).to_have_text("Threat 1 (Mast)")
        page.mouse.move(*_drawn_at(page, 4_700, 3_300))
        page.mouse.down()
        page.mouse.move(*_drawn_at(page, 6_000, 2_000), steps=4)
        page.mouse.up()
        page.click("dialog [type=submit]")
        expect(page.locator("#toast")).to_contain_text("moved")
        (asked,) = scene.stage.asked
        assert (asked["do"], asked["kind"], asked["id"]) == ("change", "threat", 1)
        assert (asked["north_m"], asked["east_m"]) == (pytest.approx(6_000, abs=60), pytest.approx(2_000, abs=60))


def test_what_the_ground_station_refuses_is_said_in_its_own_words(scene: _Scene) -> None:
    with scene.opened(picture()) as page:
        page.click("#tab-threats")
        page.locator("#threats-table tbody button").click()
        page.click("[data-act=retire]")
        page.click("dialog [type=submit]")
        expect(page.locator("dialog [role=alert]")).to_have_text("Refused: threat 1 is not known; allowed: 2, 3")
        page.keyboard.press("Escape")
        expect(page.locator("dialog")).to_be_hidden()


def test_an_unknown_thing_is_taken_in_as_a_threat(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.click("#tab-threats")
        page.click("#unknown button")
        page.click("dialog [type=submit]")
        expect(page.locator("#toast")).to_contain_text("threat added")
        (asked,) = scene.stage.asked
        assert (asked["id"], asked["north_m"], asked["east_m"]) == (77, 10_800.0, 9_300.0)


def test_the_link_of_an_agent_is_told_with_how_it_is_known(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        expect(page.locator("#agents-table .col-link").nth(3)).to_have_text("80 %")
        page.locator("#agents-table .pick").nth(2).click()
        expect(page.locator("#details-facts")).to_contain_text("hears 80 %, as the mission declares")


def test_what_is_known_of_a_thing_stands_in_the_same_order_whatever_was_chosen_before(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        names = page.locator("#details-facts dt")
        page.click("#tab-threats")
        page.locator("#threats-table .pick").first.click()
        expect(names.first).to_have_text("Attack / detection")
        at_first = names.all_inner_texts()
        page.click("#tab-agents")
        page.locator("#agents-table .pick").first.click()
        expect(names.first).to_have_text("State")
        page.click("#tab-threats")
        page.locator("#threats-table .pick").first.click()
        expect(names).to_have_text(at_first)


def test_an_observer_sees_no_live_button(guarded: tuple[_Scene, dict[str, str]]) -> None:
    scene, tokens = guarded
    with scene.opened(valley(), token=tokens["observer"]) as page:
        page.locator("#agents-table tbody button").first.click()
        visible = page.locator("button:visible").all_inner_texts()
        assert not {"Hold all", "Recall all", "Pause", "Take out", "Pin…", "Add threat", "Undo"} & set(visible)
        assert "Why?" in visible
        expect(page.locator("#who")).to_have_text("anna observer, observer")
        page.click("#log-out")
        expect(page.locator("[name=token]")).to_be_visible()


def test_an_operator_logs_in_with_a_token(guarded: tuple[_Scene, dict[str, str]]) -> None:
    scene, tokens = guarded
    with scene.opened(valley(), token=tokens["operator"]) as page:
        page.click("#hold-all")
        page.click("dialog [type=submit]")
        expect(page.locator("#toast")).to_contain_text("Hold: all agents")
        assert scene.stage.asked == [{"do": "direct", "directive": "hold", "agent": None}]


def test_every_text_has_a_contrast_of_4_5_or_more_in_every_theme(scene: _Scene) -> None:
    with scene.opened(valley()) as page:
        page.locator("#agents-table tbody button").first.click()
        for theme in THEMES:
            page.select_option("#theme", theme)
            assert page.evaluate(_CONTRAST) == []


def test_a_narrow_screen_has_everything_and_nothing_runs_out_of_it(scene: _Scene) -> None:
    with scene.opened(valley(), NARROW) as page:
        for name in ("map", "agents", "targets", "threats", "broadcast", "sources", "events", "warnings"):
            page.click(f"#tab-{name}")
            expect(page.locator(f"#panel-{name}")).to_be_visible()
            assert page.evaluate("() => document.scrollingElement.scrollWidth") <= NARROW["width"]
            shown = page.locator(".panel:visible, .map-side:visible")
            assert shown.count() == 1
        for button in ("#hold-all", "#recall-all", "#pause"):
            box = page.locator(button).bounding_box()
            assert box is not None and box["x"] + box["width"] <= NARROW["width"]


def test_a_recorded_run_is_wound_to_another_time(scene: _Scene) -> None:
    shown = picture(mode="playback")
    state = {"type": "playback", "from_s": BEGAN_S, "to_s": BEGAN_S + 600.0, "speed": 1.0, "playing": True}
    late = {"type": "event", "event": {**_event(9, {"do": "paused"}), "unix_s": BEGAN_S + 100.0}}
    with scene.opened(shown) as page:
        scene.stage.show({"type": "timeline", "events": [late["event"]]}, late, {**state, "at_s": BEGAN_S + 120.0})
        expect(page.locator("#playback output")).to_have_text("0:02:00 of 0:10:00")
        assert page.locator("#orders").is_hidden()
        page.click("#tab-events")
        expect(page.locator("#events")).to_contain_text("mission paused")
        for control in (
            lambda: page.locator("#playback select").first.select_option("10"),
            lambda: page.locator("#playback button").click(),
            lambda: page.locator("#playback select").last.select_option(label="0:01:40 mission paused"),
            lambda: page.locator("#playback input").fill(str(BEGAN_S + 60)),
        ):
            with page.expect_response("**/api/v1/playback"):
                control()
        scene.stage.show({**state, "at_s": BEGAN_S + 60.0})
        expect(page.locator("#events")).not_to_contain_text("mission paused")
        assert scene.stage.controls == [
            {"speed": 10.0},
            {"playing": False},
            {"at_s": BEGAN_S + 100.0},
            {"at_s": BEGAN_S + 60.0},
        ]


def test_one_agent_among_500_is_found_by_filter_and_order(scene: _Scene) -> None:
    with scene.opened(swarm()) as page:
        expect(page.locator("#agent-count")).to_have_text("500")
        page.fill("#agent-filter", "telemetry 499")
        expect(page.locator("#agent-count")).to_have_text("1 of 500")
        expect(page.locator("#agents-table tbody tr")).to_contain_text("telemetry")
        page.fill("#agent-filter", "")
        page.click("#agents-table thead button >> nth=0")
        expect(page.locator("#agents-table .pick").first).to_have_text("500")


def test_the_age_of_a_threat_lets_its_rim_grow_on_the_map(scene: _Scene) -> None:
    shown = picture(agents=[agent(1, 0, 0)], threats=[threat(1, 4_500, 3_000, speed_bound_m_s=1.0)])
    with scene.opened(shown) as page:
        page.click("#tab-threats")
        beyond = 4_500.0, 3_000.0 + shown["threats"][0]["detection_radius_m"] + 200.0
        assert not _is_filled(page, *beyond)
        scene.stage.show({**shown, "threats": [{**shown["threats"][0], "growth_m": 345.0}]})
        expect(page.locator("#threats-table tbody .col-growth")).to_have_text("345 m")
        assert _is_filled(page, *beyond)


def _is_filled(page: Page, north_m: float, east_m: float) -> bool:
    """Return whether the map draws anything at a place."""
    x, y = _drawn_at(page, north_m, east_m)
    return bool(
        page.evaluate(
            """([x, y]) => {
              const canvas = window.groundStationPage.map.canvas;
              const box = canvas.getBoundingClientRect();
              const copy = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
              copy.drawImage(canvas, x - box.left, y - box.top, 1, 1, 0, 0, 1, 1);
              return copy.getImageData(0, 0, 1, 1).data[3] > 0;
            }""",
            [x, y],
        )
    )


def test_tiles_of_a_local_folder_lie_under_the_mission(browser: Browser, tmp_path: Path) -> None:
    x, y = (8.0 + 180.0) / 360.0, 0.5 - math.asinh(math.tan(math.radians(47.0))) / math.tau
    for zoom in range(9, 15):
        tile = tmp_path / str(zoom) / str(int(x * 2**zoom)) / f"{int(y * 2**zoom)}.png"
        tile.parent.mkdir(parents=True)
        tile.write_bytes(TILE)
    stage = Stage()
    stage.show(picture())
    with served(stage, Site(tiles=tmp_path)) as url:
        tab = Tab(browser, url)
        expect(tab.page.locator(".leaflet-tile-loaded").first).to_be_attached()
        assert tab.hosts() == {"127.0.0.1"}
        tab.close()
