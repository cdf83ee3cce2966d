"""Health and figures for monitoring: whether frames are sent, and what a picture says in numbers.

The figures are those of the newest picture, so that whoever watches them sees what the page shows.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from groundstation.web.hub import Hub

STALE_S = 5.0
"""Age of the newest picture from which the ground station counts as silent: it comes once a second."""
LEAST_SILENT_S = 5.0
SILENT_PERIODS = 3.0
"""Broadcast periods without a frame, and LEAST_SILENT_S, after which the broadcast counts as silent."""
DIRECTIVES = ("normal", "hold", "return")


def unhealthy(hub: Hub, mode: str) -> str | None:
    """Return why the ground station is not well; None while frames are sent, and in a playback."""
    if mode == "playback":
        return None
    picture, age_s = hub.picture, hub.picture_age_s
    if picture is None:
        return "the ground station has shown nothing yet"
    if age_s > STALE_S:
        return f"the ground station has shown nothing for {age_s:.0f} s"
    sent_s = picture["broadcast"].get("last_frame_age_s")
    period_s = 0.0 if hub.mission is None else float(hub.mission.get("broadcast_period_s", 0.0))
    if sent_s is None:
        return "no frame was sent yet"
    if sent_s + age_s > max(LEAST_SILENT_S, SILENT_PERIODS * period_s):
        return f"no frame was sent for {sent_s + age_s:.0f} s"
    return None


class _PictureCollector(Collector):
    """The figures of a hub's newest picture."""

    def __init__(self, hub: Hub, mode: str) -> None:
        self._hub = hub
        self._mode = mode

    def collect(self) -> Iterator[Metric]:
        """Yield all figures; without a picture only whether the ground station is well."""
        hub = self._hub
        yield _gauge("healthy", "1 while frames are sent", float(unhealthy(hub, self._mode) is None))
        yield _gauge("browsers", "Streams that are open", float(hub.browsers))
        requests = CounterMetricFamily("oneway_http_requests", "Requests answered, by status", labels=["status"])
        for status, count in sorted(hub.answered.items()):
            requests.add_metric([str(status)], count)
        yield requests
        if hub.picture is not None:
            yield _gauge("picture_age_seconds", "Age of the newest picture", hub.picture_age_s)
            yield from _of_picture(hub.picture)
            yield from _of_broadcast(hub.picture["broadcast"])
            yield from _of_sources(hub.picture["sources"])


def metrics_text(hub: Hub, mode: str) -> bytes:
    """Return all figures in the text format of Prometheus."""
    registry = CollectorRegistry()
    registry.register(_PictureCollector(hub, mode))
    return generate_latest(registry)


def _of_picture(picture: Mapping[str, Any]) -> Iterator[Metric]:
    states = Counter(agent["state"] for agent in picture["agents"])
    agents = GaugeMetricFamily("oneway_agents", "Agents, by state", labels=["state"])
    for state in sorted({"under way", "arrived", "lost", "out", "recalled", "no target", *states}):
        agents.add_metric([state], states[state])
    yield agents
    oldest_s = max((agent["age_s"] for agent in picture["agents"]), default=0.0)
    yield _gauge("agent_age_seconds_max", "Age of the oldest place of an agent", oldest_s)
    reached = sum(1 for target in picture["targets"] if target["reached_by"])
    targets = GaugeMetricFamily("oneway_targets", "Targets, open or reached", labels=["state"])
    targets.add_metric(["open"], len(picture["targets"]) - reached)
    targets.add_metric(["reached"], reached)
    yield targets
    yield _gauge("threats", "Threats", len(picture["threats"]))
    yield _gauge("unknown_detections", "Things detected that the mission does not have", len(picture["unknown"]))
    yield _gauge("revision", "Revision of the picture that is broadcast", picture["revision"])
    yield _gauge("event", "Number of the last event", picture["event"])
    yield _gauge("paused", "1 in a pause", float(picture["paused"]))
    directive = GaugeMetricFamily("oneway_directive", "1 for what all agents are told", labels=["directive"])
    for name in DIRECTIVES:
        directive.add_metric([name], float(picture["directive"] == name))
    yield directive


def _of_broadcast(broadcast: Mapping[str, Any]) -> Iterator[Metric]:
    for key, name, words in (
        ("bytes_per_s", "broadcast_bytes_per_second", "Bytes sent in a second"),
        ("budget_bytes_per_s", "broadcast_budget_bytes_per_second", "Bytes that a second may have"),
        ("last_frame_age_s", "last_frame_age_seconds", "Time since the last frame"),
    ):
        if broadcast.get(key) is not None:
            yield _gauge(name, words, broadcast[key])
    for key, words in (("frames", "Frames sent"), ("bytes", "Bytes sent")):
        if broadcast.get(key) is not None:
            yield CounterMetricFamily(f"oneway_broadcast_{key}", words, value=broadcast[key])
    items = GaugeMetricFamily("oneway_broadcast_item_age_seconds", "Time since a kind was sent last", labels=["item"])
    for item in broadcast.get("items", ()):
        items.add_metric([item["name"]], item["age_s"])
    yield items


def _of_sources(sources: list[Mapping[str, Any]]) -> Iterator[Metric]:
    good = GaugeMetricFamily("oneway_source_good", "1 while a source is good", labels=["source", "kind"])
    rates = GaugeMetricFamily("oneway_source_rate_hertz", "Observations in a second", labels=["source", "kind"])
    for source in sources:
        labels = [str(source["name"]), str(source["kind"])]
        good.add_metric(labels, float(source["state"] == "good"))
        rates.add_metric(labels, float(source["rate_hz"] or 0.0))
    yield good
    yield rates


def _gauge(name: str, words: str, value: float) -> Metric:
    return GaugeMetricFamily(f"oneway_{name}", words, value=float(value))
