# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A calibration, from the recording to the certificate
#
# A triad visits six faces on a dual-axis table. Here the table is simulated; with a real recording
# the second cell is `recording = tc.read("run.csv")`.

# %%
import tempfile
from pathlib import Path

import tiltcal as tc

ROOT = Path(tc.__file__).parents[1]
bench = tc.load_scenario(ROOT / "scenarios" / "six_faces_dual.toml")

# %%
recording = bench.simulate(seed=7)
recording

# %% [markdown]
# ## The dwells
#
# Nothing in a recording says where a dwell begins: they are found.

# %%
dwells = [s for s in tc.find_segments(recording) if s.kind == "dwell"]
for dwell in dwells:
    print(f"{dwell.start:6.2f} ... {dwell.end:6.2f} s  {dwell.label}")

# %% [markdown]
# ## The calibration
#
# The verdict is `good` when the recording determines every term and each test of validity passed.

# %%
calibration = bench.calibrate(recording, "six_position")
assert calibration.verdict == "good"
calibration

# %%
for test in calibration.tests:
    print("passed" if test.passed else "FAILED", "-", test.statement)

# %% [markdown]
# ## Does it hold on another recording?

# %%
check = bench.check(calibration, bench.simulate(seed=8))
assert check.accepted
check

# %% [markdown]
# ## Corrected readings, and the certificate
#
# The certificate adds the uncertainty budget: noise of the record, and the references.

# %%
corrected = tc.correct(calibration, recording)
print([name for name in corrected.column_names if "corrected" in name or "tilt" in name])

# %%
certificate = bench.certify(recording, "six_position", tc.Stated(serial="0042"))
folder = Path(tempfile.mkdtemp())
certificate.save(folder / "certificate.html")
calibration.save(folder / "CAL.json")
for name, value, U, unit in zip(*certificate.as_columns().values(), strict=True):
    print(f"{name:16} {value:12.5g} +- {U:.2g} {unit}")
