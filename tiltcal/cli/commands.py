"""All commands by group: the function behind each, and its line in ``tiltcal --help``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A command.

    Args:
        target: module of ``tiltcal.cli`` and function, ``module:function``; imported on use.
        summary: first sentence of the function's docstring.
    """

    target: str
    summary: str


RECORDINGS = {
    "simulate": Command("simulate:simulate", "Simulate a recording of a scenario in MuJoCo."),
    "init": Command("init:init", "Write a commented scenario to start from."),
    "import": Command("import_log:import_log", "Import a log from another system."),
    "datasets": Command(
        "datasets:datasets", "List published recordings, or get one from its owner."
    ),
    "segments": Command("segments:segments", "Find the dwells and moves of a recording."),
    "noise": Command(
        "noise:noise", "Estimate Allan coefficients from a recording at rest, and test them."
    ),
    "view": Command("view:view", "Write a page with the table in motion."),
    "film": Command("view:film", "Write a film of the table in motion."),
}
CALIBRATION = {
    "calibrate": Command(
        "calibrate:calibrate", "Estimate parameters with covariance, tests and a verdict."
    ),
    "guide": Command(
        "guide:guide", "Guide a calibration while it is recorded: next pose, sigmas, faults."
    ),
    "correct": Command("correct:correct", "Correct a recording, streaming in constant memory."),
    "estimate": Command(
        "estimate:estimate", "Feed a recorded file to an estimator, sample by sample."
    ),
    "check": Command("check:check", "Check a calibration against another recording."),
    "compare": Command(
        "compare:compare", "Compare calibrations over the working range: do they say the same?"
    ),
    "combine": Command(
        "combine:combine",
        "Combine calibrations of one instrument: of a room and a chamber, of several days.",
    ),
    "certificate": Command("certificate:certificate", "Write the certificate of a calibration."),
    "export": Command(
        "export:export", "Export a calibration, noise, effects or a recording for other programs."
    ),
    "methods": Command("methods:methods", "List the calibration methods."),
}
DIAGNOSIS = {
    "diagnose": Command(
        "diagnose:diagnose", "Locate, name and model physics that the scenario leaves out."
    ),
    "investigate": Command(
        "investigate:investigate",
        "Diagnose, record what separates the alternatives, and repeat until explained.",
    ),
    "lab": Command("lab:lab", "Record a sequence file in a simulated laboratory."),
    "serve": Command("serve:serve", "Serve a simulated rate table and its instrument over TCP."),
    "record": Command("record:record", "Record a sequence file on a served table."),
    "effects": Command("effects:effects", "List the physical effects, or explain one."),
}
DESIGN = {
    "design": Command(
        "design:design", "Find the sequence of poses with the most information per table time."
    ),
    "confuse": Command(
        "confuse:confuse", "Show which effects a recording of a scenario can separate."
    ),
    "explain-frames": Command(
        "explain_frames:explain_frames",
        "Show what each channel reads at the six faces and after small turns.",
    ),
}
VALIDATION = {
    "run": Command("verify:run", "Simulate, calibrate and judge scenarios."),
    "verify": Command("verify:verify", "Run a folder of scenarios and write CI reports."),
    "campaign": Command(
        "campaign:campaign", "Run a scenario over seeds, grids and distributions of its fields."
    ),
    "sweep": Command("campaign:sweep", "Run a scenario over sizes of an effect."),
    "merge": Command("campaign:merge", "Merge the shards of a campaign."),
    "prove": Command("prove:prove", "Run blind trials of `diagnose` and report its success rates."),
    "demo": Command("demo:demo", "Run a tour of the main functions."),
}
SHELL = {
    "app": Command(
        "app_command:bench_app",
        "Open the bench in a browser: import, calibrate, diagnose and plan.",
    ),
    "completion": Command(
        "completion:completion", "Print or install the completion script of a shell."
    ),
}
GROUPS = {
    "Recordings": RECORDINGS,
    "Calibration": CALIBRATION,
    "Diagnosis": DIAGNOSIS,
    "Design of measurements": DESIGN,
    "Validation": VALIDATION,
    "Shell": SHELL,
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}
