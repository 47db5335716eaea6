"""Two simple diagnosers to compare with, on the columns of `tiltcal diagnose` and white noise:
forward selection by BIC, and sparse regression.

    python -m tests.benchmarks.baselines greedy diagnose REC --scenario SCENARIO -o DIR

takes the place of `tiltcal` in `tiltcal prove --diagnoser`; other commands go to `tiltcal`.
"""

import argparse
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiltcal.api.diagnosing import write_results
from tiltcal.core.arrays import Array
from tiltcal.diagnosis.data_faults.prepare import PreparedData
from tiltcal.diagnosis.diagnose import diagnose
from tiltcal.diagnosis.hypotheses.priors import UNLISTED
from tiltcal.diagnosis.model.finding_tests import NoiseSource
from tiltcal.diagnosis.model.fitted_model import FittedModel, FittedTerm
from tiltcal.diagnosis.model.normal_equations import normal_equations
from tiltcal.diagnosis.model.refitting import refit
from tiltcal.diagnosis.model.whitened_model import WhitenedModel
from tiltcal.diagnosis.search.candidates import Names
from tiltcal.diagnosis.search.explained import Explained
from tiltcal.laboratory.scenario import load_scenario
from tiltcal.recordings.recording_files import read_recording
from tiltcal.statistics.noise_spectrum import white_noise

MOST = 5  # causes
SCREENED = 60  # hypotheses that the sparse regression is made of
PENALTIES = 40  # of the path, from the largest correlation to a hundredth of it
SWEEPS = 200

Selection = Callable[[FittedModel, WhitenedModel], FittedModel]


def greedy(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """Forward selection by the Bayesian information criterion (Schwarz 1978)."""
    price = np.log(whitened.observations.samples)
    while len(fitted.terms) < MOST:
        scores = whitened.scores(fitted.basis, fitted.residual)
        worth = [gain - dof * price for gain, dof in (s.gain() for s in scores)]
        best = int(np.argmax(worth))
        if worth[best] <= 0:
            break
        terms = (*fitted.terms, FittedTerm.start(scores[best].hypothesis))
        fitted = refit(replace(fitted, terms=terms), whitened)
    return fitted


def sparse(fitted: FittedModel, whitened: WhitenedModel) -> FittedModel:
    """Lasso (Tibshirani 1996) over the columns of the hypotheses that explain most each (sure
    independence screening: Fan and Lv 2008), its penalty by BIC; refitted by least squares.
    """
    gains = [s.gain()[0] for s in whitened.scores(fitted.basis, fitted.residual)]
    members = [int(k) for k in np.argsort(gains)[::-1][:SCREENED] if gains[int(k)] > 0]
    normal = normal_equations(members, fitted.basis, fitted.residual, whitened)
    size = np.sqrt(np.diag(normal.gram))
    size[size == 0] = np.inf
    used = _lasso(
        normal.gram / np.outer(size, size),
        normal.target / size,
        np.log(whitened.observations.samples),
    )
    names: dict[int, list[str]] = {}
    for i in used:
        names.setdefault(normal.owner[i], []).append(normal.names[i])
    strongest = sorted(names, key=lambda k: -gains[k])[:MOST]
    terms = tuple(FittedTerm.start(whitened.hypotheses[k], names[k]) for k in strongest)
    return refit(replace(fitted, terms=terms), whitened)


def _lasso(gram: Array, target: Array, price: float) -> list[int]:
    """Columns with a size other than 0 at the penalty of the least BIC, by coordinate descent.

    Args:
        gram: inner products of columns of unit length, (p, p); target: with the data, (p,).
        price: of one column, of deviance.
    """
    best, least, size, left = list[int](), 0.0, np.zeros(len(target)), np.array(target)
    for penalty in np.abs(target).max(initial=0.0) * np.geomspace(1, 1e-2, PENALTIES):
        for _ in range(SWEEPS):
            before = size.copy()
            for i in np.flatnonzero((np.abs(left) > penalty) | (size != 0)):
                along = left[i] + gram[i, i] * size[i]
                new = np.sign(along) * max(abs(along) - penalty, 0.0)
                if new != size[i]:
                    left -= gram[:, i] * (new - size[i])
                    size[i] = new
            if np.abs(size - before).max(initial=0.0) < 1e-3 * penalty:
                break
        used = [int(i) for i in np.flatnonzero(size)]
        fit = np.linalg.lstsq(gram[np.ix_(used, used)], target[used], rcond=1e-9)[0]
        cost = price * len(used) - float(target[used] @ fit)
        if cost < least:
            best, least = used, cost
    return best


def explained(prepared: PreparedData, select: Selection) -> Explained:
    """What a selection comes to; its answers are certain."""
    start, columns = prepared.start, prepared.whitened
    whitened = columns.under([white_noise(m.white) for m in columns.noise])
    fitted = select(refit(start, whitened), whitened)
    noise_source = NoiseSource(None, len(whitened.hypotheses))
    laws = [fitted.terms[places[0]].hypothesis for places in fitted.findings()]
    names = tuple(
        Names({law.id: 1.0}, (law.id,), ()) if law.listed else Names({UNLISTED: 1.0}, (), ())
        for law in laws
    )
    left = noise_source.left_by(fitted, whitened)
    return Explained(fitted, left, (), noise_source, names, (1.0,) * len(laws), ())


SELECTIONS: dict[str, Selection] = {"greedy": greedy, "sparse": sparse}


def main(arguments: Sequence[str]) -> int:
    """Exit status."""
    method, command, *rest = arguments
    if command != "diagnose":
        return subprocess.run(
            [sys.executable, "-m", "tiltcal", command, *rest], check=False
        ).returncode
    parser = argparse.ArgumentParser()
    parser.add_argument("recording", type=Path)
    parser.add_argument("--scenario", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args(rest)
    scenario, data = load_scenario(given.scenario), [read_recording(given.recording)]
    found = diagnose(
        scenario, data, search=lambda prepared: explained(prepared, SELECTIONS[method])
    )
    write_results(found, given.output, scenario, data, [given.recording])
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
