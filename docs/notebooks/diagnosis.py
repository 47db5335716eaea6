# ---
# jupyter:
#   jupytext:
#     formats: py:percent
# ---

# %% [markdown]
# # A diagnosis: which physics does the scenario leave out?
#
# A recording is made with an effect that the honest scenario does not name. The diagnosis gets the
# recording and the honest scenario only.

# %%
import tempfile
import tomllib
from pathlib import Path

import tiltcal as tc

ROOT = Path(tc.__file__).parents[1]
honest = tomllib.loads((ROOT / "scenarios" / "six_faces_dual.toml").read_text(encoding="utf-8"))
honest.pop("method", None)
honest["sensor"][0]["rate_hz"] = 20
honest["sequence"] = [{"action": "scheme", "scheme": "12", "dwell_s": 4}]
concealed = honest | {"effect": [*honest["effect"], {"id": "acc_K2", "k2_x_ug_g2": 900.0}]}

# %%
recording = tc.parse_scenario(concealed).simulate(seed=11)
recording

# %% [markdown]
# ## The diagnosis

# %%
scenario = tc.parse_scenario(honest)
diagnosis = scenario.diagnose(recording)
diagnosis

# %%
for finding in diagnosis.findings:
    print(finding.statement)
    print("next:", finding.next_measurement)
assert "acc_K2" in {name for finding in diagnosis.findings for name in finding.names}

# %% [markdown]
# ## The amended scenario
#
# It holds what was found, and predicts a new recording of the same set-up. Diagnosing that one with
# it finds nothing more.

# %%
amended = tc.parse_scenario(dict(diagnosis.amended), "amended")
other = tc.parse_scenario(concealed).simulate(seed=12)
again = amended.diagnose(other)
print(again.headline())
assert again.verdict == "match"

# %%
folder = Path(tempfile.mkdtemp())
diagnosis.save(folder)
print(sorted(path.name for path in folder.iterdir()))
