"""The command lines that mutated files are given to."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """A command line.

    Args:
        words: as typed; ``@name`` is an input file.
        weight: how often it is drawn.
        beside: further input files that it reads.
    """

    words: str
    weight: float = 1.0
    beside: tuple[str, ...] = ()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The files it reads."""
        named = tuple(word[1:] for word in self.words.split() if word.startswith("@"))
        return named + self.beside

    @property
    def arguments(self) -> list[str]:
        """The arguments of the command line."""
        return [word.removeprefix("@") for word in self.words.split()]


METHODS: Mapping[str, str] = {
    "bench": "six_position",
    "norm": "norm",
    "incl": "two_position",
    "placing": "placing_table",
    "fog": "fog_scale",
    "turns": "gyro_turns",
    "rates": "gyro_rates",
    "north": "north",
}
LOOKED = (
    "looked/investigation.json",
    "looked/diagnosis_0/diagnosis.json",
    "looked/diagnosis_0/amended.toml",
)
RESUME = "investigate --scenario @bench.toml --lab true --resume -o looked"
SHARD = ("shard/results.journal", "shard/results.campaign.json")
SPLIT = "design --split @found/diagnosis.json --scenario @bench.toml --recordings @bench.csv"
LOGS = ("h5", "tdms", "bag", "ulg", "mat", "npz", "mcap", "txt")
LINES = (
    Line("simulate @bench.toml -o out.csv --truth truth.json", 6),
    Line("simulate @bench.toml -o out.npz --noise off --seed 3", 2),
    Line("simulate @bench.toml -o out.parquet", 1),
    Line("simulate @bench.toml", 1),
    Line("simulate @bench.toml --motion @bench.csv -o out.csv", 2),
    Line("simulate @bench.toml --motion @bench.npz -o out.csv", 1),
    Line("simulate @found/amended.toml --motion @bench.csv --noise off -o out.csv", 1),
    Line("simulate @norm.toml --motion @norm.csv -o out.csv", 1),
    *(
        Line(f"calibrate @{k}.csv --scenario @{k}.toml --method {m} -o OUT.json", 3)
        for k, m in METHODS.items()
    ),
    Line("calibrate @bench.npz --scenario @bench.toml --method six_position -o OUT.json", 3),
    Line("calibrate @bench.parquet --scenario @bench.toml --method six_position -o OUT.json", 3),
    Line("calibrate @bench.csv --scenario @bench.toml --method six_position --segments @SEG.csv"),
    Line("calibrate @bench.csv --scenario @bench.toml --method six_position --budget --json", 2),
    Line("calibrate @bench.csv --scenario @bench.toml --method six_position --option terms=6", 2),
    Line("calibrate @bench.csv --scenario @bench.toml --method own:nothing", 1, ("own.py",)),
    Line("correct @CAL.json @bench.csv -o out.csv", 5),
    Line("correct @CAL.json @bench.npz -o out.csv", 2),
    Line("correct @CAL.json @bench.parquet -o out.parquet", 2),
    Line("correct @CAL.json @bench.csv", 1),
    Line("correct @TABLE.json @placing.csv -o out.csv", 2),
    Line("check @CAL.json @bench.csv --scenario @bench.toml --limit-arcsec 100", 3),
    Line("check @TABLE.json @placing.csv --scenario @placing.toml --json", 1),
    Line("segments @bench.csv -o OUT.csv --window 0.5", 3),
    Line("segments @bench.npz --json", 1),
    Line("segments @bench.parquet", 1),
    Line("noise @still.csv", 2),
    Line("init --from @bench.csv -o out.toml", 2),
    Line("init --from @bench.npz -o out.toml", 1),
    Line("init --latitude 48 --height 200 -o out.toml", 1),
    Line("import @log.txt --map @map.toml -o out.csv", 5),
    Line("export @TABLE.json --name tab -o out.h", 3),
    Line("lab @bench.toml @sequence.csv out.csv --seed 3", 5),
    Line("effects acc_bias", 1),
    Line("confuse @bench.toml", 0.5),
    Line("explain-frames @bench.toml", 1),
    Line("run @bench.toml -o out", 1.5),
    Line("run @bench.toml --json", 1),
    Line("verify @bench.toml -o out", 1),
    Line("diagnose @bench.csv --scenario @bench.toml -o out", 0.8),
    Line("diagnose @bench.csv --scenario @bench.toml --static @still.csv", 0.3),
    Line(RESUME, 2, ("bench.csv", *LOOKED)),
    Line("campaign @campaign.toml -o out", 0.15, ("bench.toml",)),
    Line("sweep @bench.toml --effect acc_bias.bias_x_ug=0:1:2 --seeds 1 -o out", 0.15),
    Line("design @bench.toml --terms bias --budget-s 120 -o out", 0.05),
    Line(
        "design --split @found/diagnosis.json --scenario @bench.toml --recordings @bench.csv", 0.3
    ),
    Line("merge shard -o out", 0.5, SHARD),
    Line("prove --kinds none --n 1", 0.05),
    *(Line(f"import @log.{ending} --propose -o out.toml", 1) for ending in LOGS),
    Line("import @log4.mat --propose", 1),
    Line("import @log.h5 --map @h5.toml -o out.csv", 2),
    Line("import @sysid.yaml --scenario @found/amended.toml -o out.toml", 2),
    Line("compare @CAL.json @LATER.json -o out", 3),
    Line("combine @CAL.json @LATER.json -o OUT.json", 3),
    Line("certificate @CAL.json -o out.html --dcc out.xml --date 2026-11-23", 3),
    Line("export @CAL.json -o out.h --vectors vectors.csv", 2),
    Line("export @CAL.json --format px4 -o out.params", 1),
    Line("export @CAL.json --format ardupilot -o out.param", 1),
    Line("export @still.csv --format kalibr -o out.yaml", 1),
    Line("export @still.csv --format sdf --calibration @CAL.json -o out.sdf", 1),
    Line("export @found/amended.toml -o out.yaml", 1),
    Line("export @bench.csv -o out.mcap", 1),
    Line("correct @found/amended.toml @bench.csv -o out.csv", 2),
    Line("check @found/amended.toml @bench.csv --scenario @bench.toml", 1),
    Line("estimate @bench.csv --scenario @bench.toml --estimator accelerometer -o out.csv", 1),
    Line("view @bench.toml -o out.html", 1),
    Line("view @bench.csv --scenario @bench.toml -o out.html", 1),
    Line("view @plan/design.toml -o out.html", 1),
    Line("lab @bench.toml @plan/steps.csv out.csv", 1),
    Line("simulate @arm.toml -o out.csv", 5, ("arm.xml",)),
    Line("view @arm.toml -o out.html", 1, ("arm.xml",)),
    Line("methods", 0.2),
    Line("completion bash", 0.2),
)
