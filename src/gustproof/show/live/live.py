"""The live page: it starts flights, one after another, and shows each to the end, beside those before.

    real time   vehicle --telemetry--> GroundStation --> TelemetryBuffer --> page
    lockstep    vehicle --> journal --> follow_journal --> TelemetryBuffer --> page
    both        vehicle --> journal --> requirement status, command age --> TelemetryBuffer --> page

In lockstep the ground station provides mode, link and parameters only.
The page changes two parameters of the flight over MAVLink: the scale of the gusts and, in lockstep, the pause.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event, Thread
from typing import Any, Self

import numpy as np

from firmware_model.autopilot.parameters import GUST_SCALE_NAME, PAUSE_NAME, Parameters, published_limit
from firmware_model.config.requirement import Metric
from firmware_model.config.scenario import Scenario
from firmware_model.config.timeline import timeline
from firmware_model.config.vehicle import Vehicle
from firmware_model.process import udp
from firmware_model.recording.journal import RECORD, read_journal
from firmware_model.types import AXES
from gustproof.flight.controllers.external_autopilot import AnyController
from gustproof.show.live.ground_station import STREAM_US, GroundStation
from gustproof.show.live.journal_follower import follow_journal
from gustproof.show.live.requirement_status import requirement_status
from gustproof.show.live.server import LOOPBACK, PageServer, parse_bool, parse_number
from gustproof.show.live.telemetry_buffer import SERIES, TelemetryBuffer
from gustproof.types import Records

_JOIN_TIMEOUT_S = 30.0  # for threads with little left to do, on a machine that may be busy
_ABSENCE_S = 3.0  # without an open page, as while one is loaded again, until no other flight is expected
_JUDGE_S = 0.5
_JUDGE_SHARE = 0.05  # of a core: judging takes longer as the flight grows
_NO_RECORDS = np.empty(0, dtype=RECORD)


class LivePage:
    """The page and its data sources; a context manager that leaves no thread and no socket behind.

    The page lets choose from `controllers`, at least one.
    """

    def __init__(
        self,
        scenario: Scenario,
        controllers: Sequence[AnyController],
        vehicle: Vehicle,
        *,
        real_time: bool,
    ) -> None:
        self._scenario, self._vehicle, self._real_time = scenario, vehicle, real_time
        self._every = max(round(STREAM_US / scenario.sample_us), 1)
        parameters = Parameters(vehicle, scenario)
        self._gust = parameters.table[parameters.index(GUST_SCALE_NAME) or 0]
        laws = [each.name for each in controllers]
        self._buffer = TelemetryBuffer(
            scenario=scenario.name, laws=laws, law=laws[0], vehicle=vehicle.name, duration_s=scenario.duration_s,
            real_time=real_time, phase="ready", message="", mode="", armed=False, paused=False, texts=[], link=None,
            bands=[span._asdict() for span in timeline(scenario)], limits=_limits(scenario, vehicle), commands=[],
            has_report=False, goes_on=False, compiling=0,
            gust_scale=self._gust.default, gust_scale_limits=[self._gust.minimum, self._gust.maximum],
            lights=requirement_status(_NO_RECORDS, scenario, vehicle, over=False),
        )  # fmt: skip
        self._started, self._done = Event(), Event()
        self._law, self._controllers = 0, controllers
        self._requests: dict[str, float] = {}
        self._station: GroundStation | None = None
        self._threads: list[Thread] = []
        self._report: Callable[[], str] | None = None
        handlers: dict[str, Callable[[Any], None]] = {
            "start": self._start,
            "gust": self._set_gust,
            "law": self._set_law,
        }
        if not real_time:
            handlers["pause"] = self._pause
        self._server = PageServer(self._buffer, handlers, {"report": lambda: self._report() if self._report else ""})

    @property
    def address(self) -> str:
        """Address of the page."""
        return self._server.address

    def tell_compiling(self, about_s: int) -> None:
        """Say how long [s] it takes to compile, once after an installation; 0 when it is done."""
        self._buffer.update(compiling=about_s)

    def wait(self) -> int:
        """Return the number of the law to fly, once the page starts the flight; Ctrl-C ends this."""
        while not self._started.wait(0.2):
            pass
        return self._law

    def wait_again(self) -> int | None:
        """Return the number of the law to fly once more; `None` when no page is open any longer, or at Ctrl-C."""
        self._buffer.update(goes_on=True)
        seen_s = time.monotonic()
        try:
            while not self._started.wait(0.2):
                if self._server.readers:
                    seen_s = time.monotonic()
                elif time.monotonic() - seen_s > _ABSENCE_S:
                    return None
        except KeyboardInterrupt:
            return None
        finally:
            self._buffer.update(goes_on=False)
        return self._law

    def watch(self, port: int | None, journal: Path) -> None:
        """Show the flight of the vehicle that listens on `port` and writes `journal`.

        This is the `on_listening` of `processes.fly`. Parameters that the page has set already reach the vehicle before
        the flight begins. A real autopilot has no port: its journal is all that comes here.
        """
        if port is not None:
            limit, peer = published_limit(self._vehicle), (0, (LOOPBACK, port))
            self._station = GroundStation(peer, self._buffer, limit, streams=self._real_time)
            for name, value in self._requests.items():
                self._station.set_parameter(name, value)
            self._run(_serve, self._station)
        names = SERIES if port is None or not self._real_time else ("age",)  # no message has the age
        self._run(follow_journal, journal, self._every, self._scenario.sample_us, self._buffer, self._done, names)
        if self._scenario.require:
            self._run(self._judge, journal)
        if port is not None and self._station is not None:
            self._station.parameters_confirmed.wait(_JOIN_TIMEOUT_S)
        self._buffer.update(phase="flying")

    def end(
        self,
        message: str,
        records: Records = _NO_RECORDS,
        commands: Sequence[str] = (),
        report: Callable[[], str] | None = None,
    ) -> None:
        """Show the end of the flight, the requirement status of its journal records (n,), and `commands` to go on.

        `report` returns the report on the flights so far as HTML, for the page that asks for it.
        """
        self._done.set()
        if self._station is not None:
            self._station.end()
        for thread in self._threads:
            thread.join(_JOIN_TIMEOUT_S)
        status = self._status(records, over=True)
        self._threads, self._station = [], None
        self._requests.pop(PAUSE_NAME, None)
        self._report = report or self._report
        shown = {"message": message, "lights": status, "commands": [*commands]}
        self._buffer.update(phase="over", paused=False, has_report=self._report is not None, **shown)
        self._started.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._buffer["phase"] != "over":
            self.end("the flight broke off")
        self._server.server_close()

    def _run(self, function: Callable[..., None], *arguments: Any) -> None:
        thread = Thread(target=function, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _judge(self, journal: Path) -> None:
        spent_s = 0.0
        while not self._done.wait(max(_JUDGE_S, spent_s / _JUDGE_SHARE)):
            begun_s = time.thread_time()
            _, records = read_journal(journal)
            self._buffer.update(lights=self._status(records, over=False))
            spent_s = time.thread_time() - begun_s

    def _status(self, records: Records, *, over: bool) -> list[dict[str, Any]]:
        law = self._controllers[self._law]
        return requirement_status(records, self._scenario, self._vehicle, over=over, law=law)

    def _start(self, value: Any) -> None:
        is_over = self._buffer["phase"] == "over"
        if not parse_bool(value) or self._started.is_set() or (is_over and not self._buffer["goes_on"]):
            return
        chosen = {"phase": "starting", "message": "", "law": self._buffer["laws"][self._law], "texts": []}
        if is_over:
            self._done.clear()
            self._buffer.restart(**chosen, lights=self._status(_NO_RECORDS, over=False))
        else:
            self._buffer.update(**chosen)
        self._started.set()

    def _set_law(self, value: Any) -> None:
        number = parse_number(value, 0, len(self._buffer["laws"]) - 1)
        if self._started.is_set():
            raise ValueError("a flight is under way")
        self._law = int(number)
        if self._buffer["phase"] == "ready":
            self._buffer.update(law=self._buffer["laws"][self._law])

    def _pause(self, value: Any) -> None:
        self._request(PAUSE_NAME, float(parse_bool(value)))

    def _set_gust(self, value: Any) -> None:
        scale = parse_number(value, self._gust.minimum, self._gust.maximum)
        if not self._started.is_set():
            self._buffer.update(gust_scale=scale)
        self._request(GUST_SCALE_NAME, scale)

    def _request(self, name: str, value: float) -> None:
        self._requests[name] = value
        if self._station is not None:
            self._station.set_parameter(name, value)


def _limits(scenario: Scenario, vehicle: Vehicle) -> dict[str, list[dict[str, Any]]]:
    """Return lines for the charts by series: torque limits [N*m], and peaks of the angles [deg] in their windows."""
    end_s = scenario.duration_s
    torque = [{"axis": i, "value": limit, "from_s": 0.0, "to_s": end_s} for i, limit in enumerate(vehicle.torque_limit)]
    peaks = [
        {
            "axis": None if each.axis is None else AXES.index(each.axis),
            "value": each.at_most,
            "from_s": each.from_s,
            "to_s": end_s if each.to_s is None else each.to_s,
        }
        for each in scenario.require
        if each.metric is Metric.PEAK and each.at_most is not None and not scenario.references
    ]
    return {"angles": peaks, "torque": torque}


def _serve(station: GroundStation) -> None:
    with udp.bind(0, LOOPBACK) as bound:
        udp.serve(station, [bound])
