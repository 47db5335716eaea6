"""An exported header compiled with the system's C compiler and run on this machine."""

import shutil
import subprocess
from pathlib import Path

import numpy as np

SOURCE = Path(__file__).with_name("firmware_host.c")
STRICT = ("-O2", "-Wall", "-Wextra", "-Werror", "-std=c11", "-pedantic")


def compiler() -> str | None:
    """The system's C compiler."""
    return next((found for name in ("cc", "gcc", "clang") if (found := shutil.which(name))), None)


def build(header: Path, *flags: str) -> Path:
    """A program around a header whose names begin with ``level``."""
    program = header.with_name(
        header.stem + "_" + "_".join(f.strip("-D").lower() for f in flags) or header.stem
    )
    command = [
        str(compiler()),
        *STRICT,
        *flags,
        f'-DTABLE="{header}"',
        str(SOURCE),
        "-o",
        str(program),
        "-lm",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return program


def run(program: Path, what: str, samples: np.ndarray) -> tuple[np.ndarray, float]:
    """Answers of the program, (n, 2), and its nanoseconds a sample. samples: (n, 3)."""
    given, answer = program.with_suffix(".in"), program.with_suffix(".out")
    given.write_bytes(np.ascontiguousarray(samples, dtype=float).tobytes())
    words = [str(program), what, str(len(samples)), str(given), str(answer)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return np.fromfile(answer).reshape(-1, 2), float(done.stderr)
