"""A page in which a designed sequence follows its settings.

marimo run docs/notebooks/design_explorer.py
"""

import marimo

app = marimo.App(width="medium", app_title="Design explorer")


@app.cell
def _():
    from pathlib import Path

    import marimo as mo

    import tiltcal as tc

    bench = tc.load_scenario(Path(tc.__file__).parents[1] / "scenarios" / "six_faces_dual.toml")
    mo.md("# Which poses to record\n\nA dual-axis table and a triad; see `docs/design.md`.")
    return bench, mo, tc


@app.cell
def _(mo):
    budget = mo.ui.slider(40, 600, step=20, value=120, label="table time, s", show_value=True)
    settle = mo.ui.slider(0, 20, step=1, value=5, label="settling after a move, s", show_value=True)
    reach = mo.ui.slider(
        45, 180, step=15, value=180, label="tilt of the outer axis up to, deg", show_value=True
    )
    criterion = mo.ui.dropdown(["both", "tilt", "D", "A"], value="both", label="criterion")
    mo.vstack([budget, settle, reach, criterion])
    return budget, criterion, reach, settle


@app.cell
def _(budget, criterion, reach, settle):
    settings = {
        "budget_s": float(budget.value),
        "settle_s": float(settle.value),
        "criterion": criterion.value,
        "angles_deg": {"outer": (-float(reach.value), float(reach.value))},
    }
    return (settings,)


@app.cell
def _(bench, mo, settings, tc):
    try:
        design, refusal = bench.design(terms=("bias", "scale"), nuisance=(), **settings), ""
    except tc.TiltcalError as error:
        design, refusal = None, str(error)
    mo.md(refusal or design.headline())
    return design, refusal


@app.cell
def _(design, mo):
    mo.stop(design is None)
    poses = [{n: round(v, 2) for n, v in pose.items()} for pose in design.to_arrow().to_pylist()]
    mo.ui.table(poses, selection=None, pagination=False)
    return


@app.cell
def _(design, mo):
    mo.stop(design is None)
    expected = [
        {
            "parameter": p["name"],
            "before": p["prior"],
            "expected": float(f"{p['sigma']:.3g}"),
            "unit": p["unit"],
        }
        for p in design.plan.to_json()["parameters"]
    ]
    mo.ui.table(expected, selection=None, pagination=False)
    return (expected,)


if __name__ == "__main__":
    app.run()
