"""An exported header run over its own test vectors, in floating point and in integers."""

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cortex_m0 import Target
from host import STRICT, compiler

from tiltcal.calibration.firmware.fixed_temperature import READ_PLACES
from tiltcal.recordings.recording import Recording

C99 = tuple("-std=c99" if flag.startswith("-std=") else flag for flag in STRICT)
HOST = """
#include <stdio.h>
{head}
#include "{header}"
int main(void)
{{
  double row[2 + {inputs}], out[{outputs}], last = 0;
  int first = 1, n;
  {state}
  while (fread(row, sizeof row, 1, stdin) == 1) {{
    const double t = row[0], c = row[1];
    {real} in[{inputs}], f[{outputs}];
    for (n = 0; n < {inputs}; n++)
      in[n] = ({real})row[2 + n];
    {temperature}
    first = 0;
    last = t;
    {correct}
    for (n = 0; n < {outputs}; n++)
      out[n] = (double)f[n];
    if (fwrite(out, sizeof out, 1, stdout) != 1)
      return 1;
  }}
  return (first + (last > 0)) > 2;
}}
"""


@dataclass(frozen=True)
class Case:
    """One sensor of a header.

    Args:
        header: file; name: prefix of its names; sensor: whose function is called.
        inputs, outputs: columns of the vectors.
        forced: whether the last three inputs are the force.
        thermal: whether it has a state.
    """

    header: Path
    name: str
    sensor: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    forced: bool = False
    thermal: bool = False

    def run(self, vectors: Recording, places: int | None, *flags: str) -> np.ndarray:
        """What the header gives for each row; ``places`` of integers, None in floating point."""
        rows = np.column_stack([vectors.column(c) for c in self.inputs])
        heat, time = np.zeros(len(rows)), vectors.time.copy()
        if self.thermal:
            heat = vectors.column("temperature_degC")
        if places is not None:
            rows, heat = np.round(rows * 2.0**places), np.round(heat * 2.0**READ_PLACES)
            time = np.round(time * 1e6)
        lines = np.column_stack([time, heat, rows])
        program = self.compiled(places is not None, *flags)
        given = np.ascontiguousarray(lines, dtype=float).tobytes()
        done = subprocess.run([program], input=given, capture_output=True, check=False)
        assert (done.returncode, done.stderr) == (0, b""), done.stderr
        return np.frombuffer(done.stdout).reshape(-1, len(self.outputs))

    def target(self) -> Target:
        """The integers of it on a Cortex-M0, in the middle of 25 degC where it has a state."""
        given = ("&state, " if self.thermal else "") + "in, "
        given += f"in + {len(self.inputs) - 3}, " if self.forced else ""
        warm = "{ (int64_t)25 << 40, (int64_t)25 << 40, 0 }"
        state = f"static const {self.name}_fixed_state state = {warm};"
        call = f"return {self.name}_{self.sensor}_fixed({given}f);"
        call = f"{state}\n  {call}" if self.thermal else call
        return Target(self.header, call, f"{self.name.upper()}_FIXED_ONLY")

    def compiled(self, fixed: bool, *flags: str) -> str:
        """The program, by the strict rules of C99."""
        end = "_fixed" if fixed else ""
        real = "int32_t" if fixed else f"{self.name}_real"
        step = "(uint32_t)(t - last)" if fixed else f"({real})(t - last)"
        if self.thermal:
            state = f"{self.name}{end}_state s = {{0}};"
            temperature = (
                f"if (first) {self.name}_start{end}(&s, ({real})c);"
                f" else {self.name}_step{end}(&s, ({real})c, {step});"
            )
        else:
            state, temperature = "", "(void)c;"
        given = ("&s, " if self.thermal else "") + "in, "
        given += f"in + {len(self.inputs) - 3}, " if self.forced else ""
        source = self.header.with_suffix(".c")
        source.write_text(
            HOST.format(
                head="#include <stdint.h>",
                header=self.header.name,
                inputs=len(self.inputs),
                outputs=len(self.outputs),
                state=state,
                real=real,
                temperature=temperature,
                correct=f"{self.name}_{self.sensor}{end}({given}f);",
            )
        )
        program = str(self.header.with_suffix(".run"))
        only = [f"-D{self.name.upper()}_FIXED_ONLY"] if fixed else []
        words = [str(compiler()), *C99, *only, *flags, str(source), "-o", program, "-lm"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        return program
