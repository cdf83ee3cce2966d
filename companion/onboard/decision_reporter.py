"""Reports each decision to the terminal, systemd, the logs, ground-control programs and the ground station."""

from __future__ import annotations

from companion.onboard.broadcast_monitor import BroadcastMonitor
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.onboard.decision import Decision
from companion.onboard.flight_log import summary_line
from companion.onboard.log_folder import LogFolder
from companion.onboard.loop_watch import LoopWatch
from companion.onboard.output import AutopilotOutput
from companion.onboard.senses import sense_of_others
from companion.onboard.statustext import StatusReporter
from companion.onboard.uplink import Uplink
from companion.runtime.console import program_logger
from companion.runtime.rate import Evenness
from companion.runtime.systemd import Notifier

LOGGER = program_logger("companion")


class DecisionReporter:
    """Reports each decision to all who are to know of it; a line that stays the same is printed and logged once."""

    def __init__(
        self,
        companion: Companion,
        output: AutopilotOutput,
        logs: LogFolder,
        notifier: Notifier,
        uplink: Uplink | None,
        watch: LoopWatch,
    ) -> None:
        """Report the decisions of `companion` as its configuration wants; `uplink`, if any, takes position reports.

        `watch` tells what holds up the setpoint loop.
        """
        self._companion = companion
        self._output = output
        self._logs = logs
        self._notifier = notifier
        self._uplink = uplink
        self._lateness = watch.stalls.lateness
        self._broadcast = BroadcastMonitor(companion)
        self._monitors = (self._broadcast, watch)
        self._statustext = _statustext(companion.config)
        is_signed = companion.config.broadcast is None or companion.config.broadcast.trust != "unsigned"
        self._trust = "" if is_signed else ", unsigned"
        self._sense: str | None = None
        """What was said last of the vehicle's sense of the others."""
        self._said: set[str] = set()
        """Lines printed for the last decision."""

    def tell(self, decision: Decision, now_s: float) -> None:
        """Report, log and print a decision, and send the vehicle's position report on the uplink if one is due."""
        if self._uplink is not None:
            self._uplink.send(self._companion.report(now_s), now_s)
        line = summary_line(decision) + self._trust
        if self._output.waits_for_mavsdk:
            line += ", MAVSDK is not ready yet"
        if self._broadcast.stopped_by is not None:
            # In front, because a ground-control program shows the first 50 characters of a long line for sure.
            line = f"{self._broadcast.stopped_by}; {line}"
        self._say(line, now_s)
        self._statustext.note(decision, line, insists=self._companion.is_waited_for(decision))
        self._send_values(decision, now_s)
        if self._logs.decisions is not None:
            evenness = Evenness(self._output.decision_gaps.recent.take(), self._lateness.of_decision.take())
            self._logs.decisions.add(decision, self._companion.adapter.telemetry, evenness)

    def send_text(self, now_s: float) -> None:
        """Send the newest line to ground-control programs, unless it was sent already or the last one too recently."""
        for frame in self._statustext.text(now_s, self._companion.adapter.telemetry.system_id):
            self._output.send_status(frame)

    def _say(self, line: str, now_s: float) -> None:
        told = [news for monitor in self._monitors for news in monitor.news(now_s)]
        for news in [*told, *self._sense_news(), line]:
            if news not in self._said:
                LOGGER.info("%s", news)
                self._logs.vehicle.tell(now_s, news)
        if self._said != {line}:
            self._notifier.status(line)
        self._said = {line}

    def _sense_news(self) -> list[str]:
        """Return by what the vehicle knows where the others are, if that changed and enough is known to say it."""
        companion, adapter = self._companion, self._companion.adapter
        if not adapter.parameters_known or companion.world_model.origin_deg is None:
            return []
        told = companion.world_model.others_told
        sense = sense_of_others(companion.config, told, adapter.sees_others, adapter.asks_for_others)
        if sense.words == self._sense:
            return []
        self._sense = sense.words
        return [sense.words if sense.exists else f"warning: {sense.words}"]

    def _send_values(self, decision: Decision, now_s: float) -> None:
        if self._statustext.values_due(now_s):
            evenness = Evenness(self._output.gaps.recent.take(), self._lateness.recent.take())
            system_id = self._companion.adapter.telemetry.system_id
            for frame in self._statustext.values(now_s, system_id, decision, evenness):
                self._output.send_status(frame)


def _statustext(config: Config) -> StatusReporter:
    """Return the reporter to ground-control programs, which in Case II is quiet unless the configuration differs."""
    quiet = config.case == "II" if config.status.quiet is None else config.status.quiet
    return StatusReporter(config.status.period_s, quiet)
