"""A real or scripted laboratory behind a command: a sequence file in, a recording out."""

import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.recordings.recording import Recording
from tiltcal.recordings.recording_files import read_recording


@dataclass(frozen=True)
class CommandLaboratory:
    """Called as ``COMMAND SEQUENCE.csv RECORDING.csv``, without a shell.

    Args:
        words: of the command.
    """

    words: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> "CommandLaboratory":
        """From one text with quotes.

        Raises:
            TiltcalError: it is empty, or a quote is not closed.
        """
        try:
            words = tuple(shlex.split(text))
        except ValueError as error:
            raise TiltcalError(
                "--lab", found=f"{text!r} ({error})", need="a command", do="close the quotes"
            ) from error
        if not words:
            raise TiltcalError(
                "--lab",
                found="nothing",
                need="a command",
                do="name the program that records a sequence",
            )
        return cls(words)

    def record(self, sequence: Path, recording: Path) -> Recording:
        """Have a sequence recorded; the recording takes its name only when it can be read.

        Raises:
            TiltcalError: the program is not there, fails, or writes nothing that can be read.
        """
        part = recording.with_name(f".part-{recording.name}")
        part.unlink(missing_ok=True)
        subject = f"laboratory {self.words[0]}"
        again = "put it right and run again with --resume: what is recorded is kept"
        try:
            try:
                done = subprocess.run(
                    [*self.words, str(sequence), str(part)], capture_output=True, check=False
                )
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
                raise TiltcalError(
                    subject, found=reason, need="a program that can be run", do=again
                ) from error
            if done.returncode != 0:
                said = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [
                    "no message"
                ]
                raise TiltcalError(
                    subject,
                    found=f"exit status {done.returncode} ({said[0]})",
                    need="exit status 0",
                    do=again,
                )
            if not part.is_file() or part.stat().st_size == 0:
                raise TiltcalError(
                    subject,
                    found="no recording written",
                    need=f"the file {recording.name}",
                    do=again,
                )
            read_recording(part)
            part.replace(recording)
        finally:
            part.unlink(missing_ok=True)
        return read_recording(recording)
