"""Every option of the commands and methods with every odd value, one after another."""

import inspect
from collections.abc import Iterator, Mapping

from tests.fuzz.cases import Case
from tests.fuzz.commands import METHODS
from tiltcal.calibration.methods.registry import METHODS as BUILT_IN

DESIGN = "design bench.toml --terms bias --budget-s 60 -o out"
COMMANDS: Mapping[str, str] = {
    DESIGN: "--seed --terms --nuisance --textbook --criterion --grade --prior --range-deg --sensor"
    " --budget-s --rate-deg-s --settle-s --dwell-s --angles --step-deg --floor-ug"
    " --all-effects-observable",
    "investigate bench.csv --scenario bench.toml --lab true -o out": "--blocks --budget-min"
    " --block-min --rate-deg-s --dwell-s --angles",
    "sweep bench.toml --effect acc_bias.bias_x_ug=0:1:2 --seeds 1 -o out": "--effect --field"
    " --seeds --time-limit --memory-limit",
    "campaign campaign.toml -o out": "--shard --time-limit --memory-limit",
    "check CAL.json bench.csv --scenario bench.toml": "--limit-arcsec",
    "init -o x.toml": "--latitude --height",
    "segments bench.csv": "--window",
    "simulate bench.toml -o r.csv": "--seed --noise --allow-rows --allow-memory --allow-hours",
    "lab bench.toml sequence.csv r.csv": "--seed",
    "run bench.toml": "--engine",
}
VALUES = (
    *("nan", "inf", "-inf", "-1", "0", "1e308", "1e-308", "", "x", "9" * 23, "all", "1/0"),
    *("outer=nan:1", "outer=0:inf", "outer=5:5"),
)
OF_METHODS = ("nan", "inf", "-1", "0", "[]", "{}", '""', "1e308", "[1,2]", "true", "x", "[nan]")


def option_cases(originals: Mapping[str, bytes], methods_only: bool = False) -> list[Case]:
    """All of them; ``methods_only``: only the options of methods."""
    found = list(lines_of_methods()) + ([] if methods_only else list(lines_of_commands()))
    files = {name: originals[name] for name in originals if "/" not in name}
    return [
        Case(k, tuple(words), {n: files[n] for n in files if n in words or n == "bench.toml"}, "")
        for k, words in enumerate(found)
    ]


def lines_of_commands() -> Iterator[list[str]]:
    """Command lines with one odd value of an option."""
    for line, options in COMMANDS.items():
        for option in options.split():
            for value in VALUES:
                words = line.split()
                if option in words:
                    words[words.index(option) + 1] = value
                else:
                    words += [option, value]
                yield words


def lines_of_methods() -> Iterator[list[str]]:
    """Command lines of `calibrate` with one odd value of an option of the method."""
    for name, method in METHODS.items():
        line = f"calibrate {name}.csv --scenario {name}.toml --method {method}".split()
        accepted = inspect.signature(BUILT_IN[method]).parameters.items()
        for key in (k for k, p in accepted if p.kind is p.KEYWORD_ONLY):
            for value in OF_METHODS:
                yield [*line, "--option", f"{key}={value}"]
