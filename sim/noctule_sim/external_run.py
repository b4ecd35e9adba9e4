"""A flight of a real autopilot against the companion's processes: the closed loop of run.Runner around external.External.

A sweep is stamped T, reaches the companion the laser's latency later, and what the companion answers takes effect at T plus the
whole latency, whatever the wall clock did. The physics waits for the autopilot at each inertial sample, and for the companion at
each sweep.
"""

from __future__ import annotations

import time
from pathlib import Path

from .external import AutopilotGone, External
from .passage import Passage
from .run import CONNECT_WAIT_S, LASER_LATENCY_S, Runner
from .simulation import Outcome, Simulation, TickData


class ExternalRunner(Runner):
    """Flies a simulation whose autopilot is a real one.

    Args:
        simulation: with `external` set.
        link: the MAVLink between the two, see passage.Passage.
        program: the autopilot's program (sitl.Program), or None when the user runs it.
        others: as of run.Runner.
    """

    def __init__(self, simulation: Simulation, link: Passage, lcm_url: str, camera_lcm_url: str | None = None, folder: Path | None = None,
                 realtime: bool = False, program=None):
        super().__init__(simulation, 0, lcm_url, camera_lcm_url, folder, realtime, link)
        self.external: External = simulation.external
        self.external.attach(simulation)
        self.external.on_time = self._on_time
        self.external.stop = lambda: self.stop
        self._program = program
        self._due: TickData | None = None
        self._laser_us = int(round(LASER_LATENCY_S * 1e6))
        self._answer_us = int(round(simulation.profile.answer_latency_s * 1e6))
        self._connect_end = None

    def run(self) -> Outcome:
        """As Runner.run; ends with the outcome autopilot_lost when the autopilot's program does."""
        try:
            return super().run()
        except AutopilotGone as error:
            if self.stop:
                self.simulation.outcome = Outcome("interrupted", "interrupted")
            else:
                self.simulation.outcome = Outcome("autopilot_lost", str(error))
                self.reasons.append(str(error))
            self.close()
            return self.simulation.outcome

    def close(self) -> None:
        super().close()
        self.external.close()
        if self._program is not None:
            self._program.end()

    def summary(self) -> dict:
        return {**super().summary(), "odometry_received": self.link.odometry_passed, "odometry_used": None,
                "setpoints_received": self.link.setpoints_passed, "autopilot": self.external.flavour}

    def _wait_for_companion(self) -> None:
        self.external.connect(self._problem)

    def _problem(self) -> str | None:
        return self._program.problem() if self._program is not None else None

    def _publish(self, tick: TickData) -> None:
        for severity, text in tick.messages:
            print(f"{tick.t_us * 1e-6:8.2f} s  autopilot, severity {severity}: {text}", flush=True)
        self.external.ranges(tick, self.link)
        if self.link.companion_heard and self.link.imu_heard:
            self._due = tick
        if tick.image is not None:
            self._publish_image(tick)

    def _await(self, tick: TickData) -> None:
        if self.realtime:
            self._pace(self._started + tick.t_us * 1e-6)

    def _on_time(self, t_us: int) -> None:
        self.link.pump(t_us)
        tick = self._due
        if tick is None or t_us < tick.t_us + self._laser_us:
            return
        self._due = None
        if self._connect_end is None:
            self._connect_end = time.monotonic() + CONNECT_WAIT_S
        self.link.hold_until(tick.t_us + self._answer_us)
        self._publish_scan(tick)
        if not self.realtime:
            super()._await(tick)
