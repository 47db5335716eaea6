"""A program as an estimator: a line a sample on its standard input, a line a tilt on its standard
output.
"""

import os
import select
import subprocess
import time
from collections.abc import Mapping, Sequence
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.setup.setup import Setup

PATIENCE = 10.0  # s for one answer


class Process:
    """Feeds ``time_s,<readings of each sensor in SI, in the scenario's order>`` and reads
    ``tilt_x,tilt_y``, rad.

    Cells of a sensor that was not sampled are empty. The next sample is written only after the
    answer to the last: a program cannot look ahead, and has to flush every line.

    Args:
        command: words of the program; no shell.
        setup: whose sensors are fed.

    Raises:
        TiltcalError: it does not start, ends early, does not answer in time, or answers with
            something else.
    """

    def __init__(self, command: Sequence[str], setup: Setup) -> None:
        self.name, self.rest = command[0], b""
        self.sensors = [(s.name, len(s.axes)) for s in setup.sensor]
        try:
            self.process = subprocess.Popen(
                list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
            )
        except OSError as error:
            raise TiltcalError(
                f"command {self.name}",
                found=str(error),
                need="a program that runs",
                do="check the path",
            ) from error

    def update(self, sample: Mapping[str, Any]) -> tuple[float, float]:
        """Tilt of x and y, rad."""
        cells = [repr(float(sample["time_s"]))]
        for name, axes in self.sensors:
            cells += [repr(float(v)) for v in sample[name]] if name in sample else [""] * axes
        pipe = self.process.stdin
        try:
            if pipe is not None:
                pipe.write((",".join(cells) + "\n").encode())
        except OSError:
            raise self._broken("a program that has ended") from None
        line = self._line()
        try:
            x, y = (float(cell) for cell in line.split(","))
        except ValueError:
            raise self._broken(f"the answer '{line[:60]}'") from None
        return x, y

    def _line(self) -> str:
        """The next line of its output."""
        assert self.process.stdout is not None
        fd, end = self.process.stdout.fileno(), time.monotonic() + PATIENCE
        while b"\n" not in self.rest:
            ready, _, _ = select.select([fd], [], [], max(end - time.monotonic(), 0.0))
            if not ready:
                raise self._broken(f"no answer within {PATIENCE:g} s")
            more = os.read(fd, 65536)
            if not more:
                raise self._broken("a program that has ended")
            self.rest += more
        line, _, self.rest = self.rest.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _broken(self, found: str) -> TiltcalError:
        self.close()
        return TiltcalError(
            f"command {self.name}",
            found=found,
            need="a line 'tilt_x,tilt_y' in rad for every sample",
            do="flush standard output after each line",
        )

    def close(self) -> None:
        """End the program."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self.process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
