"""Mutations of command lines."""

import numpy as np

VALUES = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "1e308",
    "1e-308",
    "1000000000000",
    "99999999999999999999999",
    "",
    " ",
    "x",
    "0.5",
    ",",
    "=",
    "a=",
    "terms=[]",
    "terms=nan",
    "terms=-1",
    "terms={}",
    "poses=[]",
    "[]",
    "{}",
    "\udcff",
    "\x1b[31m",
    "é",
    "a" * 300,
    "a" * 5000,
    "outer=0:nan",
    "outer=:",
    "acc_bias.bias_x_ug=0:1:1000000000",
    "acc_bias.bias_x_ug=nan:1:2",
    "acc_bias.bias_x_ug=0:1:0",
    "1/0",
    "0/1",
    "own:fails",
    "own:np",
    "nothere:x",
    "os:getcwd",
    ":",
    ".:x",
    "..a:b",
    "six_position",
    "norm",
    "gyro_rates",
    "/dev/null",
    "/dev/zero",
    "/dev/full",
    "/proc/self/mem",
    "/proc",
    ".",
    "none/out.csv",
    "bench.toml",
    "bench.csv",
    "CAL.json",
    "out.npz",
    "out.txt",
    "pipe",
    "loop",
    "-",
    "--",
)
OPTIONS = (
    "--json",
    "--seed",
    "--noise",
    "--motion",
    "--truth",
    "--option",
    "--segments",
    "--budget",
    "--window",
    "--limit-arcsec",
    "--name",
    "--latitude",
    "--height",
    "--json-schema",
    "--method",
    "--scenario",
    "--static",
    "--check",
    "--block-min",
    "--rate-deg-s",
    "--dwell-s",
    "--angles",
    "--blocks",
    "--budget-min",
    "--terms",
    "--prior",
    "--range-deg",
    "--shard",
    "--seeds",
    "--effect",
    "--field",
    "-o",
    "--help",
    "--nothing",
)


def mutated_arguments(words: list[str], rng: np.random.Generator) -> list[str]:
    """A command line with values replaced, or words taken away, put in, moved or repeated."""
    words = list(words)
    for _ in range(int(rng.integers(1, 3))):
        kind, at = rng.random(), int(rng.integers(1, len(words) + 1))
        if kind < 0.5 and at < len(words):
            words[at] = odd_word(rng)
        elif kind < 0.6 and at < len(words):
            del words[at]
        elif kind < 0.9:
            words += [OPTIONS[rng.integers(len(OPTIONS))]]
            words += [odd_word(rng)] if rng.random() < 0.8 else []
        elif kind < 0.95:
            words += words[at:]
        else:
            words.insert(at, odd_word(rng))
    return tamed(words)


def tamed(words: list[str]) -> list[str]:
    """Without what would leave the case's folder or start many processes."""
    banned = {"--install", "--jobs", "-j", "--engine"}
    return [word for word in words if word not in banned]


def odd_word(rng: np.random.Generator) -> str:
    """One of the odd values."""
    return VALUES[rng.integers(len(VALUES))]
