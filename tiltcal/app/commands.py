"""The command of every action, word by word: what a page runs, and what it shows to be copied."""

from collections.abc import Sequence

Words = list[str]


def file(name: str) -> str:
    """The name of a file as a word that is no option."""
    return f"./{name}" if name.startswith("-") else name


def propose(log: str, mapping: str) -> Words:
    """Propose how a log is to be read."""
    return ["import", file(log), "--propose", "-o", file(mapping)]


def import_log(log: str, mapping: str, recording: str, repairs: Sequence[str]) -> Words:
    """Import a log by its mapping."""
    repaired = ["--repair", *repairs] if repairs else []
    return ["import", file(log), "--map", file(mapping), *repaired, "-o", file(recording)]


def get_dataset(name: str, folder: str) -> Words:
    """Get a published recording from its owner."""
    return ["datasets", "get", name, "-o", file(folder)]


def init(recording: str, latitude: float, height: float, table: str, scenario: str) -> Words:
    """Write a scenario.

    Args:
        recording: that it describes; empty: that of a bench to start from.
        latitude: deg.
        height: m.
        table: its name; empty: that of the recording, or one of two axes.
        scenario: file to write.
    """
    source = ["--from", file(recording)] if recording else []
    where = [f"--latitude={latitude:.10g}", f"--height={height:.10g}"]
    return ["init", *source, *where, *(["--table", table] if table else []), "-o", file(scenario)]


def segments(recording: str, output: str) -> Words:
    """Find the dwells and moves."""
    return ["segments", file(recording), "-o", file(output)]


def methods(recording: str, scenario: str, dwells: str) -> Words:
    """Which methods a recording allows."""
    return ["methods", file(recording), "--scenario", file(scenario), *_segments(dwells)]


def calibrate(
    recordings: Sequence[str],
    scenario: str,
    method: str,
    output: str,
    *,
    options: Sequence[str] = (),
    dwells: str = "",
    budget: bool = False,
) -> Words:
    """Calibrate."""
    given = [word for text in options for word in ("--option", text)]
    return [
        "calibrate",
        *map(file, recordings),
        "--scenario",
        file(scenario),
        "--method",
        method,
        *given,
        *_segments(dwells),
        *(["--budget"] if budget else []),
        "-o",
        file(output),
    ]


def certify(calibrating: Words, page: str, dcc: str, stated: Sequence[tuple[str, str]]) -> Words:
    """Calibrate with a certificate.

    Args:
        calibrating: the command of the calibration.
        page: HTML to write.
        dcc: XML to write; empty: none.
        stated: by the laboratory, by the name of the option.
    """
    texts = [f"--{name}={text}" for name, text in stated if text]
    return [*calibrating, "--report", file(page), *(["--dcc", file(dcc)] if dcc else []), *texts]


def check(calibration: str, recording: str, scenario: str) -> Words:
    """Check a calibration against another recording."""
    return ["check", file(calibration), file(recording), "--scenario", file(scenario)]


def compare(calibrations: Sequence[str], folder: str) -> Words:
    """Compare calibrations over the working range."""
    return ["compare", *map(file, calibrations), "-o", file(folder)]


def combine(calibrations: Sequence[str], output: str) -> Words:
    """Combine calibrations of one instrument."""
    return ["combine", *map(file, calibrations), "-o", file(output)]


def export(calibration: str, form: str, output: str) -> Words:
    """Export a calibration for firmware or an autopilot."""
    return ["export", file(calibration), "--format", form, "-o", file(output)]


def diagnose(recordings: Sequence[str], scenario: str, static: str, folder: str) -> Words:
    """Find what a scenario leaves out."""
    still = ["--static", file(static)] if static else []
    words = ["diagnose", *map(file, recordings), "--scenario", file(scenario), *still]
    return [*words, "-o", file(folder)]


def predict(amended: str, recording: str, output: str) -> Words:
    """What the amended model says that the recording should have read."""
    motion = ["--motion", file(recording), "--noise", "off"]
    return ["simulate", file(amended), *motion, "-o", file(output)]


def design(
    scenario: str,
    folder: str,
    *,
    budget_s: float,
    rate_deg_s: float,
    settle_s: float,
    dwell_s: tuple[float, float],
    range_deg: float,
    grade: str,
    criterion: str,
    angles: Sequence[str] = (),
    goals: Sequence[str] = (),
) -> Words:
    """Design a sequence of poses."""
    numbers = {
        "--budget-s": budget_s,
        "--rate-deg-s": rate_deg_s,
        "--settle-s": settle_s,
        "--range-deg": range_deg,
    }
    return [
        "design",
        file(scenario),
        *(word for name, value in numbers.items() for word in (name, f"{value:.10g}")),
        "--dwell-s",
        *(f"{value:.10g}" for value in dwell_s),
        "--grade",
        grade,
        "--criterion",
        criterion,
        *(f"--angles={text}" for text in angles),
        *(f"--goal={text}" for text in goals),
        "-o",
        file(folder),
    ]


def design_next(
    diagnosis: str,
    scenario: str,
    folder: str,
    *,
    budget_s: float,
    rate_deg_s: float,
    angles: Sequence[str] = (),
) -> Words:
    """Design the recording that separates the alternatives of a diagnosis."""
    limits = ["--budget-s", f"{budget_s:.10g}", "--rate-deg-s", f"{rate_deg_s:.10g}"]
    words = ["design", "--split", file(diagnosis), "--scenario", file(scenario), *limits]
    return [*words, *(f"--angles={text}" for text in angles), "-o", file(folder)]


def record(table: str, sequence: str, recording: str) -> Words:
    """Record a sequence on a served table."""
    return ["record", file(table), file(sequence), file(recording)]


def simulate_sequence(scenario: str, sequence: str, recording: str) -> Words:
    """Record a sequence in a simulated laboratory."""
    return ["lab", file(scenario), file(sequence), file(recording)]


def _segments(dwells: str) -> Words:
    return ["--segments", file(dwells)] if dwells else []
